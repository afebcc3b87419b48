"""Hub: all devices together. It owns the live links, and turns what they say into topics, services and robots."""

import asyncio
import contextlib
import itertools
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import structlog
from structlog.contextvars import bound_contextvars

from hostlink.config import Config, LinkConfig
from hostlink.errors import DeviceGone, HostlinkError, UnknownTopic, WrongType
from hostlink.hub.device import Device, check_type
from hostlink.hub.device_calls import DeviceCalls
from hostlink.hub.diagnoses import Diagnoses
from hostlink.hub.guard import Guard
from hostlink.hub.identities import Identities, Parts
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import Message
from hostlink.hub.parameters import find_parameter
from hostlink.hub.robot_topic_publisher import RobotTopicPublisher
from hostlink.hub.robots import ENDING, PROGRAM_PRIORITY, Robot, Robots
from hostlink.hub.services import Services
from hostlink.hub.topic_graph import Topic, TopicGraph, resolve
from hostlink.link.fair_share import FairShare, Turns
from hostlink.link.link import Link, LinkEnd
from hostlink.logs import log_what_is_missing, of_peer, printable
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType
from hostlink.protocol import events
from hostlink.protocol.control import LOG_LEVELS, Parameter
from hostlink.protocol.session import Session
from hostlink.robot.directory import VELOCITY_TYPE, Directory
from hostlink.robot.velocity import Velocity
from hostlink.transport.base import Transport

log = structlog.get_logger()

STOP_REPEATS = 3  # a single stop can be lost on a radio
STOP_INTERVAL_S = 0.05
SHUTDOWN_TIMEOUT_S = 0.5
MAX_UNKNOWN_PARAMETERS = 256  # names that are remembered; a name can be as long as a frame
LOG_INTERVAL_S = 10.0  # between two lines about lines that are missing
_NS_PER_S = 1_000_000_000
_DEVICE_LOG = ("debug", "info", "warning", "error", "error")  # the daemon's method for each of rosserial's levels


