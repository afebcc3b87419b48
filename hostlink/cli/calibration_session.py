"""A calibration's robot and the person who measures it: through the daemon and at the terminal, or simulated."""

import asyncio
import contextlib
import json
import math
import signal
import sys
import termios
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Protocol

from hostlink.cli.calibration_plan import UNITS_M, Step, UnitMissing, parse_angle, parse_length
from hostlink.cli.names import driver
from hostlink.cli.output import show_progress, show_question, write, write_error
from hostlink.client import Host, RobotState, connect
from hostlink.client.robot import Robot
from hostlink.client.topics import Subscription
from hostlink.errors import HostlinkError, RefusalKind, UnknownTopic
from hostlink.robot.calibration import Measurement, RunKind, WheelGeometry
from hostlink.robot.course import STUCK_S, CourseFollower, Leg, Speed
from hostlink.robot.kinematics import Pose, wrap_angle
from hostlink.robot.odometry import OdometryCorrection
from hostlink.sim.firmware_module import WorldParameters
from hostlink.sim.firmware_world import FirmwareWorld, Person, follow

# -- courses through the daemon ---------------------------------------------------------------------------------------

PRIORITY = 55  # above a program, below a person at the keys
SILENCE_S = 0.4  # of the odometry: the robot would drive blind
FIRST_POSE_S = 3.0
JUMP_M = 0.3  # between two poses: the device restarted, or its odometry was reset
STAND_S = 0.3  # after the stop, before the person may touch it
SIGNALS = (signal.SIGTERM, signal.SIGHUP)  # Ctrl-C is asyncio's own
OWN_PARAMETERS = ("wheel_radius", "wheel_separation", "ticks_per_turn")
OWN_TOPIC = "pid_tune_l"  # that only hostlink's firmware subscribes to

Show = Callable[[int, float], None]  # legs that are left, seconds


class Drives:
    """Courses of one robot of a daemon."""

    def __init__(self, url: str, token: str | None, robot: str, speed: Speed) -> None:
        self.robot = robot.strip("/")
        self._url, self._token, self._speed = url, token, speed

    async def follow(self, legs: Sequence[Leg], correction: OdometryCorrection, show: Show) -> tuple[Pose, ...]:
        """Drive a course; returns the poses of the robot's own odometry. A signal cancels it.

        Raises:
            HostlinkError: it is refused or broken off; the robot stands.
        """
        async with self._connected() as host:
            state = await _state(host, self.robot)
            robot = host.robot(self.robot, priority=PRIORITY)
            async with host.subscribe(state["odometry_topic"]) as poses, _stopping(robot):
                drive = _Drive(robot, CourseFollower(legs, self._speed), correction)
                return await drive.run(poses, show)

    async def nominal(self) -> WheelGeometry:
        """The numbers that the robot uses: as it was answered, else as configured, else the paper's.

        Raises:
            HostlinkError: there is no hostlink, or no such robot; or its parameters have changed since it connected.
        """
        usual = WheelGeometry()
        async with self._connected() as host:
            state = await _state(host, self.robot)
            await self._require_current(host, state)
            radii = await self._parameter(host, "wheel_radius", [usual.left_radius_m, usual.right_radius_m])
            configured_m = state.get("wheel_separation_m") or usual.separation_m
            separation = await self._parameter(host, "wheel_separation", [configured_m])
        return WheelGeometry(radii[0], radii[-1], separation[0])

    async def _require_current(self, host: Host, state: RobotState) -> None:
        """The robot must use what the daemon has now: a robot requests its parameters when it connects, no later."""
        link = next((each for each in await host.links() if each["number"] == state["link"]), {})
        for name in OWN_PARAMETERS:
            answered = link.get("parameters", {}).get(f"/{self.robot}/{name}")
            text = (await host.call("/rosapi/get_param", {"name": f"/{self.robot}/{name}", "default": "[]"}))["value"]
            now = _values(str(text))
            if answered is not None and answered != now:
                was, become = (", ".join(map(str, values)) for values in (answered, now))
                raise HostlinkError(
                    f"{self.robot} was given {was or 'no number'} as {name} when it connected, and the daemon has "
                    f"{become or 'none'} now: reset the robot, then begin again"
                )

    async def requests_parameters(self) -> bool:
        """Whether it is hostlink's own firmware, which requests its wheels as parameters.

        Raises:
            HostlinkError: there is no hostlink.
        """
        async with self._connected() as host:
            return any(topic["name"] == f"/{self.robot}/{OWN_TOPIC}" for topic in await host.topics())

    async def set_parameters(self, parameters: Mapping[str, str]) -> None:
        """Give the running daemon parameters, as JSON; the robot requests them when it connects the next time.

        Raises:
            HostlinkError: they were refused.
        """
        async with self._connected() as host:
            for name, value in parameters.items():
                await host.call("/rosapi/set_param", {"name": name, "value": value})

    def _connected(self) -> contextlib.AbstractAsyncContextManager[Host]:
        return connect(self._url, token=self._token, reconnect=False)

    async def _parameter(self, host: Host, name: str, usual: list[float]) -> list[float]:
        answer = await host.call("/rosapi/get_param", {"name": f"/{self.robot}/{name}", "default": "[]"})
        return numbers_of(str(answer["value"])) or usual


