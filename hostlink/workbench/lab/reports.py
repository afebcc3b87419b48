"""Reports of the laboratory, as lines."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hostlink.workbench.lab.experiment import (
    PAPER_WORLD,
    PATTERNS,
    SQUARE_LEFT,
    SQUARE_RIGHT,
    Errors,
    Experiment,
    Laboratory,
    Pattern,
    Setup,
    Software,
    axes_of,
)
from hostlink.workbench.lab.tables import CAUSES, MISTAKES, Cause, means_and_errors, measure_all
from hostlink.workbench.lab.tables import tables as driven_tables
from hostlink.workbench.lab.turns import (
    BestTurns,
    Needed,
    best_turns,
    chance_of_table_2,
    mean_of,
    needed_radius,
    needed_twists,
)
from hostlink.workbench.sim.firmware_module import WorldParameters

TABLE_RUNS = 12
CAUSE_RUNS = 4
PICTURE_RUNS = 5
_THRESHOLDS_PWM = (690.0, 670.0, 650.0, 600.0, 550.0)

Progress = Callable[[str], None]
_Array = NDArray[np.float64]


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Format a table as Markdown."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    cells = [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in (head, *rows)]
    first, *others = [f"| {' | '.join(row)} |" for row in cells]
    return [first, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *others]


# -- causes -----------------------------------------------------------------------------------------------------------


def causes(laboratory: Laboratory, runs: int, progress: Progress) -> list[str]:
    """Report the effect of each cause alone on each pattern: means of |x| / |y|, of the line |length|, in cm.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    listed = [*CAUSES, *MISTAKES]
    experiments = [
        Experiment(cause.setup(software), pattern, runs)
        for cause in listed
        for software in Software
        for pattern in PATTERNS
    ]
    measured = list(measure_all(laboratory, experiments, progress))
    width = len(PATTERNS) * len(Software)
    cells = {cause.name: measured[i * width : (i + 1) * width] for i, cause in enumerate(listed)}
    return [
        f"Means of {runs} runs: |x| / |y| in cm, of the line |length|. ccw, cw: the squares; back: there and back.",
        "",
        "A cause alone, with our firmware and with the paper's software:",
        "",
        *_cause_table(CAUSES, cells, "cause", ("ours", "paper")),
        "",
        "A mistake of the paper's software alone, and all its others without this one:",
        "",
        *_cause_table(MISTAKES, cells, "mistake", ("alone", "without")),
    ]


def _cause_table(
    listed: Sequence[Cause], cells: dict[str, list[Errors]], head: str, columns: tuple[str, str]
) -> list[str]:
    heads = [head, *(f"{column}: {pattern.short}" for column in columns for pattern in PATTERNS)]
    return text_table(heads, [[cause.title, *map(_sizes, cells[cause.name])] for cause in listed])


def _sizes(errors: Errors) -> str:
    return " / ".join(f"{mean:.1f}" for mean in errors.means_cm)


# -- tables -----------------------------------------------------------------------------------------------------------


