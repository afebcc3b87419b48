"""Tables 2-5: the paper, its software rebuilt, the project's firmware, and the same calibrated; side by side."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hostlink.lab.calibrated import calibrated
from hostlink.lab.causes import RADIUS_M
from hostlink.lab.experiment import PAPER_WORLD, Errors, Experiment, Laboratory, Setup, Software
from hostlink.lab.paper_results import PAPER_CM
from hostlink.lab.patterns import PATTERNS, Pattern
from hostlink.sim.world_parameters import WorldParameters

_Array = NDArray[np.float64]

PAPER, REBUILT, OURS, CALIBRATED = "paper", "its software", "ours", "ours calibrated"

# Line and squares at once as near as a radius and a caster bring them: docs/laboratory.md#which-world
CASTER_WORLD = PAPER_WORLD.changed(
    {
        "left.radius_m": RADIUS_M * 1.005,
        "right.radius_m": RADIUS_M * 1.005,
        "caster_twist_rad": 0.055,
        "caster_random": 0.4,
    }
)


@dataclass(frozen=True, slots=True)
class Column:
    """One of the columns of a table."""

    title: str
    sizes_cm: _Array  # a row each run: |x| and |y|, or |length|

    @property
    def means_cm(self) -> _Array:
        """The last line of the paper's table."""
        means: _Array = self.sizes_cm.mean(axis=0)
        return means

    @property
    def errors_cm(self) -> _Array:
        """The standard errors of the means."""
        errors: _Array = self.sizes_cm.std(axis=0, ddof=1) / np.sqrt(len(self.sizes_cm))
        return errors


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """One of the paper's."""

    pattern: Pattern
    columns: tuple[Column, ...]


def tables(
    world: WorldParameters, laboratory: Laboratory, *, runs: int, report: Callable[[str], None]
) -> list[ErrorTable]:
    """Drive all of them.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    report("calibrating")
    firmware = Setup(software=Software.FIRMWARE, world=world)
    setups = {
        REBUILT: replace(firmware, software=Software.PAPER),
        OURS: firmware,
        CALIBRATED: calibrated(firmware),
    }
    experiments = [Experiment(setup, pattern, runs) for pattern in PATTERNS for setup in setups.values()]
    measured = _reported(laboratory.measure(experiments), len(experiments), report)
    return [
        ErrorTable(
            pattern,
            (Column(PAPER, PAPER_CM[pattern.table]), *(Column(title, next(measured).sizes_cm) for title in setups)),
        )
        for pattern in PATTERNS
    ]


def _reported(measured: Iterator[Errors], count: int, report: Callable[[str], None]) -> Iterator[Errors]:
    for number, errors in enumerate(measured, start=1):
        report(f"{number} of {count} experiments driven")
        yield errors
