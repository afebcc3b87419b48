"""DriveTrain: a motor on the shield, its gear, its wheel, its grip on the floor and its single-channel encoder. Pure.

The twin of firmware/host/drive_train.cpp, operation by operation.
"""

import math
import sys

from hostlink.sim.random_numbers import RandomNumbers
from hostlink.sim.rolling import Rolling
from hostlink.sim.world_parameters import WheelParameters

FULL_PWM = 4095
EDGES_PER_TICK = 2  # a rising and a falling one
_BEFORE_AN_EDGE_TICKS = (1.0 - sys.float_info.epsilon) / EDGES_PER_TICK
FULL_SPEED_TICKS_S = 280.0  # docs/robot.md#numbers: the top speed
_NOISE_M = 0.01  # rolled between two numbers of the slip's noise


class DriveTrain(Rolling):
    """One wheel. It turns at `speed_rad_s`, signed; its encoder counts `edges`, two a tick, without a sign."""

    def __init__(self, wheel: WheelParameters | None = None, *, stream: int = 1) -> None:
        self.speed_rad_s = 0.0
        self.rolled_rad = 0.0  # signed: the truth of the encoder
        self.moved_m = 0.0  # in the last step, signed: over the floor, slip included
        self.edges = 0
        self.is_deaf = False  # its encoder is dead
        self._stream = stream  # of its random numbers
        self._is_gripped = self._is_broken = self._is_stuck = False
        self._part_ticks = 0.0  # behind the last edge, seen forwards: the edges lie half a tick apart
        self._part_noise_m = 0.0  # rolled since the last noise

        self.be(WheelParameters() if wheel is None else wheel, 1)

    def be(self, wheel: WheelParameters, seed: int) -> None:
        """Another wheel from now on, that has rolled as far."""
        self.wheel = wheel
        self._random = RandomNumbers(seed, self._stream)

    def grip(self, ticks_s: float) -> None:
        """Somebody turns the wheel by hand, at this speed, or blocks it (0), whatever the motor does."""
        self._is_gripped = True
        self.speed_rad_s = ticks_s * math.tau / self.wheel.ticks_per_turn

    def release(self) -> None:
        """The hand lets it go."""
        self._is_gripped = False

    def break_driver(self) -> None:
        """The motor runs on at full speed once it was driven, whatever it is given then."""
        self._is_broken = True

    def step(self, pwm: float, dt_s: float, *, brake: float | None = None, load_pwm: float = 0.0) -> int:
        """Drive with a signed PWM for `dt_s`; returns the edges that its encoder counted.

        `brake`: for which share of the time it is shorted; None: with a PWM of 0 always, else never. `load_pwm`: counts
        of PWM that floor and caster cost.
        """
        if brake is None:
            brake = 1.0 if pwm == 0 else 0.0
        self._is_stuck |= self._is_broken and pwm != 0
        if self._is_stuck:
            pwm, brake = float(FULL_PWM), 0.0
        before, before_m_s = self.edges, self.speed_m_s
        rolled_rad = self._roll(pwm, brake, load_pwm, dt_s)
        self.moved_m = 0.0
        if rolled_rad != 0.0:
            self._count(rolled_rad)
            self.moved_m = self._over_floor(rolled_rad * self.wheel.radius_m, before_m_s)
        return self.edges - before

    def _roll(self, pwm: float, brake: float, load_pwm: float, dt_s: float) -> float:
        wheel = self.wheel
        if self._is_gripped:
            return self.speed_rad_s * dt_s
        if pwm == 0.0 and self.speed_rad_s == 0.0:
            return 0.0
        target_rad_s = self._aimed_rad_s(pwm, load_pwm)
        if target_rad_s != 0.0:
            is_too_fast = (
                self.speed_rad_s * target_rad_s > target_rad_s * target_rad_s
            )  # a PWM pushes, it does not brake
            return self._approach(target_rad_s, wheel.coast_constant_s if is_too_fast else wheel.rise_constant_s, dt_s)
        constant_s = 1.0 / (brake / wheel.brake_constant_s + (1.0 - brake) / wheel.coast_constant_s)
        return self._slow_down(constant_s, load_pwm / FULL_PWM * wheel.full_speed_rad_s + wheel.friction_rad_s, dt_s)

    def _aimed_rad_s(self, pwm: float, load_pwm: float) -> float:
        wheel = self.wheel
        duty = abs(pwm) - load_pwm
        dead_pwm = wheel.dead_zone_pwm
        if duty < dead_pwm or duty <= 0.0:
            return 0.0
        share = duty / FULL_PWM if wheel.has_jump != 0.0 else (duty - dead_pwm) / (FULL_PWM - dead_pwm)
        return (1.0 if pwm > 0.0 else -1.0) * share * wheel.full_speed_rad_s

    def _approach(self, target_rad_s: float, constant_s: float, dt_s: float) -> float:
        """The exact solution of the first-order lag, so that the result does not depend on the length of the step."""
        decay = math.exp(-dt_s / constant_s)
        ahead_rad_s = self.speed_rad_s - target_rad_s
        self.speed_rad_s = target_rad_s + ahead_rad_s * decay
        return target_rad_s * dt_s + ahead_rad_s * constant_s * (1.0 - decay)

    def _slow_down(self, constant_s: float, friction_rad_s: float, dt_s: float) -> float:
        """As if friction drove it backwards, until it stands."""
        if friction_rad_s == 0.0:
            return self._approach(0.0, constant_s, dt_s)
        backwards_rad_s = friction_rad_s if self.speed_rad_s < 0.0 else -friction_rad_s
        until_stand_s = constant_s * math.log((abs(self.speed_rad_s) + friction_rad_s) / friction_rad_s)
        if until_stand_s > dt_s:
            return self._approach(backwards_rad_s, constant_s, dt_s)
        rolled_rad = self._approach(backwards_rad_s, constant_s, until_stand_s)
        self.speed_rad_s = 0.0
        return rolled_rad

    def _count(self, rolled_rad: float) -> None:
        self.rolled_rad += rolled_rad
        self._part_ticks += rolled_rad * self.wheel.ticks_per_turn / math.tau
        passed = math.floor(self._part_ticks * EDGES_PER_TICK)
        # Rounded onto the edge that it has just come back over, it would pass that again with each step.
        self._part_ticks = min(self._part_ticks - passed / EDGES_PER_TICK, _BEFORE_AN_EDGE_TICKS)
        if not self.is_deaf:
            self.edges += abs(passed)

    def _over_floor(self, rolled_m: float, before_m_s: float) -> float:
        """How far the robot moved for what the wheel rolled: less while it speeds up, more while it slows down."""
        wheel = self.wheel
        gained = (self.speed_m_s * self.speed_m_s - before_m_s * before_m_s) / 2.0
        share_s2_m = wheel.slip_accelerating_s2_m if gained > 0.0 else wheel.slip_braking_s2_m
        moved_m = rolled_m - share_s2_m * gained * (1.0 if rolled_m > 0.0 else -1.0)
        if wheel.slip_noise_m == 0.0:
            return moved_m
        self._part_noise_m += abs(rolled_m)
        while self._part_noise_m >= _NOISE_M:
            self._part_noise_m -= _NOISE_M
            moved_m += wheel.slip_noise_m * math.sqrt(_NOISE_M) * self._random.normal()
        return moved_m
