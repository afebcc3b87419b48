"""DriveTrain: a motor with a wheel and a single-channel encoder, as first-order as the robot's own. Pure."""

import math

FULL_PWM = 4095
FULL_SPEED_TICKS_S = 280.0  # ROBOT.md: the top speed
TIME_CONSTANT_S = 0.1  # a geared 12 V motor under a small robot
STICTION_PWM = 350  # below it the wheel does not move; well under the firmware's dead band of 700


class DriveTrain:
    """One wheel. It turns at `speed_ticks_s`, signed; its encoder counts edges without a sign."""

    def __init__(self) -> None:
        self.speed_ticks_s = 0.0
        self.rolled_ticks = 0.0  # signed, exact: the truth that odometry tries to tell
        self._counted = 0.0

    def step(self, pwm: float, dt_s: float) -> int:
        """Drive with a signed PWM for `dt_s`; returns the edges that the encoder saw."""
        target_ticks_s = 0.0 if abs(pwm) < STICTION_PWM else pwm / FULL_PWM * FULL_SPEED_TICKS_S
        decay = math.exp(-dt_s / TIME_CONSTANT_S)
        # The exact solution of the first-order lag over the step, so that the result does not depend on its length.
        rolled_ticks = target_ticks_s * dt_s + (self.speed_ticks_s - target_ticks_s) * TIME_CONSTANT_S * (1 - decay)
        self.speed_ticks_s = target_ticks_s + (self.speed_ticks_s - target_ticks_s) * decay
        before = math.floor(self._counted)
        self._counted += abs(rolled_ticks)
        self.rolled_ticks += rolled_ticks
        return math.floor(self._counted) - before
