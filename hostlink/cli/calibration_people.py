"""Who measures: a person at the terminal, or a simulated one beside a simulated robot."""

import asyncio
import math
import sys
import termios
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from hostlink.cli.calibration_drive import Drives
from hostlink.cli.calibration_plan import UNITS_M, Step, UnitMissing, parse_angle, parse_length
from hostlink.cli.output import show_progress, show_question, write, write_error
from hostlink.errors import HostlinkError
from hostlink.robot.calibration import Kind, Measurement, WheelGeometry
from hostlink.robot.course import Leg
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry import OdometryCorrection
from hostlink.sim.firmware_module import WorldParameters
from hostlink.sim.firmware_world import FirmwareWorld, Person, follow

MISTAKES = ("slip", "sides")
_SLIP = 0.1
_TURNS = (Kind.TURNS_CCW, Kind.TURNS_CW)


class Session(Protocol):
    """A robot, and who measures it."""

    @property
    def is_patient(self) -> bool:
        """Whether a drive is repeated after an error."""

    def nominal(self) -> WheelGeometry:
        """The numbers in which the robot believes."""

    def requests_parameters(self) -> bool:
        """Whether it requests its wheels as parameters."""

    def set_parameters(self, parameters: Mapping[str, str], /) -> None:
        """For the next time that it connects."""

    def prepare(self, step: Step, place: str) -> None:
        """Before a drive."""

    def follow(self, legs: Sequence[Leg], correction: OdometryCorrection) -> tuple[Pose, ...]:
        """The drive; the poses of the robot's own odometry."""

    def measure(self, step: Step) -> Measurement:
        """After it."""

    def drives_again(self, reason: str) -> bool:
        """After numbers that cannot be: whether to drive again, else only to measure again."""

    def goes_on(self, doubt: str) -> bool:
        """Whether a number that is doubted is right."""

    def choose(self, complaint: str, titles: Sequence[str], /) -> int | None:
        """Which drive to measure again; None: none."""


class AtTheTerminal:
    """A real robot, through the daemon, and a person."""

    is_patient = True

    def __init__(self, drives: Drives, show: Callable[..., None] = write) -> None:
        """`show` writes lines for the person; questions go to standard error."""
        self._drives, self._show = drives, show

    def nominal(self) -> WheelGeometry:
        return asyncio.run(self._drives.nominal())

    def requests_parameters(self) -> bool:
        return asyncio.run(self._drives.requests_parameters())

    def set_parameters(self, parameters: Mapping[str, str], /) -> None:
        asyncio.run(self._drives.set_parameters(parameters))

    def prepare(self, step: Step, place: str) -> None:
        self._show(
            "",
            f"{place}  {step.title}",
            f"  Put the robot down with {step.room}.",
            "  Mark on the floor the middle of its axle (between the wheels) and the line along which it points.",
        )
        _forget_keys()
        while _prompt("  Enter starts the drive, Ctrl-C stops the robot at any time: ").strip():
            write_error("  Not started: Enter alone starts it, Ctrl-C leaves.")

    def follow(self, legs: Sequence[Leg], correction: OdometryCorrection) -> tuple[Pose, ...]:
        def show(left: int, seconds: float) -> None:
            number = min(len(legs) - left + 1, len(legs))
            show_progress(f"  driving: {seconds:.0f} s, leg {number} of {len(legs)}; Ctrl-C stops it")

        try:
            return asyncio.run(self._drives.follow(legs, correction, show))
        except asyncio.CancelledError:  # by a signal; Ctrl-C comes as itself
            raise KeyboardInterrupt from None
        finally:
            show_progress("")

    def measure(self, step: Step) -> Measurement:
        if step.kind in _TURNS:
            past_rad = _read(
                "  How far did it turn past its line? Degrees, counter-clockwise is positive: ", parse_angle
            )
            return Measurement(0.0, 0.0, step.way * step.size * math.tau + past_rad)
        self._show("  Measure from the mark to the middle of the axle, along the line and across it.")
        # Only of a line the odometry tells the unit of a number alone: a square ends near its mark in any unit.
        default = "cm" if step.kind is Kind.STRAIGHT else ""
        unit = "cm, or with its unit" if default else "with its unit, as 12.5 cm"
        x_m = _read_length(f"  Forward along the line ({unit}; behind the mark is negative): ", default)
        y_m = _read_length("  To the left of the line (with its unit, as 12.5 cm; to the right is negative): ")
        return Measurement(x_m, y_m)

    def drives_again(self, reason: str) -> bool:
        write_error(f"  {reason}")
        return _prompt("  Enter: measure again; d: drive again: ").strip().lower().startswith("d")

    def goes_on(self, doubt: str) -> bool:
        write_error(f"  {doubt}")
        return _prompt("  y: it is right; Enter leaves: ").strip().lower() in ("y", "yes")

    def choose(self, complaint: str, titles: Sequence[str]) -> int | None:
        write_error("", complaint)
        self._show(*(f"  {number}  {title}" for number, title in enumerate(titles, start=1)))
        word = _prompt("  The number of the drive to do again; Enter leaves: ").strip()
        return int(word) - 1 if word.isdigit() and 1 <= int(word) <= len(titles) else None


