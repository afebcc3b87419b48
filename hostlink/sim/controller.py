"""The robot's control (docs/robot.md#equations), without the mistakes of the paper's code. Pure.

The firmware's, operation by operation and in its single precision: the same edges and times give the same PWMs.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum, StrEnum, auto

import numpy as np

from hostlink.sim.drive_train import EDGES_PER_TICK, FULL_PWM, FULL_SPEED_TICKS_S

DEAD_BAND_PWM = 10
LEAST_PWM = 700
FILTER = 0.1  # weight of the newest speed
S_PER_TICK_S = 0.018  # of minimum jerk, for a change of one tick/s
SLOWER_S_PER_TICK_S = 0.0009  # the same where the set-point goes towards zero
LOOP_S = 1 / 30
FEEDBACK_WASHOUT_S = 1.0  # how fast Feedback.WASHED_OUT fades
HALF_TURN_S = LOOP_S / 2
NOTHING_TICKS_S = 0.001  # a set-point of less is zero: rounding must not decide a sign
STANDING_S = 0.1  # braked and without an edge: a wheel has come to rest, or all but
REST_S = 5.0  # from a zero to rest; a wheel that is slower runs away
HIGH_PWM = 2048  # turns any wheel that is free
STALLED_S = 0.5  # with a high PWM and no edge
BLIND_S = 5.0  # with any PWM and no edge
RECENT_TURNS = 6  # a fifth of a second: the filter is late by a third of one
REQUEST_TURNS = 9  # 0.3 s: a wheel follows its set-point that much later
OUTDATED_SHARE = 0.05  # of the set-point: below it, the filter has forgotten the higher speed
SLOWER_FACTOR = 1.15  # of the set-point: until then, from here a wheel brakes,
BRAKED_TURNS = 6  # until a wheel that was braked is as fast as its PWM makes it
TOO_FAST_FACTOR = 1.05  # else of the requested speed, and so much more,
TOO_FAST_TICKS_S = 2.0  # whatever the PID computes
COUNT_TICKS = 0.49  # nearly an edge: so much a count may be off
RUNAWAY_FACTOR = 1.1  # too fast, although it has braked since 1.05: by so much,
RUNAWAY_TICKS_S = 20.0  # and by so much,
RUNAWAY_S = 0.5  # the least duration
SLOWING_FACTOR = 0.9  # without having slowed to this share of its peak


@dataclass(frozen=True, slots=True)
class Gains:
    """Of one wheel's PID with feedback; table 1 of the paper."""

    kp: float
    ki: float
    kd: float
    feedback: float = 0.05


class Feedback(Enum):
    """What of the last output the PID subtracts from its error."""

    WASHED_OUT = 0  # its changes: a steady output costs no speed
    PAPER = 1  # all of it: the integral then keeps every speed 5 % below the request


