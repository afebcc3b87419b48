"""Experiment: a pattern that is driven several times with one software in one world, and its errors."""

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from hostlink.lab.operator import Habits, RollOn, Run, drive, rehearse
from hostlink.lab.paper_results import LINE_TABLE
from hostlink.lab.paper_software import Mistakes
from hostlink.lab.patterns import Pattern
from hostlink.lab.robots import FirmwareRobot, PaperRobot, Robot
from hostlink.sim.world_parameters import WorldParameters

# The paper: "between 0-700 nothing happens", and 700 is where a motor turns "consistently": it begins a little lower.
THRESHOLD_PWM = 650.0
PAPER_WORLD = WorldParameters().changed(
    {
        f"{side}.{name}": value
        for side in ("left", "right")
        for name, value in (("dead_zone_pwm", THRESHOLD_PWM), ("has_jump", 0.0))
    }
)


class Software(StrEnum):
    """What drives the robot."""

    FIRMWARE = "firmware"  # of the project, as the board executes it
    PAPER = "paper"  # the paper's, rebuilt


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """A robot, its software, its world and its operator."""

    software: Software
    world: WorldParameters = PAPER_WORLD
    mistakes: Mistakes = field(default_factory=Mistakes)  # of the paper's software
    device_parameters: tuple[tuple[str, tuple[float, ...]], ...] = ()  # of the firmware: what calibration found
    habits: Habits = field(default_factory=Habits)
    first_seed: int = 1

    def robot(self, seed: int) -> Robot:
        """A new one; equal seeds repeat.

        Raises:
            WorldLibraryMissing: the firmware is not built.
        """
        world = self.world.changed({"seed": seed})
        if self.software is Software.PAPER:
            return PaperRobot(world, self.mistakes)
        return FirmwareRobot(world, dict(self.device_parameters))


@dataclass(frozen=True, slots=True)
class Experiment:
    """Some runs of a pattern; run n has the seed first_seed + n."""

    setup: Setup
    pattern: Pattern
    runs: int


@dataclass(frozen=True, slots=True)
class Errors:
    """Odometry less truth, a row each run."""

    pattern: Pattern
    xy_cm: NDArray[np.float64]
    length_cm: NDArray[np.float64]

    @property
    def sizes_cm(self) -> NDArray[np.float64]:
        """As the paper's table has them: |x| and |y|, or |length|; a row each run."""
        return np.abs(self.length_cm[:, np.newaxis] if self.pattern.table == LINE_TABLE else self.xy_cm)

    @property
    def means_cm(self) -> NDArray[np.float64]:
        """The last line of the paper's table."""
        means: NDArray[np.float64] = self.sizes_cm.mean(axis=0)
        return means


def conduct(experiment: Experiment) -> list[Run]:
    """Drive them.

    Raises:
        WorldLibraryMissing: the firmware is not built.
    """
    setup = experiment.setup
    roll_on = practise(setup)
    return [
        drive(setup.robot(setup.first_seed + run), experiment.pattern, run=run, roll_on=roll_on, habits=setup.habits)
        for run in range(experiment.runs)
    ]


def practise(setup: Setup) -> RollOn:
    """What the operator learns before: how far this robot rolls on."""
    return rehearse(lambda: setup.robot(0), setup.habits)


def errors_of(runs: Iterable[Run]) -> Errors:
    """Of some runs of one pattern."""
    driven = list(runs)
    xy_cm = np.array([run.error_cm for run in driven])
    return Errors(driven[0].pattern, xy_cm, np.array([run.length_error_cm for run in driven]))


def measure(experiment: Experiment) -> Errors:
    """Drive, and keep the errors alone.

    Raises:
        WorldLibraryMissing: the firmware is not built.
    """
    return errors_of(conduct(experiment))


def measure_all(experiments: list[Experiment]) -> Iterator[Errors]:
    """The errors of each, in their order, on all cores.

    Raises:
        WorldLibraryMissing: the firmware is not built.
    """
    workers = os.cpu_count() or 1
    if workers == 1 or len(experiments) == 1:
        yield from map(measure, experiments)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(measure, experiments)


def in_world(setup: Setup, world: WorldParameters) -> Setup:
    """The same elsewhere."""
    return replace(setup, world=world)
