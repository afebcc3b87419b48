"""Drives with wheels that are not steered: differential, skid-steer, mecanum and omni. Pure."""

import math
from dataclasses import dataclass, field

from hostlink.core.robot.kinematics.drive import WHERE, Drive, Row
from hostlink.core.robot.velocity import Kinematics
from hostlink.errors import ConfigError

FOUR_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialDrive(Drive):
    """Two driven wheels on one axis; the defaults are the paper's robot (docs/paper-robot.md#equations)."""

    kinematics: Kinematics = field(init=False, default=Kinematics.DIFFERENTIAL)
    label: str = field(init=False, default="a differential drive")
    has_y: bool = field(init=False, default=False)
    wheel_radius_m: float = 0.045
    wheel_separation_m: float = 0.210  # the full one, wheel to wheel
    ticks_per_turn: float = 230.4

    @property
    def metres_per_tick(self) -> float:
        """Distance that a wheel rolls in one encoder tick."""
        return math.tau * self.wheel_radius_m / self.ticks_per_turn

    def _named_rows(self) -> list[tuple[str, Row]]:
        half_m = self.wheel_separation_m / 2
        return [("left", (1.0, 0.0, -half_m)), ("right", (1.0, 0.0, half_m))] if half_m else []


@dataclass(frozen=True, slots=True, kw_only=True)
class SkidSteerDrive(Drive):
    """Four wheels, or two tracks, that slide sideways in a turn: a differential drive with a wider separation.

    `separation_factor` is the separation of the differential drive that turns equally fast, divided by that of the
    wheels: above 1, measured by turning on the spot (Mandow et al., Experimental kinematics for wheeled skid-steer
    mobile robots, IROS 2007: the distance of the instantaneous centres of rotation of both sides).
    """

    kinematics: Kinematics = field(init=False, default=Kinematics.SKID_STEER)
    label: str = field(init=False, default="a skid-steer drive")
    has_y: bool = field(init=False, default=False)
    wheel_separation_m: float = 0.0
    separation_factor: float = 1.0

    def _named_rows(self) -> list[tuple[str, Row]]:
        half_m = self.wheel_separation_m * self.separation_factor / 2
        left, right = (1.0, 0.0, -half_m), (1.0, 0.0, half_m)
        return list(zip(FOUR_WHEELS, (left, right, left, right), strict=True)) if half_m else []


@dataclass(frozen=True, slots=True, kw_only=True)
class MecanumDrive(Drive):
    """Four wheels with rollers at 45 degrees, mounted so that the rollers on the ground form an X from below.

    Lynch and Park, Modern Robotics, section 13.2.1. The wheelbase is the distance between the axles.
    """

    kinematics: Kinematics = field(init=False, default=Kinematics.MECANUM)
    label: str = field(init=False, default="a mecanum drive")
    wheel_separation_m: float = 0.0
    wheelbase_m: float = 0.0

    def _named_rows(self) -> list[tuple[str, Row]]:
        if not (self.wheel_separation_m and self.wheelbase_m):
            return []
        arm_m = (self.wheel_separation_m + self.wheelbase_m) / 2
        rows = ((1.0, -1.0, -arm_m), (1.0, 1.0, arm_m), (1.0, 1.0, -arm_m), (1.0, -1.0, arm_m))
        return list(zip(FOUR_WHEELS, rows, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class OmniDrive(Drive):
    """Three wheels with rollers at 90 degrees, on a circle around the centre; each drives along the circle.

    An angle is that of the wheel's place, counter-clockwise from the front. A wheel of positive speed turns the robot
    counter-clockwise. The defaults are those of the Robotino: two wheels in front, one behind.
    """

    kinematics: Kinematics = field(init=False, default=Kinematics.OMNI3)
    label: str = field(init=False, default="an omni drive")
    wheel_count: int = field(init=False, default=3)
    wheel_distance_m: float = 0.0  # from the centre to each wheel
    wheel_angles_deg: tuple[float, ...] = (60.0, 180.0, 300.0)

    def _named_rows(self) -> list[tuple[str, Row]]:
        if len(self.wheel_angles_deg) != self.wheel_count or not all(map(math.isfinite, self.wheel_angles_deg)):
            shown = list(self.wheel_angles_deg)
            raise ConfigError(WHERE, f"wheel_angles_deg must be {self.wheel_count} angles in degrees, not {shown}")
        if not self.wheel_distance_m:
            return []
        angles_rad = map(math.radians, self.wheel_angles_deg)
        return [
            (f"wheel_{number}", (-math.sin(angle_rad), math.cos(angle_rad), self.wheel_distance_m))
            for number, angle_rad in enumerate(angles_rad, 1)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Omni4Drive(OmniDrive):
    """Four omni wheels; by default at the corners of a square."""

    kinematics: Kinematics = field(init=False, default=Kinematics.OMNI4)
    wheel_count: int = field(init=False, default=4)
    wheel_angles_deg: tuple[float, ...] = (45.0, 135.0, 225.0, 315.0)
