"""Calibration: a robot's wheels from drives, their odometry, and their ends as a tape measure has them. Pure.

There are two methods. UMBmark (J. Borenstein, L. Feng, IEEE Trans. Robotics and Automation 12(6), 1996)
reads the wheels off the four mean errors of squares driven both ways. Least squares over the recorded ways of the
wheels (after G. Antonelli, S. Chiaverini, G. Fusco, IEEE Trans. Robotics 21(5), 2005) uses every number of every drive,
and knows how certain it is. Both integrate the recorded drives anew until nothing changes, so neither is bound to small
errors. Only the way of a wheel per tick can be known from drives: the ticks per turn stay, the radii change.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryCorrection, wheel_way
from hostlink.errors import HostlinkError

MEASURED_M = 0.001  # how finely a tape measure is read: the weights of drives are not more uneven than that
EXPECTED_M = 0.003  # of a line of a few metres: slip and reading; counts as much as EXPECTED_LINES lines
EXPECTED_LINES = 4
MEASURED_RAD = math.radians(1.0)  # the same of a heading, which is measured by eye
ROUNDS = 12  # each round of either method leaves a small share of what the one before left
_QUARTER_RAD = math.pi / 2
_NORMAL_95 = 1.959963985

_Array = NDArray[np.float64]


class RunKind(StrEnum):
    """Kind of a drive: its course."""

    STRAIGHT = "straight"
    TURNS_CCW = "turns_ccw"
    TURNS_CW = "turns_cw"
    SQUARE_CCW = "square_ccw"
    SQUARE_CW = "square_cw"


class WheelGeometry(NamedTuple):
    """The numbers with which a robot integrates its wheels; the defaults are the paper's robot."""

    left_radius_m: float = 0.045
    right_radius_m: float = 0.045
    separation_m: float = 0.210

    def corrected(self, correction: OdometryCorrection) -> "WheelGeometry":
        """The numbers with which the robot would need no correction."""
        left_m, right_m = self.left_radius_m * correction.left_factor, self.right_radius_m * correction.right_factor
        return WheelGeometry(left_m, right_m, correction.separation_m)


class Measurement(NamedTuple):
    """True position of the axle's middle at the end, relative to the start; x is the heading at the start."""

    x_m: float
    y_m: float
    theta_rad: float | None = None  # whole turns stay in it; None: not measured


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """One drive."""

    kind: RunKind
    size: float  # metres of the line or the side; whole turns
    path: tuple[Pose, ...]  # by the robot's own odometry, from the start to the end
    measured: Measurement


class Deviations(NamedTuple):
    """Half of the interval that contains the true number with 95 %."""

    left_radius_m: float
    right_radius_m: float
    separation_m: float


class ReturnErrors(NamedTuple):
    """UMBmark's figure of merit, and what it is made of: how far odometry and truth are apart after a square."""

    cw_m: tuple[float, float]  # mean of x and y
    ccw_m: tuple[float, float]

    @property
    def largest_m(self) -> float:
        """E_max,syst: the farther of the two centres."""
        return max(math.hypot(*self.cw_m), math.hypot(*self.ccw_m))


@dataclass(frozen=True, slots=True)
class Calibration:
    """The result of the drives."""

    nominal: WheelGeometry
    correction: OdometryCorrection
    deviations: Deviations
    umbmark: OdometryCorrection
    separation_by_turns_m: float | None  # of the turns on the spot alone
    before: ReturnErrors
    after: ReturnErrors  # of the same drives, with the correction
    residual_m: float  # root mean square of what the correction leaves of the squares' ends
    squares: int  # of which that is; few of them leave less than another square will

    @property
    def geometry(self) -> WheelGeometry:
        """The numbers that the robot should have."""
        return self.nominal.corrected(self.correction)

    @property
    def umbmark_geometry(self) -> WheelGeometry:
        """Wheels by UMBmark."""
        return self.nominal.corrected(self.umbmark)


def calibrated(runs: Iterable[MeasuredRun], nominal: WheelGeometry) -> Calibration:
    """The wheels of the robot that made these drives while it believed in `nominal`.

    Raises:
        HostlinkError: they do not determine the wheels: a line and squares both ways are needed.
    """
    drives = [_Drive(run, nominal.separation_m) for run in runs]
    _require(drives)
    fit = _fit(drives, nominal)
    squares = [drive for drive in drives if drive.is_square]
    off = [drive.error(fit.correction)[:2] for drive in squares]
    return Calibration(
        nominal=nominal,
        correction=fit.correction,
        deviations=_deviations(fit, nominal),
        umbmark=_umbmark(drives, nominal),
        separation_by_turns_m=_separation_by_turns(drives, fit.correction),
        before=_return_errors(squares, uncorrected(nominal)),
        after=_return_errors(squares, fit.correction),
        residual_m=math.sqrt(sum(x_m**2 + y_m**2 for x_m, y_m in off) / len(off)),
        squares=len(squares),
    )


