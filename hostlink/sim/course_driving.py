"""A course that a robot drives in virtual time, by its own odometry, and a person who measures where it came. Pure.

It is what `hostlink calibrate --simulate` does.
"""

import math
from collections.abc import Sequence

import numpy as np

from hostlink.robot.course import CourseFollower, Leg
from hostlink.robot.kinematics import Pose, placed
from hostlink.robot.odometry_correction import OdometryCorrection
from hostlink.sim.firmware_world import COMMAND_S, FirmwareWorld

READING_ERROR_M = 0.002  # standard deviation of a distance read off the tape measure
READING_ERROR_RAD = math.radians(0.5)  # standard deviation of an angle, and of the mark's direction
LONGEST_S = 1800.0  # of a course: a robot that needs longer does not move


class Person:
    """Somebody with a tape measure; what is read off it is a little wrong, the same for the same seed."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def measure(self, end: Pose) -> Pose:
        """Where something is, from a mark."""
        marked = placed(Pose(theta_rad=READING_ERROR_RAD * float(self._random.normal())), end)
        x_m, y_m = (marked[axis] + READING_ERROR_M * float(self._random.normal()) for axis in (0, 1))
        return Pose(x_m, y_m, end.theta_rad + READING_ERROR_RAD * float(self._random.normal()))


def follow(
    robot: FirmwareWorld,
    legs: Sequence[Leg],
    correction: OdometryCorrection | None = None,
) -> tuple[tuple[Pose, ...], Pose]:
    """Drive a course by its odometry, corrected if need be; returns its poses, and how far it truly came.

    Raises:
        TimeoutError: it does not get there.
    """
    follower, start, path, shown = CourseFollower(legs), robot.pose, [robot.odometry], Pose()
    correction = OdometryCorrection() if correction is None else correction
    now_s = 0.0
    while not follower.is_done:
        if now_s > LONGEST_S or follower.is_stuck:
            raise TimeoutError(
                f"the simulated robot does not get there: {follower.legs_left} legs are left after {now_s:.0f} s"
            )
        robot.drive(*follower.update(shown, now_s), COMMAND_S)
        shown = correction.advance(shown, path[-1], robot.odometry)
        path.append(robot.odometry)
        now_s += COMMAND_S
    return tuple(path), _from(start, robot.pose)


def _from(start: Pose, end: Pose) -> Pose:
    """A pose as it is from another; whole turns stay in it."""
    cos, sin = math.cos(start.theta_rad), math.sin(start.theta_rad)
    dx_m, dy_m = end.x_m - start.x_m, end.y_m - start.y_m
    return Pose(dx_m * cos + dy_m * sin, dy_m * cos - dx_m * sin, end.theta_rad - start.theta_rad)