def tables(laboratory: Laboratory, world: WorldParameters, runs: int, progress: Progress) -> list[str]:
    """Report tables 2-5 for all software.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    driven = driven_tables(world, laboratory, runs=runs, report=progress)
    heads = ["table", "pattern", "axis", *driven[PATTERNS[0]]]
    rows = [row for pattern, columns in driven.items() for row in _table_rows(pattern, columns)]
    return [
        f"|error| in cm: mean +- standard error; the paper's of 3 runs (table 4: 5), others of {runs}.",
        "",
        *text_table(heads, rows),
        "",
        "World: " + (", ".join(f"{name}={value:.6g}" for name, value in _changed(world)) or "without a flaw"),
    ]


def _table_rows(pattern: Pattern, columns: Mapping[str, _Array]) -> list[list[str]]:
    found = [means_and_errors(sizes_cm) for sizes_cm in columns.values()]
    return [
        [
            str(pattern.table),
            pattern.title,
            axis,
            *(f"{means_cm[number]:.1f} +- {errors_cm[number]:.1f}" for means_cm, errors_cm in found),
        ]
        for number, axis in enumerate(axes_of(pattern.table))
    ]


def _changed(world: WorldParameters) -> list[tuple[str, float]]:
    pairs = [line.split("=") for line in world.text().splitlines()]
    return [(name, float(value)) for name, value in pairs]


# -- claims -----------------------------------------------------------------------------------------------------------


def claims(laboratory: Laboratory, runs: int, progress: Progress) -> list[str]:
    """Report which numbers the paper's tables need, whether one set explains all, and the error of its software alone.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    progress("driving the paper's software")
    alone = _software_alone(laboratory, runs)
    progress("solving")
    radius, twists = needed_radius(), needed_twists()
    progress("drawing squares like table 2")
    chance, chance_turns = chance_of_table_2()
    progress("drawing laboratories")
    best = {has_loss: best_turns(has_loss=has_loss) for has_loss in (False, True)}
    return [
        f"radius for table 4: +{radius.mean * 100:.2f} % [{radius.low * 100:.2f}, {radius.high * 100:.2f}]",
        "",
        "Overturning that each column needs, if all turns err equally (95 % of 3 runs):",
        "",
        *text_table(["column", "rad a turn", "95 %"], [_needed_row(needed) for needed in twists]),
        "",
        f"No one number serves both of: {'; '.join(f'{a} and {b}' for a, b in apart(twists)) or 'none'}.",
        "",
        f"Three runs like table 2 (|x| 26 to 36, |y| to 6 cm): at most {chance:.1g}, with turns of"
        f" {chance_turns.mean_rad:.2f} +- {chance_turns.random_rad:.2f} rad.",
        "",
        *(line for has_loss, found in best.items() for line in _best_lines(found, has_loss=has_loss)),
        "",
        f"The paper's software alone, without caster and slip: distance in cm after a square, {runs} runs:",
        "",
        *text_table(["motors turn from", "pattern", "mean", "95 % of the mean"], alone),
    ]


def _software_alone(laboratory: Laboratory, runs: int) -> list[list[str]]:
    """Drive the squares with motors that start at different PWMs; the Due's pin turns 700 into 690.

    Return a row for each PWM and square: the mean distance from the start in cm, and its 95 % interval.
    """
    cases = [(pwm, pattern) for pwm in _THRESHOLDS_PWM for pattern in (SQUARE_LEFT, SQUARE_RIGHT)]
    setups = [Setup(software=Software.PAPER, world=_with_threshold(pwm)) for pwm, _ in cases]
    experiments = [Experiment(setup, pattern, runs) for setup, (_, pattern) in zip(setups, cases, strict=True)]
    rows = []
    for (pwm, pattern), errors in zip(cases, laboratory.measure(experiments), strict=True):
        distance_cm = mean_of(pattern.name, np.hypot(*errors.xy_cm.T))
        interval = f"{distance_cm.low:.1f} to {distance_cm.high:.1f}"
        rows.append([f"{pwm:.0f}", pattern.title, f"{distance_cm.mean:.1f}", interval])
    return rows


def _with_threshold(pwm: float) -> WorldParameters:
    return PAPER_WORLD.changed({"left.dead_zone_pwm": pwm, "right.dead_zone_pwm": pwm})


def apart(needed: Sequence[Needed]) -> list[tuple[str, str]]:
    """Return the pairs whose intervals do not overlap."""
    return [(a.what, b.what) for a, b in combinations(needed, 2) if not a.overlaps(b)]


def _needed_row(needed: Needed) -> list[str]:
    return [needed.what, f"{needed.mean:.3f}", f"{needed.low:.3f} to {needed.high:.3f}"]


def _best_lines(found: BestTurns, *, has_loss: bool) -> list[str]:
    turns = found.turns
    loss = f", and {turns.loss_m * 100:.0f} cm of slip after each turn" if has_loss else ""
    pairs = ", ".join(f"{found.means_cm[i]:.0f}/{found.means_cm[i + 1]:.0f}" for i in range(0, len(found.means_cm), 2))
    return [
        f"Best for tables 2, 3 and 5 at once: turns of {turns.mean_rad:.2f} +- {turns.random_rad:.2f} rad{loss}:",
        f"  {pairs} cm of 30/3, 40/30, 3/7; worse in {found.p_value * 100:.1f} % of drawn laboratories",
    ]
