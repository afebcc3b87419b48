"""Ackermann steering by the bicycle model: one steered wheel in the middle of the front axle, the origin at the rear.

steering = atan(wheelbase * yaw / x), yaw = x * tan(steering) / wheelbase: the bicycle model of ros2_controllers
(control.ros.org, "Wheeled Mobile Robot Kinematics", section "Car-Like (Bicycle) Model") and of teb_local_planner
(cmd_vel_to_ackermann_drive.py). Signs as in ackermann_msgs/AckermannDrive: a positive angle is to the left, also in
reverse.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from hostlink.core.robot.kinematics.drive import WHERE, Drive, Row
from hostlink.core.robot.velocity import Kinematics, PlanarVelocity
from hostlink.errors import ConfigError


class Steering(NamedTuple):
    """The command of a car: the speed of its rear axle, and the angle of its front wheels."""

    speed_m_s: float = 0.0
    angle_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AckermannDrive(Drive):
    """Car with steered front wheels. With a `wheel_separation_m` the rear wheels are known, which do not slide.

    The defaults are the car of F1TENTH (f1tenth_gym, f110_env.py: lf + lr, s_max).

    A curve that is tighter than the steering allows keeps its speed and gets the tightest curve: a driver who turns the
    stick too far wants to turn as much as possible, and a slower car would not turn more.
    """

    kinematics: Kinematics = field(init=False, default=Kinematics.ACKERMANN)
    label: str = field(init=False, default="a car with steered wheels")
    has_y: bool = field(init=False, default=False)
    turns_in_place: bool = field(init=False, default=False)
    wheelbase_m: float = 0.3302  # from the rear axle to the front axle
    max_steering_rad: float = 0.4189
    wheel_separation_m: float = 0.0

    def _named_rows(self) -> list[tuple[str, Row]]:
        if not self.wheelbase_m:
            raise ConfigError(WHERE, "wheelbase_m must be above zero")
        if not 0 < self.max_steering_rad < math.pi / 2:
            raise ConfigError(
                WHERE,
                f"max_steering_rad must be above zero and below {math.pi / 2:.4f}, not {self.max_steering_rad}",
            )
        half_m = self.wheel_separation_m / 2
        return [("rear_left", (1.0, 0.0, -half_m)), ("rear_right", (1.0, 0.0, half_m))] if half_m else []

    def _why_not(self, velocity: PlanarVelocity) -> str | None:
        if velocity.y_m_s != 0:
            return self._not_sideways()
        if velocity.yaw_rad_s != 0 and velocity.x_m_s == 0:
            return f"{self.label} cannot turn in place: send a linear.x that is not 0 together with angular.z"
        return None

    @property
    def max_curvature_per_m(self) -> float:
        """Curvature of the tightest curve."""
        return math.tan(self.max_steering_rad) / self.wheelbase_m

    def possible(self, velocity: PlanarVelocity) -> PlanarVelocity:
        """The velocity at the same speed; the tightest curve instead of a tighter one."""
        tightest_rad_s = abs(velocity.x_m_s) * self.max_curvature_per_m
        if velocity.turn_rad_s <= tightest_rad_s:
            return velocity
        return PlanarVelocity(velocity.x_m_s, velocity.y_m_s, math.copysign(tightest_rad_s, velocity.yaw_rad_s))

    def steering(self, velocity: PlanarVelocity) -> Steering:
        """Speed and steering angle for a velocity; straight if it stops, within the steering's limit."""
        x_m_s, _, yaw_rad_s = velocity
        if x_m_s == 0 or yaw_rad_s == 0:
            return Steering(x_m_s)
        angle_rad = math.atan(self.wheelbase_m * yaw_rad_s / x_m_s)
        return Steering(x_m_s, max(-self.max_steering_rad, min(angle_rad, self.max_steering_rad)))

    def velocity_of(self, steering: Steering) -> PlanarVelocity:
        """Velocity of the body at a speed and a steering angle, within the steering's limit."""
        angle_rad = max(-self.max_steering_rad, min(steering.angle_rad, self.max_steering_rad))
        return PlanarVelocity(steering.speed_m_s, yaw_rad_s=steering.speed_m_s * math.tan(angle_rad) / self.wheelbase_m)
