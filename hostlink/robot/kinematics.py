"""The kinematics of a differential drive (docs/paper-robot.md#equations). Metres, radians, seconds."""

import math
from dataclasses import dataclass
from typing import NamedTuple

SMALL_ANGLE_RAD = 1e-8  # below it an arc and its chord are equally long to the last digit of a double


class Pose(NamedTuple):
    """Pose of the robot, in the frame in which its odometry began; theta in (-pi, pi]."""

    x_m: float = 0.0
    y_m: float = 0.0
    theta_rad: float = 0.0


def wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to (-pi, pi]; NaN for an angle that is not finite."""
    if not math.isfinite(angle_rad):
        return math.nan
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped <= -math.pi else wrapped


def chord_per_arc(turned_rad: float) -> float:
    """Length of the chord of an arc, in lengths of the arc; 2/pi for half a turn."""
    half_rad = turned_rad / 2
    return 1.0 if abs(turned_rad) < SMALL_ANGLE_RAD else math.sin(half_rad) / half_rad


def placed(frame: Pose, pose: Pose) -> Pose:
    """A pose in a frame, expressed in the frame around it."""
    cos, sin = math.cos(frame.theta_rad), math.sin(frame.theta_rad)
    return Pose(
        frame.x_m + cos * pose.x_m - sin * pose.y_m,
        frame.y_m + sin * pose.x_m + cos * pose.y_m,
        wrap_angle(frame.theta_rad + pose.theta_rad),
    )


def frame_of(outer: Pose, inner: Pose) -> Pose:
    """The frame that makes `inner` be at `outer`: placed(frame_of(outer, inner), inner) == outer."""
    turned = Pose(theta_rad=wrap_angle(outer.theta_rad - inner.theta_rad))
    arm = placed(turned, inner)
    return Pose(outer.x_m - arm.x_m, outer.y_m - arm.y_m, turned.theta_rad)


ORIGIN_M, ORIGIN_RAD = 0.05, 0.2  # how near the origin the first pose after a reset is; a robot may roll on


def is_near_origin(pose: Pose) -> bool:
    return math.hypot(*pose[:2]) < ORIGIN_M and abs(pose.theta_rad) < ORIGIN_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialDrive:
    """Two driven wheels on one axis; the defaults are the paper's robot."""

    wheel_radius_m: float = 0.045
    wheel_separation_m: float = 0.210  # the full one, wheel to wheel
    ticks_per_turn: float = 230.4

    @property
    def metres_per_tick(self) -> float:
        """Distance that a wheel rolls in one encoder tick."""
        return math.tau * self.wheel_radius_m / self.ticks_per_turn

    def wheel_speeds(self, linear_m_s: float, angular_rad_s: float) -> tuple[float, float]:
        """(left, right) in m/s that give the body this velocity."""
        turning_m_s = angular_rad_s * self.wheel_separation_m / 2
        return linear_m_s - turning_m_s, linear_m_s + turning_m_s

    def integrate(self, pose: Pose, left_m: float, right_m: float) -> Pose:
        """The pose after the wheels rolled this far: along the arc of a circle.

        The d/D sin D and d/D (1-cos D) of docs/paper-robot.md#equations, as the chord and its direction: no digits get
        lost near D = 0.
        """
        turned_rad = (right_m - left_m) / self.wheel_separation_m
        chord_m = (left_m + right_m) / 2 * chord_per_arc(turned_rad)
        heading_rad = pose.theta_rad + turned_rad / 2
        return Pose(
            pose.x_m + chord_m * math.cos(heading_rad),
            pose.y_m + chord_m * math.sin(heading_rad),
            wrap_angle(pose.theta_rad + turned_rad),
        )
