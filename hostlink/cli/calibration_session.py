"""Robot of a calibration and the person who measures it: a real robot of the daemon, or a simulated one."""

import asyncio
import contextlib
import json
import math
import signal
import sys
import termios
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Literal

from hostlink.cli.calibration_plan import Step
from hostlink.cli.connecting import connected, rosapi
from hostlink.cli.output import show_progress, show_question, write, write_error
from hostlink.cli.quantities import UNITS_M, UnitMissing, parse_angle, parse_length
from hostlink.cli.robots import free_robot
from hostlink.client import Host, RobotState
from hostlink.client.course import STUCK_S, CourseFollower, Leg, Speed
from hostlink.client.motion import require_pose
from hostlink.client.robot import Robot
from hostlink.client.topics import Subscription
from hostlink.core.robot.kinematics import Pose, wrap_angle, yaw_of
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.errors import HostlinkError, RefusalKind
from hostlink.workbench.calibration import Measurement, RunKind, WheelGeometry
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import FirmwareWorld, Person, follow

# -- courses through the daemon ---------------------------------------------------------------------------------------

PRIORITY = 55  # above a program, below a person at the keys
SILENCE_S = 0.4  # without odometry the robot would drive blind
FIRST_POSE_S = 3.0
JUMP_M = 0.3  # a larger distance between two poses means that the device restarted or reset its odometry
STAND_S = 0.3  # after the stop, until the person may touch the robot
SIGNALS = (signal.SIGTERM, signal.SIGHUP)  # asyncio handles Ctrl-C itself
OWN_PARAMETERS = ("wheel_radius", "wheel_separation", "ticks_per_turn")
OWN_TOPIC = "pid_tune_l"  # only hostlink's firmware subscribes to it

Show = Callable[[int, float], None]  # remaining legs, seconds


def require_two_wheels(robot: str, kinematics: str) -> None:
    """Refuse a robot whose drive the method does not describe.

    Raises:
        HostlinkError: the settings give it another drive.
    """
    if kinematics not in ("", "differential"):
        raise HostlinkError(
            f"{robot} has a drive of the kind {kinematics}; calibration measures the wheels of differential drives. "
            f'If it has two driven wheels, set kinematics = "differential" in [robots.{robot}]'
        )


class Drives:
    """Drives of one robot of a daemon along courses."""

    def __init__(self, url: str, token: str | None, robot: str, speed: Speed) -> None:
        self.robot = robot.strip("/")
        self._url, self._token, self._speed = url, token, speed

    async def follow(self, legs: Sequence[Leg], correction: OdometryCorrection, show: Show) -> tuple[Pose, ...]:
        """Drive a course; return the poses of the robot's own odometry. A signal cancels the drive.

        Raises:
            HostlinkError: the drive is refused or broken off; the robot was sent a stop.
        """
        async with connected(self._url, self._token) as host:
            state = await free_robot(host, self.robot)
            require_pose(state)
            require_two_wheels(state["name"], state["kinematics"])
            robot = host.robot(self.robot, priority=PRIORITY)
            poses_topic = state["odometry_topic"]
            if poses_topic is None:
                raise HostlinkError(f"{state['name']} publishes no pose: there is nothing to calibrate")
            async with host.subscribe(poses_topic) as poses, _stopping(robot):
                return await _drive(robot, CourseFollower(legs, self._speed), correction, poses, show)

    async def nominal(self) -> WheelGeometry:
        """Return the wheels that the robot uses: of its parameters, else of the configuration, else of the paper.

        Raises:
            HostlinkError: no daemon answers, the robot is unknown, or its parameters have changed since it connected.
        """
        usual = WheelGeometry()
        async with connected(self._url, self._token) as host:
            state = await free_robot(host, self.robot)
            require_pose(state)
            await self._require_current(host, state)
            radii = await self._parameter(host, "wheel_radius", [usual.left_radius_m, usual.right_radius_m])
            configured_m = state.get("wheel_separation_m") or usual.separation_m
            separation = await self._parameter(host, "wheel_separation", [configured_m])
        return WheelGeometry(radii[0], radii[-1], separation[0])

    async def _require_current(self, host: Host, state: RobotState) -> None:
        """Refuse a robot whose parameters have changed since it connected, which is when it requests them."""
        link = next((each for each in await host.links() if each["number"] == state["link"]), {})
        for name in OWN_PARAMETERS:
            answered = link.get("parameters", {}).get(f"/{self.robot}/{name}")
            now = _values(await self._text(host, name))
            if answered is not None and answered != now:
                was, become = (", ".join(map(str, values)) for values in (answered, now))
                raise HostlinkError(
                    f"{self.robot} was given {was or 'no number'} as {name} when it connected, but the daemon has "
                    f"{become or 'none'} now; reset the robot, then begin again"
                )

    async def requests_parameters(self) -> bool:
        """Whether the robot has hostlink's own firmware, which requests its wheels as parameters.

        Raises:
            HostlinkError: no daemon answers.
        """
        async with connected(self._url, self._token) as host:
            return any(topic["name"] == f"/{self.robot}/{OWN_TOPIC}" for topic in await host.topics())

    async def set_parameters(self, parameters: Mapping[str, str]) -> None:
        """Set parameters in the running daemon, as JSON; the robot requests them at its next connection.

        Raises:
            HostlinkError: the daemon refuses them.
        """
        async with connected(self._url, self._token) as host:
            for name, value in parameters.items():
                await host.call("/rosapi/set_param", {"name": name, "value": value})

    async def _parameter(self, host: Host, name: str, usual: list[float]) -> list[float]:
        return numbers_of(await self._text(host, name)) or usual

    async def _text(self, host: Host, name: str) -> str:
        return str(await rosapi(host, "get_param", "value", name=f"/{self.robot}/{name}", default="[]"))


