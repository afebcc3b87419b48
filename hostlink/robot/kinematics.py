"""The kinematics of a differential drive: ROBOT.md's equations. Metres, radians, seconds."""

import math
from dataclasses import dataclass
from typing import NamedTuple

SMALL_ANGLE_RAD = 1e-6  # below it the arc is a straight line to the last digit of a double


class Pose(NamedTuple):
    """Where the robot is, in the frame in which its odometry began; theta in (-pi, pi]."""

    x_m: float = 0.0
    y_m: float = 0.0
    theta_rad: float = 0.0


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped <= -math.pi else wrapped


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialDrive:
    """Two driven wheels on one axis; the defaults are the paper's robot."""

    wheel_radius_m: float = 0.045
    wheel_separation_m: float = 0.210  # the full one, wheel to wheel
    ticks_per_turn: float = 230.4

    @property
    def metres_per_tick(self) -> float:
        """How far a wheel rolls in one encoder tick."""
        return math.tau * self.wheel_radius_m / self.ticks_per_turn

    def wheel_speeds(self, linear_m_s: float, angular_rad_s: float) -> tuple[float, float]:
        """(left, right) in m/s that give the body this velocity."""
        turning_m_s = angular_rad_s * self.wheel_separation_m / 2
        return linear_m_s - turning_m_s, linear_m_s + turning_m_s

    def body_velocity(self, left_m_s: float, right_m_s: float) -> tuple[float, float]:
        """(m/s, rad/s) of the body at these wheel speeds."""
        return (left_m_s + right_m_s) / 2, (right_m_s - left_m_s) / self.wheel_separation_m

    def integrate(self, pose: Pose, left_m: float, right_m: float) -> Pose:
        """The pose after the wheels rolled this far: along the arc of a circle."""
        distance_m = (left_m + right_m) / 2
        turned_rad = (right_m - left_m) / self.wheel_separation_m
        if abs(turned_rad) < SMALL_ANGLE_RAD:
            forward_m = distance_m * math.cos(turned_rad / 2)
            left_of_m = distance_m * math.sin(turned_rad / 2)
        else:
            radius_m = distance_m / turned_rad
            forward_m = radius_m * math.sin(turned_rad)
            left_of_m = radius_m * (1 - math.cos(turned_rad))
        cos, sin = math.cos(pose.theta_rad), math.sin(pose.theta_rad)
        return Pose(
            pose.x_m + forward_m * cos - left_of_m * sin,
            pose.y_m + forward_m * sin + left_of_m * cos,
            wrap_angle(pose.theta_rad + turned_rad),
        )
