"""Experiment: one pattern of the paper, driven several times by a simulated operator, and the errors of its odometry.

The operator drives from mark to mark as the authors of the paper did, with a keyboard and by eye. Each movement ends
before the next one begins: turn on the spot towards the next mark, stop, drive straight, stop. The robot is not steered
during a movement. The operator knows by practice how far the robot rolls after the key is released, and how far the
caster turns it then.
"""

import math
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from enum import StrEnum
from multiprocessing import get_context
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hostlink.core.robot.kinematics import Pose, wrap_angle
from hostlink.workbench import calibration
from hostlink.workbench.calibration import MeasuredRun, Measurement, RunKind, WheelGeometry
from hostlink.workbench.lab.robots import FirmwareRobot, LabRobot, Mistakes, PaperRobot, RandomNumbers
from hostlink.workbench.sim.firmware_module import WorldParameters

# -- results of the paper ---------------------------------------------------------------------------------------------

SIDE_M = 2.0  # of the squares
LINE_TABLE = 4  # the only table with a length instead of x and y
LINE_M = (3.84, 3.52, 3.47, 3.96, 3.95)  # of table 4, as measured on the floor

# One row for each run: |x| and |y|, or |length|. The lengths have more digits than the columns they were computed from.
PAPER_CM: dict[int, NDArray[np.float64]] = {
    2: np.array([(26.0, 0.0), (28.0, 3.0), (36.0, 6.0)]),  # square, counterclockwise
    3: np.array([(41.0, 53.0), (45.0, 26.0), (35.0, 12.0)]),  # square, clockwise
    LINE_TABLE: np.array([(2.97,), (0.64,), (1.96,), (1.79,), (1.84,)]),
    5: np.array([(0.0, 7.0), (2.0, 15.0), (6.0, 0.0)]),  # there and back
}

POLL_S = 0.1

# The paper: "between 0-700 nothing happens", and from 700 a motor turns "consistently". It starts slightly lower.
THRESHOLD_PWM = 650.0
PAPER_WORLD = WorldParameters(
    {
        f"{side}.{name}": value
        for side in ("left", "right")
        for name, value in (("dead_zone_pwm", THRESHOLD_PWM), ("has_jump", 0.0))
    }
)

TRAINING_RUNS = 5  # in each direction, as in UMBmark


def axes_of(table: int) -> tuple[str, ...]:
    """Return the columns of a table."""
    return ("length",) if table == LINE_TABLE else ("x", "y")


# -- patterns ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Pattern:
    """Marks on the floor that are reached one after the other. The robot begins at the origin, heading along x."""

    name: str
    title: str
    short: str
    table: int  # of the paper
    marks: tuple[tuple[float, float], ...]  # x, y in metres
    is_scaled: bool = False  # its length differs between the runs, as in table 4

    def marks_of(self, run: int) -> tuple[tuple[float, float], ...]:
        """Return the marks of a run. The runs of a scaled pattern have the lengths of the paper's table 4 in turn."""
        length_m = LINE_M[run % len(LINE_M)] if self.is_scaled else 1.0
        return tuple((x_m * length_m, y_m * length_m) for x_m, y_m in self.marks)


SQUARE_LEFT = Pattern(
    "square_left", "square, counterclockwise", "ccw", 2, ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0))
)
SQUARE_RIGHT = Pattern(
    "square_right", "square, clockwise", "cw", 3, ((SIDE_M, 0.0), (SIDE_M, -SIDE_M), (0.0, -SIDE_M), (0.0, 0.0))
)
LINE = Pattern("line", "straight line", "line", 4, ((1.0, 0.0),), is_scaled=True)
BACK = Pattern("there_and_back", "there and back", "back", 5, ((1.0, 0.0), (0.0, 0.0)), is_scaled=True)
PATTERNS = (SQUARE_LEFT, SQUARE_RIGHT, LINE, BACK)


# -- operator ---------------------------------------------------------------------------------------------------------

