"""World: the paper's robot on a floor: battery, motors, wheels, encoders, caster, and where it truly is. Pure.

The twin of firmware/host/world.cpp, operation by operation, so that both compute the same digits.
"""

import math

from hostlink.sim.caster import Caster
from hostlink.sim.drive_train import FULL_PWM, DriveTrain
from hostlink.sim.world_parameters import WorldParameters

_PWM_BITS = 12  # of the firmware's duties
_SMALL_RAD = 1e-8  # below it an arc is as long as its chord
_STANDING_M = 0.001  # the motion that a standing wheel's PWM stands for


class World:
    """Set the PWMs with `drive`, let time pass with `step`, read the rest."""

    def __init__(self, parameters: WorldParameters | None = None) -> None:
        self.left, self.right, self._caster = DriveTrain(stream=1), DriveTrain(stream=2), Caster()
        self.x_m = self.y_m = 0.0
        self.theta_rad = 0.0  # not wrapped: whole turns stay in it
        self.rolled_m = 0.0  # by the robot's middle, forwards and backwards
        self._pwm = (0, 0)
        self.be(WorldParameters() if parameters is None else parameters)

    def be(self, parameters: WorldParameters) -> None:
        """Another world from now on; pose and edges stay."""
        self.parameters = parameters
        seed, bits = int(parameters.seed), int(parameters.pwm_bits)
        self.left.be(parameters.left, seed)
        self.right.be(parameters.right, seed)
        self._caster.be(parameters)
        self._step_pwm = float(1 << (_PWM_BITS - bits))
        self._top = float((1 << bits) - 1)

    @property
    def caster_rad(self) -> float:
        """Where the caster's wheel rolls to, in the robot's frame; 0: forwards."""
        return self._caster.heading_rad

    @property
    def battery_v(self) -> float:
        """At the motors, now."""
        left, right = (abs(self._duty(pwm)) for pwm in self._pwm)
        volts = self.parameters.battery_v - self.parameters.battery_sag_v * (left + right) / 2.0 / FULL_PWM
        return max(volts, 0.0)

    def drive(self, left_pwm: int, right_pwm: int) -> None:
        """What the motors are given until the next call: -4095..4095, 0 brakes."""
        self._pwm = (left_pwm, right_pwm)

    def step(self, dt_s: float) -> None:
        """Let time pass."""
        scale = self.battery_v / self.parameters.rated_v
        left_pwm, right_pwm = (self._duty(pwm) * scale for pwm in self._pwm)
        load_pwm = self._load_pwm(left_pwm, right_pwm)
        self.left.step(left_pwm, dt_s, brake=float(self._pwm[0] == 0), load_pwm=load_pwm)
        self.right.step(right_pwm, dt_s, brake=float(self._pwm[1] == 0), load_pwm=load_pwm)
        self._move(self.left.moved_m, self.right.moved_m)

    def shove(self, forward_m: float, sideways_m: float, turned_rad: float) -> None:
        """The robot is pushed over the floor: neither wheel nor encoder notices."""
        cos, sin = math.cos(self.theta_rad), math.sin(self.theta_rad)
        self.x_m += forward_m * cos - sideways_m * sin
        self.y_m += forward_m * sin + sideways_m * cos
        self.theta_rad += turned_rad

    def _duty(self, pwm: int) -> float:
        """What the pin gives of a PWM: the core drops the low bits."""
        size = math.floor(abs(pwm) / self._step_pwm) / self._top * FULL_PWM
        return size if pwm >= 0 else -size

    def _load_pwm(self, left_pwm: float, right_pwm: float) -> float:
        world = self.parameters
        if world.caster_pwm == 0.0:
            return world.floor_pwm
        left_m, right_m = _course_m(self.left, left_pwm), _course_m(self.right, right_pwm)
        against = self._caster.resistance((left_m + right_m) / 2.0, (right_m - left_m) / world.track_m)
        return world.floor_pwm + world.caster_pwm * against

    def _move(self, left_m: float, right_m: float) -> None:
        if left_m == 0.0 and right_m == 0.0:
            return
        world = self.parameters
        forward_m = (left_m + right_m) / 2.0
        turned_rad = (right_m - left_m) / world.track_m
        if world.caster_pwm != 0.0 or world.caster_twist_rad != 0.0:
            turned_rad += self._caster.step(forward_m, turned_rad)
        half_rad = turned_rad / 2.0
        chord_m = forward_m if abs(half_rad) < _SMALL_RAD else forward_m * math.sin(half_rad) / half_rad
        self.x_m += chord_m * math.cos(self.theta_rad + half_rad)
        self.y_m += chord_m * math.sin(self.theta_rad + half_rad)
        self.theta_rad += turned_rad
        self.rolled_m += abs(forward_m)


def _course_m(wheel: DriveTrain, pwm: float) -> float:
    """Where a wheel goes: as it rolls; one that stands, as it is driven."""
    if wheel.speed_rad_s != 0.0:
        return wheel.speed_m_s
    return math.copysign(_STANDING_M, pwm) if pwm != 0.0 else 0.0
