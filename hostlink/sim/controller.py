"""The robot's control, by ROBOT.md's equations with the paper's mistakes mended. Pure."""

from dataclasses import dataclass

from hostlink.sim.drive_train import FULL_PWM, FULL_SPEED_TICKS_S

DEAD_BAND_PWM = 10
LEAST_PWM = 700
FILTER = 0.1  # weight of the newest speed
S_PER_TICK_S = 0.018  # of minimum jerk: how long a change of one tick/s takes
STANDING_TICKS_S = 5.0  # slower than this a wheel has stopped: its encoder may count the other way now


@dataclass(frozen=True, slots=True)
class Gains:
    """Of one wheel's PID with feedback; table 1 of the paper."""

    kp: float
    ki: float
    kd: float
    feedback: float = 0.05


LEFT_GAINS = Gains(23.0, 36.0, 0.1)
RIGHT_GAINS = Gains(24.0, 35.0, 0.1)


class MinimumJerk:
    """A set-point that goes from where it is to a target without a jerk."""

    def __init__(self) -> None:
        self.value = self.target = 0.0
        self._from = 0.0
        self._elapsed_s = self._length_s = 0.0

    def aim(self, target: float) -> None:
        """Go to a new target from the present value; the same target again changes nothing."""
        if target != self.target:
            self._from, self.target = self.value, target
            self._elapsed_s, self._length_s = 0.0, abs(target - self.value) * S_PER_TICK_S

    def halt(self) -> None:
        """Be at zero now."""
        self.value = self.target = self._from = 0.0
        self._length_s = 0.0

    def step(self, dt_s: float) -> float:
        """The set-point after `dt_s` more."""
        self._elapsed_s += dt_s
        s = 1.0 if self._length_s <= 0 else min(self._elapsed_s / self._length_s, 1.0)
        self.value = self._from + (self.target - self._from) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        return self.value


class WheelController:
    """Set-point, filter, PID and motor output of one wheel."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self.set_point = MinimumJerk()
        self.speed_ticks_s = 0.0  # filtered, signed
        self.pwm = 0
        self.direction = 1  # the sign that the encoder's ticks are given
        self._output = self._integral = self._last_error = 0.0

    def aim(self, ticks_s: float) -> None:
        """Ask for a speed. Zero is no ramp but a stop: a robot that is told to stop stops."""
        if ticks_s == 0:
            self.set_point.halt()
        else:
            self.set_point.aim(ticks_s)

    def step(self, ticks: int, dt_s: float) -> int:
        """One turn of the loop; returns the signed ticks that the wheel rolled since the last one."""
        signed = ticks * self.direction
        self.speed_ticks_s += FILTER * (signed / dt_s - self.speed_ticks_s)
        wanted = self.set_point.step(dt_s)
        if wanted == 0 and self.set_point.target == 0:
            self._output = self._integral = self._last_error = 0.0
        else:
            self._output = self._regulate(wanted, dt_s)
        self.pwm = motor_output(self._output)
        # One channel has no sign: it follows the motor only when the wheel has come to rest.
        if self.pwm * self.direction < 0 and ticks / dt_s < STANDING_TICKS_S:
            self.direction = -self.direction
        return signed

    def _regulate(self, wanted: float, dt_s: float) -> float:
        gains = self.gains
        error = wanted - self.speed_ticks_s - gains.feedback * self._output / FULL_PWM * FULL_SPEED_TICKS_S
        integral = self._integral + error * dt_s
        free = gains.kp * error + gains.ki * integral + gains.kd * (error - self._last_error) / dt_s
        output = max(-FULL_PWM, min(FULL_PWM, free))
        if output == free or (free > 0) != (error > 0):  # no winding up against the limit
            self._integral = integral
        self._last_error = error
        return output


def motor_output(wanted: float) -> int:
    """The PWM with a sign: nothing up to 10, at least 700 above, 4095 at the most."""
    size = min(abs(wanted), FULL_PWM)
    if size <= DEAD_BAND_PWM:
        return 0
    return round(max(size, LEAST_PWM)) * (1 if wanted > 0 else -1)