_LEAST_POLL_S = 0.01
_SETTLED_S = 1.5  # after the stop, until the paper's filter has followed
_MOST_STOP_S = 15.0  # for a stop; then the operator continues
_MOST_LEG_S = 120.0
_STREAM = 9  # stream of the operator's random numbers
_STANDING_M = 1e-5  # distance in one poll below which the robot counts as stopped
_REHEARSED_S = 8.0  # long enough for any set-point to be reached


@dataclass(frozen=True, slots=True, kw_only=True)
class Habits:
    """Speeds and inaccuracies of the operator."""

    linear_m_s: float = 0.245  # 200 ticks/s: the minimum-jerk stop of 3.6 s
    angular_rad_s: float = 0.6  # initial value of the paper's teleoperation
    mark_noise_m: float = 0.01  # standard deviation of the stop position
    aim_noise_rad: float = 0.02  # standard deviation of the heading after a turn
    push_m: float = 0.0  # sideways push by the operator's foot after the first leg


class PoseSample(NamedTuple):
    """True pose of the robot and its odometry at one time."""

    truth: Pose
    odometry: Pose


@dataclass(frozen=True, slots=True)
class Run:
    """One driven pattern."""

    pattern: Pattern
    samples: list[PoseSample] = field(repr=False)

    @property
    def error_cm(self) -> tuple[float, float]:
        """Odometry minus true position at the end, x and y."""
        truth, odometry = self.samples[-1]
        return (odometry.x_m - truth.x_m) * 100, (odometry.y_m - truth.y_m) * 100

    @property
    def length_error_cm(self) -> float:
        """Error of the distance from the start, as the paper measured its lines."""
        truth, odometry = self.samples[-1]
        return (math.hypot(odometry.x_m, odometry.y_m) - math.hypot(truth.x_m, truth.y_m)) * 100


class Practice(NamedTuple):
    """Distances and angles of a robot that the operator allows for: after a zero, and by the caster afterwards."""

    forward_m: float
    turned_rad: float
    kick_rad: float  # further turn when the robot drives straight after a turn


def rehearse(new_robot: Callable[[], LabRobot], habits: Habits) -> Practice:
    """Measure how far a robot rolls and turns after a zero."""
    straight = _Operated(new_robot(), habits)
    straight.go(habits.linear_m_s, 0.0, _REHEARSED_S)
    begun_m = straight.robot.world.rolled_m
    straight.stop()
    turning = _Operated(new_robot(), habits)
    turning.go(0.0, habits.angular_rad_s, _REHEARSED_S)
    begun_rad = turning.robot.world.theta_rad
    turning.stop()
    stood_rad = turning.robot.world.theta_rad
    turning.go(habits.linear_m_s, 0.0, _REHEARSED_S)
    kick_rad = turning.robot.world.theta_rad - stood_rad
    return Practice(straight.robot.world.rolled_m - begun_m, stood_rad - begun_rad, kick_rad)


def drive(robot: LabRobot, pattern: Pattern, *, run: int, practice: Practice, habits: Habits) -> Run:
    """Drive one pattern. `run`: number that determines the lengths and the operator's inaccuracy."""
    noise = RandomNumbers(run, _STREAM)
    driver = _Operated(robot, habits)
    for number, mark in enumerate(pattern.marks_of(run)):
        if number > 0:
            driver.turn_to(mark, practice.turned_rad + practice.kick_rad, noise.normal() * habits.aim_noise_rad)
        driver.drive_to(mark, practice.forward_m, noise.normal() * habits.mark_noise_m)
        if number == 0 and habits.push_m:
            robot.world.shove(0.0, habits.push_m, 0.0)
            driver.stop()
    return Run(pattern, driver.samples)


