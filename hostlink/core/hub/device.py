"""Device: the topics and services of one link in the graph, their names there, and the routes of its frames."""

import contextlib
import dataclasses
import struct
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Protocol

import structlog

from hostlink.core.config import RobotConfig
from hostlink.core.hub.diagnoses import Diagnosis
from hostlink.core.hub.gates import Drivable, Echo, LostEndpoint
from hostlink.core.hub.message import Message
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.hub.robot_settings import commands_of, limits_of
from hostlink.core.hub.services import DeviceService
from hostlink.core.hub.shared import Shared
from hostlink.core.hub.topic import DeviceSubscription, Subscriber, Topic
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.messages.fields import Field
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import MessageReceived, Parameter
from hostlink.core.robot.admission import Admission
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.command_types import FixedZero, TopicType, zero_of
from hostlink.core.robot.model import (
    NO_SETTINGS,
    CommandSettings,
    Endpoint,
    RobotTopicNames,
    Suggestion,
    announced,
    is_velocity,
    motion_of,
    suggestion,
    unguarded,
)
from hostlink.core.robot.names import Presence
from hostlink.core.robot.parts import Membership
from hostlink.core.robot.readings import POSE_TYPES, READERS
from hostlink.core.robot.state import BATTERY_TYPE
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, ZERO, Twist
from hostlink.core.robot.velocity_gate import Unlimited, VelocityGate
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, BadRequest, CommandRefused, HostlinkError, RefusalKind, WrongType

log = structlog.get_logger()

MAX_PARAMETERS = 64  # answers that are kept; a name can be as long as a frame
COMMAND_DEPTH = 16  # messages of one topic that may wait for a slow device; a velocity has one slot of its own


class ShownNames:
    """Names of one device's topics in the graph. They are in the robot's namespace if the robot has another name here.

    `/robot_0/imu` of a robot that is named `a` is `/a/imu`, and so is `imu` of one that has no namespace. Velocity,
    odometry and reset are always the robot's: `/odom` is `/a/odom`. Every other topic keeps its announced name, and is
    shared with other users of the name, as in ROS.
    """

    __slots__ = ("_is_renamed", "_name", "_own", "_prefix")

    def __init__(self, robot: RobotTopicNames | None = None, name: str | None = None) -> None:
        """`name`: the robot's name here."""
        self._is_renamed = robot is not None and name not in (None, robot.name)
        self._name = name or ""
        namespace = () if robot is None else robot.namespace
        self._prefix = "/" + "".join(f"{part}/" for part in namespace)
        own: tuple[str | None, ...] = ()
        if robot is not None and self._is_renamed:
            own = (*(topic.name for topic in robot.commands), robot.odometry, robot.reset)
        self._own = tuple(resolve(topic) for topic in own if topic is not None)

    def of(self, name: str) -> str:
        """Return the full name in the graph of the device's topic or service."""
        full = resolve(name)
        if not self._is_renamed:
            return full
        if self._prefix != "/" and full.startswith(self._prefix):
            return f"/{self._name}/{full.removeprefix(self._prefix)}"
        is_relative = self._prefix == "/" and not name.startswith("/")
        return f"/{self._name}{full}" if is_relative or full in self._own else full

    def of_robot(self, robot: RobotTopicNames) -> RobotTopicNames:
        """Return the robot's topics by their names in the graph."""
        commands = tuple(TopicType(self.of(topic.name), topic.type_name) for topic in robot.commands)
        odometry = None if robot.odometry is None else self.of(robot.odometry)
        reset = None if robot.reset is None else self.of(robot.reset)
        shown = dataclasses.replace(
            robot, name=self._name or robot.name, commands=commands, odometry=odometry, reset=reset
        )
        return robot if shown == robot else shown  # most have the same names: kept once


_SIX_NUMBERS = (TWIST_TYPE, TWIST_STAMPED_TYPE)
_HEADER = Field("header", "std_msgs/Header")
_STAMP = struct.Struct("<4xII")  # seq, secs, nsecs
EARLY_MESSAGES, EARLY_BYTES = 128, 65536  # three seconds of the project's robot


def endpoints_of(infos: Iterable[DeviceEndpoint]) -> list[Endpoint]:
    """Return the topics of an announcement as the model of robots knows them."""
    kinds = (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER)
    return [Endpoint(info.name, info.type, info.is_to_device) for info in infos if info.kind in kinds]


