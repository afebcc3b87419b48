"""Geometry: what the robot knows of its wheels, and the parameters that change it. Pure; the twin of the firmware's.

It computes in single precision where the firmware does, with the same digits.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hostlink.robot.kinematics import DifferentialDrive, Pose
from hostlink.sim.drive_train import FULL_SPEED_TICKS_S

WHEEL_RADIUS_M = 0.045  # docs/robot.md#numbers
TICKS_PER_TURN = 230.4


class Range(NamedTuple):
    """How many numbers a parameter has, and what each may be."""

    least: int
    most: int
    low: float
    high: float

    def accepts(self, values: Sequence[float]) -> bool:
        """Whether they make sense; NaN does not."""
        return self.least <= len(values) <= self.most and all(self.low <= value <= self.high for value in values)

    def __str__(self) -> str:
        count = f"{self.least}" if self.least == self.most else f"{self.least} or {self.most}"
        noun = "numbers" if self.most > 1 else "number"
        return f"{count} {noun} from {self.low:.3f} to {self.high:.1f}"


PARAMETERS = {  # in the order in which they are requested
    "wheel_radius": Range(1, 2, 0.005, 0.5),  # metres: of both wheels, or left and right
    "wheel_separation": Range(1, 1, 0.02, 5.0),  # metres, wheel to wheel
    "ticks_per_turn": Range(1, 2, 1.0, 100_000.0),  # of the wheel: both, or left and right
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """Left and right; the defaults are the paper's robot."""

    wheel_radius_m: tuple[float, float] = (WHEEL_RADIUS_M, WHEEL_RADIUS_M)
    ticks_per_turn: tuple[float, float] = (TICKS_PER_TURN, TICKS_PER_TURN)
    wheel_separation_m: float = 0.210

    @property
    def metres_per_tick(self) -> tuple[float, float]:
        """How far each wheel rolls in one encoder tick; in single precision."""
        turn = np.float32(2.0) * np.float32(math.pi)
        left, right = (
            float(turn * np.float32(radius_m) / np.float32(ticks))
            for radius_m, ticks in zip(self.wheel_radius_m, self.ticks_per_turn, strict=True)
        )
        return left, right

    def changed(self, name: str, values: Sequence[float]) -> "Geometry":
        """The same with a parameter that makes sense."""
        pair = (values[0], values[-1])
        match name:
            case "wheel_radius":
                return replace(self, wheel_radius_m=pair)
            case "ticks_per_turn":
                return replace(self, ticks_per_turn=pair)
            case _:
                return replace(self, wheel_separation_m=values[0])

    def wheel_speeds(self, linear_m_s: float, angular_rad_s: float) -> tuple[float, float]:
        """(left, right) in ticks/s that give the body this velocity; both slowed so that the faster keeps the limit."""
        with np.errstate(all="ignore"):  # what is no number is found by who reads it
            linear, angular = single(linear_m_s), single(angular_rad_s)
            turning_m_s = angular * np.float32(self.wheel_separation_m) / np.float32(2.0)
            left_m, right_m = map(np.float32, self.metres_per_tick)
            wanted = (linear - turning_m_s) / left_m, (linear + turning_m_s) / right_m
            fastest = max(map(abs, wanted))
            factor = np.float32(FULL_SPEED_TICKS_S) / fastest if fastest > FULL_SPEED_TICKS_S else np.float32(1.0)
            return float(wanted[0] * factor), float(wanted[1] * factor)

    def integrate(self, pose: Pose, left_ticks: float, right_ticks: float) -> Pose:
        """The pose after the wheels rolled this far."""
        left_m, right_m = self.metres_per_tick
        return self._drive.integrate(pose, left_ticks * left_m, right_ticks * right_m)

    @property
    def lines(self) -> tuple[str, str]:
        """As the robot logs it; the host's own log cuts a line at 64 characters."""
        radii = " and ".join(f"{radius_m * 1000:.3f}" for radius_m in self.wheel_radius_m)
        ticks = " and ".join(f"{count:.3f}" for count in self.ticks_per_turn)
        wheels = f"wheel radius {radii} mm, {self.wheel_separation_m * 1000:.2f} mm apart"
        return wheels, f"ticks a turn {ticks}"

    @property
    def _drive(self) -> DifferentialDrive:
        return DifferentialDrive(wheel_separation_m=self.wheel_separation_m)


def single(value: float) -> np.float32:
    """A float64 of a message as the firmware reads it: cut off towards zero, and zero below the normal numbers."""
    with np.errstate(all="ignore"):
        rounded = np.float32(value)
    if abs(value) < np.finfo(np.float32).tiny:
        return np.float32(0.0)
    is_longer = math.isfinite(rounded) and abs(float(rounded)) > abs(value)
    return np.nextafter(rounded, np.float32(0.0)) if is_longer else rounded
