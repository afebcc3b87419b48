"""What is wrong with the numbers that a person read off a tape measure: slips, and sides exchanged. Pure.

Each function returns a line for that person; empty: nothing is wrong that can be found so.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from hostlink.robot.calibration import (
    Calibration,
    Kind,
    MeasuredRun,
    Measurement,
    WheelGeometry,
    calibrated,
    end_of,
    uncorrected,
)

MOST_OFF = 0.15  # of a length or an angle: wheels that were measured at all are not farther off
MOST_OFF_SQUARE = 0.6  # of the side: the same wheels after four sides and corners
MOST_APART = 0.2  # of the side, between two squares driven alike; a random caster makes a tenth
MOST_APART_LINE = 0.02  # of the length, between two lines
MOST_LEFT = 0.1  # of the side, that no wheels explain
MUCH_BETTER = 3.0  # how many times smaller the remains of another reading of the same numbers are
LEAST_LEFT_M = 0.01  # remains that need no other reading
TURNS_DIFFER = 0.08  # between the separations by turns and by squares; 5 % is a caster that twists each corner
CONFIRMED = 0.5  # of the error before: what a check drive may leave at most
CONFIRMED_LINE = 0.01  # of a length: what is no error worth speaking of
MOST_LEFT_CHECK = 0.05  # of the side: more is an error in any case

_SQUARES = (Kind.SQUARE_CCW, Kind.SQUARE_CW)


def complaint_of_run(run: MeasuredRun, nominal: WheelGeometry) -> str:
    """Of one drive, against the robot's own odometry."""
    odometry = end_of(run, uncorrected(nominal))
    if run.kind is Kind.STRAIGHT:
        return _complaint_of_line(run.measured, odometry, run.size)
    if run.kind in _SQUARES:
        off_m = math.dist(run.measured[:2], odometry[:2])
        if off_m > MOST_OFF_SQUARE * run.size:
            return (
                f"the tape measure has {_xy(run.measured)}, the odometry {_xy(odometry)}: {off_m * 100:.0f} cm apart "
                "after one square; no wheels explain that. A decimal slip, or a unit?"
            )
        return ""
    turned_rad, odometry_rad = run.measured.theta_rad or 0.0, odometry.theta_rad or 0.0
    if abs(turned_rad - odometry_rad) > MOST_OFF * abs(odometry_rad):
        return (
            f"it turned {math.degrees(turned_rad):.0f} degrees by the mark, {math.degrees(odometry_rad):.0f} by its "
            "odometry: more than 15 % apart. A decimal slip, or a whole turn miscounted?"
        )
    return ""


def complaint_of_runs(runs: Sequence[MeasuredRun], nominal: WheelGeometry) -> str:
    """Of all drives together: those that should agree, and the wheels that would explain them."""
    if complaint := _complaint_of_repeats(runs, nominal):
        return complaint
    found = calibrated(runs, nominal)
    side_m = max(run.size for run in runs if run.kind in _SQUARES)
    if complaint := _complaint_of_reading(runs, found):
        return complaint
    if found.residual_m > MOST_LEFT * side_m:
        return f"no wheels explain these drives: {found.residual_m * 100:.0f} cm are left. Measure the squares again"
    by_turns_m, by_squares_m = found.separation_by_turns_m, found.correction.separation_m
    if by_turns_m is not None and abs(by_turns_m / by_squares_m - 1) > TURNS_DIFFER:
        return (
            f"by the turns the wheels are {by_turns_m * 1000:.0f} mm apart, by the squares "
            f"{by_squares_m * 1000:.0f} mm: one of them was measured or entered wrong"
        )
    return ""


class Confirmation(NamedTuple):
    """The result of the check drives."""

    before_m: float  # the farthest end of the check's squares from the robot's own odometry
    after_m: float  # the same from the corrected one
    complaint: str  # empty: it is confirmed


class _Check(NamedTuple):
    run: MeasuredRun
    before_m: float
    after_m: float
    most_m: float  # that may be left where there was little to gain

    @property
    def is_better(self) -> bool:
        return self.after_m <= CONFIRMED * self.before_m

    @property
    def complaint(self) -> str:
        if self.is_better or self.after_m <= self.most_m:
            return ""
        return (
            f"the check drive does not confirm it: the {self.run.kind} was {self.before_m * 100:.1f} cm off with the "
            f"old numbers and is {self.after_m * 100:.1f} cm off with the new ones. Nothing is kept: find a "
            "decimal slip, or left and right exchanged, in what was entered"
        )


