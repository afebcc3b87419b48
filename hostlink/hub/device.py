"""Device: what one link means to the graph: its topics, its services, and the routes of its frames."""

import asyncio
import struct
import time
from collections import deque

import structlog

from hostlink.errors import BadRequest, WrongType
from hostlink.hub.services import DeviceService, Services
from hostlink.hub.shown_names import ShownNames
from hostlink.hub.topic_graph import SendToDevice, Topic, TopicGraph
from hostlink.hub.ungated import UngatedVelocities, is_velocity
from hostlink.link.link import Link
from hostlink.logs import printable
from hostlink.messages.catalog import Catalog
from hostlink.messages.fields import Field
from hostlink.messages.message_type import MessageType
from hostlink.protocol.control import TopicInfo
from hostlink.protocol.events import MessageReceived
from hostlink.protocol.frame import Id
from hostlink.robot.directory import RobotTopicNames

log = structlog.get_logger()

_HEADER = Field("header", "std_msgs/Header")
_STAMP = struct.Struct("<4xII")  # seq, secs, nsecs
_NS_PER_S = 1_000_000_000
EARLY_MESSAGES, EARLY_BYTES = 128, 65536  # three seconds of the project's robot
COMMAND_DEPTH = 16  # messages of one topic that may wait for a slow device; a velocity has one slot of its own


def check_type(catalog: Catalog, info: TopicInfo) -> int | None:
    """The fixed size of an endpoint's payloads, None if it varies or the type is unknown; WrongType for a wrong md5."""
    checks = {
        Id.PUBLISHER: catalog.check_message,
        Id.SUBSCRIBER: catalog.check_message,
        Id.SERVICE_SERVER_PUBLISHER: catalog.check_response,
        Id.SERVICE_SERVER_SUBSCRIBER: catalog.check_request,
        Id.SERVICE_CLIENT_PUBLISHER: catalog.check_request,
        Id.SERVICE_CLIENT_SUBSCRIBER: catalog.check_response,
    }
    found = checks[info.kind](info.name, info.type, info.md5)
    return None if found is None else found.fixed_bytes


class Device:
    """A link in the graph, from its first negotiation to its end."""

    def __init__(
        self, link: Link, topics: TopicGraph, services: Services, catalog: Catalog, ungated: UngatedVelocities
    ) -> None:
        self.link = link
        self._ungated = ungated
        self.routes: dict[int, Topic] = {}  # where the messages of an id go
        self.odometry: dict[int, MessageType] = {}  # the ids that tell where its robot is
        self.shown = ShownNames()
        self.names: frozenset[str] = frozenset()  # of its topics, as they are shown
        self.services: dict[str, DeviceService] = {}  # its own, by the names that it tells
        self.early = EarlyMessages()
        self.is_undecided = False  # whether it is known who it is
        self.infos: tuple[TopicInfo, ...] = ()  # what it told last
        self._stamped: set[int] = set()  # the ids of messages that begin with a header
        self._topics, self._services, self._catalog = topics, services, catalog

    def announce(self, infos: tuple[TopicInfo, ...], shown: ShownNames, robot: RobotTopicNames | None = None) -> None:
        """Put the device's endpoints into the graph in place of those that it had."""
        self.leave()
        self.shown = shown
        self.names = frozenset(shown.of(info.name) for info in infos if info.kind in (Id.PUBLISHER, Id.SUBSCRIBER))
        for info in infos:
            try:
                self._add(info)
            except (WrongType, BadRequest) as error:
                log.warning("topic.refused", topic=printable(info.name), reason=str(error))
            if robot is not None and info.kind is Id.PUBLISHER:
                self._add_odometry(info, robot)

    def look_at_stamp(self, topic_id: int, payload: bytes) -> None:
        """A message came: if it has a header, its stamp says something about the device's clock."""
        if topic_id in self._stamped and len(payload) >= _STAMP.size:
            secs, nsecs = _STAMP.unpack_from(payload)
            clock = self.link.session.device_clock
            clock.see(secs * _NS_PER_S + nsecs, at_ns=time.time_ns(), now_s=self.link.heard_at_s)

    def leave(self) -> None:
        """Take everything of this device out of the graph."""
        self.routes.clear()
        self.odometry.clear()
        self._stamped.clear()
        self.names = frozenset()
        self._topics.leave(self.link)
        self._services.leave(self.link)
        self.services.clear()

    def _add(self, info: TopicInfo) -> None:
        name = self.shown.of(info.name)
        if info.kind is Id.PUBLISHER:
            topic = self.routes[info.topic_id] = self._topics.advertise(name, self.link, type_name=info.type)
            if topic.type is not None and topic.type.fields[:1] == (_HEADER,):
                self._stamped.add(info.topic_id)
        elif info.kind is Id.SUBSCRIBER:
            self._topics.subscribe_device(name, self.link, self._sender(info), type_name=info.type)
        elif info.kind is Id.SERVICE_SERVER_SUBSCRIBER:
            type_ = self._catalog.service(info.type)
            service = DeviceService(name, info.type, type_, self.link, lambda payload: self._call(info.name, payload))
            service.md5_sums = self._md5_sums(info.name)
            self._services.add_device_service(service)
            self.services[info.name] = service

    def _md5_sums(self, service: str) -> tuple[str, str]:
        sums = {info.kind: info.md5 for info in self.infos if info.name == service}
        return sums.get(Id.SERVICE_SERVER_SUBSCRIBER, ""), sums.get(Id.SERVICE_SERVER_PUBLISHER, "")

    def _add_odometry(self, info: TopicInfo, robot: RobotTopicNames) -> None:
        type_ = self._catalog.message(info.type)
        if (info.name, info.type) == (robot.odometry, robot.odometry_type) and type_ is not None:
            self.odometry[info.topic_id] = type_

    def _sender(self, info: TopicInfo) -> SendToDevice:
        def send(payload: bytes) -> None:
            self.link.session.publish(info.name, payload, depth=COMMAND_DEPTH)
            self.link.wake()

        def drive(payload: bytes) -> None:
            self._ungated.send(self.link, info.name, payload, now_s=asyncio.get_running_loop().time())

        return drive if is_velocity(info) else send  # a robot's own velocity topic has a gate, and comes here never

    def _call(self, name: str, payload: bytes) -> None:
        self.link.session.call(name, payload)
        self.link.wake()


class EarlyMessages:
    """What a device said while it was not known who it is, to be heard afterwards; of too much the oldest goes."""

    def __init__(self) -> None:
        self._waiting: deque[MessageReceived] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, message: MessageReceived) -> int:
        """Returns how many went for it."""
        before = len(self._waiting)
        self._waiting.append(message)
        self._bytes += len(message.payload)
        while len(self._waiting) > EARLY_MESSAGES or self._bytes > EARLY_BYTES:
            self._bytes -= len(self._waiting.popleft().payload)
        return before + 1 - len(self._waiting)

    def take(self) -> list[MessageReceived]:
        """All of them; none is left."""
        taken = list(self._waiting)
        self._waiting.clear()
        self._bytes = 0
        return taken
