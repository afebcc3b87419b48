"""StepRecorder: drives a robot through stages by the daemon's API, and records its wheels meanwhile."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hostlink.cli.drivers import driver
from hostlink.cli.step_stages import Stage, Wheel
from hostlink.client import PRIORITY, Host, Mailbox, Robot, RobotState
from hostlink.errors import CommandRefused, DeviceGone, HostlinkError, RefusalKind, Refused, UnknownTopic
from hostlink.robot.step_response import Record, Sample, make_record

TICK_S = 0.02
COMMAND_INTERVAL_S = 0.1  # a fifth of the lease
LONGEST_PAUSE_S = 0.4  # of this program; after a lease the robot has stopped
CREEP_M_S = 0.01  # a zero takes a robot over from nobody
STANDING_S = 0.5
STOP_INTERVAL_S = 1.0
STANDING_TIMEOUT_S = 5.0
STANDING_TICKS_S, STANDING_M_S = 1.5, 0.005
FIRST_MESSAGE_S = 2.0
SILENCE_S = 0.9  # of what measures it: the robot would drive blind
SEPARATION_M = 0.210  # docs/robot.md#numbers
LEAST_SEPARATION_M, MOST_SEPARATION_M = 0.02, 5.0  # that hostlink's firmware accepts
PLOT_TYPE, GAINS_TYPE = "geometry_msgs/Twist", "geometry_msgs/Vector3"
ODOMETRY_TYPE = "nav_msgs/Odometry"

Samples = Mapping[str, Sample]  # by wheel; "robot" where only the whole is known
Reader = Callable[[Mapping[str, Any], Stage], Samples]


@dataclass(frozen=True, slots=True)
class Source:
    """Where a robot's speeds come from."""

    topic: str
    type_name: str
    unit: str
    read: Reader
    standing: float  # in the unit; slower is a standstill


@dataclass(frozen=True, slots=True)
class Recording:
    """What came of a drive."""

    source: str
    records: Mapping[str, Record]
    accepted: tuple[float, float]  # m/s, rad/s of the last stage, within the limits of the robot


class RobotTopics:
    """A robot's topics by their leaf, as the daemon knows them on its link."""

    def __init__(self, state: RobotState, links: Sequence[Mapping[str, Any]]) -> None:
        self._namespace = state["velocity_topic"].rpartition("/")[0] + "/"
        self._topics = [topic for link in links if link["number"] == state["link"] for topic in link["topics"]]

    def find(self, leaf: str, type_name: str) -> str | None:
        """The robot's own topic first; None: it has none."""
        found = [
            topic["name"]
            for topic in self._topics
            if topic["type"] == type_name and topic["name"].rpartition("/")[2] == leaf
        ]
        wanted = self._namespace + leaf
        return wanted if wanted in found else next(iter(found), None)


async def connected_state(robot: Robot) -> RobotState:
    """The state of a robot that may be driven.

    Raises:
        HostlinkError: there is no such robot.
        DeviceGone: it is not connected.
        CommandRefused: it is locked.
        HostlinkError: a source of the same or a higher priority drives it.
    """
    state = await robot.state()
    if not state["connected"]:
        raise DeviceGone(robot.name)
    if state.get("locked"):
        reason = f"{robot.name}: locked: {state.get('lock_reason')}; to drive it again: hostlink unlock {robot.name}"
        raise CommandRefused(robot.name, RefusalKind.LOCKED, reason)
    if state["holder"] is not None and not _is_less_important(state):
        raise HostlinkError(f"{robot.name}: {driver(state)} drives it; end that first")
    return state


def _is_less_important(state: RobotState) -> bool:
    priority = state.get("priority")
    return priority is not None and priority < PRIORITY