def end_of(run: MeasuredRun, correction: OdometryCorrection) -> Measurement:
    """Position of the corrected odometry at the end of a drive."""
    return Measurement(*_Drive(run, correction.nominal_separation_m).end(correction))


def uncorrected(nominal: WheelGeometry) -> OdometryCorrection:
    """The correction that changes nothing."""
    return OdometryCorrection(1.0, 1.0, nominal.separation_m, nominal.separation_m)


def student_95(freedom: int) -> float:
    """Student's t for 95 % on both sides; Fisher's expansion, good to 1 % from 3 degrees of freedom on."""
    z = _NORMAL_95
    first = (z**3 + z) / 4
    second = (5 * z**5 + 16 * z**3 + 3 * z) / 96
    third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return z + first / freedom + second / freedom**2 + third / freedom**3


class _Drive:
    """One drive as the ways of its wheels."""

    def __init__(self, run: MeasuredRun, separation_m: float) -> None:
        self.kind, self.size, self.measured = run.kind, run.size, run.measured
        pairs = itertools.pairwise(run.path)
        ways = [wheel_way(before, after, separation_m) for before, after in pairs]
        self._ways: _Array = np.array(ways, dtype=np.float64).reshape(-1, 3)

    @property
    def is_square(self) -> bool:
        return self.kind in (RunKind.SQUARE_CCW, RunKind.SQUARE_CW)

    @property
    def is_straight(self) -> bool:
        return self.kind is RunKind.STRAIGHT

    def end(self, correction: OdometryCorrection) -> tuple[float, float, float]:
        """End of a drive by the corrected odometry; whole turns stay in the angle."""
        left_m = self._ways[:, 0] * correction.left_factor
        right_m = self._ways[:, 1] * correction.right_factor
        turned_rad = (right_m - left_m) / correction.separation_m
        after_rad = np.cumsum(turned_rad)
        heading_rad = after_rad - turned_rad / 2
        chord_m = (left_m + right_m) / 2 * np.sinc(turned_rad / math.tau)
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        x_m = np.sum(chord_m * cos - self._ways[:, 2] * sin)
        y_m = np.sum(chord_m * sin + self._ways[:, 2] * cos)
        return float(x_m), float(y_m), float(np.sum(turned_rad))

    def error(self, correction: OdometryCorrection) -> tuple[float, float, float | None]:
        """Measured less odometry, as UMBmark has it."""
        x_m, y_m, theta_rad = self.end(correction)
        measured_rad = self.measured.theta_rad
        turned_rad = None if measured_rad is None else measured_rad - theta_rad
        return self.measured.x_m - x_m, self.measured.y_m - y_m, turned_rad


class _Fit(NamedTuple):
    correction: OdometryCorrection
    covariance: _Array  # of the three factors
    freedom: int


def _require(drives: Sequence[_Drive]) -> None:
    kinds = {drive.kind for drive in drives}
    missing = [str(kind) for kind in (RunKind.STRAIGHT, RunKind.SQUARE_CCW, RunKind.SQUARE_CW) if kind not in kinds]
    if missing:
        raise HostlinkError(f"a calibration needs also: {', '.join(missing)}")


def _correction(factors: _Array, nominal: WheelGeometry) -> OdometryCorrection:
    left, right, separation = (float(factor) for factor in factors)
    return OdometryCorrection(left, right, nominal.separation_m, nominal.separation_m * separation)


def _fit(drives: Sequence[_Drive], nominal: WheelGeometry) -> _Fit:
    """Least squares twice: equal weights first; then each kind of drive by what was left of it.

    The turns on the spot are left out: a caster that swings round at the begin of each side changes squares, not them.
    """
    used = [drive for drive in drives if drive.is_straight or drive.is_square]
    factors, _ = _solve(used, nominal, np.ones(3), _weights(used, None))
    weights = _weights(used, _correction(factors, nominal))
    factors, jacobian = _solve(used, nominal, factors, weights)
    freedom = max(len(used) - 2, 3)  # one for each drive: what went wrong on its way moves x and y together
    covariance: _Array = np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
    return _Fit(_correction(factors, nominal), covariance, freedom)


def _weights(drives: Sequence[_Drive], correction: OdometryCorrection | None) -> dict[bool, float]:
    """One over the scatter, of lines and of squares."""
    if correction is None:
        return {False: 1.0 / MEASURED_M, True: 1.0 / MEASURED_M}
    weights = {}
    for is_square in (False, True):
        errors = [drive.error(correction)[:2] for drive in drives if drive.is_square is is_square]
        off = [error[axis] for error in errors for axis in ((0, 1) if is_square else (0,))]
        # Squares give two of the factors, lines one; two lines alone would not show how much lines differ.
        freedom = len(off) - 2 if is_square else len(off) - 1 + EXPECTED_LINES
        expected = 0.0 if is_square else EXPECTED_LINES * EXPECTED_M**2
        mean = (sum(value**2 for value in off) + expected) / max(freedom, 1)
        weights[is_square] = 1.0 / max(MEASURED_M, math.sqrt(mean))
    return weights


