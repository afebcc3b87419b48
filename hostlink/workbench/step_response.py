"""Step responses: what a robot recorded of a step of its speed, and the figures that describe it. Pure.

Figures are those of control engineering, as MATLAB's stepinfo and python-control's step_info define them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hostlink.errors import HostlinkError

RISE_FROM, RISE_TO = 0.1, 0.9
SETTLED_SHARE = 0.05  # of the step, to each side
STARTED_SHARE = 0.02  # of the step: it has begun to move
STEADY_S = 1.0  # the last part of the record
FULL_PWM = 4095.0  # docs/paper-robot.md#numbers
LEAST_SAMPLES = 15
CHANGING_SAMPLES = 4

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sample:
    """Values of one wheel in one message: speeds in the robot's own unit; `pwm` is None where the robot sends none."""

    set_point: float
    measured: float
    pwm: float | None = None


@dataclass(frozen=True, slots=True)
class Record:
    """A wheel from before the step to its end; time 0 is the first command."""

    unit: str  # of the speeds: ticks/s, m/s
    t_s: Floats
    set_point: Floats
    measured: Floats
    pwm: Floats | None = None

    @property
    def target(self) -> float:
        """The speed that was requested last, as the robot has it."""
        return float(self.set_point[-1])

    @property
    def is_set_point_changing(self) -> bool:
        """Whether it moves at the end: the record is too short."""
        return abs(self.target - float(self.set_point[-CHANGING_SAMPLES])) > 0.001 * abs(self.target)

    def forwards(self) -> "Record":
        """Samples with the signs of a wheel that rolls forwards."""
        if self.target >= 0:
            return self
        pwm = None if self.pwm is None else -self.pwm
        return Record(self.unit, self.t_s, -self.set_point, -self.measured, pwm)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFigures:
    """Figures of one wheel. None: not within the record, or the robot does not send the necessary values."""

    target: float  # in the unit of the record
    rise_s: float | None  # from 10 to 90 % of the target
    set_point_rise_s: float | None  # the same of the set-point: the fastest that is meant
    lag_s: float | None  # of the measured speed behind the set-point, at half of the target
    dead_s: float | None  # from the first command until 2 % of the target; the network is in it
    overshoot_percent: float
    settling_s: float | None  # from the first command until it stays within 5 % of the target
    steady_error_percent: float  # mean of the last second less the target; below zero: too slow
    tracking_error: float  # root of the mean square of set-point less measured, in the unit of the record
    saturated_percent: float | None  # share of the time with full PWM


def make_record(unit: str, arrivals_s: Sequence[float], samples: Sequence[Sample]) -> Record:
    """A record of messages that the robot sent at a constant rate.

    Raises:
        HostlinkError: there are too few of them.
    """
    if len(samples) < LEAST_SAMPLES:
        raise HostlinkError(f"only {len(samples)} messages came of the step; does the robot send at 10 Hz?")
    pwm = [sample.pwm for sample in samples if sample.pwm is not None]
    return Record(
        unit,
        regular_times(arrivals_s),
        np.array([sample.set_point for sample in samples]),
        np.array([sample.measured for sample in samples]),
        np.array(pwm) if len(pwm) == len(samples) else None,
    )


def regular_times(arrivals_s: Sequence[float]) -> Floats:
    """The times of messages that were sent at a constant rate: the line through their arrivals.

    A network delays single messages; the robot's loop does not.
    """
    index = np.arange(len(arrivals_s), dtype=float)
    slope_s, first_s = np.polyfit(index, np.array(arrivals_s), 1)
    return np.asarray(first_s + slope_s * index)


def step_figures(record: Record, *, full_pwm: float = FULL_PWM) -> StepFigures:
    """The figures of a step from rest.

    Raises:
        HostlinkError: the set-point is zero at the end or in between: there was no step.
    """
    target = record.target
    driven = np.flatnonzero(record.set_point)
    if target == 0 or not record.set_point[driven[0] :].all():
        raise HostlinkError(
            "the robot's set-point fell to 0 during the step: a fault of its own or of the link stopped it; "
            "see its log lines and `hostlink doctor`"
        )
    forwards = record.forwards()
    size = abs(target)
    t_s, measured, set_point = forwards.t_s, forwards.measured, forwards.set_point
    half_s, set_half_s = crossing_s(t_s, measured, size / 2), crossing_s(t_s, set_point, size / 2)
    return StepFigures(
        target=target,
        rise_s=_rise_s(t_s, measured, size),
        set_point_rise_s=_rise_s(t_s, set_point, size),
        lag_s=None if half_s is None or set_half_s is None else half_s - set_half_s,
        dead_s=crossing_s(t_s, measured, size * STARTED_SHARE),
        overshoot_percent=max(0.0, 100 * (float(measured.max()) / size - 1)),
        settling_s=_settling_s(t_s, measured, size),
        steady_error_percent=100 * (float(measured[t_s > t_s[-1] - STEADY_S].mean()) / size - 1),
        tracking_error=float(np.sqrt(np.mean((set_point - measured) ** 2))),
        saturated_percent=_saturated_percent(forwards, full_pwm),
    )


def crossing_s(t_s: Floats, values: Floats, level: float) -> float | None:
    """Time when the samples first reach a level, on the straight line between two samples."""
    reached = np.flatnonzero(values >= level)
    if not len(reached):
        return None
    at = int(reached[0])
    if at == 0:
        return float(t_s[0])
    share = (level - values[at - 1]) / (values[at] - values[at - 1])
    return float(t_s[at - 1] + share * (t_s[at] - t_s[at - 1]))


def _rise_s(t_s: Floats, values: Floats, size: float) -> float | None:
    begin_s, end_s = crossing_s(t_s, values, RISE_FROM * size), crossing_s(t_s, values, RISE_TO * size)
    return None if begin_s is None or end_s is None else end_s - begin_s


def _settling_s(t_s: Floats, measured: Floats, size: float) -> float | None:
    """The sample after the last one outside; at least one must be inside."""
    outside = np.flatnonzero(np.abs(measured - size) > SETTLED_SHARE * size)
    first_inside = int(outside[-1]) + 1 if len(outside) else 0
    return float(t_s[first_inside]) if first_inside < len(t_s) else None


def _saturated_percent(record: Record, full_pwm: float) -> float | None:
    """Share of the time since the first command with full PWM, in percent; None without PWM."""
    if record.pwm is None:
        return None
    driven = np.abs(record.pwm[record.t_s >= 0])
    return 100 * float(np.mean(driven >= full_pwm * 0.999))
