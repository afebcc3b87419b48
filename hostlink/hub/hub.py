"""Hub: all devices and participants together. It owns the parts; links and participants come in and go out here."""

import asyncio
import contextlib
import dataclasses
import functools
import itertools
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import structlog
from structlog.contextvars import bound_contextvars

from hostlink.config import Config, LinkConfig
from hostlink.hub.device import Device, check_type
from hostlink.hub.device_calls import DeviceCalls
from hostlink.hub.device_events import DeviceEvents, Receivers
from hostlink.hub.diagnoses import Diagnoses
from hostlink.hub.diagnostics_topic import DiagnosticsTopic
from hostlink.hub.emergency_stop import EmergencyStop
from hostlink.hub.gates import Gates
from hostlink.hub.graph_changes import GraphChanges, Kind
from hostlink.hub.graph_view import GraphViews
from hostlink.hub.guard import Guard
from hostlink.hub.identities import Affected, Identities
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import PROGRAM_PRIORITY
from hostlink.hub.node import Node, Role
from hostlink.hub.parameters import ParameterAnswers, ParameterSource
from hostlink.hub.participant import Participant, Parts
from hostlink.hub.remote_robots import RemoteRobots
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import EventKind, RobotEvents
from hostlink.hub.robot_settings import limits_of
from hostlink.hub.robot_topic_publisher import RobotTopicPublisher
from hostlink.hub.robots import Robots
from hostlink.hub.rosout import Rosout
from hostlink.hub.services import Services
from hostlink.hub.topic_graph import TopicGraph
from hostlink.link.fair_share import FairShare, Turns
from hostlink.link.link import Authenticate, Link, LinkEnd, trust
from hostlink.logs import log_what_is_missing, of_peer, printable
from hostlink.messages.catalog import Catalog
from hostlink.protocol.control import Parameter
from hostlink.protocol.session import Session
from hostlink.robot.directory import Directory
from hostlink.transport.base import Transport

log = structlog.get_logger()

DAEMON = "hostlink"  # the name of the daemon's own parts in the graph
STOP_REPEATS = 3  # a single stop can be lost on a radio
STOP_INTERVAL_S = 0.05
SHUTDOWN_TIMEOUT_S = 0.5
END_S = 0.0005  # what it costs to take a device out of the graph
LOG_INTERVAL_S = 10.0  # between two lines about lines that are missing


