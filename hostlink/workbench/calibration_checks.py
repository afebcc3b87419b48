"""Checks of numbers that a person read off a tape measure: slips of the pen, and exchanged sides. Pure.

Each function returns a line for that person; empty: nothing is wrong that can be found so.
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.workbench.calibration import (
    Calibration,
    MeasuredRun,
    Measurement,
    RunKind,
    WheelGeometry,
    calibrated,
    end_of,
    student_95,
    uncorrected,
)

MOST_OFF = 0.15  # of a length or an angle: wheels that were measured at all are not farther off
MOST_OFF_SQUARE = 1.0  # of the side: the same wheels after four sides and corners
MOST_APART = 0.2  # of the side, between two squares driven alike; a random caster makes a tenth
MOST_APART_LINE = 0.02  # of the length, between two lines
MOST_LEFT = 0.1  # of the side, that no wheels explain
MUCH_BETTER = 3.0  # how many times smaller the remains of another reading of the same numbers are
LEAST_LEFT = 0.02  # of the side: remains that need no other reading; the robot and the tape leave as much
SMALL_END = 0.05  # of the side: a square that ends so near where it is expected needs no other unit
TINY_END = 0.01  # of the side: a hundredth of MOST_OFF_SQUARE
UNIT_FACTORS = {"metres": 100.0, "millimetres": 0.1, "inches": 2.54}  # of what was taken for centimetres
SLIPS = (10.0, 100.0, 1000.0, 2.54, 25.4, 39.37)  # between two units, or of a decimal point
ALIKE = 0.05  # of such a factor
TURNS_DIFFER = 0.08  # between the separations by turns and by squares; 5 % is a caster that twists each corner
CONFIRMED = 0.5  # of the error before: what a check drive may leave at most,
SMALLER = 0.8  # or so much where the robot's noise explains what is left
NOISE = 2.5  # times what the calibration left of a square
SMALL = 0.01  # of a length or a side: no error worth a word
WORTH_LINE = 0.003  # of its length
MANY = 1000  # drives, of which the scatter is known
MOST_NOISE = 0.1  # of the side: more is an error in any case

_SQUARES = (RunKind.SQUARE_CCW, RunKind.SQUARE_CW)


def complaint_of_run(run: MeasuredRun, correction: OdometryCorrection) -> str:
    """Check one drive against the odometry that led it."""
    odometry = end_of(run, correction)
    if run.kind is RunKind.STRAIGHT:
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


def complaint_of_nominal(nominal: WheelGeometry, known: WheelGeometry) -> str:
    """Check the numbers that a robot assumes against known numbers: a slip or a wrong unit, by its factor."""
    names = ("radius of the left wheel", "radius of the right wheel", "wheels' separation")
    for name, value_m, known_m in zip(names, nominal, known, strict=True):
        ratio = max(value_m / known_m, known_m / value_m)
        if any(abs(ratio / factor - 1) < ALIKE for factor in SLIPS):
            more = "times" if value_m > known_m else "times less than"
            return (
                f"the {name}, {value_m:g} m, is {ratio:.3g} {more} the {known_m:g} m that hostlink has for it: "
                "a decimal slip, or a unit? Numbers are metres"
            )
    return ""


def doubt_of_squares(runs: Sequence[MeasuredRun]) -> str:
    """Ask whether squares that all end at their start, to a hundredth of their side, were measured in a larger unit.

    A robot may drive so well. If it does not, its numbers were entered 100 times too small, and the check drives
    cannot show that, because the same person measures them.
    """
    squares = [run for run in runs if run.kind in _SQUARES]
    ends = [math.hypot(*run.measured[:2]) for run in squares]
    if not any(ends) or any(end_m > TINY_END * run.size for end_m, run in zip(ends, squares, strict=True)):
        return ""
    farthest = squares[ends.index(max(ends))].measured
    return (
        f"every square ends within {max(ends) * 1000:.1f} mm of its start, for example at {_xy(farthest)}. "
        "Few robots drive so well. Were metres entered as centimetres?"
    )


def complaint_of_runs(runs: Sequence[MeasuredRun], nominal: WheelGeometry) -> str:
    """Check all drives together: those that should agree, and the wheels that would explain them."""
    if complaint := _complaint_of_repeats(runs, nominal):
        return complaint
    found = calibrated(runs, nominal)
    side_m = max(run.size for run in runs if run.kind in _SQUARES)
    if complaint := _complaint_of_reading(runs, found, side_m):
        return complaint
    if complaint := _complaint_of_units(runs, found):
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

    before_m: float  # how far the check's squares end from the robot's own odometry, root mean square
    after_m: float  # the same from the corrected one
    complaint: str  # empty: it is confirmed


class _Check(NamedTuple):
    """The errors of one kind of drive, with the old numbers and with the new ones."""

    name: str
    before_m: float
    after_m: float
    most_m: float  # what the robot's own noise explains
    worth_m: float  # an error before that is worth a calibration
    size_m: float  # of the line or the side

    @property
    def is_gain(self) -> bool:
        share = SMALLER if self.after_m <= self.most_m else CONFIRMED
        return self.before_m > self.worth_m and self.after_m <= share * self.before_m

    @property
    def complaint(self) -> str:
        if self.after_m <= max(CONFIRMED * self.before_m, self.most_m):
            return ""
        return (
            f"the check drive does not confirm it: the {self.name} {self.before_m * 100:.1f} cm off with the old "
            f"numbers, {self.after_m * 100:.1f} cm with the new ones. Nothing is kept: {self._next_step}"
        )

    @property
    def _next_step(self) -> str:
        slip = "find a slip, or left and right exchanged, in what was entered"
        if max(self.before_m, self.after_m) > MOST_NOISE * self.size_m:
            return slip
        return f"if this robot's drives scatter by as much, more of them help (--repeats, a longer --side); else {slip}"


def confirm(calibration: Calibration, checks: Iterable[MeasuredRun]) -> Confirmation:
    """Whether drives that the calibration does not know end at its odometry, and not at the robot's own."""
    runs = list(checks)
    squares = _check_squares(calibration, [run for run in runs if run.kind in _SQUARES])
    found = [squares, *(_check_line(calibration, run) for run in runs if run.kind is RunKind.STRAIGHT)]
    complaint = next((check.complaint for check in found if check.complaint), "")
    if not complaint and not any(check.is_gain for check in found):
        complaint = (
            f"there is nothing to gain: the squares of the check end {squares.before_m * 100:.1f} cm off with the old "
            f"numbers, {squares.after_m * 100:.1f} cm with the new ones. Nothing is kept"
        )
    return Confirmation(squares.before_m, squares.after_m, complaint)