class _Operated:
    """Robot that the operator drives with a keyboard, and the samples of the drive."""

    def __init__(self, robot: LabRobot, habits: Habits) -> None:
        self.robot = robot
        self.samples = [_sample(robot)]
        self._habits = habits

    @property
    def _truth(self) -> Pose:
        return self.samples[-1].truth

    def turn_to(self, mark: tuple[float, float], early_rad: float, noise_rad: float) -> None:
        """Turn on the spot until the robot points to the mark. Half a turn is made to the left."""
        truth = self._truth
        wanted_rad = wrap_angle(math.atan2(mark[1] - truth.y_m, mark[0] - truth.x_m) - truth.theta_rad)
        if wanted_rad < -0.75 * math.pi:
            wanted_rad += math.tau
        sign = math.copysign(1.0, wanted_rad)
        goal_rad = abs(wanted_rad) + noise_rad - early_rad
        begun_rad = truth.theta_rad
        self.robot.command(0.0, sign * self._habits.angular_rad_s)
        self._until(lambda: goal_rad - sign * (self._truth.theta_rad - begun_rad), self._habits.angular_rad_s)
        self.stop()

    def drive_to(self, mark: tuple[float, float], early_m: float, noise_m: float) -> None:
        """Drive straight until the robot has reached the mark."""
        begun = self._truth
        way_m = math.hypot(mark[0] - begun.x_m, mark[1] - begun.y_m)
        along = ((mark[0] - begun.x_m) / way_m, (mark[1] - begun.y_m) / way_m)
        goal_m = way_m + noise_m - early_m

        def left_m() -> float:
            truth = self._truth
            return goal_m - (truth.x_m - begun.x_m) * along[0] - (truth.y_m - begun.y_m) * along[1]

        self.robot.command(self._habits.linear_m_s, 0.0)
        self._until(left_m, self._habits.linear_m_s)
        self.stop()

    def go(self, linear_m_s: float, angular_rad_s: float, seconds: float) -> None:
        """Drive for `seconds`."""
        self.robot.command(linear_m_s, angular_rad_s)
        self.robot.advance(seconds)

    def stop(self) -> None:
        """Release the key, and wait until the robot has stopped and its odometry has followed."""
        self.robot.command(0.0, 0.0)
        waited_s = 0.0
        while waited_s < _MOST_STOP_S:
            before = self._truth
            self._advance(POLL_S)
            waited_s += POLL_S
            after = self._truth
            if math.dist(before, after) < _STANDING_M:
                break
        self._advance(_SETTLED_S)

    def _until(self, left: Callable[[], float], speed: float) -> None:
        """Wait until `left` is 0, or for _MOST_LEG_S."""
        waited_s = 0.0
        while (rest := left()) > 0.0 and waited_s < _MOST_LEG_S:
            wait_s = max(_LEAST_POLL_S, min(POLL_S, rest / speed))
            self._advance(wait_s)
            waited_s += wait_s

    def _advance(self, seconds: float) -> None:
        self.robot.advance(seconds)
        self.samples.append(_sample(self.robot))


def _sample(robot: LabRobot) -> PoseSample:
    return PoseSample(robot.world.pose, robot.odometry)


# -- experiments ------------------------------------------------------------------------------------------------------

_POOLED_RUNS = 40  # fewer are finished before a process has started


class Software(StrEnum):
    """Software of the robot."""

    FIRMWARE = "firmware"  # the project's firmware
    PAPER = "paper"  # the paper's software, rebuilt


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """A robot, its software, its world and its operator."""

    software: Software
    world: WorldParameters = PAPER_WORLD
    mistakes: Mistakes = field(default_factory=Mistakes)  # of the paper's software
    device_parameters: tuple[tuple[str, tuple[float, ...]], ...] = ()  # of the firmware: result of a calibration
    habits: Habits = field(default_factory=Habits)
    first_seed: int = 1

    def robot(self, seed: int) -> LabRobot:
        """Return a new robot. Equal seeds give equal drives.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
        """
        world = self.world.changed({"seed": seed})
        if self.software is Software.PAPER:
            return PaperRobot(world, self.mistakes)
        return FirmwareRobot(world, dict(self.device_parameters))


@dataclass(frozen=True, slots=True)
class Experiment:
    """Runs of one pattern. Run n has the seed first_seed + n."""

    setup: Setup
    pattern: Pattern
    runs: int


