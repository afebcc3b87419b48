"""Fit: the causes that bring the paper's software nearest to the paper's tables, by least squares; and its report.

Needs scipy, which only `fit` imports.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hostlink.lab.experiment import (
    PAPER_CM,
    PAPER_WORLD,
    PATTERNS,
    Experiment,
    Laboratory,
    Pattern,
    Setup,
    Software,
    axes_of,
)
from hostlink.lab.reports import LabReport, text_table
from hostlink.lab.tables import RADIUS_M, TRACK_M
from hostlink.sim.firmware_module import WorldParameters

# -- fit --------------------------------------------------------------------------------------------------------------

_Array = NDArray[np.float64]

_LEAST_ERROR_CM = 0.3  # error of a mean of three readings to a centimetre
_NORMAL_95 = 1.959963985


@dataclass(frozen=True, slots=True)
class FittedCause:
    """Number that the fit may change."""

    name: str
    unit: str
    step: float  # step of the derivative
    prior: float  # standard deviation around zero among robots built by hand, where the tables do not decide
    low: float
    high: float


FITTED = (
    FittedCause("radius", "%, both wheels", 0.2, 2.0, -3.0, 3.0),
    FittedCause("radius_difference", "%, right less left", 0.2, 1.0, -3.0, 3.0),
    FittedCause("track", "%", 1.0, 3.0, -10.0, 10.0),
    FittedCause("caster_twist", "rad", 0.01, 0.1, -0.2, 0.2),
    FittedCause("caster_random", "share", 0.2, 1.0, 0.0, 3.0),
)
# Sizes without signs have several optima, so the fit starts from each of these, in the order of FITTED.
STARTS = ((0.5, 0.0, 0.0, 0.05, 0.4), (0.5, 0.0, 0.0, 0.0, 0.4), (0.5, 1.0, 0.0, 0.03, 0.2))
_PRIORS = np.array([cause.prior for cause in FITTED])


def world_of(numbers: _Array) -> WorldParameters:
    """Return the paper's world with these causes."""
    radius, difference, track, twist, random = (float(number) for number in numbers)
    return PAPER_WORLD.changed(
        {
            "left.radius_m": RADIUS_M * (1 + (radius - difference / 2) / 100),
            "right.radius_m": RADIUS_M * (1 + (radius + difference / 2) / 100),
            "track_m": TRACK_M * (1 + track / 100),
            "caster_twist_rad": twist,
            "caster_random": random,
        }
    )


@dataclass(frozen=True, slots=True)
class Residual:
    """One mean of the paper and of the fit."""

    pattern: Pattern
    axis: str
    paper_cm: float
    uncertainty_cm: float  # standard error of the paper's mean
    fitted_cm: float

    @property
    def deviations(self) -> float:
        """Difference of the two means in standard errors."""
        return (self.fitted_cm - self.paper_cm) / self.uncertainty_cm


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a fit."""

    tables: tuple[int, ...]  # fitted tables of the paper
    numbers: _Array
    intervals: _Array  # half of the 95 % interval, if the model is right
    residuals: tuple[Residual, ...]
    evaluations: int

    @property
    def chi_square(self) -> float:
        """Sum of the squared deviations of the fitted tables."""
        return sum(residual.deviations**2 for residual in self.residuals if residual.pattern.table in self.tables)

    @property
    def unreached(self) -> tuple[Residual, ...]:
        """Means outside of the 95 % interval of the paper's scatter."""
        return tuple(residual for residual in self.residuals if abs(residual.deviations) > _NORMAL_95)