async def _drive(
    robot: Robot, follower: CourseFollower, correction: OdometryCorrection, poses: Subscription, show: Show
) -> tuple[Pose, ...]:
    """Drive along a course, with a command at each pose. Return the poses."""
    now_s = asyncio.get_running_loop().time
    start_s = now_s()
    path, shown = [await _next_pose(poses, FIRST_POSE_S)], Pose()
    while not follower.is_done:
        velocity = follower.update(shown, now_s())
        if follower.is_stuck:
            raise HostlinkError(
                f"the odometry did not change for {STUCK_S:g} s, and the robot was stopped; look for a wall "
                "or an encoder that does not count"
            )
        await robot.command(*velocity)
        if robot.refusal is not None:
            raise HostlinkError(f"a command for {robot.name} was refused: {robot.refusal.reason}")
        show(follower.legs_left, now_s() - start_s)
        before, pose = path[-1], await _next_pose(poses, SILENCE_S)
        if math.dist(before[:2], pose[:2]) > JUMP_M or abs(wrap_angle(pose.theta_rad - before.theta_rad)) > 1.0:
            raise HostlinkError("the odometry jumped, so this drive does not count; put the robot back to the start")
        shown = correction.advance(shown, before, pose)
        path.append(pose)
    return tuple(path)


async def _next_pose(poses: Subscription, timeout_s: float) -> Pose:
    try:
        async with asyncio.timeout(timeout_s):
            return pose_of(await anext(poses))
    except TimeoutError:
        raise HostlinkError(
            f"no odometry arrived for {timeout_s:g} s, and the robot was stopped; `hostlink doctor` finds out why"
        ) from None


