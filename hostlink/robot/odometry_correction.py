"""OdometryCorrection: what a robot's odometry would be with the wheels that it truly has. Pure.

A robot integrates its wheels with the numbers that it was given. The way of each wheel between two of its poses follows
from these poses; multiplied by the factor of that wheel and integrated with the true separation, it is a better pose.
"""

import math
from typing import NamedTuple

from hostlink.robot.kinematics import Pose, chord_per_arc, wrap_angle
from hostlink.robot.velocity import PlanarVelocity


class WheelWay(NamedTuple):
    """How far each wheel rolled between two poses, by the robot's own numbers."""

    left_m: float
    right_m: float
    sideways_m: float  # of the chord: what no arc explains, because the robot bent between the two poses


class OdometryCorrection(NamedTuple):
    """Of one robot: factors of its wheels' radii, and the separation that it believes and has."""

    left_factor: float = 1.0
    right_factor: float = 1.0
    nominal_separation_m: float = 0.210  # with which the robot integrates
    separation_m: float = 0.210  # the true one

    def advance(self, pose: Pose, before: Pose, after: Pose) -> Pose:
        """Where the robot is that was truly at `pose` when its own odometry went from `before` to `after`."""
        way = wheel_way(before, after, self.nominal_separation_m)
        left_m, right_m = way.left_m * self.left_factor, way.right_m * self.right_factor
        turned_rad = (right_m - left_m) / self.separation_m
        chord_m = (left_m + right_m) / 2 * chord_per_arc(turned_rad)
        heading_rad = pose.theta_rad + turned_rad / 2
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return Pose(
            pose.x_m + chord_m * cos - way.sideways_m * sin,
            pose.y_m + chord_m * sin + way.sideways_m * cos,
            wrap_angle(pose.theta_rad + turned_rad),
        )

    def velocity(self, measured: PlanarVelocity) -> PlanarVelocity:
        """The true motion of a robot that measures this one. Wheels say nothing of a sideways motion: it is kept."""
        turning_m_s = measured.yaw_rad_s * self.nominal_separation_m / 2
        left_m_s = (measured.x_m_s - turning_m_s) * self.left_factor
        right_m_s = (measured.x_m_s + turning_m_s) * self.right_factor
        yaw_rad_s = (right_m_s - left_m_s) / self.separation_m
        return PlanarVelocity((left_m_s + right_m_s) / 2, measured.y_m_s, yaw_rad_s)


def wheel_way(before: Pose, after: Pose, separation_m: float) -> WheelWay:
    """How far each wheel rolled along the arc between two poses."""
    turned_rad = wrap_angle(after.theta_rad - before.theta_rad)
    heading_rad = before.theta_rad + turned_rad / 2  # of the arc's chord
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    dx_m, dy_m = after.x_m - before.x_m, after.y_m - before.y_m
    arc_m = (dx_m * cos + dy_m * sin) / chord_per_arc(turned_rad)
    turning_m = turned_rad * separation_m / 2
    return WheelWay(arc_m - turning_m, arc_m + turning_m, dy_m * cos - dx_m * sin)
