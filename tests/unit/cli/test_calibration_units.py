"""A length in a wrong unit is doubted or refused at every question, and one in the right unit never is."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hostlink.cli import calibration_session
from hostlink.cli.calibrate import GuidedCalibration
from hostlink.cli.calibration_plan import SavedCalibration, Sizes, open_state
from hostlink.cli.calibration_session import AtTheTerminal, Drives, Show
from hostlink.cli.quantities import UNITS_M
from hostlink.client.course import CourseFollower, Leg, Speed
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.errors import HostlinkError
from hostlink.workbench.calibration import Calibration, WheelGeometry
from tests.unit.core.robot.drives import ExactRobot, relative

NOMINAL = WheelGeometry()
SIZES = Sizes(length_m=2.0, side_m=1.0, turns=0, repeats=1)
READS_M, MARK_RAD = 0.001, math.radians(0.5)  # how finely a tape and the direction of a mark are read
ROBOTS = int(os.environ.get("HOSTLINK_DRAWN_ROBOTS", "6"))  # for each unit; 300 were drawn once
WRONG_UNITS = ("m", "mm", "in")
QUESTIONS = ("forward on lines", "sideways on lines", "squares", "squares and checks", "everything")


def drawn_wheels(random: np.random.Generator) -> WheelGeometry:
    """Wheels as they are built: alike to one and a half percent, their separation to six."""
    size, uneven, apart = random.uniform(-0.03, 0.03), random.uniform(-0.008, 0.008), random.uniform(-0.06, 0.06)
    return WheelGeometry(0.045 * (1 + size - uneven), 0.045 * (1 + size + uneven), 0.21 * (1 + apart))


class DrawnDrives(Drives):
    """Drives without a daemon, of a robot without motors."""

    def __init__(self, robot: ExactRobot) -> None:
        super().__init__("", None, "robot_0", Speed())
        self.driven = robot

    async def follow(self, legs: Sequence[Leg], correction: OdometryCorrection, show: Show) -> tuple[Pose, ...]:
        follower, path, shown, now_s = CourseFollower(legs), [self.driven.odometry], Pose(), 0.0
        while not follower.is_done:
            self.driven.move(*follower.update(shown, now_s))
            shown = correction.advance(shown, path[-1], self.driven.odometry)
            path.append(self.driven.odometry)
            now_s += 0.1
            show(follower.legs_left, now_s)
        return tuple(path)


@dataclass
class Person:
    """Reads the questions and a tape. `is_wrong`: at which questions the number is typed alone, in `unit`."""

    robot: ExactRobot
    random: np.random.Generator
    unit: str = "cm"
    is_wrong: Callable[[int, str], bool] = lambda *_: False  # number of the drive, axis
    asked: int = 0
    refused: list[str] = field(default_factory=list)
    drive: int = -1
    start: Pose = field(default_factory=Pose)
    typed: list[str] = field(default_factory=list)

    def answer(self, question: str) -> str:
        """Answer a question as a person at the terminal does."""
        if "Enter to start the drive" in question:
            self.start, self.drive = self.robot.truth, self.drive + 1
            return "\n"
        if "Unit of " in question:
            self.asked += 1
            return f"{self.unit}\n"
        if "measure again" in question:
            self.refused.append(question)
            self.is_wrong = lambda *_: False
            return "\n"
        if "drive to repeat" in question:
            raise AssertionError("the drives contradict each other")
        axis = "x" if "Forward" in question else "y"
        end = relative(self.start, self.robot.truth)
        bearing_rad = MARK_RAD * self.random.normal()
        x_m, y_m = end.x_m - bearing_rad * end.y_m, end.y_m + bearing_rad * end.x_m
        value_m = (x_m if axis == "x" else y_m) + READS_M * self.random.normal()
        number = f"{value_m / UNITS_M[self.unit]:.{ {'m': 3, 'cm': 1, 'mm': 0, 'in': 2}[self.unit] }f}"
        is_alone = self.is_wrong(self.drive, axis)
        self.typed.append(number)
        return f"{number}\n" if is_alone else f"{number} {self.unit}\n"


def wrong_at(questions: str) -> Callable[[int, str], bool]:
    """The drives are: a line, two squares, and as checks a line and two squares."""
    drives = {"squares": {1, 2}, "squares and checks": {1, 2, 4, 5}, "everything": set(range(6))}
    if questions in drives:
        return lambda drive, _: drive in drives[questions]
    wanted = "x" if questions.startswith("forward") else "y"
    return lambda drive, axis: drive in (0, 3) and axis == wanted


def calibrate(
    seed: int, folder: Path, monkeypatch: pytest.MonkeyPatch, unit: str = "cm", questions: str = ""
) -> tuple[Calibration | None, Person, WheelGeometry]:
    """Return the result; None if there is nothing to gain, or less than this robot's scatter."""
    random = np.random.default_rng(seed)
    true = drawn_wheels(random)
    robot = ExactRobot(NOMINAL, true, noise_m=random.uniform(0.0, 0.002), seed=seed)
    person = Person(robot, random, unit)
    if questions:
        person.is_wrong = wrong_at(questions)
    monkeypatch.setattr(calibration_session, "_prompt", person.answer)
    state = open_state(folder / f"{seed}.json", SavedCalibration("robot_0", SIZES, NOMINAL), anew=True)
    session = AtTheTerminal(DrawnDrives(robot), lambda *_: None)
    calibration = GuidedCalibration(session, state, folder / "picture.svg", is_quiet=True)
    try:
        return calibration.run()[0], person, true
    except HostlinkError as error:
        if "nothing to gain" not in str(error) and "drives scatter by as much" not in str(error):
            raise
        return None, person, true


def is_right(found: Calibration, true: WheelGeometry) -> bool:
    """Whether the result is as good as a tape measure and the robot's scatter allow."""
    return found.geometry == pytest.approx(true, rel=0.012)


@pytest.mark.slow
@pytest.mark.parametrize(
    "unit", [each if each in ("cm", "in") else pytest.param(each, marks=pytest.mark.long) for each in UNITS_M]
)
def test_lengths_with_their_unit_are_never_doubted(unit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, first = 0, 1000 * list(UNITS_M).index(unit)
    for seed in range(first, first + ROBOTS):
        found, person, true = calibrate(seed, tmp_path, monkeypatch, unit)
        assert (person.asked, person.refused) == (0, []), seed
        assert found is None or is_right(found, true), (seed, found, true)
        kept += found is not None
    assert kept >= 0.8 * ROBOTS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unit", "questions"),
    [
        (unit, questions)
        if unit == "m" or questions == "everything"
        else pytest.param(unit, questions, marks=pytest.mark.long)
        for unit, questions in product(WRONG_UNITS, QUESTIONS)
    ],
)
def test_a_number_alone_in_another_unit_is_asked_about_or_refused(
    unit: str, questions: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(max(ROBOTS // 10, 2)):
        found, person, true = calibrate(seed, tmp_path, monkeypatch, unit, questions)
        assert person.asked or person.refused, (seed, person.typed)
        assert found is None or is_right(found, true), (seed, person.typed)
