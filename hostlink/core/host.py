"""Host and Component: the interface of components, and nothing else of the core (docs/components.md).

A component offers the robots to something outside: a broker, a cloud, a display. It imports this module and
`hostlink.errors`. Methods are synchronous and belong to the event loop, unless they are declared with `async`.
"""

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, MutableMapping
from contextlib import AbstractContextManager
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, Unpack

import structlog

from hostlink.core.config import ParameterValue
from hostlink.core.hub.any_robot import LOCK_REASON, AnyRobot
from hostlink.core.hub.byte_budget import Share
from hostlink.core.hub.devices import Capture, Devices
from hostlink.core.hub.graph_view import OBSERVERS, Graph, GraphService, GraphTopic, is_imported
from hostlink.core.hub.hub import Hub, Listening
from hostlink.core.hub.isolation import Spawn
from hostlink.core.hub.measures import LinkMeasures, Measures, RobotMeasures
from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.core.hub.node import Role
from hostlink.core.hub.node_graph import KnownTopic, NodeGraph, VelocityTopic
from hostlink.core.hub.parameters import ParameterSource, to_parameter
from hostlink.core.hub.participant import MAX_ADVERTISED, MAX_CALLS, MAX_SUBSCRIPTIONS, Participant
from hostlink.core.hub.providers import ProvidedRobot, Provision, RobotProvider
from hostlink.core.hub.queue import Queue
from hostlink.core.hub.reloader import Prepare, Reloaded
from hostlink.core.hub.remote_robot import RemoteRobot
from hostlink.core.hub.remote_robots import RemoteRobots
from hostlink.core.hub.robot_handle import How, Measured, RecordedMotion, RobotHandle
from hostlink.core.hub.robot_topic_publisher import own_topics
from hostlink.core.hub.robots_here import RobotHere, RobotsHere
from hostlink.core.hub.shared import DAEMON, Offered
from hostlink.core.hub.standstills import MAX_WAIT_S, WAIT_S, own_services
from hostlink.core.hub.stops import Stops
from hostlink.core.hub.subscription import Subscription
from hostlink.core.hub.topic import Receive
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.link.fair_share import Turns
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.admission import Command
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import BadRequest, HostlinkError

__all__ = [
    "API_VERSION",
    "LOCK_REASON",
    "MAX_ADVERTISED",
    "MAX_CALLS",
    "MAX_SUBSCRIPTIONS",
    "MAX_WAIT_S",
    "OBSERVERS",
    "PROGRAM_PRIORITY",
    "WAIT_S",
    "Capture",
    "Command",
    "CommandEndpoint",
    "Component",
    "Connections",
    "Devices",
    "EventKind",
    "Graph",
    "GraphService",
    "GraphTopic",
    "Host",
    "How",
    "KnownTopic",
    "LinkMeasures",
    "Listening",
    "Measured",
    "Measures",
    "Message",
    "NodeGraph",
    "Participant",
    "PlanarVelocity",
    "ProvidedRobot",
    "Queue",
    "Receive",
    "RecordedMotion",
    "Reloaded",
    "RemoteRobot",
    "RemoteRobots",
    "RobotEvent",
    "RobotHandle",
    "RobotHere",
    "RobotMeasures",
    "RobotProvider",
    "RobotState",
    "RobotsHere",
    "Role",
    "Share",
    "Spawn",
    "Standstill",
    "Stopped",
    "Stops",
    "Subscription",
    "TopicSource",
    "Turns",
    "VelocityTopic",
    "resolve",
    "to_parameter",
]  # fmt: skip

API_VERSION = (1, 3)  # the second number grows with what is added, the first with what is removed or changed

log = structlog.get_logger()
Settings = TypeVar("Settings")
Kept = TypeVar("Kept")


class Stopped(NamedTuple):
    """Result of a stop: what the odometry of each robot said, by its name, and what could not be sent a zero."""

    robots: dict[str, Standstill]
    unreached: tuple[str, ...]  # "topic: reason" of boards and topics without a robot; of all also "robot: reason"


class TopicSource(NamedTuple):
    """Source of a topic's messages: a robot, a device, another graph."""

    robot: str  # of the device that publishes or takes it, or whose name the topic begins with; empty: of none
    is_device: bool  # a device publishes it
    is_elsewhere: bool  # only other graphs publish it and no device takes it, or it is of a robot of another daemon