class Hub:
    """Everything that is connected. Its methods are synchronous, so each is atomic; only services wait.

    `reraises`: a crash of one link brings the hub down, as tests want it, instead of being logged and counted.
    """

    def __init__(self, config: Config, catalog: Catalog, *, reraises: bool = False, guard: Guard | None = None) -> None:
        self.catalog = catalog
        self.isolation = Isolation(reraises=reraises)
        self.topics = TopicGraph(catalog, self.isolation)
        self.services = Services(catalog)
        self._share = FairShare()
        self.device_calls = DeviceCalls(
            self.services,
            catalog,
            spawn=self.spawn,
            give_up=self._give_up,
            name_of=self._service_name,
            turns=self.turns(),
        )
        self.diagnoses = Diagnoses(self.isolation)
        self.robots = Robots(
            config.robots,
            catalog,
            self.isolation,
            subscribe=self.topics.subscribe,
            show=self._show,
            forget_after_s=config.link.forget_robot_after_s,
            on_forgotten=self._forget_robot,
        )
        self.robots.guard = guard
        self.robot_topics = RobotTopicPublisher(config.robots, self.topics, catalog)
        self.is_running = asyncio.Event()  # once set, it can `spawn`
        self.refused: Counter[str] = Counter()  # connections that were not served or gave way, by cause
        self.parameters = dict(config.parameters)  # what devices ask for; clients may change it
        self._rosout = self.topics.advertise("/rosout", "hostlink", type_name="rosgraph_msgs/Log")
        self.config = config
        self._identities = Identities(
            Parts(self.robots, self.robot_topics, self.services, self.diagnoses),
            Directory({name: robot.address for name, robot in config.robots.items()}),
            spawn=lambda work, name: self.spawn(work, name=name),
            deliver=self._deliver,
        )
        self._devices = self._identities.devices
        self._numbers = itertools.count(1)
        self._unknown_parameters: OrderedDict[str, None] = OrderedDict()  # that were told of, the latest last
        self._tasks: asyncio.TaskGroup | None = None
        self._reactions: dict[type[Any], Callable[[Link, Any], None]] = {
            events.MessageReceived: self._deliver,
            events.TimeRequested: _ignore,
            events.TopicsNegotiated: self._announce,
            events.TopicRefused: self._refuse_topic,
            events.TopicsAsked: _log_ask,
            events.ServiceRequested: self.device_calls.take,
            events.ServiceResponded: self._pass_answer,
            events.ParameterRequested: self._answer_parameter,
            events.DeviceLogged: self._log_for_device,
            events.UnknownTopicUsed: _ignore,
            events.Protocol1Recognised: _log_protocol_1,
        }

    # -- links --------------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Serve until cancelled; the parent of whatever is spawned."""
        async with asyncio.TaskGroup() as self._tasks:
            self.spawn(self.diagnoses.run(), name="diagnoses")
            self.spawn(_log_what_is_missing(), name="log")
            self.is_running.set()
            await self.robots.run()

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> None:
        """Run something as long as it takes, at most as long as the hub. Its crash ends nothing else."""
        if self._tasks is None:
            raise RuntimeError("the hub does not run yet")
        self._tasks.create_task(self._isolated(work, name), name=name)

    async def _isolated(self, work: Coroutine[Any, Any, object], name: str) -> None:
        with self.isolation.around("task", task=name):
            await work

    def turns(self) -> Turns:
        """The part of somebody new in what the loop does for all."""
        return Turns(self._share)

    def open(self, transport: Transport, link_config: LinkConfig | None = None) -> Link:
        """A link for one connection, to be served from now on."""
        config = self.config.link if link_config is None else link_config
        session = Session(
            check=lambda info: check_type(self.catalog, info),
            uart_bytes_s=self._uart_bytes_s(transport, config),
            max_topics=config.max_topics,
        )
        link = Link(transport, session, config, number=next(self._numbers), on_event=self._react, share=self._share)
        self._devices[link.number] = Device(link, self.topics, self.services, self.catalog, self.robots.ungated)
        self.diagnoses.begin(link)
        return link

    async def serve(self, link: Link) -> LinkEnd:
        """Serve an opened link to its end."""
        end = LinkEnd.CRASHED
        with bound_contextvars(link=link.number, peer=printable(link.peer), **of_peer(link.address)):
            log.info("link.opened")
            try:
                with self.isolation.around("link"):  # a bug in one link must not stop another robot
                    end = await link.run()
            except asyncio.CancelledError:
                end = LinkEnd.STOPPED
                raise
            finally:
                with self.isolation.around("link"):
                    self._forget(link)
                    self.diagnoses.finish(link, end)
                log.info("link.closed", reason=end.value, **link.facts())
        return end

    def links(self) -> list[Link]:
        """The live links, oldest first."""
        return [device.link for device in self._devices.values()]

    @property
    def unheard(self) -> int:
        """Messages that were lost because it was not known in time which device sent them."""
        return self._identities.unheard

    def shown_name(self, link: Link, name: str) -> str:
        """By which name the graph knows what a device calls so."""
        device = self._devices.get(link.number)
        return name if device is None else device.shown.of(name)

    async def shutdown(self) -> None:
        """Stop every robot, tell every device to fall silent, end every link; bounded by SHUTDOWN_TIMEOUT_S.

        From its first moment on nobody moves a robot any more: the last velocity that leaves is zero.
        """
        self.robots.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                connected = [robot for robot in self.robots.all() if robot.link is not None]
                for _ in range(STOP_REPEATS if connected or self.robots.ungated.is_active else 0):
                    self.robots.ungated.stop(now_s=asyncio.get_running_loop().time())
                    for robot in connected:
                        self.robots.halt(robot)
                    await asyncio.sleep(STOP_INTERVAL_S)
                for link in self.links():
                    link.session.stop()
                    link.wake()
                for link in self.links():
                    await link.drained()
        for link in self.links():
            link.end(LinkEnd.STOPPED)

    def _uart_bytes_s(self, transport: Transport, config: LinkConfig) -> int | None:
        here = (transport.peer, transport.address)
        mine = (robot.uart_bytes_s for robot in self.config.robots.values() if robot.address in here)
        return next((rate for rate in mine if rate is not None), config.uart_bytes_s)

    def _forget(self, link: Link) -> None:
        self._identities.forget(link)
        self.device_calls.leave(link)

    def _forget_robot(self, robot: Robot) -> None:
        self._identities.forget_robot(robot)

    # -- what devices say ---------------------------------------------------------------------------------------------

    def _react(self, link: Link, event: events.Event) -> None:
        if link.number in self._devices:  # one that was replaced has nothing to say any more
            self._identities.hear(link)
            if not isinstance(event, events.MessageReceived):
                self.diagnoses.note(link, event)
            self._reactions[type(event)](link, event)

    def _deliver(self, link: Link, event: events.MessageReceived) -> None:
        device = self._devices[link.number]
        if device.is_undecided:
            self._identities.keep(device, event)
            return
        device.look_at_stamp(event.topic.topic_id, event.payload)
        type_ = device.odometry.get(event.topic.topic_id)
        if type_ is not None:
            self._see_odometry(link, Message(event.topic.name, type_.name, type_, event.payload, time.time_ns()))
        topic = device.routes.get(event.topic.topic_id)
        if topic is None:
            return
        try:
            self._publish_to_topic(topic, event.payload, source=link)
        except HostlinkError as error:
            log.debug("message.refused", topic=topic.name, reason=str(error))

    def _see_odometry(self, link: Link, message: Message) -> None:
        """A pose belongs to the robot of the link by which it came, whatever its topic is called."""
        robot = self.robots.of_link(link)
        if robot is not None:
            robot.see(message)
            self.robot_topics.relay(robot, message)

    def _announce(self, link: Link, event: events.TopicsNegotiated) -> None:
        log.info("topics.negotiated", count=len(event.topics), gap_at=event.gap_at, is_changed=event.is_changed)
        if event.is_changed:
            link.last_frame = b""  # its id may be another's now
            self._identities.announce(link, event.topics)

    def _refuse_topic(self, link: Link, event: events.TopicRefused) -> None:  # noqa: ARG002 - the shape of a reaction
        log.warning("topic.refused", topic=printable(event.topic.name), reason=str(event.reason))

    def _answer_parameter(self, link: Link, event: events.ParameterRequested) -> None:
        """Always answer: a device spins until it hears something."""
        parameter = None
        try:
            parameter = self._find_parameter(link, event.name)
            link.session.answer_parameter(event.name, parameter or Parameter())
        except HostlinkError as error:
            log.warning("parameter.refused", name=printable(event.name), reason=str(error))
            with contextlib.suppress(HostlinkError):  # the queue is full of answers: the device hears one of those
                link.session.answer_parameter(event.name, Parameter())
        if parameter is None:
            self._note_unknown_parameter(event.name)

    def _note_unknown_parameter(self, name: str) -> None:
        """Log it once, as long as it is remembered."""
        if name not in self._unknown_parameters:
            log.warning("parameter.unknown", name=printable(name))
        self._unknown_parameters[name] = None
        self._unknown_parameters.move_to_end(name)
        if len(self._unknown_parameters) > MAX_UNKNOWN_PARAMETERS:
            self._unknown_parameters.popitem(last=False)

    def _find_parameter(self, link: Link, name: str) -> Parameter | None:
        """That of the robot's name here goes before that of the name that all of its kind tell."""
        shown = self.shown_name(link, name)
        mine = find_parameter(self.parameters, shown)
        is_renamed = shown != resolve(name)
        return find_parameter(self.parameters, name) if mine is None and is_renamed else mine

    def _log_for_device(self, link: Link, event: events.DeviceLogged) -> None:
        """Into the daemon's log, and as rosgraph_msgs/Log on /rosout."""
        level, text = event.level, printable(event.text)
        getattr(log, _DEVICE_LOG[level])("device.logged", level_name=LOG_LEVELS[level], text=text)
        if self._rosout.subscribers and self._rosout.type is not None:
            stamp_ns = time.time_ns()
            secs, nsecs = divmod(stamp_ns, _NS_PER_S)
            line = {"level": 1 << level, "name": link.peer, "msg": event.text}
            header = {"stamp": {"secs": secs, "nsecs": nsecs}}
            self._rosout.deliver(self._rosout.type.encode({"header": header, **line}), stamp_ns)

    def _pass_answer(self, link: Link, event: events.ServiceResponded) -> None:
        service = self._devices[link.number].services.get(event.service.name)
        if service is None or not service.answered(event.payload):
            log.warning("service.late", service=printable(event.service.name))

    async def _give_up(self, link: Link) -> None:
        """End the link of a device that waits for an answer which it cannot take; it stands, and waits no more."""
        robot = self.robots.of_link(link)
        if robot is not None:
            self.robots.halt(robot)
        link.session.stop()
        link.wake()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                await link.drained()
        link.end(LinkEnd.UNANSWERABLE)

    def _service_name(self, link: Link, name: str) -> str:
        """That of the robot's name here, if anybody offers it; else the name that all of its kind call."""
        shown = self.shown_name(link, name)
        return shown if self.services.is_offered(shown) else name

    # -- what clients say ---------------------------------------------------------------------------------------------

    def publish(
        self,
        topic: str,
        message: Mapping[str, object] | bytes,
        *,
        source: str,
        type_name: str = "",
        priority: int = PROGRAM_PRIORITY,
    ) -> None:
        """Send a message to everybody who takes the topic; a robot's velocity goes through its gate.

        Raises UnknownTopic when neither the topic nor its type is known, BadRequest for a message that does not fit,
        FrameTooLarge, RobotHeld, DeviceGone.
        """
        known = self.topics.find_or_none(topic)
        named = self.catalog.message(type_name) if type_name else None
        type_ = self.message_type(topic, type_name)
        if known is not None and known.type_name and named is not None and known.type_name != named.name:
            raise WrongType(known.name, known.type_name, named.name)
        if known is None and named is None:
            raise UnknownTopic("topic", topic, self.topics.names())
        if isinstance(message, bytes):
            payload = message
        elif type_ is not None:
            payload = type_.encode(message)
        else:
            raise WrongType(topic, "a type with a definition", type_name or "none")
        if known is not None:
            self._publish_to_topic(known, payload, source=source, priority=priority)

    def message_type(self, topic: str, type_name: str = "") -> MessageType | None:
        """What the messages of a topic are: as it is known, else the type of this name; None: nobody knows."""
        known = self.topics.find_or_none(topic)
        if known is not None and known.type_name:
            return known.type
        return self.catalog.message(type_name) if type_name else None

    def leave(self, source: str) -> None:
        """A client is gone: what it drove stops, what it offered is no more."""
        self.robots.leave(source)
        self.topics.leave(source)
        self.services.leave(source)

    def _publish_to_topic(
        self, topic: Topic, payload: bytes, *, source: str | Link, priority: int = PROGRAM_PRIORITY
    ) -> None:
        if self.robots.is_closed:
            raise DeviceGone(topic.name, ENDING)
        commands = self._commands(topic, payload)
        if commands is None:
            self.robots.expect_reset(topic.name)
            topic.publish(payload, time.time_ns(), source=source)
            return
        refusal: HostlinkError | None = None
        for robot, velocity in commands:
            if robot.link is source:  # as with every topic: nobody hears himself
                continue
            try:
                self.robots.command(robot, velocity, owner=str(source), priority=priority)
            except HostlinkError as error:
                refusal = error
        if refusal is not None:
            raise refusal

    def _commands(self, topic: Topic, payload: bytes) -> list[tuple[Robot, Velocity]] | None:
        """Which robots a message drives, and how; None: it is no command. A topic of another type drives nobody."""
        robots = self.robots.of_velocity_topic(topic.name) if topic.type_name == VELOCITY_TYPE else ()
        if robots:
            velocity = Velocity.from_twist(self.robots.twist.decode(payload))
            return [(robot, velocity) for robot in robots]
        command = self.robot_topics.command(topic, payload)
        return None if command is None else [command]

    def _show(self, robot: Robot, payload: bytes) -> None:
        """Let subscribers of a velocity topic, under any of its names, see what the gate sent."""
        for name in self.robot_topics.names_of_velocity(robot):
            topic = self.topics.find_or_none(name)
            if topic is not None and topic.type_name == VELOCITY_TYPE:
                topic.deliver(payload, time.time_ns())


async def _log_what_is_missing() -> None:
    while True:
        await asyncio.sleep(LOG_INTERVAL_S)
        log_what_is_missing()


def _ignore(link: Link, event: events.Event) -> None:
    """The session has done all that there is to do."""


def _log_ask(link: Link, event: events.TopicsAsked) -> None:  # noqa: ARG001 - the shape of a reaction
    log.debug("topics.asked", reason=event.reason)


def _log_protocol_1(link: Link, event: events.Protocol1Recognised) -> None:  # noqa: ARG001
    log.error(
        "protocol.version_1", advice="the device speaks rosserial of before 2013: rebuild it with a newer library"
    )