async def find_source(host: Host, state: RobotState, wheel: Wheel | None, separation_m: float) -> Source:
    """Where its speeds come from: plot_data, else the odometry that the daemon publishes.

    Raises:
        HostlinkError: the robot has neither.
    """
    plot = RobotTopics(state, await host.links()).find("plot_data", PLOT_TYPE)
    if plot is not None:
        return Source(plot, PLOT_TYPE, "ticks/s", _plot_reader(wheel), STANDING_TICKS_S)
    odometry = f"/{state['name']}/odom"
    if any(topic["name"] == odometry and topic["type"] == ODOMETRY_TYPE for topic in await host.topics()):
        return Source(odometry, ODOMETRY_TYPE, "m/s", _odometry_reader(wheel, separation_m), STANDING_M_S)
    raise HostlinkError(f"{state['name']} sends neither plot_data nor odometry: nothing measures its speed")


def _plot_reader(wheel: Wheel | None) -> Reader:
    axes = {"left": "x", "right": "y"} if wheel is None else {wheel.value: "x" if wheel is Wheel.LEFT else "y"}
    pwm = {"left": "linear", "right": "angular"}

    def read(message: Mapping[str, Any], _: Stage) -> Samples:
        return {
            side: Sample(message["angular"][axis], message["linear"][axis], message[pwm[side]]["z"])
            for side, axis in axes.items()
        }

    return read


def _odometry_reader(wheel: Wheel | None, separation_m: float) -> Reader:
    side = 0.0 if wheel is None else separation_m / 2 * (-1 if wheel is Wheel.LEFT else 1)
    name = "robot" if wheel is None else wheel.value

    def read(message: Mapping[str, Any], stage: Stage) -> Samples:
        twist = message["twist"]["twist"]
        return {name: Sample(stage.speed_m_s, twist["linear"]["x"] + side * twist["angular"]["z"])}

    return read


