"""The report of a fit. Needs scipy."""

from collections.abc import Callable
from typing import Any

from hostlink.lab.experiment import Laboratory
from hostlink.lab.fit import FITTED, STARTS, Fit, fit
from hostlink.lab.reports import LabReport, text_table

FIT_RUNS = 6


def report_fit(laboratory: Laboratory, progress: Callable[[str], None], *, runs: int = FIT_RUNS) -> LabReport:
    """Fit all tables at once.

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
