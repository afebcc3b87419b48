"""Drives of a robot without motors: its wheels roll exactly as they are driven, and its odometry believes in others."""

import math
from collections.abc import Sequence

import numpy as np

from hostlink.client.course import CourseFollower, Leg, square, straight, turns
from hostlink.core.robot.kinematics import DifferentialDrive, Pose
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.workbench.calibration import MeasuredRun, Measurement, RunKind, WheelGeometry

PERIOD_S = 0.1
LONGEST_S = 600.0
LENGTH_M, SIDE_M, TURNS = 3.0, 2.0, 5


class ExactRobot:
    """Follows courses by its own odometry; a wheel may be a little noisy, and each corner may be twisted."""

    def __init__(self, nominal: WheelGeometry, true: WheelGeometry, *, noise_m: float = 0.0, seed: int = 1) -> None:
        self.odometry = self.truth = Pose(0.3, -0.2, 1.0)
        self.turned_rad = 0.0  # in truth; whole turns stay in it
        self._random = np.random.default_rng(seed)
        self._noise_m = noise_m  # after a metre
        self._nominal = DifferentialDrive(wheel_separation_m=nominal.separation_m)
        self._true = DifferentialDrive(wheel_separation_m=true.separation_m)
        self._factors = (
            true.left_radius_m / nominal.left_radius_m,
            true.right_radius_m / nominal.right_radius_m,
        )

    def move(self, linear_m_s: float, angular_rad_s: float) -> None:
        believed = [
            speed * PERIOD_S for speed in self._nominal.wheel_speeds(PlanarVelocity(linear_m_s, 0.0, angular_rad_s))
        ]
        rolled = [
            way_m * factor + self._noise_m * math.sqrt(abs(way_m)) * self._random.normal()
            for way_m, factor in zip(believed, self._factors, strict=True)
        ]
        self.odometry = self._nominal.integrate(self.odometry, believed)
        self.truth = self._true.integrate(self.truth, rolled)
        self.turned_rad += (rolled[1] - rolled[0]) / self._true.wheel_separation_m

    def drive(self, kind: RunKind, legs: Sequence[Leg], size: float) -> MeasuredRun:
        """A course, and its end by a perfect tape measure."""
        follower, start, first, turned_rad = CourseFollower(legs), self.truth, self.odometry, self.turned_rad
        path, now_s = [self.odometry], 0.0
        while not follower.is_done:
            assert now_s < LONGEST_S, f"{follower.legs_left} legs are left"
            self.move(*follower.update(relative(first, self.odometry), now_s))
            path.append(self.odometry)
            now_s += PERIOD_S
        end = relative(start, self.truth)
        is_turn = kind in (RunKind.TURNS_CCW, RunKind.TURNS_CW)
        measured = Measurement(end.x_m, end.y_m, self.turned_rad - turned_rad if is_turn else None)
        return MeasuredRun(kind, size, tuple(path), measured)

    def drives(self, repeats: int = 2) -> list[MeasuredRun]:
        """All that a calibration has."""
        return [
            *(self.drive(RunKind.STRAIGHT, straight(LENGTH_M), LENGTH_M) for _ in range(repeats)),
            self.drive(RunKind.TURNS_CCW, turns(TURNS, 1), TURNS),
            self.drive(RunKind.TURNS_CW, turns(TURNS, -1), TURNS),
            *(self.square(way) for _ in range(repeats) for way in (-1, 1)),
        ]

    def square(self, way: int) -> MeasuredRun:
        return self.drive(RunKind.SQUARE_CCW if way > 0 else RunKind.SQUARE_CW, square(SIDE_M, way), SIDE_M)


def relative(frame: Pose, pose: Pose) -> Pose:
    """A pose as it is from another one."""
    cos, sin = math.cos(frame.theta_rad), math.sin(frame.theta_rad)
    dx_m, dy_m = pose.x_m - frame.x_m, pose.y_m - frame.y_m
    return Pose(cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m, pose.theta_rad - frame.theta_rad)