class StepRecorder:
    """Drives one robot; whatever ends `record`, the robot is stopped, unless somebody else has it."""

    def __init__(self, host: Host, robot: Robot, source: Source, *, show: Callable[[str], None]) -> None:
        self._host, self._robot, self._source, self._show = host, robot, source, show
        self._arrivals_s: list[float] = []
        self._samples: list[Samples] = []
        self._is_measured = False  # a message came
        self._has_commanded = False
        self._ran_at_s = 0.0
        self._commanded_at_s = -math.inf

    async def record(self, stages: Sequence[Stage]) -> Recording:
        """Wait until the robot stands, drive the stages, stop.

        Raises:
            HostlinkError: it is driven by another, refused, not measured, does not stand, or the connection is lost.
        """
        source = self._source
        async with self._host.subscribe(source.topic, type_name=source.type_name) as messages, self._stopping():
            await self._stand(messages)
            began_s = _now_s()
            for stage in stages:
                await self._drive(stage, messages)
            accepted = (await self._robot.state())["velocity"]
        names = self._samples[0]
        arrivals_s = [arrival_s - began_s for arrival_s in self._arrivals_s]
        return Recording(
            source.topic,
            {name: make_record(source.unit, arrivals_s, [each[name] for each in self._samples]) for name in names},
            (accepted["linear_m_s"], accepted["angular_rad_s"]),
        )

    @contextlib.asynccontextmanager
    async def _stopping(self) -> AsyncIterator[None]:
        try:
            yield
        finally:
            if self._may_move:
                with contextlib.suppress(HostlinkError):  # without a connection the daemon has stopped it
                    await self._robot.stop(wait_s=0.0)

    @property
    def _may_move(self) -> bool:
        """Whether it moves as commanded here; a stop would end another's drive, too."""
        refusal = self._robot.refusal
        return self._has_commanded and (refusal is None or refusal.kind != RefusalKind.HELD)

    async def _stand(self, messages: Mailbox[dict[str, Any]]) -> None:
        """Stop the robot, and keep the last half second of its standing."""
        began_s, stopped_s = _now_s(), -math.inf
        rest = Stage(0.0, 0.0, 0.0, 0.0)
        while not self._stands():
            if _now_s() >= stopped_s + STOP_INTERVAL_S:
                stopped_s = _now_s()
                await self._take_over()
            await asyncio.sleep(TICK_S)
            self._receive(messages, rest)
            if not self._is_measured and _now_s() > began_s + FIRST_MESSAGE_S:
                raise HostlinkError(f"nothing comes on {self._source.topic}; see `hostlink doctor`")
            if _now_s() > began_s + STANDING_TIMEOUT_S:
                raise HostlinkError(f"{self._robot.name} does not come to rest; a step begins with a robot that stands")

    async def _take_over(self) -> None:
        """Stop what somebody less important drives; he may have begun since."""
        state = await connected_state(self._robot)
        if state["holder"] is not None:
            self._has_commanded = True
            await self._robot.command(CREEP_M_S, 0.0)
        await self._robot.stop(wait_s=0.0)

    def _stands(self) -> bool:
        """For half a second; what came before that is forgotten."""
        moving = [
            number
            for number, samples in enumerate(self._samples)
            if any(abs(sample.measured) > self._source.standing for sample in samples.values())
        ]
        first = moving[-1] + 1 if moving else 0
        del self._arrivals_s[:first], self._samples[:first]
        return bool(self._arrivals_s) and self._arrivals_s[-1] - self._arrivals_s[0] >= STANDING_S

    async def _drive(self, stage: Stage, messages: Mailbox[dict[str, Any]]) -> None:
        end_s = _now_s() + stage.seconds
        self._ran_at_s, self._commanded_at_s = _now_s(), -math.inf
        self._show(f"driving at {stage.speed_m_s:.2f} m/s; Ctrl-C stops")
        while _now_s() < end_s:
            await self._command(stage)
            await asyncio.sleep(min(TICK_S, max(0.0, end_s - _now_s())))
            self._receive(messages, stage)
            if _now_s() > self._arrivals_s[-1] + SILENCE_S:
                raise HostlinkError(f"{self._source.topic} has fallen silent; the robot was sent a stop")

    async def _command(self, stage: Stage) -> None:
        now_s = _now_s()
        if now_s > self._ran_at_s + LONGEST_PAUSE_S:
            raise HostlinkError(
                f"this program did not run for {now_s - self._ran_at_s:.1f} s; the robot was sent a stop"
            )
        self._ran_at_s = now_s
        refusal = self._robot.refusal
        if refusal is not None:
            raise Refused(refusal.kind, refusal.reason)
        if now_s >= self._commanded_at_s + COMMAND_INTERVAL_S:
            self._has_commanded, self._commanded_at_s = True, now_s
            await self._robot.command(stage.linear_m_s, stage.angular_rad_s)

    def _receive(self, messages: Mailbox[dict[str, Any]], stage: Stage) -> None:
        for message in messages.pop_all():
            self._is_measured = True
            self._arrivals_s.append(_now_s())
            self._samples.append(self._source.read(message, stage))


async def wheel_parameter(host: Host, robot: str, leaf: str) -> list[float]:
    """Numbers of a parameter of the robot, as the daemon's configuration has them; empty: none.

    Raises:
        HostlinkError: there is no connection.
    """
    answer = await host.call("/rosapi/get_param", {"name": f"/{robot}/{leaf}", "default": ""})
    return _numbers(str(answer["value"]))


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.strip("[] ").split(",")] if text.strip("[] ") else []
    except ValueError:
        return []


async def separation_of(host: Host, robot: str) -> float:
    """Wheel to wheel: the parameter unless the firmware refuses it, else the robot's setting, else the paper's.

    Raises:
        HostlinkError: there is no connection, or no such robot.
    """
    parameter = await wheel_parameter(host, robot, "wheel_separation")
    if parameter and LEAST_SEPARATION_M <= parameter[0] <= MOST_SEPARATION_M:
        return parameter[0]
    return (await host.robot(robot).state()).get("wheel_separation_m") or SEPARATION_M


async def require_robot(host: Host, name: str) -> Robot:
    """A robot that the daemon knows.

    Raises:
        UnknownTopic: it does not; the text names those that it does.
    """
    known = tuple(state["name"] for state in await host.robots())
    if name.strip("/") not in known:
        raise UnknownTopic("robot", name.strip("/"), known)
    return host.robot(name)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
