"""Host and Component: the interface of components, and nothing else of the core (docs/components.md).

A component offers the robots to something outside: a broker, a cloud, a display. It imports this module and
`hostlink.errors`. Methods are synchronous and belong to the event loop, unless they are declared with `async`.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Mapping
from contextlib import AbstractContextManager
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import structlog

from hostlink.core.hub.byte_budget import Share
from hostlink.core.hub.device import CommandEndpoint
from hostlink.core.hub.graph_view import Graph, GraphService, GraphTopic
from hostlink.core.hub.hub import Hub, Listening
from hostlink.core.hub.isolation import Spawn
from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.core.hub.node import Role
from hostlink.core.hub.parameters import ParameterSource
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.queue import Queue
from hostlink.core.hub.robot import AnyRobot
from hostlink.core.hub.robot_events import EventKind, RobotEvent
from hostlink.core.hub.robot_topic_publisher import own_topics
from hostlink.core.hub.standstills import own_services
from hostlink.core.hub.subscription import Subscription
from hostlink.core.hub.topic import Receive
from hostlink.core.link.fair_share import Turns
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import HostlinkError

__all__ = [
    "API_VERSION", "Component", "EventKind", "Graph", "GraphService", "GraphTopic", "Host", "Listening", "Message",
    "Participant", "PlanarVelocity", "Queue", "Receive", "RobotEvent", "RobotState", "Role", "Spawn", "Standstill",
    "Stopped", "Subscription",
]  # fmt: skip

API_VERSION = (1, 0)  # the second number grows with what is added, the first with what is removed or changed

MANY = 16

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
        self._participants: list[Participant] = []  # with some that have left
        self._most = MANY  # of them, before those that have left are removed
        self._watcher: Participant | None = None  # for what is read without a participant
        self._source: ParameterSource | None = None
        self._has_clock = False
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
        group: str = "",
        on_end: Callable[[], None] = lambda: None,
    ) -> Participant:
        """Join the graph as one source of messages and commands: one for each program that the component serves.

        It advertises, publishes, subscribes, and calls and provides services. Payloads are ROS 1's bytes;
        `Participant.message_type` decodes and encodes them. `priority` is that of its velocities, 0 to 100; a person
        at a stick has 60. `group`: of a bridge to another graph: its participants do not receive what the group sends.
        `on_end` is called when a failure of one of its callbacks ends it. The participant leaves by
        `leave`, and with the run: the robots that it drives stop.
        """
        participant = Participant(self._hub, name, role=role, priority=priority, group=group, on_end=on_end)
        if len(self._participants) >= self._most:
            self._participants = [each for each in self._participants if not each.has_left]
            self._most = max(MANY, 2 * len(self._participants))
        self._participants.append(participant)
        return participant

    def _watching(self) -> Participant:
        if self._watcher is None:
            self._watcher = self.join(self._name, role=Role.READ)
        return self._watcher

    @property
    def messages(self) -> Catalog:
        """The known types of messages and services."""
        return self._hub.catalog

    def device_names(self) -> list[tuple[str, str]]:
        """Return each name of a topic or service that a device has announced, with its name in the graph."""
        links = self._hub.links
        away = (robot for robot in self._hub.robots.here() if robot.link is None)
        found = [(name, shown) for robot in away for shown, name in robot.velocities.items()]
        found += [(info.name, links.shown_name(link, info.name)) for link in links.all() for info in link.topics]
        return found

    def own_names(self) -> list[str]:
        """Return the names that hostlink itself gives for robots; of robots of other daemons all names below theirs."""
        robots = self._hub.robots
        found = [name for robot in robots.here() for name in (*own_topics(robot), *own_services(robot.name))]
        found += [name for robot in robots.remote for name in own_services(robot)]
        if robots.remote:
            found += [name[1:] for name in self._hub.topics.names() if name.split("/", 2)[1] in robots.remote]
        return found

    def warn(self, node: str, text: str) -> None:
        """Publish a warning on /rosout in the name of a node. The caller writes the daemon's own log."""
        self._hub.rosout.warn(node, text)

    def answer_parameters(self, source: ParameterSource | None) -> None:
        """Let a source answer devices' requests for parameters that the settings lack; None: no more."""
        self._hub.links.parameter_source = self._source = source

    def set_clock(self, wall_ns: Callable[[], int] | None) -> None:
        """Answer devices' requests for the time by this clock, in nanoseconds; None: by the computer's."""
        self._hub.links.wall_ns = self._hub.wall_ns if wall_ns is None else wall_ns
        self._has_clock = wall_ns is not None

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

    def count_by(self, read: Callable[[], Mapping[str, int]]) -> None:
        """Show further counters in GET /metrics: those that `read` returns."""
        own = self._counts
        self._hub.counts.components[self._name] = lambda: {**own, **read()}

    def share(self, kind: str) -> Share:
        """Return a part of the one budget of bytes that strangers make the daemon keep: "queues", "calls", others."""
        return self._hub.budget[kind]

    def turns(self) -> Turns:
        """Create the share of one connection in the event loop: what it reads waits for its turn."""
        return self._hub.turns()

    def around(self, what: str, **facts: object) -> AbstractContextManager[None]:
        """Catch an exception of a block: it is logged as `what`.crashed, counted, and ends nothing else."""
        return self._hub.isolation.around(what, **facts)

    def crashed(self, what: str, error: Exception, **facts: object) -> None:
        """Log and count an exception that was caught, as `around` does."""
        self._hub.isolation.crashed(what, error, **facts)

    def report(self, problem: str) -> None:
        """Say what is wrong with the component, as `hostlink doctor` shows it; empty: it works."""
        self._hub.diagnoses.observe_own(self._name, "component_troubled" if problem else "", problem)

    def close(self) -> None:
        """End everything that the run took. Called by the daemon."""
        for participant in self._participants:
            participant.leave()
        self._participants.clear()
        if self._source is not None and self._hub.links.parameter_source is self._source:
            self.answer_parameters(None)
        if self._has_clock:
            self.set_clock(None)


def _unreached(endpoints: Iterable[CommandEndpoint]) -> tuple[str, ...]:
    return tuple(f"{each.topic}: {each.reason}" for each in endpoints if each.reason)