LEFT_GAINS = Gains(23.0, 36.0, 0.1)
RIGHT_GAINS = Gains(24.0, 35.0, 0.1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Temper:
    """How quickly a robot's control goes to a new speed; the defaults are the firmware's."""

    left: Gains = LEFT_GAINS
    right: Gains = RIGHT_GAINS
    s_per_tick_s: float = S_PER_TICK_S
    slower_s_per_tick_s: float = SLOWER_S_PER_TICK_S
    filter: float = FILTER


PAPER = Temper()
NIMBLE = Temper(  # at a new speed within 0.3 s, as small robots are today
    left=Gains(12.0, 120.0, 0.0),
    right=Gains(12.0, 120.0, 0.0),
    s_per_tick_s=0.002,
    slower_s_per_tick_s=0.0001,
    filter=0.6,
)


class RobotKind(StrEnum):
    """Of simulated robots, by how quickly they follow."""

    NIMBLE = "nimble"
    PAPER = "paper"

    @property
    def temper(self) -> Temper:
        """Of its control."""
        return PAPER if self is RobotKind.PAPER else NIMBLE


class MinimumJerk:
    """A set-point that goes from where it is to a target without a jerk; the firmware's, operation by operation.

    Its slope is at most 1.875 / S_PER_TICK_S away from zero and 1.875 / SLOWER_S_PER_TICK_S towards zero, and it never
    passes the target. A further or nearer target the same way keeps the slope, so that commands which change ten times
    a second add up to one motion; one the other way begins at zero slope. Before a target of the other sign it is zero
    at once, and at a target of zero, too.
    """

    def __init__(self, s_per_tick_s: float = S_PER_TICK_S, slower_s_per_tick_s: float = SLOWER_S_PER_TICK_S) -> None:
        self.value = self.target = 0.0
        self._s_per_tick_s = s_per_tick_s
        self._slower_s_per_tick_s = slower_s_per_tick_s
        self._from = 0.0
        self._elapsed_s = self._length_s = 0.0

    def aim(self, target: float) -> None:
        """Go to a new target from the present value; the same target again changes nothing."""
        if target == self.target:
            return
        if target == 0.0 or (self.value > 0.0 if target < 0.0 else self.value < 0.0):
            self.stop()
        rest = target - self.value
        goes_on = rest * (self.target - self._from) > 0.0  # by the whole way: rounding decides what is left at its end
        s = self._rising_phase() if goes_on else 0.0
        # The slope of each curve is 30 s^2 (1-s)^2 / its seconds per tick, whatever its way.
        way = rest / (1.0 - travelled(1.0, s))
        self._from = self.value - travelled(way, s)
        self.target = target
        is_slower = abs(target) < abs(self.value)
        self._length_s = abs(way) * (self._slower_s_per_tick_s if is_slower else self._s_per_tick_s)
        self._elapsed_s = s * self._length_s

    def stop(self) -> None:
        """Be at zero now."""
        self.value = self.target = self._from = 0.0
        self._elapsed_s = self._length_s = 0.0

    def begin_at_zero(self) -> None:
        """Go to the target from a standstill."""
        target = self.target
        self.stop()
        self.aim(target)

    def step(self, dt_s: float) -> float:
        """The set-point after `dt_s` more."""
        self._elapsed_s += dt_s
        if not self._elapsed_s < self._length_s:  # also when there is no way to go
            self.value = self.target
            self._elapsed_s = self._length_s
        else:
            self.value = self._from + travelled(self.target - self._from, self._elapsed_s / self._length_s)
        return self.value

    def _rising_phase(self) -> float:
        """Where in its first half a curve has the present slope: the second half has the same slopes, and is slower."""
        if not self._elapsed_s < self._length_s:
            return 0.0
        s = self._elapsed_s / self._length_s
        return s if s < 0.5 else 1.0 - s  # noqa: PLR2004


class RecentSpeed:
    """Ticks and seconds of the last fifth of a second, and of the last turn.

    The filter of the PID is late by a third of a second.
    """

    def __init__(self) -> None:
        self._ticks = [0.0] * RECENT_TURNS
        self._seconds = [0.0] * RECENT_TURNS
        self._at = 0
        self.last_ticks = 0.0

    @property
    def ticks(self) -> float:
        """Added up in the firmware's order."""
        return sum(self._ticks, 0.0)

    @property
    def seconds(self) -> float:
        """Added up in the firmware's order."""
        return sum(self._seconds, 0.0)

    def add(self, ticks: float, dt_s: float) -> None:
        """A turn of the loop."""
        self.last_ticks = ticks
        self._ticks[self._at] = ticks
        self._seconds[self._at] = dt_s
        self._at = (self._at + 1) % RECENT_TURNS

    def is_above(self, ticks_s: float) -> bool:
        """Whether the mean speed, which has no sign, is more."""
        return self.ticks > ticks_s * self.seconds + COUNT_TICKS


class WheelFault(Enum):
    """Why a wheel does not follow its command."""

    STALLED = auto()  # driven, and no edge: blocked, or its encoder is dead
    RUNAWAY = auto()  # far faster than it should be, and not slowing down: not this program drives it


class Pid:
    """e = wanted - measured - feedback * last output, or its changes alone; no winding up against the limit."""

    def __init__(self, gains: Gains, feedback: Feedback = Feedback.WASHED_OUT) -> None:
        self.gains = gains
        self._feedback = feedback
        self._steady_ticks_s = 0.0  # the output's slow part, which is not fed back
        self._output = self._integral = self._last_error = 0.0

    def step(self, wanted: float, measured: float, dt_s: float, *, low: float, high: float) -> float:
        """The output after `dt_s` more, within `low` and `high`."""
        gains = self.gains
        error = wanted - measured - gains.feedback * self._fed_back_ticks_s(dt_s)
        integral = self._integral + error * dt_s
        free = gains.kp * error + gains.ki * integral + gains.kd * (error - self._last_error) / dt_s
        output = max(low, min(high, free))
        if output == free or (free > 0) != (error > 0):  # no winding up against the limit
            self._integral = integral
        self._last_error = error
        self._output = output
        return output

    def scale_integral(self, factor: float) -> None:
        """Begin with what another speed needs."""
        self._integral = self._integral * factor

    def reset(self) -> None:
        """Begin anew, at an output of zero."""
        self._output = self._steady_ticks_s = self._integral = self._last_error = 0.0

    def _fed_back_ticks_s(self, dt_s: float) -> float:
        """The last output as a speed; washed out, less its mean over the last second or so."""
        last_ticks_s = self._output / FULL_PWM * FULL_SPEED_TICKS_S
        if self._feedback is Feedback.PAPER:
            return last_ticks_s
        quick_ticks_s = last_ticks_s - self._steady_ticks_s
        self._steady_ticks_s += quick_ticks_s * dt_s / (FEEDBACK_WASHOUT_S + dt_s)
        return quick_ticks_s


class WheelController:
    """Set-point, filter, PID and motor output of one wheel.

    One channel of an encoder has no sign, so the wheel must never roll otherwise than it is driven:

    | set-point        | wheel                         | motor                                                 |
    |------------------|-------------------------------|-------------------------------------------------------|
    | zero             | any                           | brakes; the edges keep their sign                     |
    | along the sign   | faster than requested in the  | brakes, at the latest after 0.2 s                     |
    |                  | last 0.3 s                    |                                                       |
    | along the sign,  | faster than the set-point in  | brakes                                                |
    | has gone slower  | the last turn                 |                                                       |
    | along the sign   | any                           | driven that way, or brakes: never a torque against it |
    | against the sign | had an edge in the last 0.1 s | brakes; the set-point waits at zero                   |
    | against the sign | stands: braked for 0.1 s, and | the sign changes, then it is driven                   |
    |                  | no edge meanwhile             |                                                       |
    """

    def __init__(self, gains: Gains, feedback: Feedback = Feedback.WASHED_OUT, temper: Temper = PAPER) -> None:
        self.pid = Pid(gains, feedback)
        self.set_point = MinimumJerk(temper.s_per_tick_s, temper.slower_s_per_tick_s)
        self._filter = temper.filter
        self.speed_ticks_s = 0.0  # filtered, signed
        self._outdated_ticks_s = 0.0  # of speed_ticks_s: what the PID ignores, as the set-point has given it up
        self._braked_turns = 0  # for which the PID ignores what the wheel's brake did
        self.pwm = 0
        self.direction = 1  # the sign that the encoder's ticks are given
        self.watch = WheelWatch()
        self.recent = RecentSpeed()
        self._recent_requests = deque([0.0], REQUEST_TURNS)
        self._still_s = 0.0  # since the last edge, and since it was driven: a wheel may roll before it has an edge

    def aim(self, ticks_s: float) -> None:
        """Request a speed."""
        self.set_point.aim(np.float32(ticks_s))  # type: ignore[arg-type]

    @property
    def pwm_now(self) -> int:
        """Of the last turn, unless a command has stopped the wheel since."""
        return 0 if self.set_point.value == 0 else self.pwm

    @property
    def stands(self) -> bool:
        """Whether the wheel has come to rest, by its encoder."""
        return has_lasted(self._still_s, STANDING_S)

    @property
    def requested_ticks_s(self) -> float:
        """The fastest that the set-point allows."""
        return max(abs(self.set_point.value), abs(self.set_point.target))

    @property
    def recent_request_ticks_s(self) -> float:
        """The fastest that the set-point allowed in the last 0.3 s."""
        return max(self._recent_requests)

    def step(self, edges: int, dt_s: float) -> float:
        """One turn of the loop; returns the signed ticks that the wheel rolled since the last one."""
        dt_s = np.float32(dt_s)  # type: ignore[assignment]  # it makes each number that it meets a single one
        ticks = edges / EDGES_PER_TICK
        signed = ticks * self.direction
        self.speed_ticks_s += self._filter * (signed / dt_s - self.speed_ticks_s)
        self.recent.add(ticks, dt_s)
        self._still_s = 0.0 if edges or self.pwm else min(self._still_s + dt_s, 1.0)
        before, wanted = self.set_point.value, self.set_point.step(dt_s)
        self._forget(before, wanted)
        self._recent_requests.append(self.requested_ticks_s)
        is_reversal = wanted * self.direction < -NOTHING_TICKS_S
        is_resting = wanted * self.direction < NOTHING_TICKS_S
        if is_resting:
            self._rest(is_reversal=is_reversal)
        else:
            self.pwm = motor_output(self._regulate(wanted, dt_s))
        is_waiting = is_resting and self.set_point.target != 0
        self.watch.step(self, has_edges=edges > 0, is_waiting=is_waiting, dt_s=dt_s)
        return signed

    def _rest(self, *, is_reversal: bool) -> None:
        """Brake; and once the wheel stands, its edges may get the other sign."""
        self.pwm = 0
        self.pid.reset()
        self._outdated_ticks_s = 0.0
        self._braked_turns = 0
        if self.stands:
            self.speed_ticks_s = 0.0  # the filter need not find out
        if is_reversal:
            self.set_point.begin_at_zero()
        if is_reversal and self.stands:
            self.direction = -self.direction

    def _regulate(self, wanted: float, dt_s: float) -> float:
        low, high = (0.0, float(FULL_PWM)) if self.direction > 0 else (-float(FULL_PWM), 0.0)
        output = self.pid.step(wanted, self.speed_ticks_s - self._outdated_ticks_s, dt_s, low=low, high=high)
        is_over = self._is_too_fast(dt_s)
        if not is_over and not self._is_to_slow_down(dt_s):
            return output
        if is_over:
            self.pid.scale_integral(self.recent_request_ticks_s * self.recent.seconds / self.recent.ticks)
        self._braked_turns = BRAKED_TURNS
        return 0.0

    def _forget(self, before: float, wanted: float) -> None:
        """Let the filter and the integral follow a set-point that goes slower, and not notice a braking.

        They are late by a third of a second and more: otherwise the wheel is braked to a standstill, driven too fast,
        and braked again, for as long as the command lasts.
        """
        self._outdated_ticks_s -= self._filter * self._outdated_ticks_s
        if abs(wanted) < abs(before):
            self._outdated_ticks_s += before - wanted
            self.pid.scale_integral(wanted / before)
        if self._braked_turns > 0:
            self._braked_turns -= 1
            self._outdated_ticks_s = self.speed_ticks_s - wanted

    def _is_to_slow_down(self, dt_s: float) -> bool:
        """Whether the wheel is faster than the set-point, as long as the filter still has the higher speed."""
        wanted_ticks_s = abs(self.set_point.value)
        is_outdated = abs(self._outdated_ticks_s) > OUTDATED_SHARE * wanted_ticks_s
        return is_outdated and self.recent.last_ticks > SLOWER_FACTOR * wanted_ticks_s * dt_s + COUNT_TICKS

    def _is_too_fast(self, dt_s: float) -> bool:
        """Whether the wheel is faster than it was requested to be in the last 0.3 s.

        The window is late by a tenth of a second: the last turn ends the braking before the wheel stands.
        """
        allowed_ticks_s = TOO_FAST_FACTOR * self.recent_request_ticks_s + TOO_FAST_TICKS_S
        return self.recent.is_above(allowed_ticks_s) and self.recent.last_ticks + COUNT_TICKS > allowed_ticks_s * dt_s


class WheelWatch:
    """Finds a wheel that does not follow its command; `fault` stays until it is forgiven."""

    def __init__(self) -> None:
        self.fault: WheelFault | None = None
        self._has_stood = True  # since it was last driven: what rolls then is rolled by somebody else
        self._waited_s = 0.0  # for a standstill, to reverse
        self._blind_s = 0.0  # driven without an edge
        self._strained_s = 0.0  # the same with a high PWM
        self._over_s = 0.0  # too fast
        self._peak_ticks_s = 0.0  # the fastest that it was meanwhile

    def step(self, wheel: WheelController, *, has_edges: bool, is_waiting: bool, dt_s: float) -> None:
        """Check a wheel after each of its turns."""
        self._has_stood = wheel.pwm == 0 and (self._has_stood or wheel.stands)
        self._waited_s = self._waited_s + dt_s if is_waiting else 0.0
        is_stalled = self._is_stalled(wheel.pwm, has_edges, dt_s)
        runs_away = self._runs_away(wheel, dt_s)
        if self.fault is None and (is_stalled or runs_away):
            self.fault = WheelFault.RUNAWAY if runs_away else WheelFault.STALLED

    def forgive(self) -> None:
        """Begin anew."""
        self.fault = None
        self._waited_s = self._blind_s = self._strained_s = self._over_s = self._peak_ticks_s = 0.0

    def _is_stalled(self, pwm: int, has_edges: bool, dt_s: float) -> bool:
        is_blind = pwm != 0 and not has_edges
        self._blind_s = self._blind_s + dt_s if is_blind else 0.0
        self._strained_s = self._strained_s + dt_s if is_blind and abs(pwm) >= HIGH_PWM else 0.0
        return has_lasted(self._strained_s, STALLED_S) or has_lasted(self._blind_s, BLIND_S)

    def _runs_away(self, wheel: WheelController, dt_s: float) -> bool:
        """A wheel that coasts or has a lower set-point slows down; one that is driven from outside does not."""
        if has_lasted(self._waited_s, REST_S):
            return True
        if self._has_stood or not self._is_over(wheel):
            self._over_s = self._peak_ticks_s = 0.0
            return False
        speed_ticks_s = wheel.recent.ticks / wheel.recent.seconds
        self._over_s += dt_s
        self._peak_ticks_s = max(self._peak_ticks_s, speed_ticks_s)
        if not has_lasted(self._over_s, RUNAWAY_S):
            return False
        slows_down = speed_ticks_s <= self._peak_ticks_s * SLOWING_FACTOR
        self._over_s = self._peak_ticks_s = 0.0
        return not slows_down

    def _is_over(self, wheel: WheelController) -> bool:
        requested_ticks_s = wheel.recent_request_ticks_s
        allowed_ticks_s = max(requested_ticks_s + RUNAWAY_TICKS_S, requested_ticks_s * RUNAWAY_FACTOR)
        return wheel.recent.ticks / wheel.recent.seconds > allowed_ticks_s


def travelled(way: float, s: float) -> float:
    """What a minimum-jerk curve has travelled of its way after the share `s` of its time."""
    return way * s * s * s * (10.0 + s * (-15.0 + 6.0 * s))


def has_lasted(time_s: float, wanted_s: float) -> bool:
    """Times are sums of turns: half a turn less, so that rounding decides nothing."""
    return time_s > wanted_s - HALF_TURN_S


def motor_output(wanted: float) -> int:
    """The PWM with a sign: nothing up to 10, at least 700 above, 4095 at the most; what is no number is nothing."""
    size = min(abs(wanted), FULL_PWM)
    if not size > DEAD_BAND_PWM:  # NaN compares false
        return 0
    return math.floor(max(size, LEAST_PWM) + 0.5) * (1 if wanted > 0 else -1)