class _Drive:
    """One course: a command at each pose."""

    def __init__(self, robot: Robot, follower: CourseFollower, correction: OdometryCorrection) -> None:
        self._robot, self._follower, self._correction = robot, follower, correction
        self._path: list[Pose] = []
        self._shown = Pose()

    async def run(self, poses: Subscription, show: Show) -> tuple[Pose, ...]:
        now_s = asyncio.get_running_loop().time
        start_s = now_s()
        self._add(await self._next(poses, FIRST_POSE_S))
        while not self._follower.is_done:
            velocity = self._follower.update(self._shown, now_s())
            if self._follower.is_stuck:
                raise HostlinkError(
                    f"its odometry did not advance for {STUCK_S:g} s: a wall, or an encoder that does not count? "
                    "The robot was stopped"
                )
            await self._robot.command(*velocity)
            if self._robot.refusal is not None:
                raise HostlinkError(f"{self._robot.name} is not driven any more: {self._robot.refusal.reason}")
            show(self._follower.legs_left, now_s() - start_s)
            self._add(await self._next(poses, SILENCE_S))
        return tuple(self._path)

    def _add(self, pose: Pose) -> None:
        if self._path:
            before = self._path[-1]
            if math.dist(before[:2], pose[:2]) > JUMP_M or abs(wrap_angle(pose.theta_rad - before.theta_rad)) > 1.0:
                raise HostlinkError("its odometry jumped: this drive does not count. Put it back to the start")
            self._shown = self._correction.advance(self._shown, before, pose)
        self._path.append(pose)

    async def _next(self, poses: Subscription, timeout_s: float) -> Pose:
        try:
            async with asyncio.timeout(timeout_s):
                return pose_of(await anext(poses))
        except TimeoutError:
            raise HostlinkError(f"no odometry for {timeout_s:g} s: the robot was stopped") from None


@contextlib.asynccontextmanager
async def _stopping(robot: Robot) -> AsyncIterator[None]:
    """However the block is left, the robot stops first, unless another has it; a signal leaves the block."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - it is one that runs this
    for number in SIGNALS:
        loop.add_signal_handler(number, task.cancel)
    try:
        yield
    finally:
        for number in SIGNALS:
            loop.remove_signal_handler(number)
        if robot.refusal is None or robot.refusal.kind != RefusalKind.HELD:  # a stop would end another's drive, too
            with contextlib.suppress(HostlinkError):  # with the connection gone the daemon has stopped it
                await robot.stop(wait_s=0.0)
    await asyncio.sleep(STAND_S)


async def _state(host: Host, name: str) -> RobotState:
    names = tuple(robot["name"] for robot in await host.robots())
    if name not in names:
        raise UnknownTopic("robot", name, names)
    state = await host.robot(name).state()
    if not state["connected"]:
        raise HostlinkError(f"{name} is not connected")
    if state.get("locked"):
        raise HostlinkError(f"{name} is locked: {state.get('lock_reason')}")
    if state["holder"] is not None:
        raise HostlinkError(f"{name}: {driver(state)} drives it; end that first, or it drives on while you measure")
    return state


def pose_of(message: Mapping[str, Any]) -> Pose:
    """Of a geometry_msgs/Pose2D or a nav_msgs/Odometry."""
    if "theta" in message:
        return Pose(message["x"], message["y"], wrap_angle(message["theta"]))
    pose = message["pose"]["pose"]
    x, y, z, w = (pose["orientation"][axis] for axis in "xyzw")
    yaw_rad = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return Pose(pose["position"]["x"], pose["position"]["y"], wrap_angle(yaw_rad))


def _values(text: str) -> list[Any]:
    """Of a parameter in JSON, as the API shows what a device was answered."""
    value = json.loads(text)
    return value if isinstance(value, list) else [value]


def numbers_of(text: str) -> list[float]:
    """Of a parameter in JSON: one number or several; nothing where it is something else."""
    words = text.strip().strip("[]").split(",")
    try:
        values = [float(word) for word in words]
    except ValueError:
        return []
    return values if all(math.isfinite(value) and value > 0 for value in values) else []


# -- measurements -----------------------------------------------------------------------------------------------------

MISTAKES = ("slip", "sides")
_SLIP = 0.1
_TURNS = (RunKind.TURNS_CCW, RunKind.TURNS_CW)


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
        default = "cm" if step.kind is RunKind.STRAIGHT else ""
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
        is_wrong = step.kind is not RunKind.STRAIGHT and not self._is_checking
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
