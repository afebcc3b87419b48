"""Caster: the swivel wheel behind the axle, which twists the robot while it swings round. Pure.

The twin of firmware/host/caster.cpp, operation by operation. Its wheel rolls freely along its heading b and scrubs
across it, so its pivot pulls the tail sideways by cos(b) while it swings: over a swing that sums up to the change of
sin(b). Wheels that turn the robot on the spot hold it against that; wheels that roll straight do not (the paper's
"overturning"): cos2 of the pivot's course is the share.
"""

import math

from hostlink.sim.random_numbers import RandomNumbers
from hostlink.sim.world_parameters import WorldParameters

STREAM = 3
_TRAILS_RAD = 0.1  # nearer to its course it trails
_SWINGS_RAD = 0.5  # farther from it a new swing has begun
_LEAST_OFF_RAD = 0.05  # no caster stands exactly against its course
_HALF = 0.5


class Caster:
    """The caster of one world."""

    def __init__(self) -> None:
        self.heading_rad = 0.0  # where it rolls to, in the robot's frame
        self._factor = 1.0  # of this swing's twist
        self._is_swinging = False
        self._is_ahead = True  # its heading has a part forwards
        self.be(WorldParameters())

    def be(self, world: WorldParameters) -> None:
        """Another caster from now on, that points the same way."""
        self._world = world
        self._random = RandomNumbers(int(world.seed), STREAM)

    def step(self, forward_m: float, turned_rad: float) -> float:
        """The robot moved this far; returns by how much the caster twists it."""
        world = self._world
        side_m = -world.caster_arm_m * turned_rad
        way_m = math.sqrt(forward_m * forward_m + side_m * side_m)
        if way_m == 0.0:
            return 0.0
        course_rad = math.atan2(side_m, forward_m)
        off_rad = self._begin(_half_turn(course_rad - self.heading_rad))
        after_rad = 2.0 * math.atan(math.tan(off_rad / 2.0) * math.exp(-way_m / world.caster_trail_m))
        before_sin = math.sin(course_rad - off_rad)
        heading_rad = course_rad - after_rad
        straight = forward_m / way_m
        twist_rad = world.caster_twist_rad * self._factor * straight * straight * (math.sin(heading_rad) - before_sin)
        self.heading_rad = _half_turn(heading_rad - turned_rad - twist_rad)
        return twist_rad

    def resistance(self, forward_m: float, turned_rad: float) -> float:
        """How much it stands in the way of such a motion: 0 it trails, 1 it points the other way."""
        side_m = -self._world.caster_arm_m * turned_rad
        if forward_m == 0.0 and side_m == 0.0:
            return 0.0
        return (1.0 - math.cos(math.atan2(side_m, forward_m) - self.heading_rad)) / 2.0

    def _begin(self, off_rad: float) -> float:
        """Draw the strength of a swing that begins or passes the right angle; and the side, where that is open."""
        size_rad = abs(off_rad)
        is_ahead = math.cos(self.heading_rad) >= 0.0
        begins = not self._is_swinging and size_rad > _SWINGS_RAD
        if begins or (self._is_swinging and is_ahead != self._is_ahead):
            self._factor = 1.0 + self._world.caster_random * self._random.normal()
        if begins:
            self._is_swinging = True
        elif size_rad < _TRAILS_RAD:
            self._is_swinging = False
        self._is_ahead = is_ahead
        if math.pi - size_rad >= _LEAST_OFF_RAD:
            return off_rad
        return (math.pi - _LEAST_OFF_RAD) * (1.0 if self._random.uniform() < _HALF else -1.0)


def _half_turn(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return angle_rad - math.tau * math.floor((angle_rad + math.pi) / math.tau)