def _check_squares(calibration: Calibration, runs: Sequence[MeasuredRun]) -> _Check:
    """Root mean squares; a single square of a noisy robot may end anywhere."""
    old, new = uncorrected(calibration.nominal), calibration.correction
    before_m, after_m = (
        math.sqrt(sum(math.dist(run.measured[:2], end_of(run, correction)[:2]) ** 2 for run in runs) / len(runs))
        for correction in (old, new)
    )
    side_m = runs[0].size
    most_m = min(NOISE * _scatter_m(calibration) + SMALL * side_m, MOST_NOISE * side_m)
    return _Check("squares are", before_m, after_m, most_m, SMALL * side_m, side_m)


def _scatter_m(calibration: Calibration) -> float:
    """Scatter of one more square: few squares show little of it, so the factor of Student's distribution widens it."""
    freedom = 2 * calibration.squares - 2
    spread = calibration.residual_m * math.sqrt(2 * calibration.squares / freedom)
    return spread * student_95(max(freedom, 3)) / student_95(MANY)


def _check_line(calibration: Calibration, run: MeasuredRun) -> _Check:
    """Along the line: across it the mark's direction counts more than the wheels."""
    old, new = end_of(run, uncorrected(calibration.nominal)), end_of(run, calibration.correction)
    x_m = run.measured.x_m
    return _Check("line is", abs(x_m - old.x_m), abs(x_m - new.x_m), SMALL * run.size, WORTH_LINE * run.size, run.size)


def _complaint_of_line(measured: Measurement, odometry: Measurement, length_m: float) -> str:
    if abs(measured.x_m - odometry.x_m) > MOST_OFF * length_m:
        return (
            f"the tape measure has {measured.x_m:.2f} m, the odometry {odometry.x_m:.2f} m: more than 15 % apart. "
            f"{_slip_or_unit(odometry.x_m / measured.x_m if measured.x_m else 0.0)}"
        )
    if abs(measured.y_m) > MOST_OFF * 2 * length_m:
        return f"{measured.y_m * 100:.0f} cm to the side on {length_m:g} m: no line. A decimal slip, or a unit?"
    return ""


