"""MotorModel: a first-order motor with dead time, identified from a record, and the PI gains that follow. Pure.

The motor with its filter, from PWM to measured speed: the robot's own loop is closed around it, but both its input and
its output are in the record, so the loop need not be known. docs/gains.md#what-is-identified
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hostlink.errors import HostlinkError
from hostlink.workbench.step_response import Floats, Record

LEAST_TIME_CONSTANT_S, MOST_TIME_CONSTANT_S = 0.02, 5.0
MOST_DEAD_TIME_S = 0.5
LEAST_DEAD_TIME_S = 0.05  # half of the time between two messages: less is not measured, and would give wild gains
LEAST_DRIVEN = 25  # samples
LEAST_EXPLAINED = 0.9  # share of the variance
GRID_S = 1 / 60  # of the simulated motor: half a turn of the robot's loop
_TIME_CONSTANTS, _DEAD_TIMES = 25, 16
_ROUNDS = 4  # of the search, each on a finer grid

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorModel:
    """T dx/dt + x = K (u(t - L) - u0): x the measured speed, u the PWM."""

    gain: float  # K, in the record's unit for a count of PWM
    offset_pwm: float  # u0: what friction and load cost; none in a motor whose dead zone ends with a jump
    time_constant_s: float  # T
    dead_time_s: float  # L
    explained: float  # share of the variance

    def __str__(self) -> str:
        return (
            f"K {self.gain:.4f} a count, T {self.time_constant_s:.3f} s, L {self.dead_time_s:.3f} s, "
            f"friction {self.offset_pwm:.0f} counts ({100 * self.explained:.1f} % of the variance)"
        )


@dataclass(frozen=True, slots=True)
class PidGains:
    """u = Kp e + Ki * integral of e + Kd * de/dt: the form of the robot's firmware."""

    kp: float
    ki: float
    kd: float = 0.0

    def __str__(self) -> str:
        return f"Kp {self.kp:.1f}  Ki {self.ki:.1f}  Kd {self.kd:.1f}"


def simc_gains(model: MotorModel) -> PidGains:
    """PI gains after S. Skogestad, J. Process Control 13 (2003) 291-309, with his choice tau_c = dead time."""
    dead_time_s = max(model.dead_time_s, LEAST_DEAD_TIME_S)
    kp = model.time_constant_s / (model.gain * 2 * dead_time_s)
    integral_s = min(model.time_constant_s, 8 * dead_time_s)
    return PidGains(kp, kp / integral_s)


def identify_motor(record: Record) -> MotorModel:
    """The model that fits the record best, by least squares.

    Raises:
        HostlinkError: the robot sends no PWM, was hardly driven, or is not like such a motor.
    """
    model = _search(driven_part(record.forwards()))
    if model.explained < LEAST_EXPLAINED or model.gain <= 0:
        raise HostlinkError(
            f"PWM and speed do not belong together as a motor's (explained: {100 * max(model.explained, 0.0):.0f} %); "
            "drive it on the floor, straight and undisturbed"
        )
    return model


def driven_part(record: Record) -> Record:
    """The longest part with more than the least PWM: below that the robot drives and brakes between two messages.

    Raises:
        HostlinkError: the robot sends no PWM, or that part is too short.
    """
    if record.pwm is None:
        raise HostlinkError("the robot sends no PWM (its plot_data), without which its motors cannot be identified")
    pushing = record.pwm[record.pwm > 0]
    least_pwm = 1.01 * float(pushing.min()) if len(pushing) else 0.0
    begin, end = _longest_run(record.pwm > least_pwm)
    if end - begin < LEAST_DRIVEN:
        raise HostlinkError(
            f"the wheel was driven steadily for {end - begin} messages only, {LEAST_DRIVEN} are needed; "
            "request a higher --speed"
        )
    part = slice(begin, end)
    return Record(record.unit, record.t_s[part], record.set_point[part], record.measured[part], record.pwm[part])


def _longest_run(flags: Flags) -> tuple[int, int]:
    """Begin and end of the longest run of true ones."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(int)))
    runs = [(int(begin), int(end)) for begin, end in edges.reshape(-1, 2)]
    return max(runs, key=lambda run: run[1] - run[0], default=(0, 0))


def _search(record: Record) -> MotorModel:
    """A grid of time constants and dead times, then finer ones around the best; the rest is linear."""
    constants_s = np.geomspace(LEAST_TIME_CONSTANT_S, MOST_TIME_CONSTANT_S, _TIME_CONSTANTS)
    dead_times_s = np.linspace(0, MOST_DEAD_TIME_S, _DEAD_TIMES)
    for _ in range(_ROUNDS):
        fits = (fit for dead_s in dead_times_s for fit in _fits(record, constants_s, float(dead_s)))
        best = max(fits, key=lambda fit: fit.explained)
        ratio = constants_s[1] / constants_s[0]
        width_s = dead_times_s[1] - dead_times_s[0]
        constants_s = np.geomspace(best.time_constant_s / ratio, best.time_constant_s * ratio, 7)
        dead_times_s = np.linspace(max(0.0, best.dead_time_s - width_s), best.dead_time_s + width_s, 7)
    return best


def _fits(record: Record, constants_s: Floats, dead_time_s: float) -> list[MotorModel]:
    """For each time constant the gain, offset and initial speed that fit best."""
    compared = record.t_s >= record.t_s[0] + MOST_DEAD_TIME_S  # before, the PWM of a dead time ago is not in the record
    measured = record.measured[compared]
    spread = float(((measured - measured.mean()) ** 2).sum())
    fits = []
    for response, constant_s in zip(_responses(record, constants_s, dead_time_s), constants_s, strict=True):
        left = np.exp(-(record.t_s - record.t_s[0]) / constant_s)  # of the state at the beginning
        columns = np.column_stack((response, left - 1, left))[compared]
        (gain, gain_offset, start), *_ = np.linalg.lstsq(columns, measured, rcond=None)
        error = float(((columns @ (gain, gain_offset, start) - measured) ** 2).sum())
        fit = MotorModel(
            gain=float(gain),
            offset_pwm=float(gain_offset / gain) if gain else 0.0,
            time_constant_s=float(constant_s),
            dead_time_s=dead_time_s,
            explained=1 - error / spread if spread > 0 else 0.0,
        )
        fits.append(fit)
    return fits


def _responses(record: Record, constants_s: Floats, dead_time_s: float) -> Floats:
    """Response of motors of gain 1 that begin at rest to the PWM; a row for each time constant."""
    assert record.pwm is not None  # noqa: S101 - of driven_part
    steps = int(np.ceil((record.t_s[-1] - record.t_s[0]) / GRID_S))
    grid_s = record.t_s[0] + GRID_S * np.arange(steps + 1)
    pwm = np.interp(grid_s - dead_time_s, record.t_s, record.pwm)
    decay = np.exp(-GRID_S / constants_s)
    speeds = np.zeros((steps + 1, len(constants_s)))
    for at, mean_pwm in enumerate((pwm[1:] + pwm[:-1]) / 2):
        speeds[at + 1] = speeds[at] * decay + mean_pwm * (1 - decay)
    return np.array([np.interp(record.t_s, grid_s, column) for column in speeds.T])