def fit(
    laboratory: Laboratory,
    tables: tuple[int, ...] = (2, 3, 4, 5),
    *,
    start: tuple[float, ...] = STARTS[0],
    runs: int = 6,
    rounds: int = 8,
    measured_cm: Mapping[int, _Array] = PAPER_CM,
    report: Callable[[str], None] = lambda _: None,
) -> Fit:
    """Fit the causes to some of the tables. `measured_cm`: one row for each run, by the table's number.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    model = _Model(laboratory, measured_cm, tables, runs, report)
    scale = np.array([cause.step for cause in FITTED])
    bounds = (np.array([cause.low for cause in FITTED]), np.array([cause.high for cause in FITTED]))
    from scipy.optimize import least_squares  # noqa: PLC0415 - takes half a second, which only a fit needs

    found = least_squares(
        model.deviations,
        np.array(start),
        jac=model.slopes,
        bounds=bounds,
        x_scale=scale * 5,
        max_nfev=rounds,
        xtol=1e-2,
        ftol=1e-2,
    )
    residuals = tuple(model.residuals(model.means(found.x)))
    return Fit(tables, found.x, _intervals(found.jac), residuals, model.evaluations)


def uncertainty_cm(sizes_cm: _Array) -> _Array:
    """Return the standard errors of the means of some runs."""
    errors: _Array = np.maximum(sizes_cm.std(axis=0, ddof=1) / np.sqrt(len(sizes_cm)), _LEAST_ERROR_CM)
    return errors


class _Model:
    """Means of the patterns as functions of the causes, always with the same seeds."""

    def __init__(
        self,
        laboratory: Laboratory,
        measured_cm: Mapping[int, _Array],
        tables: tuple[int, ...],
        runs: int,
        report: Callable[[str], None],
    ) -> None:
        """Drive every pattern; only those of `tables` count in the deviations."""
        self.evaluations = 0
        self._laboratory = laboratory
        self._measured_cm = measured_cm
        self._fitted = [pattern for pattern in PATTERNS if pattern.table in tables]
        self._runs, self._report = runs, report
        self._setup = Setup(software=Software.PAPER)
        self._at: tuple[bytes, dict[Pattern, _Array]] = (b"", {})

    def means(self, numbers: _Array) -> dict[Pattern, _Array]:
        """Return the means of all patterns."""
        return self._means_at([numbers], list(PATTERNS))[0]

    def residuals(self, means: dict[Pattern, _Array]) -> list[Residual]:
        """Return a residual for each mean."""
        found = []
        for pattern, mean_cm in means.items():
            paper = self._measured_cm[pattern.table]
            columns = zip(axes_of(pattern.table), paper.mean(axis=0), uncertainty_cm(paper), mean_cm, strict=True)
            found += [Residual(pattern, *(axis, float(a), float(b), float(c))) for axis, a, b, c in columns]
        return found

    def deviations(self, numbers: _Array) -> _Array:
        """Return the deviations of the fitted tables, and of the numbers from their priors."""
        (means,) = self._means_at([numbers], self._fitted)
        self._at = (numbers.tobytes(), means)
        return np.concatenate([self._deviations(means), numbers / _PRIORS])

    def slopes(self, numbers: _Array) -> _Array:
        """Return the derivatives of the deviations, by steps that exceed the noise."""
        if self._at[0] != numbers.tobytes():
            self.deviations(numbers)
        base = self._deviations(self._at[1])
        steps = np.diag([_inward(cause, number) for cause, number in zip(FITTED, numbers, strict=True)])
        around = self._means_at([numbers + step for step in steps], self._fitted)
        columns = [(self._deviations(means) - base) / step.sum() for means, step in zip(around, steps, strict=True)]
        return np.vstack([np.array(columns).T, np.diag(1.0 / _PRIORS)])

    def _deviations(self, means: dict[Pattern, _Array]) -> _Array:
        return np.array([residual.deviations for residual in self.residuals(means)])

    def _means_at(self, points: list[_Array], patterns: list[Pattern]) -> list[dict[Pattern, _Array]]:
        setups = [replace(self._setup, world=world_of(point)) for point in points]
        experiments = [Experiment(setup, pattern, self._runs) for setup in setups for pattern in patterns]
        measured = [errors.means_cm for errors in self._laboratory.measure(experiments)]
        self.evaluations += len(points)
        self._report(f"fit: {self.evaluations} worlds driven")
        count = len(patterns)
        return [dict(zip(patterns, measured[i * count : (i + 1) * count], strict=True)) for i in range(len(points))]


def _inward(cause: FittedCause, number: float) -> float:
    """Return the step, reversed if it would pass the upper bound."""
    return cause.step if number + cause.step <= cause.high else -cause.step


def _intervals(slopes: _Array) -> _Array:
    """Return the half intervals from the curvature at the optimum."""
    half: _Array = _NORMAL_95 * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    return half


# -- report -----------------------------------------------------------------------------------------------------------

FIT_RUNS = 6


def report_fit(laboratory: Laboratory, progress: Callable[[str], None], *, runs: int = FIT_RUNS) -> LabReport:
    """Fit all tables together, from each start. Return the report of the best fit.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    fits = [fit(laboratory, start=start, runs=runs, report=progress) for start in STARTS]
    found = min(fits, key=lambda each: each.chi_square)
    free = len(found.residuals) - len(FITTED)
    causes = [
        [cause.name, f"{number:.3f}", f"+- {half:.3f}", cause.unit]
        for cause, number, half in zip(FITTED, found.numbers, found.intervals, strict=True)
    ]
    residuals = [
        [
            str(residual.pattern.table),
            residual.axis,
            f"{residual.paper_cm:.1f} +- {residual.uncertainty_cm:.1f}",
            f"{residual.fitted_cm:.1f}",
            f"{residual.deviations:+.1f}",
        ]
        for residual in found.residuals
    ]
    optima = [[*(f"{number:.2f}" for number in each.numbers), f"{each.chi_square:.0f}"] for each in fits]
    unreached = ", ".join(f"table {residual.pattern.table} {residual.axis}" for residual in found.unreached)
    driven = sum(each.evaluations for each in fits)
    lines = [
        f"The paper's software, fitted to tables 2-5; the best of {len(fits)} optima ({driven} worlds driven):",
        "",
        *text_table(["cause", "fitted", "95 %", "unit"], causes),
        "",
        *text_table(["table", "axis", "paper (cm)", "fitted (cm)", "deviations"], residuals),
        "",
        f"Sum of squared deviations: {found.chi_square:.0f}, with {free} degrees of freedom (95 %: below 6.0).",
        f"Not reached: {unreached or 'nothing'}.",
        "",
        "Where the fit ended from each of its starts:",
        "",
        *text_table([*(cause.name for cause in FITTED), "squared deviations"], optima),
    ]
    return LabReport(lines, {"fit": _view(found), "optima": [_view(each) for each in fits]})


def _view(found: Fit) -> dict[str, Any]:
    return {
        "causes": {
            cause.name: {"value": float(number), "half_interval": float(half), "unit": cause.unit}
            for cause, number, half in zip(FITTED, found.numbers, found.intervals, strict=True)
        },
        "residuals": [
            {
                "table": residual.pattern.table,
                "axis": residual.axis,
                "paper_cm": residual.paper_cm,
                "uncertainty_cm": residual.uncertainty_cm,
                "fitted_cm": residual.fitted_cm,
            }
            for residual in found.residuals
        ],
        "chi_square": found.chi_square,
        "worlds": found.evaluations,
    }