def _slip_or_unit(factor: float) -> str:
    """Possible cause of a number that is wrong by this factor."""
    for unit, of_centimetres in UNIT_FACTORS.items():
        if abs(factor / of_centimetres - 1) < MOST_OFF:
            return f"A decimal slip, or was it in {unit}? Enter the unit with the number"
    return "A decimal slip, or a unit?"


def _complaint_of_units(runs: Sequence[MeasuredRun], found: Calibration) -> str:
    """Whether lines and turns lead the squares' ends to where they are if centimetres were metres.

    Other units are too alike for that: a caster turns the corners of squares by more than turns on the spot show.
    """
    if found.separation_by_turns_m is None:
        return ""
    lines = [run for run in runs if run.kind is RunKind.STRAIGHT]
    expected = _bent_as(lines, found.correction._replace(separation_m=found.separation_by_turns_m))
    squares = [run for run in runs if run.kind in _SQUARES]
    ends = [end_of(run, expected) for run in squares]
    apart_m, otherwise_m = (
        math.sqrt(
            sum(
                (k * run.measured.x_m - end.x_m) ** 2 + (k * run.measured.y_m - end.y_m) ** 2
                for run, end in zip(squares, ends, strict=True)
            )
            / len(squares)
        )
        for k in (1.0, UNIT_FACTORS["metres"])
    )
    if apart_m < SMALL_END * squares[0].size or otherwise_m * MUCH_BETTER > apart_m:
        return ""
    return (
        f"by the lines and the turns the squares end {apart_m * 100:.0f} cm from where they were measured, as if "
        f"metres were entered as centimetres: {_xy(squares[0].measured)}. Measure them again, and enter the unit"
    )


def _bent_as(lines: Sequence[MeasuredRun], correction: OdometryCorrection) -> OdometryCorrection:
    """The wheels by whose difference the lines end as far to the side as they were measured."""
    for _ in range(4):  # each leaves a small share of what the one before left
        off_m = sum(line.measured.y_m - end_of(line, correction).y_m for line in lines) / len(lines)
        share = off_m * correction.separation_m / lines[0].size ** 2  # of half the difference; a bow of so much
        left, right = correction.left_factor * (1 - share), correction.right_factor * (1 + share)
        correction = correction._replace(left_factor=left, right_factor=right)
    return correction


def _complaint_of_repeats(runs: Sequence[MeasuredRun], nominal: WheelGeometry) -> str:
    """Difference between two drives of one kind, apart from their odometry."""
    none = uncorrected(nominal)
    for one, other in itertools.combinations(runs, 2):
        if one.kind is not other.kind or one.kind in (RunKind.TURNS_CCW, RunKind.TURNS_CW):
            continue
        errors = [[m - o for m, o in zip(r.measured[:2], end_of(r, none)[:2], strict=True)] for r in (one, other)]
        apart_m = math.dist(*errors)
        limit = MOST_APART_LINE if one.kind is RunKind.STRAIGHT else MOST_APART
        along_m = abs(errors[0][0] - errors[1][0]) if one.kind is RunKind.STRAIGHT else apart_m
        if along_m > limit * one.size:
            return (
                f"two drives alike ({one.kind}) are {along_m * 100:.0f} cm apart: {_xy(one.measured)} and "
                f"{_xy(other.measured)}; one of them is a slip"
            )
    return ""


def _complaint_of_reading(runs: Sequence[MeasuredRun], found: Calibration, side_m: float) -> str:
    """Whether other wheels would explain the same numbers far better, read in another way."""
    if found.residual_m < LEAST_LEFT * side_m:
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
    return run if run.kind not in _SQUARES else replace(run, measured=Measurement(run.measured.x_m, -run.measured.y_m))


def _transposed(run: MeasuredRun) -> MeasuredRun:
    return run if run.kind not in _SQUARES else replace(run, measured=Measurement(run.measured.y_m, run.measured.x_m))


def _xy(at: Measurement) -> str:
    return f"({at.x_m * 100:.1f}, {at.y_m * 100:.1f}) cm"
