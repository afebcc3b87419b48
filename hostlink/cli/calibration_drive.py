"""A course that a robot drives through the daemon: within its limits, and it stands when this program ends or dies."""

import asyncio
import contextlib
import json
import math
import signal
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any

from hostlink.cli.drivers import driver
from hostlink.client import Host, RobotState, connect
from hostlink.client.robot import Robot
from hostlink.client.topics import Subscription
from hostlink.errors import HostlinkError, RefusalKind, UnknownTopic
from hostlink.robot.calibration import WheelGeometry
from hostlink.robot.course import STUCK_S, CourseFollower, Leg, Speed
from hostlink.robot.kinematics import Pose, wrap_angle
from hostlink.robot.odometry import OdometryCorrection

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