def confirm(calibration: Calibration, checks: Iterable[MeasuredRun]) -> Confirmation:
    """Whether drives that the calibration does not know end at its odometry, and not at the robot's own."""
    found = [_check(calibration, run) for run in checks]
    squares = [check for check in found if check.run.kind in _SQUARES]
    complaint = next((check.complaint for check in found if check.complaint), "")
    if not complaint and not any(check.is_better for check in found):
        complaint = (
            "there is nothing to gain: the check drives end where the old numbers have them, too. Nothing is kept"
        )
    return Confirmation(max(check.before_m for check in squares), max(check.after_m for check in squares), complaint)


def _check(calibration: Calibration, run: MeasuredRun) -> _Check:
    old, new = end_of(run, uncorrected(calibration.nominal)), end_of(run, calibration.correction)
    if run.kind is Kind.STRAIGHT:
        x_m = run.measured.x_m
        return _Check(run, abs(x_m - old.x_m), abs(x_m - new.x_m), CONFIRMED_LINE * run.size)
    most_m = min(2 * calibration.residual_m + CONFIRMED_LINE * run.size, MOST_LEFT_CHECK * run.size)
    return _Check(run, math.dist(run.measured[:2], old[:2]), math.dist(run.measured[:2], new[:2]), most_m)


def _complaint_of_line(measured: Measurement, odometry: Measurement, length_m: float) -> str:
    if abs(measured.x_m - odometry.x_m) > MOST_OFF * length_m:
        return (
            f"the tape measure has {measured.x_m:.2f} m, the odometry {odometry.x_m:.2f} m: more than 15 % apart. "
            "A decimal slip, or a unit?"
        )
    if abs(measured.y_m) > MOST_OFF * 2 * length_m:
        return f"{measured.y_m * 100:.0f} cm to the side on {length_m:g} m: no line. A decimal slip, or a unit?"
    return ""


def _complaint_of_repeats(runs: Sequence[MeasuredRun], nominal: WheelGeometry) -> str:
    """What differs between two drives alike, apart from their odometry."""
    none = uncorrected(nominal)
    for one, other in itertools.combinations(runs, 2):
        if one.kind is not other.kind or one.kind in (Kind.TURNS_CCW, Kind.TURNS_CW):
            continue
        errors = [[m - o for m, o in zip(r.measured[:2], end_of(r, none)[:2], strict=True)] for r in (one, other)]
        apart_m = math.dist(*errors)
        limit = MOST_APART_LINE if one.kind is Kind.STRAIGHT else MOST_APART
        along_m = abs(errors[0][0] - errors[1][0]) if one.kind is Kind.STRAIGHT else apart_m
        if along_m > limit * one.size:
            return (
                f"two drives alike ({one.kind}) are {along_m * 100:.0f} cm apart: {_xy(one.measured)} and "
                f"{_xy(other.measured)}; one of them is a slip"
            )
    return ""


def _complaint_of_reading(runs: Sequence[MeasuredRun], found: Calibration) -> str:
    """Whether other wheels would explain the same numbers far better, read in another way."""
    if found.residual_m < LEAST_LEFT_M:
        return ""
    readings = {
        "left and right, or clockwise and counter-clockwise, exchanged in the squares": [
            _mirrored(run) for run in runs
        ],
        "forward and sideways exchanged in the squares": [_transposed(run) for run in runs],
    }
    left_m = {name: calibrated(read, found.nominal).residual_m for name, read in readings.items()}
    best = min(left_m, key=lambda name: left_m[name])
    if left_m[best] * MUCH_BETTER < found.residual_m:
        return (
            f"the numbers make sense with {best}: {left_m[best] * 100:.1f} cm are left then, "
            f"{found.residual_m * 100:.1f} cm as they are. Measure again"
        )
    return ""


def _mirrored(run: MeasuredRun) -> MeasuredRun:
    return run if run.kind not in _SQUARES else _measured(run, Measurement(run.measured.x_m, -run.measured.y_m))


def _transposed(run: MeasuredRun) -> MeasuredRun:
    return run if run.kind not in _SQUARES else _measured(run, Measurement(run.measured.y_m, run.measured.x_m))


def _measured(run: MeasuredRun, measured: Measurement) -> MeasuredRun:
    return MeasuredRun(run.kind, run.size, run.path, measured)


def _xy(at: Measurement) -> str:
    return f"({at.x_m * 100:.1f}, {at.y_m * 100:.1f}) cm"