def _solve(
    drives: Sequence[_Drive], nominal: WheelGeometry, factors: _Array, weights: dict[bool, float]
) -> tuple[_Array, _Array]:
    """Gauss and Newton's way; returns the factors and the last Jacobian."""

    def residuals_at(at: _Array) -> _Array:
        correction = _correction(at, nominal)
        return np.concatenate([_residuals(drive, correction, weights[drive.is_square]) for drive in drives])

    for _ in range(ROUNDS):
        jacobian = _jacobian(residuals_at, factors)
        factors = factors + np.linalg.lstsq(jacobian, -residuals_at(factors), rcond=None)[0]
    return factors, jacobian


def _residuals(drive: _Drive, correction: OdometryCorrection, weight: float) -> _Array:
    x_m, y_m, turned_rad = drive.error(correction)
    sideways_m = drive.size * MEASURED_RAD if drive.is_straight else 0.0  # the mark's direction is not known better
    values = [x_m * weight, y_m / math.hypot(1 / weight, sideways_m)]
    if turned_rad is not None:
        values.append(turned_rad / MEASURED_RAD)
    return np.array(values)


def _jacobian(residuals_at: Callable[[_Array], _Array], factors: _Array) -> _Array:
    step = 1e-6
    columns = []
    for index in range(len(factors)):
        change = np.zeros(len(factors))
        change[index] = step
        columns.append((residuals_at(factors + change) - residuals_at(factors - change)) / (2 * step))
    return np.stack(columns, axis=1)


def _deviations(fit: _Fit, nominal: WheelGeometry) -> Deviations:
    factors = student_95(fit.freedom) * np.sqrt(np.diag(fit.covariance))
    left, right, separation = (float(factor) * size for factor, size in zip(factors, nominal, strict=True))
    return Deviations(left, right, separation)


def _umbmark(drives: Sequence[_Drive], nominal: WheelGeometry) -> OdometryCorrection:
    """Borenstein and Feng's numbers; again with the corrected odometry until the errors' centres are explained."""
    squares = [drive for drive in drives if drive.is_square]
    lines = [drive for drive in drives if drive.is_straight]
    correction = uncorrected(nominal)
    for _ in range(ROUNDS):
        scale = sum(line.measured.x_m / line.end(correction)[0] for line in lines) / len(lines)
        alpha_rad, beta_rad = umbmark_angles(_return_errors(squares, correction), squares[0].size)
        correction = _umbmark_step(correction, squares[0].size, alpha_rad, beta_rad, scale)
    return correction


def umbmark_angles(errors: ReturnErrors, side_m: float) -> tuple[float, float]:
    """(alpha, beta): what each corner turns too far, and what each side does; means of x and y."""
    (cw_x, cw_y), (ccw_x, ccw_y) = errors
    alpha_rad = ((cw_x + ccw_x) + (cw_y - ccw_y)) / (-8 * side_m)
    beta_rad = ((cw_x - ccw_x) + (cw_y + ccw_y)) / (-8 * side_m)
    return alpha_rad, beta_rad


def _umbmark_step(
    now: OdometryCorrection, side_m: float, alpha_rad: float, beta_rad: float, scale: float
) -> OdometryCorrection:
    curvature_per_m = math.sin(beta_rad / 2) / (side_m / 2)
    half_m = now.separation_m / 2
    ratio = (1 + curvature_per_m * half_m) / (1 - curvature_per_m * half_m)  # right to left
    return now._replace(
        left_factor=now.left_factor * 2 / (ratio + 1) * scale,
        right_factor=now.right_factor * 2 / (1 / ratio + 1) * scale,
        separation_m=now.separation_m * _QUARTER_RAD / (_QUARTER_RAD - alpha_rad),
    )


def _return_errors(squares: Sequence[_Drive], correction: OdometryCorrection) -> ReturnErrors:
    centres = []
    for kind in (RunKind.SQUARE_CW, RunKind.SQUARE_CCW):
        errors = [drive.error(correction) for drive in squares if drive.kind is kind]
        centres.append((sum(error[0] for error in errors) / len(errors), sum(e[1] for e in errors) / len(errors)))
    return ReturnErrors(*centres)


def _separation_by_turns(drives: Sequence[_Drive], correction: OdometryCorrection) -> float | None:
    """From how far the robot truly turned on the spot; a mean over the drives."""
    found = [
        correction.separation_m * drive.end(correction)[2] / drive.measured.theta_rad
        for drive in drives
        if drive.kind in (RunKind.TURNS_CCW, RunKind.TURNS_CW) and drive.measured.theta_rad
    ]
    return sum(found) / len(found) if found else None
