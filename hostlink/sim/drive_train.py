"""DriveTrain: a motor on the shield, its gear, its wheel and a single-channel encoder. Pure.

The twin of firmware/host/motor.cpp; what differs from motor to motor is in MotorWorld.
"""

import math
from dataclasses import dataclass

FULL_PWM = 4095
EDGES_PER_TICK = 2  # a rising and a falling one
FULL_SPEED_TICKS_S = 280.0  # docs/robot.md#numbers: the top speed
CASTER_TICKS = 40.0  # 5 cm: the caster has swung round


@dataclass(frozen=True, slots=True)
class MotorWorld:
    """What a motor is like; the defaults are the robot's, tests draw others."""

    full_speed_ticks_s: float = FULL_SPEED_TICKS_S
    time_constant_s: float = 0.1  # while its PWM pushes it: a geared 12 V motor under a small robot
    coast_constant_s: float = 0.3  # while nothing pushes it and it runs free
    brake_constant_s: float = 0.04  # while it is short-circuited, behind its 75:1 gear
    friction_ticks_s: float = 24.0  # ends a coasting: the speed lost to friction in one time constant
    dead_zone_pwm: float = 350.0  # less does not turn it; well under the firmware's dead band of 700
    has_jump: bool = True  # above the dead zone it turns as if there were none; else beginning with nothing
    caster_pwm: float = 0.0  # the load of the caster while it swings round after a reversal


class DriveTrain:
    """One wheel. It turns at `speed_ticks_s`, signed; its encoder counts edges, two a tick, without a sign."""

    def __init__(self, world: MotorWorld | None = None) -> None:
        self.world = MotorWorld() if world is None else world
        self.speed_ticks_s = 0.0
        self.rolled_ticks = 0.0  # signed, exact: the truth that odometry estimates
        self._is_blocked = False
        self._is_broken = False
        self._is_stuck = False
        self._sense = 0  # of the last roll
        self._since_turn_ticks = 0.0  # rolled since its sense changed

    def block(self) -> None:
        """Nothing turns the wheel any more."""
        self._is_blocked = True

    def break_driver(self) -> None:
        """The motor runs on at full speed once it was driven, whatever it is given then."""
        self._is_broken = True

    def step(self, pwm: float, dt_s: float) -> int:
        """Drive with a signed PWM for `dt_s`, 0 brakes; returns the edges that the encoder counted."""
        self._is_stuck |= self._is_broken and pwm != 0
        if self._is_blocked or (pwm == self.speed_ticks_s == 0 and not self._is_stuck):
            return 0
        if self._is_stuck:
            pwm = FULL_PWM
        target_ticks_s = self._aimed_ticks_s(pwm)
        if target_ticks_s:
            is_too_fast = self.speed_ticks_s * target_ticks_s > target_ticks_s**2  # a PWM pushes, it does not brake
            constant_s = self.world.coast_constant_s if is_too_fast else self.world.time_constant_s
            rolled_ticks = self._approach(target_ticks_s, constant_s, dt_s)
        else:
            constant_s = self.world.coast_constant_s if pwm else self.world.brake_constant_s
            rolled_ticks = self._slow_down(constant_s, dt_s)
        return self._count(rolled_ticks)

    def _aimed_ticks_s(self, pwm: float) -> float:
        world = self.world
        sense = 1 if pwm > 0 else -1
        swings = self._since_turn_ticks < CASTER_TICKS or self._sense != sense
        duty = abs(pwm) - (world.caster_pwm if swings else 0.0)
        if duty < world.dead_zone_pwm or duty <= 0:
            return 0.0
        dead_pwm = world.dead_zone_pwm
        share = duty / FULL_PWM if world.has_jump else (duty - dead_pwm) / (FULL_PWM - dead_pwm)
        return sense * share * world.full_speed_ticks_s

    def _approach(self, target_ticks_s: float, constant_s: float, dt_s: float) -> float:
        """The exact solution of the first-order lag, so that the result does not depend on the length of the step."""
        decay = math.exp(-dt_s / constant_s)
        ahead_ticks_s = self.speed_ticks_s - target_ticks_s
        self.speed_ticks_s = target_ticks_s + ahead_ticks_s * decay
        return target_ticks_s * dt_s + ahead_ticks_s * constant_s * (1 - decay)

    def _slow_down(self, constant_s: float, dt_s: float) -> float:
        """As if friction drove it backwards, until it stands."""
        friction_ticks_s = self.world.friction_ticks_s
        backwards_ticks_s = -math.copysign(friction_ticks_s, self.speed_ticks_s)
        if friction_ticks_s == 0:
            return self._approach(0.0, constant_s, dt_s)
        until_stand_s = constant_s * math.log((abs(self.speed_ticks_s) + friction_ticks_s) / friction_ticks_s)
        if until_stand_s > dt_s:
            return self._approach(backwards_ticks_s, constant_s, dt_s)
        rolled_ticks = self._approach(backwards_ticks_s, constant_s, until_stand_s)
        self.speed_ticks_s = 0.0
        return rolled_ticks

    def _count(self, rolled_ticks: float) -> int:
        sense = (rolled_ticks > 0) - (rolled_ticks < 0)
        if sense and sense != self._sense:
            self._sense, self._since_turn_ticks = sense, 0.0
        before = math.floor(EDGES_PER_TICK * self.rolled_ticks)
        self._since_turn_ticks += abs(rolled_ticks)
        self.rolled_ticks += rolled_ticks
        return abs(math.floor(EDGES_PER_TICK * self.rolled_ticks) - before)