class Registry(Protocol):
    """Registry of devices and robots, as a device knows it."""

    def lock_of(self, device: "Device") -> Admission:
        """Return the admission whose lock holds for a device without a robot: of one that it may be, or of all."""

    @property
    def devices(self) -> Mapping[int, "Device"]:
        """Devices of all live links, by the number of the link."""

    def get_here(self, name: str) -> LocalRobot | None:
        """Return the robot of this daemon with this name; None if it does not exist."""

    def config_of(self, name: str) -> RobotConfig:
        """Return the settings of a configured robot, connected or not."""


class Device:
    """Device of one link: its endpoints in the graph, its robot, its velocity gates and its diagnosis.

    `Robots` has the devices of all live links.
    """

    __slots__ = (
        "_awaited", "_lockable", "_observers", "_odometry", "_reader", "_registry", "_shared", "_suggest", "_zeros",
        "diagnosis", "drivables", "early", "infos", "is_undecided", "link", "lost", "member", "missing", "names",
        "parameters", "presence", "refused_settings", "robot", "routes", "services", "settings", "shown", "stop_frames",
        "suggested", "unfit", "unguarded",
    )  # fmt: skip

    def __init__(
        self,
        link: Link,
        diagnosis: Diagnosis,
        presence: Presence,
        shared: Shared,
        registry: Registry,
        suggest: Callable[["Device"], Suggestion | None],
    ) -> None:
        """`suggest` returns the settings that make a device a robot; None if it is one, or no settings do."""
        self.link = link
        self.presence = presence
        self.diagnosis = diagnosis
        self.robot: LocalRobot | None = None  # set by Robots
        self.drivables: list[Drivable] = []  # set by Gates
        self.stop_frames: list[bytes] = []  # frames that the guardian sends to stop it; set by Gates
        self.lost: dict[str, LostEndpoint] = {}  # velocity endpoints that an announcement gave up; set by Gates
        self.settings: CommandSettings = NO_SETTINGS  # of its robot's command
        self.member: Membership | None = None  # of a robot of several devices
        self.missing = ""  # why the robot of several devices of which it is one cannot be driven; empty: it can be
        self.refused_settings = ""  # why they do not fit the device
        self.unfit = ""  # why they do not fit the devices of its robot together
        self.unguarded: tuple[DeviceEndpoint, ...] = ()  # look like commands of a motion, and have no gate
        self.suggested: Suggestion | None = None  # settings that make a robot of it; None: none do, or it is one
        self._lockable: frozenset[str] = frozenset()  # own names of topics without a gate that a lock refuses
        self._zeros: dict[str, bytes] = {}  # of the unguarded ones that can be sent one, by own name
        self.routes: dict[int, Topic] = {}  # topic of each id in frames from the device
        self.shown = ShownNames()
        self.names: frozenset[str] = frozenset()  # names of its topics in the graph
        self.services: dict[str, DeviceService] = {}  # services of the device, by announced name
        self.early = EarlyMessages()
        self.is_undecided = False  # its identity is not known yet
        self.infos: tuple[DeviceEndpoint, ...] = ()  # endpoints of the last announcement
        self.parameters: dict[str, Parameter] = {}  # answers to its requests, by name in the graph
        self._observers: dict[int, Callable[[bytes], None]] = {}  # readers of the hub itself, by id
        self._awaited: dict[str, None] = {}  # services that may still answer a call from before the last `leave`
        self._odometry: list[tuple[Topic, int]] = []  # where the robot reads its pose, and as which subscriber
        self._reader: LocalRobot | None = None  # robot of several devices that reads this one
        self._shared, self._registry, self._suggest = shared, registry, suggest

    def announce(self, infos: tuple[DeviceEndpoint, ...], shown: ShownNames, robot: LocalRobot | None = None) -> None:
        """Replace the device's endpoints in the graph."""
        self.leave()
        self.shown = shown
        if robot is not None:
            robot.has_had_device |= not self.diagnosis.is_played
            robot.velocities = {shown.of(info.name): info.name for info in infos if self._is_velocity(info)}
            pairs = zip(robot.shown.commands, robot.topics.commands, strict=True)
            robot.velocities |= {ours.name: its.name for ours, its in pairs}
        self.names = frozenset(
            shown.of(info.name) for info in infos if info.kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER)
        )
        own = {} if robot is None else robot.shown.own
        for info in sorted(infos, key=lambda info: own.get(shown.of(info.name)) != info.type):  # its own types first
            try:
                self._add(info, robot)
            except (WrongType, BadRequest) as error:
                log.warning("topic.refused", topic=printable(info.name), reason=str(error))
                self._route_refused(info, robot)
        for name in self.services.keys() & self._awaited.keys():
            self.services[name].expect_late()
        self._awaited.clear()
        self._stand_lost()
        self._note_unguarded()

    def displace(self, name: str, type_name: str, robot: LocalRobot | None) -> None:
        """Remove the device from a topic, because the topic is another robot's own, with this type."""
        topic = self._shared.topics.find(name)
        log.warning("topic.refused", topic=printable(name), reason=str(WrongType(name, type_name, topic.type_name)))
        self.routes = {topic_id: each for topic_id, each in self.routes.items() if each is not topic}
        for drivable in self.drivables:
            drivable.echoes.pop(name, None)
        self._shared.topics.unadvertise(name, self.link)
        self._shared.topics.unsubscribe_device(name, self.link)
        reader = robot or self._reader
        if reader is not None and name in {self.shown.of(own) for own, _ in reader.feedback.topics}:
            self._end_odometry()
            for info in self.infos:
                self._route_refused(info, reader)

    def receive(self, message: MessageReceived, read: tuple[float, float] | None = None) -> None:
        """Publish a message of the device. `read` is when it was read and may have arrived; None: with the last read.

        A velocity is as old as it may be. A played recording drives no robot.
        """
        topic_id, link = message.topic.id, self.link
        read_s, came_s = (link.received_at_s, link.came_s) if read is None else read
        observe = self._observers.get(topic_id)
        if observe is not None:
            observe(message.payload)
        topic = self.routes.get(topic_id)
        if topic is not None and not (topic.is_gated and self.diagnosis.is_played):
            try:
                topic.publish(message.payload, source=link, at_s=came_s if topic.is_gated else read_s)
            except HostlinkError as error:
                log.debug("message.refused", topic=topic.name, reason=str(error))

    @property
    def sent_topics(self) -> list[TopicType]:
        """Topics that the device sends, by its own names."""
        return [TopicType(info.name, info.type) for info in self.infos if info.kind is EndpointKind.PUBLISHER]

    @property
    def read_topics(self) -> list[tuple[str, str]]:
        """Topics by which its robot's motion is known and that come from this device, by own name and type."""
        robot = self._robot
        if robot is None:
            return []
        return [
            (info.name, info.type)
            for info in self.infos
            if info.kind is EndpointKind.PUBLISHER and self._reads(info, robot)
        ]

    def read_for(self, robot: LocalRobot | None) -> None:
        """Read the topics of a robot's feedback that come from this device, one of several of the robot's."""
        self._end_odometry()
        self._reader = robot
        if robot is None:
            return
        for info in self.infos:
            if info.kind is EndpointKind.PUBLISHER and self._reads(info, robot):
                topic = self.routes.get(info.id)
                if topic is None:
                    self._route_refused(info, robot)
                else:
                    self._subscribe_robot(info.name, topic, robot)

    def announced_again(self) -> None:
        """Send latched messages again: a board that announces the same topics may have restarted."""
        self._shared.gates.give_up_lost(self)
        self._shared.topics.send_latched(self.link)

    def stand(self) -> None:
        """Send zero to every velocity topic: a reconnected robot may still obey an old command."""
        for info in filter(self._is_velocity, self.infos):
            self._shared.gates.attach(self._drivable(info, None), self)
        self._stand_lost()
        self._note_unguarded()

    def _stand_lost(self) -> None:
        """Send zero to velocity endpoints that the announcement lacks: it may be damaged, and the robot moves on.

        They can be stopped, and are guarded, until the next announcement.
        """
        lost, self.lost = self.lost, {}
        known = {info.id for each in self.drivables for info in each.endpoints if info is not None}
        for info, zero in lost.values():
            if info.id not in known and self.link.session.may_have(info):
                drivable = self._drivable(info, None)
                drivable.commands = FixedZero(TopicType(info.name, info.type), zero)
                self._shared.gates.attach(drivable, self, lost=info)

    # -- endpoints without a gate -------------------------------------------------------------------------------------

    @property
    def refused(self) -> str:
        """Return why its settings do not fit; empty if they do."""
        return self.refused_settings or self.unfit

    @property
    def endpoints(self) -> list[Endpoint]:
        """Topics of the last announcement, as the model of robots knows them."""
        return endpoints_of(self.infos)

    @property
    def stop_service(self) -> str | None:
        """Service that stops it by the settings, as it announces it; None: they name none."""
        wanted, kind = self.settings.stop_service, EndpointKind.SERVICE_SERVER_SUBSCRIBER
        if wanted is None:
            return None
        return announced(wanted, [info.name for info in self.infos if info.kind is kind])

    @property
    def guarded(self) -> frozenset[str]:
        """Own names of the topics that have a gate."""
        return frozenset(topic.name for drivable in self.drivables for topic in drivable.commands.topics)

    @property
    def lock(self) -> Admission:
        """Admission whose lock holds for its topics without a gate: the robot's, or that of a device without one."""
        robot = self._robot
        return self._registry.lock_of(self) if robot is None else robot.admission

    @property
    def _robot(self) -> LocalRobot | None:
        """The robot that it is, or of which it is a part."""
        if self.robot is not None or self.member is None:
            return self.robot
        return self._registry.get_here(self.member.robot)

    @property
    def suggestion(self) -> str:
        """Lines of hostlink.toml that put its endpoints without a gate in order; empty if there are none.

        Those of the boards of one robot are the same. With those of all other devices they are one file.
        """
        if self.suggested is not None:
            return self.suggested.lines
        known = self.robot_name
        if known is None or not self.unguarded:
            return ""
        boards = (each for each in self._registry.devices.values() if each is self or each.robot_name == known)
        names = dict.fromkeys(each for board in boards for each in board.unguarded_topics)
        return suggestion(list(names), known, self.link.address, is_robot=True)

    @property
    def unguarded_topics(self) -> list[Endpoint]:
        """Endpoints without a gate, as the model of robots knows them."""
        return endpoints_of(self.unguarded)

    @property
    def robot_name(self) -> str | None:
        """Name of the robot that it is, or of which it is a part, which may never have been commanded."""
        if self.robot is not None:
            return self.robot.name
        return None if self.member is None else self.member.robot

    def _note_unguarded(self) -> None:
        """Find the endpoints that look like commands and have no gate. Under a lock they are sent their zeros."""
        found = unguarded(self.endpoints, self.settings, self.guarded)
        names = {each.name for each in found} if not self.diagnosis.is_played else set[str]()
        self.unguarded = tuple(
            info for info in self.infos if info.kind is EndpointKind.SUBSCRIBER and info.name in names
        )
        zeros = ((info, self._zero_of(info)) for info in self.unguarded)
        self._zeros = {info.name: zero for info, zero in zeros if zero is not None and not self._why_no_zero(info)}
        self.suggested = self._suggest(self)
        self._lockable = self.settings.locked | names
        if self.lock.lock_reason is not None:
            self.stop_unguarded()

    def note_missing(self, missing: str) -> None:
        """Note why its robot of several devices cannot be driven: endpoints without a gate get a zero, and keep it."""
        before, self.missing = self.missing, missing
        if missing and missing != before:
            self.stop_unguarded()

    def stop_unguarded(self) -> None:
        """Send zero to each endpoint that looks like a command and has no gate. Older messages to it are dropped."""
        if self.lock.lock_reason is not None:
            for info in self.infos:
                if info.kind is EndpointKind.SUBSCRIBER and info.name in self._lockable:
                    self.link.session.drop_commands(info)
        for info in self.unguarded:
            zero = self._zeros.get(info.name)
            if zero is None:
                self.link.session.drop_commands(info)
            else:
                with contextlib.suppress(HostlinkError):  # its board has begun anew; others must get theirs
                    self.link.session.publish(info.name, zero, is_urgent=True)
        if self.unguarded:
            self.link.wake()

    def unguarded_endpoints(self) -> list[CommandEndpoint]:
        """Return its endpoints that look like commands and have no gate, after `stop_unguarded`."""
        return [
            self._endpoint(self.shown.of(info.name), info.type, self.lock, self._why_no_zero(info))
            for info in self.unguarded
        ]

    def _zero_of(self, info: DeviceEndpoint) -> bytes | None:
        """Return what stops an endpoint without a gate; settings that do not fit tell its number at rest, too."""
        rests = dict(zip(self.settings.topics, self.settings.rests, strict=False))
        return zero_of(info.type, rests.get(info.name, 0.0))

    def _why_no_zero(self, info: DeviceEndpoint) -> str:
        """Return the reason why an endpoint is not sent a zero; empty if it is."""
        zero = self._zero_of(info)
        if zero is None:
            return f"{info.type} has no value that surely means stop"
        try:
            self.link.session.endpoint_of(info.name, zero)
        except HostlinkError as error:
            return str(error)
        return ""

    def of_no_robot(self) -> list[CommandEndpoint]:
        """Return its velocity topics that have a gate and belong to no robot, after a stop."""
        if self.robot is not None:
            return []
        return [
            self._endpoint(each.name, topic.type_name, each.admission, each.refusals.cause or "", is_guarded=True)
            for each in self.drivables
            for topic in each.commands.topics
        ]

    def _endpoint(
        self, topic: str, type_name: str, admission: Admission, reason: str, *, is_guarded: bool = False
    ) -> CommandEndpoint:
        robot, is_locked = self._robot, admission.lock_reason is not None
        name = None if robot is None else robot.name
        return CommandEndpoint(self.link.number, self.link.peer, name, topic, type_name, is_guarded, is_locked, reason)

    def note_parameter(self, name: str, parameter: Parameter) -> None:
        """Note the answer to a parameter request. Of more than MAX_PARAMETERS names, the first are kept."""
        if name in self.parameters or len(self.parameters) < MAX_PARAMETERS:
            self.parameters[name] = parameter

    def leave(self) -> None:
        """Remove everything of this device from the graph."""
        self._end_odometry()
        self._reader = None
        self.missing = self.unfit = ""
        self.routes.clear()
        self._observers.clear()
        self.names = frozenset()
        self._shared.topics.leave(self.link)
        self._awaited |= {name: None for name, service in self.services.items() if service.is_awaited}
        self._shared.services.leave(self.link)
        self.services.clear()

    def _add(self, info: DeviceEndpoint, robot: LocalRobot | None) -> None:
        name = self.shown.of(info.name)
        if info.kind is EndpointKind.PUBLISHER:
            raw_encoding = self.link.session.raw_encoding
            topic = self._shared.topics.advertise(name, self.link, type_name=info.type, raw_encoding=raw_encoding)
            self._route(info, topic, robot)
        elif info.kind is EndpointKind.SUBSCRIBER:
            self._subscribe(info, name, robot)
        elif info.kind is EndpointKind.SERVICE_SERVER_SUBSCRIBER:
            type_ = self._shared.catalog.service(info.type)
            service = DeviceService(name, info.type, type_, self.link, lambda payload: self._call(info.name, payload))
            service.encoding = (self.link.session.protocol, *self._md5_sums(info.name))
            self._shared.services.add_device_service(service)
            self.services[info.name] = service

    # -- from the device ----------------------------------------------------------------------------------------------

    def _route(self, info: DeviceEndpoint, topic: Topic, robot: LocalRobot | None) -> None:
        """Route an id to its topic. A robot reads its odometry by link and id, independent of other publishers."""
        self.routes[info.id] = topic
        if robot is not None and info == self._battery_info():
            self._observers[info.id] = partial(self._observe_battery, robot)
        elif topic.type is not None and topic.type.fields[:1] == (_HEADER,):
            self._observers[info.id] = self._observe_stamp
        if robot is not None and self._reads(info, robot):
            self._subscribe_robot(info.name, topic, robot)

    def _route_refused(self, info: DeviceEndpoint, robot: LocalRobot | None) -> None:
        """Route a robot's odometry even if the graph has another type by this name."""
        if robot is not None and info.kind is EndpointKind.PUBLISHER and self._reads(info, robot):
            topic = Topic(self.shown.of(info.name), wall_ns=self._shared.wall_ns)
            topic.type, topic.type_name = self._shared.catalog.message(info.type), info.type
            self._route(info, topic, robot)

    def _reads(self, info: DeviceEndpoint, robot: LocalRobot) -> bool:
        """Whether a robot reads this topic from this device."""
        key = info.name, info.type
        is_here = robot.feedback_links is None or robot.feedback_links.get(key) is self.link
        return is_here and key in robot.feedback.topics

    def _subscribe_robot(self, own_name: str, topic: Topic, robot: LocalRobot) -> None:
        receive, fail = partial(robot.receive_feedback, own_name), partial(self._crash, robot)
        number = topic.add_subscriber(Subscriber(receive, self._shared.node, "", fail))
        self._odometry.append((topic, number))

    def _crash(self, robot: LocalRobot, error: Exception) -> None:
        """End the link after a crash of odometry. The robot then reconnects, at rest."""
        self.link.end(LinkEnd.CRASHED)
        self._shared.isolation.crashed("robot", error, robot=robot.name)

    def _battery_info(self) -> DeviceEndpoint | None:
        """Return the first topic of the battery's type; None if there is none."""
        kind = (EndpointKind.PUBLISHER, BATTERY_TYPE)
        return next((info for info in self.infos if (info.kind, info.type) == kind), None)

    def _observe_battery(self, robot: LocalRobot, payload: bytes) -> None:
        self._observe_stamp(payload)
        robot.receive_battery(payload)

    def _observe_stamp(self, payload: bytes) -> None:
        """Use a header's stamp as a sample of the device's clock."""
        if len(payload) >= _STAMP.size:
            secs, nsecs = _STAMP.unpack_from(payload)
            stamp_ns, now_s = secs * NS_PER_S + nsecs, self.link.received_at_s
            self.link.session.device_clock.update(stamp_ns, at_ns=self._shared.wall_ns(), now_s=now_s)

    def _end_odometry(self) -> None:
        for topic, number in self._odometry:
            topic.remove_subscriber(number)
        self._odometry.clear()

    # -- to the device ------------------------------------------------------------------------------------------------

    def _subscribe(self, info: DeviceEndpoint, name: str, robot: LocalRobot | None) -> None:
        drivable: Drivable | None = None
        output: int | None = 0
        if robot is not None and (info.name, info.type) in robot.topics.commands:
            drivable, output = robot, robot.topics.commands.index((info.name, info.type))
        elif self._is_velocity(info):
            drivable = self._drivable(info, robot)
            self._shared.gates.attach(drivable, self)
        if drivable is None:
            is_reset = robot is not None and info.name == robot.topics.reset
            send = partial(self._send, info.name, robot if is_reset else None)
            if info.type in POSE_TYPES:
                send = partial(self._send_pose, info)
            subscription = DeviceSubscription(send, is_gate=False, is_command=is_reset or self._may_move(info, robot))
        else:
            subscription = DeviceSubscription(drivable.receive, is_gate=True, target=drivable)
        topic = self._shared.topics.subscribe_device(
            name, self.link, subscription, type_name=info.type, raw_encoding=self.link.session.raw_encoding
        )
        if drivable is not None:
            drivable.echoes[topic.name] = Echo(topic, output)
            if robot is None:  # a robot's gate has joined before
                drivable.join(topic)

    def _may_move(self, info: DeviceEndpoint, robot: LocalRobot | None) -> bool:
        """Whether a topic without a gate looks like a command, or is one that a lock refuses by the settings."""
        endpoint = Endpoint(info.name, info.type, info.is_to_device)
        guarded = self.guarded.union(() if robot is None else (each.name for each in robot.topics.commands))
        return info.name in self.settings.locked or bool(unguarded([endpoint], self.settings, guarded))

    def _is_velocity(self, info: DeviceEndpoint) -> bool:
        """Whether a topic drives the device by its type and name, and by the robot's settings."""
        settings, endpoint = self.settings, Endpoint(info.name, info.type, info.is_to_device)
        is_named = settings.is_spatial and info.name in settings.topics and info.type in _SIX_NUMBERS
        return is_velocity(endpoint, settings.ignored) or (is_named and info.is_to_device)

    def _drivable(self, info: DeviceEndpoint, robot: LocalRobot | None) -> Drivable:
        """Create the gate of a further velocity topic of a robot, or of a device that is not identified.

        The first has the robot's limits and lock. The second has no limits: its six numbers stay as they are. A device
        that is a part of a robot has the robot's limits, and is stopped and locked with it.
        """
        topic = TopicType(info.name, info.type)
        if robot is None and self.member is not None:
            config = self._registry.config_of(self.member.robot)
            limits = limits_of(config, (topic,))
            shown = self.shown.of(info.name)
            admission = Admission(shown, drive=limits.drive, unlocked_by=self.member.robot)
            if self.lock.lock_reason is not None:
                admission.lock(self.lock.lock_reason, loop_time_s(), by=self.lock.locked_by)
            gate = VelocityGate(admission, limits, ZERO)
            return Drivable(name=shown, commands=commands_of((topic,), config), gate=gate, gates=self._shared.gates)
        if robot is None:
            shown = self.shown.of(info.name)
            admission = Admission(shown, drive=None)
            if self.lock.lock_reason is not None:
                admission.lock(self.lock.lock_reason, loop_time_s(), by=self.lock.locked_by)
            spatial: VelocityGate[Twist] = VelocityGate(admission, Unlimited(), Twist())
            commands = commands_of((topic,), RobotConfig())
            return Drivable(name=shown, commands=commands, gate=spatial, gates=self._shared.gates)
        limits = limits_of(robot.config, robot.topics.commands)
        gate = VelocityGate(robot.gate.admission, limits, ZERO, motion_of(info.name))
        commands = commands_of((topic,), robot.config, frame_id=robot.frames.base)
        return Drivable(name=robot.name, commands=commands, gate=gate, gates=self._shared.gates)

    def _send(self, name: str, reset: LocalRobot | None, message: Message) -> None:
        """Send a message to the device. `reset` is the robot whose odometry it resets.

        Raises:
            CommandRefused: it is locked, and the topic commands a motion or is one that a lock refuses by the settings;
                or its robot cannot be driven, and this is not the zero of a topic that was sent one for that.
            HostlinkError: the message does not fit the device.
        """
        if name in self._lockable and self.lock.lock_reason is not None:
            text = f"{message.topic}: {self.lock.locked_text}"
            raise CommandRefused(self.lock.robot, RefusalKind.LOCKED, text, by=self.lock.locked_by)
        if self.missing and self._zeros.get(name, message.payload) != message.payload:
            text = f"{message.topic}: robot {self.robot_name}: {self.missing}"
            raise CommandRefused(self.lock.robot, RefusalKind.NOT_CONNECTED, text)
        if reset is not None:
            reset.odometry.expect_reset(message.at_s)
            reset.feedback.reset_pose()
        self.link.session.publish(name, message.payload, depth=COMMAND_DEPTH)
        self.link.wake()

    def _send_pose(self, info: DeviceEndpoint, message: Message) -> None:
        """Send a pose to the device, which may only send it back as its own; as `_send`."""
        robot = self._robot
        if robot is not None:
            try:
                pose = READERS[info.type](message.payload).pose
            except BadPayload:  # the session refuses it
                pose = None
            if pose is not None:
                robot.feedback.note_given(pose)
        self._send(info.name, None, message)

    def _md5_sums(self, service: str) -> tuple[str, str]:
        sums = {info.kind: info.md5 for info in self.infos if info.name == service}
        return sums.get(EndpointKind.SERVICE_SERVER_SUBSCRIBER, ""), sums.get(EndpointKind.SERVICE_SERVER_PUBLISHER, "")

    def _call(self, name: str, payload: bytes) -> bytes | None:
        request = self.link.session.call(name, payload)
        self.link.wake()
        return request


class EarlyMessages:
    """Messages of a device that is not identified yet. Above a bound, the oldest is dropped."""

    __slots__ = ("_bytes", "_waiting")

    def __init__(self) -> None:
        self._waiting: list[tuple[MessageReceived, tuple[float, float]]] = []
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, message: MessageReceived, read: tuple[float, float]) -> int:
        """Add a message, with when it was read and may have arrived. Return the number of dropped messages."""
        before = len(self._waiting)
        self._waiting.append((message, read))
        self._bytes += len(message.payload)
        while len(self._waiting) > EARLY_MESSAGES or self._bytes > EARLY_BYTES:
            self._bytes -= len(self._waiting.pop(0)[0].payload)
        return before + 1 - len(self._waiting)

    def pop_all(self) -> list[tuple[MessageReceived, tuple[float, float]]]:
        """Remove and return all messages with their times."""
        waiting, self._waiting, self._bytes = self._waiting, [], 0
        return waiting
