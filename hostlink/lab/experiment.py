"""Experiment: a pattern that is driven several times with one software in one world, and its errors."""

import os
import signal
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from enum import StrEnum
from multiprocessing import get_context
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hostlink.lab.operator import Habits, Practice, Run, drive, rehearse
from hostlink.lab.paper_results import LINE_TABLE
from hostlink.lab.paper_software import Mistakes
from hostlink.lab.patterns import Pattern
from hostlink.lab.robots import FirmwareRobot, LabRobot, PaperRobot
from hostlink.sim.world_parameters import WorldParameters

# The paper: "between 0-700 nothing happens", and 700 is where a motor turns "consistently": it begins a little lower.
THRESHOLD_PWM = 650.0
PAPER_WORLD = WorldParameters(
    {
        f"{side}.{name}": value
        for side in ("left", "right")
        for name, value in (("dead_zone_pwm", THRESHOLD_PWM), ("has_jump", 0.0))
    }
)
_POOLED_RUNS = 40  # fewer are driven before a process has started


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

    def robot(self, seed: int) -> LabRobot:
        """A new one; equal seeds repeat.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
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
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    setup = experiment.setup
    practice = practise(setup)
    return [
        drive(setup.robot(setup.first_seed + run), experiment.pattern, run=run, practice=practice, habits=setup.habits)
        for run in range(experiment.runs)
    ]


def practise(setup: Setup) -> Practice:
    """What the operator has learnt of this robot: chance averages out."""
    steady = {"caster_random": 0.0, "left.slip_noise_m": 0.0, "right.slip_noise_m": 0.0}
    usual = in_world(setup, setup.world.changed(steady))
    return rehearse(lambda: usual.robot(1), setup.habits)


def errors_of(runs: Iterable[Run]) -> Errors:
    """Of some runs of one pattern."""
    driven = list(runs)
    xy_cm = np.array([run.error_cm for run in driven])
    return Errors(driven[0].pattern, xy_cm, np.array([run.length_error_cm for run in driven]))


def measure(experiment: Experiment) -> Errors:
    """Drive one, and keep the errors alone.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    return errors_of(conduct(experiment))


class Laboratory:
    """Drives many experiments, on all cores where that is worth a process: `with Laboratory() as laboratory`."""

    def __init__(self, workers: int | None = None) -> None:
        """`workers`: processes; None: one for each core."""
        self._workers = workers or os.cpu_count() or 1
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def measure(self, experiments: Sequence[Experiment]) -> Iterator[Errors]:
        """The errors of each, in their order.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
        """
        if self._workers == 1 or sum(experiment.runs for experiment in experiments) < _POOLED_RUNS:
            return map(measure, experiments)
        if self._pool is None:
            # Ctrl-C reaches the processes, too: this one ends them.
            ignored = (signal.SIGINT, signal.SIG_IGN)
            self._pool = ProcessPoolExecutor(self._workers, get_context("spawn"), signal.signal, ignored)
        return self._pool.map(measure, experiments)


def in_world(setup: Setup, world: WorldParameters) -> Setup:
    """The same elsewhere."""
    return replace(setup, world=world)