@contextlib.asynccontextmanager
async def _stopping(robot: Robot) -> AsyncIterator[None]:
    """Stop the robot when the block is left, unless another source drives it. A signal cancels the block."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - a task runs this
    for number in SIGNALS:
        loop.add_signal_handler(number, task.cancel)
    try:
        yield
    finally:
        for number in SIGNALS:
            loop.remove_signal_handler(number)
        refusal = robot.refusal
        if refusal is None or refusal.kind != RefusalKind.HELD:  # a stop would also end another source's drive
            with contextlib.suppress(HostlinkError):  # with the connection gone the daemon has stopped it
                await robot.stop(wait_s=0.0)
    await asyncio.sleep(STAND_S)


def pose_of(message: Mapping[str, Any]) -> Pose:
    """Return the pose of a geometry_msgs/Pose2D or a nav_msgs/Odometry."""
    if "theta" in message:
        return Pose(message["x"], message["y"], wrap_angle(message["theta"]))
    pose = message["pose"]["pose"]
    yaw_rad = yaw_of(*(pose["orientation"][axis] for axis in "xyzw"))
    return Pose(pose["position"]["x"], pose["position"]["y"], yaw_rad)


def _values(text: str) -> list[Any]:
    """Return the values of a parameter in JSON, as the API shows the answer to a device."""
    value = json.loads(text)
    return value if isinstance(value, list) else [value]


def numbers_of(text: str) -> list[float]:
    """Return the number or numbers of a parameter in JSON; empty if it has another type."""
    words = text.strip().strip("[]").split(",")
    try:
        values = [float(word) for word in words]
    except ValueError:
        return []
    return values if all(math.isfinite(value) and value > 0 for value in values) else []


# -- measurements -----------------------------------------------------------------------------------------------------

Mistake = Literal["slip", "sides"]
_SLIP = 0.1
_TURNS = (RunKind.TURNS_CCW, RunKind.TURNS_CW)


class AtTheTerminal:
    """Real robot of the daemon, and a person at the terminal."""

    is_patient = True  # a drive is repeated after an error

    def __init__(self, drives: Drives, show: Callable[..., None] = write) -> None:
        """Store how lines for the person are written; questions are written on standard error."""
        self._drives, self._show = drives, show

    def nominal(self) -> WheelGeometry:
        """Return the wheels that the robot uses."""
        return asyncio.run(self._drives.nominal())

    def requests_parameters(self) -> bool:
        """Whether the robot requests its wheels as parameters."""
        return asyncio.run(self._drives.requests_parameters())

    def set_parameters(self, parameters: Mapping[str, str]) -> None:
        """Set parameters for the robot's next connection."""
        asyncio.run(self._drives.set_parameters(parameters))

    def prepare(self, step: Step, place: str) -> None:
        """Prepare a drive: tell the person where to put the robot, and wait."""
        self._show(
            "",
            f"{place}  {step.title}",
            f"  Put the robot down with {step.room}.",
            "  Mark on the floor the middle of the axle and, as a line, the direction in which the robot points.",
        )
        _forget_keys()
        while _prompt("  Press Enter to start the drive; Ctrl-C stops the robot at any time: ").strip():
            write_error("  The drive was not started: press Enter alone to start it, Ctrl-C to leave.")

    def follow(self, legs: Sequence[Leg], correction: OdometryCorrection) -> tuple[Pose, ...]:
        """Drive the course; return the poses of the robot's own odometry."""

        def show(left: int, seconds: float) -> None:
            number = min(len(legs) - left + 1, len(legs))
            show_progress(f"  driving: {seconds:.0f} s, leg {number} of {len(legs)}; Ctrl-C stops the robot")

        try:
            return asyncio.run(self._drives.follow(legs, correction, show))
        except asyncio.CancelledError:  # by a signal; Ctrl-C raises KeyboardInterrupt itself
            raise KeyboardInterrupt from None

    def measure(self, step: Step) -> Measurement:
        """Ask for the measurement after a drive."""
        if step.kind in _TURNS:
            past_rad = _read(
                "  How far did the robot turn past its line? Degrees, counter-clockwise is positive: ", parse_angle
            )
            return Measurement(0.0, 0.0, step.way * step.size * math.tau + past_rad)
        self._show("  Measure from the mark to the middle of the axle, along the line and across it.")
        # Only after a line does odometry tell the unit of a bare number: a square ends near its mark in any unit.
        default = "cm" if step.kind is RunKind.STRAIGHT else ""
        unit = "cm, or with its unit" if default else "with its unit, as 12.5 cm"
        x_m = _read_length(f"  Forward along the line ({unit}; behind the mark is negative): ", default)
        y_m = _read_length("  To the left of the line (with its unit, as 12.5 cm; to the right is negative): ")
        return Measurement(x_m, y_m)

    def drives_again(self, reason: str) -> bool:
        """Ask after an impossible measurement whether to drive again, rather than only to measure again."""
        write_error(f"  {reason}")
        return _prompt("  Press Enter to measure again, d to drive again: ").strip().lower().startswith("d")

    def goes_on(self, doubt: str) -> bool:
        """Ask whether a doubtful number is right."""
        write_error(f"  {doubt}")
        return _prompt("  Press y if what you entered is right, Enter to leave: ").strip().lower() in ("y", "yes")

    def choose(self, complaint: str, titles: Sequence[str]) -> int | None:
        """Ask which drive to measure again; None to give up."""
        write_error("", complaint)
        self._show(*(f"  {number}  {title}" for number, title in enumerate(titles, start=1)))
        word = _prompt("  Number of the drive to repeat; Enter leaves: ").strip()
        return int(word) - 1 if word.isdigit() and 1 <= int(word) <= len(titles) else None


class Simulated:
    """Robot on a simulated floor, and a simulated person who reads a tape measure to two millimetres."""

    is_patient = False

    def __init__(self, world: WorldParameters, mistake: Mistake | None) -> None:
        """Connect the robot. `mistake` is the person's mistake in every square: "slip" or "sides"."""
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
        raise HostlinkError("a simulated robot stores no parameters; leave out --apply")

    def prepare(self, step: Step, place: str) -> None:
        show_progress(f"{place}  {step.title}")
        self._is_checking = place.startswith("check")

    def follow(self, legs: Sequence[Leg], correction: OdometryCorrection) -> tuple[Pose, ...]:
        try:
            path, self._end = follow(self._robot, legs, correction)
        except TimeoutError as error:
            raise HostlinkError(str(error)) from error
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


CalibrationSession = AtTheTerminal | Simulated  # the robot, and the person who measures it


def _forget_keys() -> None:
    """Discard keys that were pressed before the question, so that they start no robot."""
    if sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _prompt(question: str) -> str:
    show_question(question)
    answer = sys.stdin.readline()
    if not answer:
        write_error("")  # the question has no end of a line
        raise HostlinkError("standard input is closed; run this command in a terminal")
    return answer


def _read_length(question: str, default: str = "") -> float:
    """Ask for a length, and for the unit of a bare number.

    Check drives cannot find a wrong unit, because a person who means metres enters metres in them, too.
    """
    text = _prompt(question)
    while True:
        try:
            return parse_length(text, default)
        except UnitMissing as missing:
            answer = _prompt(f"  Unit of {missing.number} ({', '.join(UNITS_M)}): ").strip()
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