class Simulated:
    """A robot on a simulated floor, and a person who reads a tape measure to two millimetres."""

    is_patient = False

    def __init__(self, world: WorldParameters, mistake: str | None) -> None:
        """`mistake`: that the person makes in every square: "slip" or "sides"."""
        self._robot = FirmwareWorld(world)
        self._robot.connect()
        self._person = Person(int(world["seed"]))
        self._mistake = mistake
        self._end = Pose()
        self._is_checking = False

    def nominal(self) -> WheelGeometry:
        return WheelGeometry()

    def requests_parameters(self) -> bool:
        return True

    def set_parameters(self, _: Mapping[str, str]) -> None:
        raise HostlinkError("a simulated robot keeps nothing")

    def prepare(self, step: Step, place: str) -> None:
        show_progress(f"{place}  {step.title}")
        self._is_checking = place.startswith("check")

    def follow(self, legs: Sequence[Leg], correction: OdometryCorrection) -> tuple[Pose, ...]:
        try:
            path, self._end = follow(self._robot, legs, correction)
        except TimeoutError as error:
            raise HostlinkError(str(error)) from error
        finally:
            show_progress("")
        return path

    def measure(self, step: Step) -> Measurement:
        x_m, y_m, theta_rad = self._person.measure(self._end)
        if step.kind in _TURNS:
            return Measurement(0.0, 0.0, theta_rad)
        is_wrong = step.kind is not Kind.STRAIGHT and not self._is_checking
        if is_wrong and self._mistake == "slip":
            return Measurement(x_m * _SLIP, y_m * _SLIP)
        return Measurement(x_m, -y_m if is_wrong and self._mistake == "sides" else y_m)

    def drives_again(self, reason: str) -> bool:
        raise HostlinkError(reason)

    def goes_on(self, doubt: str) -> bool:  # noqa: ARG002 - the simulated robot's numbers are known
        return False

    def choose(self, *_: object) -> int | None:
        return None


def _forget_keys() -> None:
    """An Enter that was pressed before its question must not start a robot."""
    if sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _prompt(question: str) -> str:
    show_question(question)
    answer = sys.stdin.readline()
    if not answer:
        raise HostlinkError("there is nobody to answer: the input has ended")
    return answer


def _read_length(question: str, default: str = "") -> float:
    """A number without a unit is asked about: whoever means metres types the check drives in metres, too."""
    text = _prompt(question)
    while True:
        try:
            return parse_length(text, default)
        except UnitMissing as missing:
            answer = _prompt(f"  {missing.number} of what? {', '.join(UNITS_M)}: ").strip()
            text = f"{missing.number} {answer}" if answer.lower() in UNITS_M else answer or missing.number
        except ValueError as error:
            write_error(f"  {error}")
            text = _prompt(question)


def _read(question: str, parse: Callable[[str], float]) -> float:
    while True:
        try:
            return parse(_prompt(question))
        except ValueError as error:
            write_error(f"  {error}")
