"""Course: straight lines and turns on the spot, and the velocity that follows them by odometry. Pure."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from hostlink.core.robot.kinematics import Pose, wrap_angle

SETTLE_S = 1.2  # at zero after each leg: a robot stops within 0.6 s, and its poses are a tenth of a second late
STOP_LAG_S = 0.05  # from a pose to the end of its command's effect; each leg learns that of this robot
LONGEST_LAG_S = 0.5
POSE_INTERVAL_S = 0.1  # until two poses have come
MAX_CORRECTIONS = 2  # of one leg: a robot that follows badly must not turn to and fro
CLOSE_M, CLOSE_RAD = 0.001, 0.003  # a leg whose end is so near is done, and half a pose at the lowest speed more
SLOW_M_S, SLOW_RAD_S = 0.08, 0.3  # at the end of a leg; at lower speeds a geared motor does not turn
SLOW_FROM_M, SLOW_FROM_RAD = 0.15, 0.5  # what then remains
HEADING_PER_S = 1.5  # of a heading's error: how a line is followed
SIDEWAYS_RAD_PER_M = 2.0  # the heading that leads back to the line
TURN_STEP_RAD_S = 0.1  # a robot that ramps to each new command would never get anywhere with one for each pose
KEPT_STEPS = 0.6  # what is nearer to the present step leaves it; at a half, each tick of a wheel would change it
MOST_TURN_RAD_S = 0.3  # while driving on
STUCK_S = 2.0  # without progress; from rest the paper's firmware has gone 7 cm by then
STUCK_M, STUCK_RAD = 0.02, 0.05  # a smaller step does not count as progress


class Leg(NamedTuple):
    """A way forward, or a turn on the spot, counter-clockwise."""

    forward_m: float = 0.0
    turn_rad: float = 0.0


class Speed(NamedTuple):
    """Speeds of a course."""

    linear_m_s: float = 0.2
    angular_rad_s: float = 0.8


def straight(length_m: float) -> tuple[Leg, ...]:
    """One line."""
    return (Leg(forward_m=length_m),)


def turns(count: int, way: int) -> tuple[Leg, ...]:
    """Whole turns on the spot; `way` 1: counter-clockwise, -1: clockwise."""
    return (Leg(turn_rad=way * count * math.tau),)


def square(side_m: float, way: int) -> tuple[Leg, ...]:
    """Four sides, each with a quarter of a turn after it; at the end the robot is as it began."""
    return (Leg(forward_m=side_m), Leg(turn_rad=way * math.pi / 2)) * 4


class CourseFollower:
    """Decides the velocity at each pose. The corners are at the places of the course, independent of earlier errors.

    A leg ends at the pose that is nearest to its end, counting the way that the robot still moves after the zero. Each
    end teaches that way. If the robot settles away from the end, it drives the rest, forwards or back.

    A robot whose odometry does not advance as commanded is stopped: it may be driving all the same.
    """

    def __init__(self, legs: Sequence[Leg], speed: Speed = Speed()) -> None:  # noqa: B008 - a tuple never changes
        self.is_done = not legs
        self.is_stuck = False
        self._legs, self._speed = list(legs), speed
        self._start = Pose()  # of this leg, as the course has it
        self._heading_rad = 0.0  # whole turns stay in it
        self._last: Pose | None = None
        self._updated_s = math.nan
        self._interval_s = POSE_INTERVAL_S  # between two poses
        self._settled_at_s: float | None = None
        self._progress = _Progress()
        self._steps = 0  # of the turn back to the line
        self._corrections = 0  # of this leg
        self._began_s: float | None = None  # when the robot began to move, on this leg or on its rest
        self._lag_s = STOP_LAG_S
        self._ended_at = (0.0, 1.0)  # what was left at the zero, and the speed before it

    @property
    def legs_left(self) -> int:
        """Number of legs that are not done."""
        return len(self._legs)

    @property
    def is_settling(self) -> bool:
        """Whether the end of a leg was reached, and the robot is given time to stop, or drives the rest."""
        return self._settled_at_s is not None or self._corrections > 0

    def update(self, pose: Pose, now_s: float) -> tuple[float, float]:
        """The velocity (m/s, rad/s) at this pose, which is counted from where the course began."""
        if self._last is not None:
            self._heading_rad += wrap_angle(pose.theta_rad - self._last.theta_rad)
            if now_s > self._updated_s:
                self._interval_s = min(now_s - self._updated_s, 2 * POSE_INTERVAL_S)
        self._last, self._updated_s = pose, now_s
        if self._settled_at_s is not None:
            if now_s < self._settled_at_s:
                return 0.0, 0.0
            self._settled_at_s = None
            self._settle(self._legs[0], pose)
        if self.is_done or self.is_stuck:
            return 0.0, 0.0
        leg = self._legs[0]
        velocity = self._turn(leg, pose, now_s) if leg.turn_rad else self._line(leg, pose, now_s)
        if velocity is None:
            self._settled_at_s = now_s + SETTLE_S
        return velocity or (0.0, 0.0)

    def _settle(self, leg: Leg, pose: Pose) -> None:
        """Learn how far the robot has moved after the zero. Begin the next leg, unless a rest of this one is left."""
        left = self._left(leg, pose)
        left_before, speed = self._ended_at
        self._lag_s = min(max((left_before - left * math.copysign(1.0, speed)) / abs(speed), 0.0), LONGEST_LAG_S)
        close, slow = (CLOSE_RAD, SLOW_RAD_S) if leg.turn_rad else (CLOSE_M, SLOW_M_S)
        if abs(left) > close + slow * self._interval_s / 2 and self._corrections < MAX_CORRECTIONS:
            self._corrections += 1
            self._progress, self._began_s = _Progress(), None
        else:
            self._begin_next()

    def _begin_next(self) -> None:
        leg = self._legs.pop(0)
        start = self._start
        self._start = Pose(
            start.x_m + leg.forward_m * math.cos(start.theta_rad),
            start.y_m + leg.forward_m * math.sin(start.theta_rad),
            start.theta_rad + leg.turn_rad,  # whole turns stay in it
        )
        self.is_done = not self._legs
        self._progress, self._began_s, self._steps, self._corrections = _Progress(), None, 0, 0

    def _left(self, leg: Leg, pose: Pose) -> float:
        """Return the rest of a leg, in its own direction: m of a line, rad counter-clockwise of a turn."""
        start = self._start
        if leg.turn_rad:
            return start.theta_rad + leg.turn_rad - self._heading_rad
        dx_m, dy_m = pose.x_m - start.x_m, pose.y_m - start.y_m
        return leg.forward_m - (dx_m * math.cos(start.theta_rad) + dy_m * math.sin(start.theta_rad))

    def _has_ended(self, left: float, speed: float, way: float, now_s: float) -> bool:
        """Whether the place where the robot stops is nearer to the end now than at the next pose."""
        if self._began_s is None:
            self._began_s = now_s
        self._ended_at = left, way * speed
        on_its_way_s = min(self._lag_s, now_s - self._began_s)  # of commands that have had no effect yet
        return left <= speed * (on_its_way_s + self._interval_s / 2)

    def _is_stuck(self, left: float, least: float, now_s: float) -> bool:
        """Whether the leg ends because the robot does not advance. A leg that has arrived once is done then."""
        if not self._progress.has_ended(left, least, now_s):
            return False
        if self._corrections:
            self._begin_next()
        else:
            self.is_stuck = True
        return True

    def _turn(self, leg: Leg, pose: Pose, now_s: float) -> tuple[float, float] | None:
        left_rad = self._left(leg, pose)
        way = math.copysign(1.0, left_rad if self._corrections else leg.turn_rad)
        left_rad *= way
        if self._is_stuck(left_rad, STUCK_RAD, now_s):
            return 0.0, 0.0
        speed_rad_s = min(SLOW_RAD_S if left_rad < SLOW_FROM_RAD else math.inf, self._speed.angular_rad_s)
        return None if self._has_ended(left_rad, speed_rad_s, way, now_s) else (0.0, way * speed_rad_s)

    def _line(self, leg: Leg, pose: Pose, now_s: float) -> tuple[float, float] | None:
        left_m = self._left(leg, pose)
        way = math.copysign(1.0, left_m) if self._corrections else 1.0
        left_m *= way
        if self._is_stuck(left_m, STUCK_M, now_s):
            return 0.0, 0.0
        speed_m_s = min(SLOW_M_S if left_m < SLOW_FROM_M else math.inf, self._speed.linear_m_s)
        if self._has_ended(left_m, speed_m_s, way, now_s):
            return None
        if self._corrections:
            return way * speed_m_s, 0.0
        start = self._start
        dx_m, dy_m = pose.x_m - start.x_m, pose.y_m - start.y_m
        sideways_m = dy_m * math.cos(start.theta_rad) - dx_m * math.sin(start.theta_rad)
        back_rad = max(-0.5, min(0.5, SIDEWAYS_RAD_PER_M * sideways_m))
        turn_rad_s = -HEADING_PER_S * (self._heading_rad - start.theta_rad + back_rad)
        steps = max(-MOST_TURN_RAD_S, min(MOST_TURN_RAD_S, turn_rad_s)) / TURN_STEP_RAD_S
        if abs(steps - self._steps) > KEPT_STEPS:
            self._steps = round(steps)
        return speed_m_s, self._steps * TURN_STEP_RAD_S


class _Progress:
    """Progress on one leg: when it last made a step towards its end."""

    def __init__(self) -> None:
        self._left, self._at_s = math.inf, -math.inf

    def has_ended(self, left: float, least: float, now_s: float) -> bool:
        """Whether what is `left` has not become less by `least` for STUCK_S."""
        if left <= self._left - least:
            self._left, self._at_s = left, now_s
        return now_s >= self._at_s + STUCK_S