class RunWork(Protocol):
    """Run work as long as a component. A failure ends the component, or this work alone, if it is not vital."""

    def __call__(self, work: Coroutine[Any, Any, object], part: str, *, is_vital: bool) -> None: ...


class Connections(NamedTuple):
    """Share of a table with `max_connections` in the descriptors of the process, if these are too few."""

    least: int = 1  # connections without which the component does not work
    descriptors: int = 1  # that each connection takes


class Component(Generic[Settings]):
    """Base of a component. One instance is made for each start of `run`.

    `name` is that of its table in hostlink.toml, and `settings_type` a dataclass of the table's keys. `log_events`
    lists the events that it logs by `host.log`, without its name: {"connected": "the broker accepted the connection"}.

    `begins_first`: it begins before the first device is accepted, and ends after the others. The daemon waits until it
    calls `host.ready`, or has failed; a `ConfigError` before its first `ready` ends the daemon. Of those that begin
    first, one begins after those that it `uses`, and ends before them. `tables` is for hostlink's own components that
    are older than tables by their name: these tables are theirs, and each field of `settings_type` is a table.

    `connections`: its tables with a field `max_connections`, by name, which is made smaller if the process may not have
    that many descriptors.
    """

    name: ClassVar[str]
    settings_type: ClassVar[type]
    log_events: ClassVar[Mapping[str, str]] = {}
    begins_first: ClassVar[bool] = False
    uses: ClassVar[tuple[str, ...]] = ()
    tables: ClassVar[tuple[str, ...]] = ()
    connections: ClassVar[Mapping[str, Connections]] = {}

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    @classmethod
    def is_wanted(cls, settings: Settings) -> bool:  # noqa: ARG003 - for subclasses
        """Whether a table with these settings makes it run, without a word in [components]."""
        return True

    def listens(self) -> Mapping[str, tuple[str, int]]:
        """Return host and TCP port of its listeners, by table. `hostlink serve --check-config` tries them."""
        return {}

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
    """Interface of one run of a component. All that the run takes by it ends with the run: its robots stop.

    `devices`, `graph`, `stops` and `measures` are for components that show all of the daemon, as the gateway does.
    """

    def __init__(
        self,
        hub: Hub,
        name: str,
        spawn: RunWork,
        counts: Counter[str],
        kept: dict[str, Any] | None = None,
        ready: asyncio.Event | None = None,
    ) -> None:
        """`spawn` runs work as long as the component. `counts`, `kept` and `ready` are of all its runs."""
        self._hub, self._name, self._spawn, self._counts = hub, name, spawn, counts
        self._offers: list[object] = []
        self._participants: dict[Participant, None] = {}  # those that have not left
        self._follower: Participant | None = None  # of poses
        self._source: ParameterSource | None = None
        self._has_clock = False
        self._prepares: list[Prepare] = []
        self.devices = Devices(hub)  # connected devices and their connections
        self.graph = NodeGraph(hub)  # topics, services and nodes
        self.stops = Stops(hub.robots, hub.gates, hub.standstills)  # of every robot and board
        self.measures = Measures(hub)  # counters
        self.came_s = hub.gates.came_s  # earliest time at which what is read at a time may have arrived
        self.hold_writes, self.write_held = hub.gates.hold, hub.gates.write  # velocities of one turn, written at once
        self._has_ended = False
        self._kept = {} if kept is None else kept
        self._remote: list[RemoteRobots] = []
        self._here: RobotsHere | None = None
        self._ready = ready
        self.log = log.bind(component=name)

    # -- robots -------------------------------------------------------------------------------------------------------

    def robots(self) -> list[RobotState]:
        """Return all robots by name: connected, not yet forgotten, and those of other daemons of a fleet."""
        now_s = loop_time_s()
        return [robot.state(now_s) for robot in self._hub.robots.all()]

    def robot(self, name: str, *, is_here: bool = False) -> RobotState:
        """Return the present state of a robot; with `is_here` only of one whose device belongs to this daemon.

        Raises:
            UnknownTopic: there is no robot of this name.
        """
        robots = self._hub.robots
        found = robots.find_here(name.strip("/")) if is_here else robots.find(name)
        return found.state(loop_time_s())

    def has_robot(self, name: str) -> bool:
        """Whether a robot of this name exists, here or at another daemon."""
        return self._hub.robots.has(name)

    def is_played(self, robot: str) -> bool:
        """Whether the device of a robot here is a recording that is played."""
        found = self._hub.robots.get_here(robot)
        return found is not None and found.is_played

    def states(self) -> Iterator[RobotState]:
        """Yield what `robots` returns. Each state is made when it is asked for, so that the work can be spread."""
        return (robot.state(loop_time_s()) for robot in self._hub.robots.all())

    def find(self, name: str, *, driver: Callable[[], Participant] | None = None) -> RobotHandle:
        """Return the robot of this name, connected or not. `driver` returns the source that wants to drive it.

        Raises:
            UnknownTopic: there is none. What the source repeats moves no robot that has this name later.
        """
        return self._handle(self._hub.robots.find(name, driver=driver))

    def find_to_stop(self, name: str) -> RobotHandle:
        """Return the robot of this name, for a stop or a lock; also one of the settings that was not connected yet.

        Raises:
            UnknownTopic: there is none, and the settings do not name it.
        """
        return self._handle(self._hub.robots.find_to_stop(name))

    def robots_here(self) -> list[RobotHandle]:
        """Return the robots of this daemon by name, connected or not yet forgotten."""
        return [self._handle(robot) for robot in self._hub.robots.here()]

    def _handle(self, robot: AnyRobot) -> RobotHandle:
        return RobotHandle(robot, self._hub.robots, self._hub.standstills)

    def drive(
        self,
        participant: Participant,
        robot: str,
        velocity: PlanarVelocity,
        **how: Unpack[How],
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
        return participant.drive(found, velocity, **how)

    async def stop(self, robot: str | None = None, *, by: str, wait_s: float = 1.5) -> Stopped:
        """Stop a robot; None: every robot and every board. Everybody may stop. The zero is sent before this waits.

        It waits until odometry says that they are stopped, `wait_s` at most. `by`: who stops, for texts.

        Raises:
            UnknownTopic: there is no robot of this name.
            DeviceGone: another daemon of the fleet did not answer, or its robot's device is not connected.
            FrameTooLarge, WrongType: the zero does not fit the device of the robot that is named.
        """
        since_s, target = loop_time_s(), self._to_stop(robot)
        try:
            target.stop(by=by)
        except HostlinkError:
            if robot is not None:
                raise  # of all: the result names the robot
        unreached = await self._unreached(target)
        measured = await target.measure(since_s, wait_s=wait_s)
        return Stopped({each.state.name: each.standstill for each in measured}, unreached)

    def _to_stop(self, robot: str | None) -> Stops | RobotHandle:
        return self.stops if robot is None else self.find_to_stop(robot)

    async def _unreached(self, target: Stops | RobotHandle) -> tuple[str, ...]:
        """Return what could not be sent a zero, as `Stopped.unreached`."""
        refusals = target.refusals() if isinstance(target, Stops) else []
        endpoints = [*target.endpoints(), *await self.stops.settled()]
        return (*refusals, *(f"{each.topic}: {each.reason}" for each in endpoints if each.reason))

    async def lock(self, robot: str | None = None, *, reason: str, by: str) -> tuple[str, ...]:
        """Stop a robot at once and refuse commands until `unlock`; None: every robot and board, also later ones.

        Return what could not be sent a zero, as `Stopped.unreached`.

        Raises:
            UnknownTopic, DeviceGone, FrameTooLarge, WrongType: as for `stop`. What is reached is locked.
        """
        target = self._to_stop(robot)
        try:
            target.lock(reason, by=by)
        except HostlinkError:
            if robot is not None:
                raise  # of all: the result names the robot
        return await self._unreached(target)

    async def unlock(self, robot: str | None = None, *, by: str) -> None:
        """Admit commands again; None: of every robot and board. It moves nothing.

        Raises:
            UnknownTopic: there is no robot of this name.
            DeviceGone: another daemon of the fleet did not answer.
        """
        (self.stops if robot is None else self.find(robot)).unlock(by=by)
        await self.stops.settled()

    def follow(self, robot: str, receive: Callable[[], None]) -> None:
        """Call `receive` after each new pose of a robot, until the run ends or the robot is forgotten.

        A second `receive` for the same robot replaces the first one.

        Raises:
            UnknownTopic: there is no robot of this name.
        """
        if self._follower is None:
            self._follower = self._reader("follow")
        self._follower.follow(self._hub.robots.find(robot), receive)

    def observe(self, receive: Callable[[RobotEvent], None]) -> None:
        """Call `receive` with every event of robots and links, until the run ends."""
        self._reader("observe").observe(receive)

    def watch_graph(self, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and soon after every change of robots, topics and services, until the run ends."""
        self._reader("watch_graph").watch_graph(on_change)

    def _reader(self, what: str) -> Participant:
        """Join for callbacks of the component itself. A failure of one is a failure of the component."""

        def fail() -> None:
            self._fail(HostlinkError(f"a callback of {what} has failed: participant.crashed has its error"), what)

        return self.join(self._name, role=Role.READ, on_end=fail)

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

        Raises:
            BadRequest: the run has ended.
        """
        return self._joined(Participant(self._hub, name, role=role, priority=priority, group=group, on_end=on_end))

    def join_as_daemon(self) -> Participant:
        """Join as a part of the daemon: its services precede all others, and no failure of a callback ends it."""
        return self._joined(self._hub.join_daemon())

    def join_as_observer(self, *, group: str = "") -> Participant:
        """Join as a part of the daemon that only reads: to any number of topics, and no failure of a callback ends it.

        `group` is as for `join`; a subscription of the group `OBSERVERS` alone makes no topic worth importing from
        another graph.
        """
        return self._joined(Participant(self._hub, DAEMON, role=Role.READ, is_daemon=True, group=group))

    def _joined(self, participant: Participant) -> Participant:
        if self._has_ended:
            raise BadRequest(f"{participant.name}: the run of {self._name} has ended")
        self._participants[participant] = None
        participant.on_left = self._participants.pop
        return participant

    @property
    def messages(self) -> Catalog:
        """The known types of messages and services."""
        return self._hub.catalog

    @property
    def parameters(self) -> MutableMapping[str, ParameterValue]:
        """Parameters for devices, by name as in the settings. What is changed holds until the daemon ends.

        A value is one that `to_parameter` accepts.
        """
        return self._hub.parameters

    def topic_source(self, topic: str) -> TopicSource:
        """Return where the messages of a topic come from."""
        robots, first = self._hub.robots, topic.lstrip("/").partition("/")[0]
        is_remote = first in robots.remote and robots.get_here(first) is None
        found = self._hub.topics.find_or_none(topic)
        if found is None:
            return TopicSource(first if robots.has(first) else "", is_device=False, is_elsewhere=is_remote)
        users = [robot for robot in map(robots.of_link, (*found.publishers, *found.devices)) if robot is not None]
        return TopicSource(
            users[0].name if len(users) == 1 else first if robots.has(first) else "",
            is_device=found.has_device_publisher,
            is_elsewhere=is_remote or (not found.devices and is_imported(found)),
        )

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

    # -- settings -----------------------------------------------------------------------------------------------------

    def on_reload(self, prepare: Prepare) -> None:
        """Let `prepare` check the settings of each reload, in a thread. It returns the function that applies them."""
        self._prepares.append(prepare)
        self._hub.reloader.prepares.append(prepare)

    async def reload(self) -> Reloaded:
        """Read the settings again, and apply what can change without a restart, or nothing.

        Raises:
            ReloadRefused: there is no file, it cannot be read in time, or a robot that is driven would be renamed.
            ConfigError: a setting is wrong.
        """
        return await self._hub.reloader.reload()

    # -- robots of other hosts, and other daemons that use those here ----------------------------------------

    def announce_robots(self, provider: RobotProvider) -> RemoteRobots:
        """Reach robots of other hosts by a provider, until the run ends. The result announces each of them.

        A stop, a lock and an unlock of all reach the provider at once, and those of a robot by its name. Users see the
        robots as those that are here. Commands for them pass the same rules, before the provider sends them. A failure
        of the provider is a failure of the component.
        """

        def fail(error: Exception) -> None:
            self._fail(error, "provider of robots")

        robots = RemoteRobots(
            self._hub.robots, self._hub.gates, self._hub.topics, Provision(provider, self._name, fail)
        )
        self._remote.append(robots)
        return robots

    @property
    def here(self) -> RobotsHere:
        """The robots and boards of this daemon alone, for requests of other daemons."""
        if self._here is None:
            self._here = RobotsHere(self._hub.robots)
        return self._here

    def is_remote(self, robot: str) -> bool:
        """Whether the robot of this name, as `robots` shows it, is of another host."""
        remote = self._hub.robots.remote.get(robot)
        return remote is not None and self._hub.robots.find(robot) is remote

    @property
    def slept_s(self) -> float:
        """For how long this computer has slept so far, in seconds. `now_s` does not count it."""
        return self._hub.slept_s()

    @property
    def forget_after_s(self) -> float:
        """For how long a disconnected robot is kept."""
        return self._hub.config.link.forget_robot_after_s

    # -- the component itself -----------------------------------------------------------------------------------------

    @property
    def listening(self) -> Listening:
        """The addresses on which devices connect."""
        return self._hub.listening

    @property
    def now_s(self) -> float:
        """The event loop's time, in seconds: that of `received_s` and of `RobotEvent.at_s`."""
        return loop_time_s()

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str, is_vital: bool = True) -> None:
        """Run work at the same time as `run`. A failure of it is a failure of the component, if it `is_vital`.

        Otherwise a failure is logged, counted, and ends nothing else: of one connection among many.
        """
        self._spawn(work, name, is_vital=is_vital)

    def ready(self) -> None:
        """Tell that the component works now, if it `begins_first`."""
        if self._ready is not None:
            self._ready.set()

    def request_end(self, reason: str) -> None:
        """Ask the daemon to end, which only one that was started for this component does: `hostlink ros1`."""
        self.log.info("component.end_requested", reason=reason)
        self._hub.on_end_request(reason)

    def offer(self, service: object) -> None:
        """Let other components find `service` by its type, until the run ends. A later one of its type replaces it."""
        self._offers.append(service)
        self._hub.offers[type(service)] = service

    def offered(self, kind: type[Offered]) -> Offered | None:
        """Return what another component offers of this type; None: none does at present.

        Ask for it at each use: a component that was started again offers another one.
        """
        return self._hub.offered(kind)

    def count(self, what: str, number: int = 1) -> None:
        """Add to a counter of the component, which GET /metrics shows."""
        self._counts[what] += number

    def count_by(self, read: Callable[[], Mapping[str, int]], *, part: str = "") -> None:
        """Show further counters in GET /metrics: those that `read` returns. `part`: under a name of their own."""
        own = self._counts
        self._hub.counts.components[part or self._name] = read if part else lambda: {**own, **read()}

    def kept(self, what: str, make: Callable[[], Kept]) -> Kept:
        """Return what an earlier run of the component has left by this name. `make` makes it for the first one."""
        if what not in self._kept:
            self._kept[what] = make()
        found: Kept = self._kept[what]
        return found

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

    def report(self, problem: str, *, code: str = "component_troubled") -> None:
        """Say what is wrong with the component, as `hostlink doctor` shows it; empty: it works. `code`: its finding."""
        self._hub.diagnoses.observe_own(self._name, code if problem else "", problem)

    def _fail(self, error: Exception, what: str) -> None:
        self._spawn(_raise(error), what, is_vital=True)

    def close(self, *, is_resumed: bool = False) -> None:
        """End everything that the run took. Called by the daemon, at a failure and again when all of it has ended.

        `is_resumed`: another run follows.
        """
        self._has_ended = True
        for participant in list(self._participants):
            participant.leave()
        for robots in self._remote:
            robots.close(is_resumed=is_resumed)
        self._remote.clear()
        if self._here is not None:
            self._here.close()
            self._here = None
        if self._source is not None and self._hub.links.parameter_source is self._source:
            self.answer_parameters(None)
        if self._has_clock:
            self.set_clock(None)
        for service in self._offers:
            if self._hub.offers.get(type(service)) is service:
                del self._hub.offers[type(service)]
        self._offers.clear()
        for prepare in self._prepares:
            self._hub.reloader.prepares.remove(prepare)
        self._prepares.clear()


async def _raise(error: Exception) -> None:
    raise error
