"""Host and Component: the interface of components, and nothing else of the core (docs/components.md).

A component offers the robots to something outside: a broker, a cloud, a display. It imports this module and
`hostlink.errors`. Methods are synchronous and belong to the event loop, unless they are declared with `async`.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import structlog

from hostlink.core.hub.device import CommandEndpoint
from hostlink.core.hub.hub import Hub, Listening
from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.core.hub.node import Role
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robot import AnyRobot
from hostlink.core.hub.robot_events import EventKind, RobotEvent
from hostlink.core.hub.subscription import Subscription
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import HostlinkError

__all__ = [
    "API_VERSION", "Component", "EventKind", "Host", "Listening", "Message", "Participant", "PlanarVelocity",
    "RobotEvent", "RobotState", "Role", "Standstill", "Stopped", "Subscription",
]  # fmt: skip

API_VERSION = (1, 0)  # the second number grows with what is added, the first with what is removed or changed

log = structlog.get_logger()
Settings = TypeVar("Settings")


class Stopped(NamedTuple):
    """Result of a stop: what the odometry of each robot said, by its name, and what could not be sent a zero."""

    robots: dict[str, Standstill]
    unreached: tuple[str, ...]  # "topic: reason" of boards and topics without a robot; of all also "robot: reason"


class Component(Generic[Settings]):
    """Base of a component. One instance is made for each start of `run`.

    `name` is that of its table in hostlink.toml, and `settings_type` a dataclass of the table's keys. `log_events`
    lists the events that it logs by `host.log`, without its name: {"connected": "the broker accepted the connection"}.
    """

    name: ClassVar[str]
    settings_type: ClassVar[type]
    log_events: ClassVar[Mapping[str, str]] = {}

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def check(self) -> Iterable[str]:
        """Return warnings about the settings, without I/O. `hostlink serve --check-config` prints them.

        Raises:
            ConfigError: the settings cannot be served, or a library is missing.
        """
        return ()

    def describe(self) -> str:
        """Return one line for `hostlink serve --check-config`: what would be served."""
        return self.name

    async def run(self, host: "Host") -> None:
        """Work until cancelled. An exception ends this run, stops what it drives, and starts another after a pause."""
        raise NotImplementedError


class Host:
    """Interface of one run of a component. All that the run takes by it ends with the run: its robots stop."""

    def __init__(
        self, hub: Hub, name: str, spawn: Callable[[Coroutine[Any, Any, object], str], None], counts: Counter[str]
    ) -> None:
        """`spawn` runs work as long as the component. `counts`: the component's counters, of all its runs."""
        self._hub, self._name, self._spawn, self._counts = hub, name, spawn, counts
        self._participants: list[Participant] = []
        self._watcher: Participant | None = None  # for what is read without a participant
        self.log = log.bind(component=name)

    # -- robots -------------------------------------------------------------------------------------------------------

    def robots(self) -> list[RobotState]:
        """Return all robots by name: connected, not yet forgotten, and those of other daemons of a fleet."""
        now_s = loop_time_s()
        return [robot.state(now_s) for robot in self._hub.robots.all()]

    def robot(self, name: str) -> RobotState:
        """Return the present state of a robot.

        Raises:
            UnknownTopic: there is no robot of this name.
        """
        return self._hub.robots.find(name).state(loop_time_s())

    def drive(
        self,
        participant: Participant,
        robot: str,
        velocity: PlanarVelocity,
        *,
        received_s: float | None = None,
        sent_s: float | None = None,
        epoch: int | None = None,
        take_over: bool = False,
    ) -> PlanarVelocity:
        """Drive a robot for the length of its lease, 0.5 s. Return the velocity after the robot's limits.

        A component repeats a velocity that is to last. A command that may have waited for longer than a lease, in a
        broker, a buffer or a queue, is refused if the component says what it knows of it: `received_s` is the earliest
        time, by `now_s`, at which this computer may have received it (None: now); `sent_s` is its sender's time, by the
        sender's own clock. `epoch`: the `RobotState.epoch` that its sender knew: a command from before a stop is
        refused. `take_over`: from another source of the same priority, which is refused from then on.

        Raises:
            UnknownTopic: there is no robot of this name.
            NoRole: the participant may not drive.
            CommandRefused: the robot is locked, another source drives it, or the command is too old.
            DeviceGone, FrameTooLarge, WrongType: the robot could not be sent the command.
        """
        found = self._hub.robots.find(robot, driver=lambda: participant)
        return participant.drive(
            found, velocity, received_s=received_s, sent_s=sent_s, epoch=epoch, take_over=take_over
        )

    async def stop(self, robot: str | None = None, *, by: str, wait_s: float = 1.5) -> Stopped:
        """Stop a robot; None: every robot and every board. Everybody may stop. The zero is sent before this waits.

        It waits until odometry says that they are stopped, `wait_s` at most. `by`: who stops, for texts.

        Raises:
            UnknownTopic: there is no robot of this name.
            DeviceGone: another daemon of the fleet did not answer, or its robot's device is not connected.
            FrameTooLarge, WrongType: the zero does not fit the device of the robot that is named.
        """
        since_s = loop_time_s()
        if robot is None:
            robots: list[AnyRobot] = self._hub.robots.all()
            with contextlib.suppress(HostlinkError):  # of a robot that is named in the result
                self._hub.robots.stop_all(by=by)
            endpoints = self._hub.robots.endpoints()
        else:
            robots = [self._hub.robots.find_to_stop(robot)]
            robots[0].stop(by=by)
            endpoints = robots[0].unguarded_endpoints
        endpoints = [*endpoints, *await self._hub.gates.settled()]
        measured = await self._hub.standstills.measure(robots, since_s, wait_s=wait_s)
        unreached = (*self._refusing(robots), *_unreached(endpoints))
        return Stopped({each.name: found for each, found in zip(robots, measured, strict=True)}, unreached)

    def _refusing(self, robots: Iterable[AnyRobot]) -> tuple[str, ...]:
        """Return "robot: reason" of each robot here whose device refused the last velocity."""
        here = [(each.name, self._hub.robots.refusal(each)) for each in robots]
        return tuple(f"{name}: {reason}" for name, reason in here if reason)

    async def lock(self, robot: str | None = None, *, reason: str, by: str) -> tuple[str, ...]:
        """Stop a robot at once and refuse commands until `unlock`; None: every robot and board, also later ones.

        Return what could not be sent a zero, as `Stopped.unreached`.

        Raises:
            UnknownTopic, DeviceGone, FrameTooLarge, WrongType: as for `stop`. What is reached is locked.
        """
        if robot is None:
            with contextlib.suppress(HostlinkError):  # of a robot that is named in the result
                self._hub.robots.lock_all(reason, by=by)
            endpoints, refusing = self._hub.robots.endpoints(), self._refusing(self._hub.robots.all())
        else:
            refusing = ()
            found = self._hub.robots.find_to_stop(robot)
            found.lock(reason, by=by)
            endpoints = found.unguarded_endpoints
        return (*refusing, *_unreached([*endpoints, *await self._hub.gates.settled()]))

    async def unlock(self, robot: str | None = None, *, by: str) -> None:
        """Admit commands again; None: of every robot and board. It moves nothing.

        Raises:
            UnknownTopic: there is no robot of this name.
            DeviceGone: another daemon of the fleet did not answer.
        """
        if robot is None:
            self._hub.robots.unlock_all(by=by)
        else:
            self._hub.robots.find(robot).unlock(by=by)
        await self._hub.gates.settled()

    def follow(self, robot: str, receive: Callable[[], None]) -> None:
        """Call `receive` after each new pose of a robot, until the run ends or the robot is forgotten.

        Raises:
            UnknownTopic: there is no robot of this name.
        """
        self._watching().follow(self._hub.robots.find(robot), receive)

    def observe(self, receive: Callable[[RobotEvent], None]) -> None:
        """Call `receive` with every event of robots and links, until the run ends."""
        self._watching().observe(receive)

    def watch_graph(self, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and soon after every change of robots, topics and services, until the run ends."""
        self._watching().watch_graph(on_change)

    # -- topics and services ------------------------------------------------------------------------------------------

    def join(
        self,
        name: str,
        *,
        role: Role = Role.DRIVE,
        priority: int = PROGRAM_PRIORITY,
        on_end: Callable[[], None] = lambda: None,
    ) -> Participant:
        """Join the graph as one source of messages and commands: one for each program that the component serves.

        It advertises, publishes, subscribes, and calls and provides services. Payloads are ROS 1's bytes;
        `Participant.message_type` decodes and encodes them. `priority` is that of its velocities, 0 to 100; a person
        at a stick has 60. `on_end` is called when a failure of one of its callbacks ends it. The participant leaves by
        `leave`, and with the run: the robots that it drives stop.
        """
        participant = Participant(self._hub, name, role=role, priority=priority, on_end=on_end)
        self._participants = [each for each in self._participants if not each.has_left]
        self._participants.append(participant)
        return participant

    def _watching(self) -> Participant:
        if self._watcher is None:
            self._watcher = self.join(self._name, role=Role.READ)
        return self._watcher

    # -- the component itself -----------------------------------------------------------------------------------------

    @property
    def listening(self) -> Listening:
        """The addresses on which devices connect."""
        return self._hub.listening

    @property
    def now_s(self) -> float:
        """The event loop's time, in seconds: that of `received_s` and of `RobotEvent.at_s`."""
        return loop_time_s()

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> None:
        """Run work at the same time as `run`. A failure of it is a failure of the component."""
        self._spawn(work, name)

    def count(self, what: str, number: int = 1) -> None:
        """Add to a counter of the component, which GET /metrics shows."""
        self._counts[what] += number

    def report(self, problem: str) -> None:
        """Say what is wrong with the component, as `hostlink doctor` shows it; empty: it works."""
        self._hub.diagnoses.observe_own(self._name, "component_troubled" if problem else "", problem)

    def close(self) -> None:
        """End everything that the run took. Called by the daemon."""
        for participant in self._participants:
            participant.leave()
        self._participants.clear()


def _unreached(endpoints: Iterable[CommandEndpoint]) -> tuple[str, ...]:
    return tuple(f"{each.topic}: {each.reason}" for each in endpoints if each.reason)