@dataclass(frozen=True, slots=True)
class Errors:
    """Odometry minus true position, one row for each run."""

    pattern: Pattern
    xy_cm: NDArray[np.float64]
    length_cm: NDArray[np.float64]

    @property
    def sizes_cm(self) -> NDArray[np.float64]:
        """Errors as in the paper's table: |x| and |y|, or |length|; one row for each run."""
        return np.abs(self.length_cm[:, np.newaxis] if self.pattern.table == LINE_TABLE else self.xy_cm)

    @property
    def means_cm(self) -> NDArray[np.float64]:
        """Means of the columns, as in the last line of the paper's table."""
        means: NDArray[np.float64] = self.sizes_cm.mean(axis=0)
        return means


def conduct(experiment: Experiment) -> list[Run]:
    """Drive the runs of an experiment.

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
    """Return the operator's practice with this robot, measured without random disturbances."""
    steady = {"caster_random": 0.0, "left.slip_noise_m": 0.0, "right.slip_noise_m": 0.0}
    usual = replace(setup, world=setup.world.changed(steady))
    return rehearse(lambda: usual.robot(1), setup.habits)


def errors_of(runs: Iterable[Run]) -> Errors:
    """Return the errors of runs of one pattern."""
    driven = list(runs)
    xy_cm = np.array([run.error_cm for run in driven])
    return Errors(driven[0].pattern, xy_cm, np.array([run.length_error_cm for run in driven]))


def measure(experiment: Experiment) -> Errors:
    """Drive the runs of an experiment. Return only the errors.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    return errors_of(conduct(experiment))


class Laboratory:
    """Pool that drives many experiments on all cores: `with Laboratory() as laboratory`."""

    def __init__(self, workers: int | None = None) -> None:
        """`workers`: number of processes; None: one for each core."""
        self._workers = workers or os.cpu_count() or 1
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def measure(self, experiments: Sequence[Experiment]) -> Iterator[Errors]:
        """Drive the experiments. Yield the errors of each, in their order.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
        """
        if self._workers == 1 or sum(experiment.runs for experiment in experiments) < _POOLED_RUNS:
            return map(measure, experiments)
        if self._pool is None:
            # Ctrl-C reaches the processes too; this process ends them.
            ignored = (signal.SIGINT, signal.SIG_IGN)
            self._pool = ProcessPoolExecutor(self._workers, get_context("spawn"), signal.signal, ignored)
        return self._pool.map(measure, experiments)


# -- calibration ------------------------------------------------------------------------------------------------------

_TRAINING_SEED = 1000  # differs from the seeds of the runs that are measured afterwards
_KINDS: dict[Pattern, RunKind] = {
    LINE: RunKind.STRAIGHT,
    SQUARE_LEFT: RunKind.SQUARE_CCW,
    SQUARE_RIGHT: RunKind.SQUARE_CW,
}


def calibrated(setup: Setup) -> Setup:
    """Return the setup with the numbers that `hostlink calibrate` finds for its firmware in its world.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    training = replace(setup, first_seed=_TRAINING_SEED)
    runs = [run for pattern in _KINDS for run in conduct(Experiment(training, pattern, TRAINING_RUNS))]
    geometry = calibration.calibrated([_measured(run) for run in runs], WheelGeometry()).geometry
    radii = (geometry.left_radius_m, geometry.right_radius_m)
    return replace(setup, device_parameters=(("wheel_radius", radii), ("wheel_separation", (geometry.separation_m,))))


def _measured(run: Run) -> MeasuredRun:
    """Return the drive as a person with a tape measure records it. The heading is not measured."""
    truth = run.samples[-1].truth
    size_m = truth.x_m if run.pattern is LINE else SIDE_M
    path = tuple(sample.odometry for sample in run.samples)
    return MeasuredRun(_KINDS[run.pattern], size_m, path, Measurement(truth.x_m, truth.y_m))