class Hub:
    """Everything that is connected. Its methods are synchronous, so each is atomic; only services wait.

    `reraises`: a crash of one link brings the hub down, as tests want it, instead of being logged and counted.
    """

    def __init__(self, config: Config, catalog: Catalog, *, reraises: bool = False, guard: Guard | None = None) -> None:
        self.config, self.catalog = config, catalog
        self.is_running = asyncio.Event()  # once set, it can `spawn`
        self.graph_counts: dict[str, Callable[[], Mapping[str, int]]] = {}  # of each graph that it is a part of
        self.refused: Counter[str] = Counter()  # connections that were not served or were evicted, by cause
        self.datagrams_dropped: Counter[str] = Counter()  # of UDP, either way, by cause
        self.parameters = dict(config.parameters)  # what devices request; clients may change it
        self.parameter_source: ParameterSource | None = None  # of those that are not set here
        self.wall_ns: Callable[[], int] = time.time_ns  # the time that devices are given
        self.isolation = Isolation(reraises=reraises)
        self._numbers = itertools.count(1)
        changes = GraphChanges()
        self.topics = TopicGraph(catalog, changes)
        self.services = Services(catalog, changes)
        self.events = RobotEvents()
        self.gates = Gates(self.isolation, guard, self.events)
        self.diagnoses = Diagnoses(self.isolation, self.events)
        views = GraphViews(self.topics, self.services, changes)
        self._parts = Parts(catalog, self.topics, self.services, self.gates, self.isolation, changes, views)
        self._node = Node(DAEMON, is_daemon=True)
        self._share = FairShare()
        self._ends = self.turns()  # of links
        self.device_calls = DeviceCalls(
            self.services,
            catalog,
            spawn=self.spawn,
            give_up=self._give_up,
            name_of=self._service_name,
            turns=self.turns(),
        )
        self.robots = Robots(
            config.robots,
            self.gates,
            forget_after_s=config.link.forget_robot_after_s,
            on_forgotten=self._forget_robot,
            on_change=functools.partial(changes.note, Kind.ROBOT),
        )
        self.emergency_stop = EmergencyStop(self.robots, self.gates, self.join_daemon())
        self.remote_robots = RemoteRobots(self.robots, self.topics, self.gates, self.emergency_stop, self.new_number)
        robot_topics = RobotTopicPublisher(config.robots, self.topics, self.gates, self._node, catalog)
        self._identities = Identities(
            Affected(self.topics, self.gates, self.robots, robot_topics, self.emergency_stop, self.diagnoses),
            Directory(_addresses(config)),
            spawn=lambda work, name: self.spawn(work, name=name),
        )
        self._device_events = DeviceEvents(
            Receivers(
                self.gates,
                self._identities,
                self.diagnoses,
                self.device_calls,
                ParameterAnswers(self.parameters, lambda: self.parameter_source, self.spawn),
                Rosout(self.join_daemon()),
            )
        )
        self._tasks: asyncio.TaskGroup | None = None

    async def run(self) -> None:
        """Serve until cancelled; the parent of whatever is spawned."""
        async with asyncio.TaskGroup() as self._tasks:
            self.spawn(self.diagnoses.run(), name="diagnoses")
            self.spawn(self.robots.run(), name="known robots")
            self.spawn(self._diagnostics().run(), name="diagnostics")
            self.spawn(_log_what_is_missing(), name="log")
            self.is_running.set()
            await self.gates.run()

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> None:
        """Run something, at most as long as the hub. Its crash ends nothing else."""
        if self._tasks is None:
            raise RuntimeError("the hub does not run yet")
        self._tasks.create_task(self._isolated(work, name), name=name)

    async def _isolated(self, work: Coroutine[Any, Any, object], name: str) -> None:
        with self.isolation.around("task", task=name):
            await work

    def turns(self) -> Turns:
        """The part of one more link or participant in what the loop does for all."""
        return Turns(self._share)

    def reconfigure(self, config: Config) -> dict[str, str]:
        """Other names and limits of robots from now on; returns the new names of those that are connected, by the old.

        Raises:
            ConfigError: limits of a robot cannot be kept; nothing has changed.
            ReloadRefused: a robot that is driven or locked would have another name; nothing has changed.
        """
        for robot in config.robots.values():
            limits_of(robot)
        addresses = _addresses(config)
        self._identities.check_addresses(addresses)
        self.config = config
        self.robots.reconfigure(config.robots)
        return self._identities.reconfigure(addresses)

    # -- participants -------------------------------------------------------------------------------------------------

    def join(
        self,
        name: str,
        *,
        role: Role = Role.DRIVE,
        priority: int = PROGRAM_PRIORITY,
        group: str = "",
        on_end: Callable[[], None] = lambda: None,
    ) -> Participant:
        """A program takes part from now on, until it leaves; `on_end` is called when a failure of its own ends it.

        `group`: the foreign graph for which it stands, with others. What the group publishes does not come back to it.
        """
        return Participant(self._parts, name, role=role, priority=priority, group=group, on_end=on_end)

    def join_daemon(self, *, group: str = "") -> Participant:
        """A part of the daemon takes part; whatever of it fails, it stays. `group`: as of `join`."""
        return Participant(self._parts, DAEMON, is_daemon=True, group=group)

    # -- links --------------------------------------------------------------------------------------------------------

    def open(self, transport: Transport, link_config: LinkConfig | None = None) -> Link:
        """A link for one connection, to be served from now on."""
        config = self.config.link if link_config is None else link_config
        session = Session(
            check=lambda info: check_type(self.catalog, info),
            uart_bytes_s=self._uart_bytes_s(transport, config),
            max_topics=config.max_topics,
        )
        link = Link(
            transport,
            session,
            config,
            number=self.new_number(),
            on_event=self._device_events.react,
            share=self._share,
            wall_ns=self._read_wall_ns,
        )
        self._identities.devices[link.number] = Device(link, self._parts, self._node)
        self.diagnoses.begin(link)
        return link

    def new_number(self) -> int:
        """For one more connection of a device, here or to another daemon."""
        return next(self._numbers)

    async def serve(self, link: Link, authenticate: Authenticate = trust) -> LinkEnd:
        """Serve an opened link to its end; rosserial begins when `authenticate` returns."""
        end = LinkEnd.CRASHED
        with bound_contextvars(link=link.number, peer=printable(link.peer), **of_peer(link.address)):
            log.info("link.opened")
            self.events.note(EventKind.LINK_OPENED, "", link=link.number, peer=link.peer)
            try:
                with self.isolation.around("link"):  # a bug in one link must not stop another robot
                    end = await link.run(authenticate)
                    await self._ends.wait(END_S, is_flooding=True)  # a crowd that leaves at once leaves one by one
            except asyncio.CancelledError:
                end = LinkEnd.STOPPED
                raise
            finally:
                with self.isolation.around("link"):
                    self._identities.forget(link)
                    self.device_calls.leave(link)
                    self.diagnoses.finish(link, end)
                self.events.note(EventKind.LINK_CLOSED, "", link=link.number, peer=link.peer, reason=end.value)
                facts = dataclasses.asdict(link.facts())
                log.info("link.closed", reason=end.value, **facts.pop("counts"), **facts)
        return end

    def links(self) -> list[Link]:
        """The live links, oldest first."""
        return [device.link for device in self._identities.devices.values()]

    def answered_parameters(self, link: Link) -> Mapping[str, Parameter]:
        """What the device of a link was answered, by the shown names: it uses them until it connects again."""
        device = self._identities.devices.get(link.number)
        return {} if device is None else device.parameters

    def shown_name(self, link: Link, name: str) -> str:
        """By which name the graph knows what a device names so."""
        device = self._identities.devices.get(link.number)
        return name if device is None else device.shown.of(name)

    @property
    def undelivered(self) -> int:
        """Messages that were lost because it was not known in time which device sent them."""
        return self._identities.undelivered

    @property
    def late_answers(self) -> int:
        """Answers of devices' services that nobody waited for any more."""
        return self._device_events.late_answers

    def _read_wall_ns(self) -> int:
        return self.wall_ns()

    async def shutdown(self) -> None:
        """Stop every robot, request silence of every device, end every link; bounded by SHUTDOWN_TIMEOUT_S.

        From its first moment on nobody moves a robot any more: the last velocity that leaves is zero.
        """
        self.gates.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                for _ in range(STOP_REPEATS if self.gates.all() else 0):
                    self.gates.stop_at_once(self.gates.all())
                    await asyncio.sleep(STOP_INTERVAL_S)
                for link in self.links():
                    link.session.stop()
                    link.wake()
                for link in self.links():
                    await link.drained()
        for link in self.links():
            link.end(LinkEnd.STOPPED)

    def _diagnostics(self) -> DiagnosticsTopic:
        return DiagnosticsTopic(self.join_daemon(), self.diagnoses, self.robots, self.isolation, self.refused)

    def _uart_bytes_s(self, transport: Transport, config: LinkConfig) -> int | None:
        here = (transport.peer, transport.address)
        rates = (robot.uart_bytes_s for robot in self.config.robots.values() if robot.address in here)
        return next((rate for rate in rates if rate is not None), config.uart_bytes_s)

    def _forget_robot(self, robot: Robot) -> None:
        self._identities.forget_robot(robot)

    async def _give_up(self, link: Link) -> None:
        """End the link of a device that waits for an answer that does not fit it; it rests, and waits no more."""
        self.gates.stop_at_once(self.gates.of_link(link))
        link.session.stop()
        link.wake()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                await link.drained()
        link.end(LinkEnd.UNANSWERABLE)

    def _service_name(self, link: Link, name: str) -> str:
        """That of the robot's name here, if anybody provides it; else the name that all of its kind call."""
        shown = self.shown_name(link, name)
        return shown if self.services.is_offered(shown) else name


def _addresses(config: Config) -> dict[str, str | None]:
    return {name: robot.address for name, robot in config.robots.items()}


async def _log_what_is_missing() -> None:
    while True:
        await asyncio.sleep(LOG_INTERVAL_S)
        log_what_is_missing()
