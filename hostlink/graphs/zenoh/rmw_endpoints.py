"""Endpoints of this daemon in ROS 2 by rmw_zenoh's protocol: what the hub publishes, and services both ways."""

import itertools
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from hostlink.errors import BadPayload, BadRequest, HostlinkError, ServiceFailed
from hostlink.graphs.ros2_types import Ros2Message, Ros2Service, Ros2Types
from hostlink.graphs.zenoh.rmw_protocol import (
    LATCHED,
    SERVICE,
    TELEMETRY,
    Attachment,
    EndpointToken,
    Kind,
    NodeToken,
    Qos,
    data_key,
    gid_of,
)
from hostlink.graphs.zenoh.session import Declaration, Query, Session
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.messages.message_type import ServiceType

GROUP = "rmw_zenoh"  # of all participants that stand for this graph
MAX_CALLS_OF_CLIENT = 8  # under way at once, of one client and one service
CALL_TIMEOUT_S = 30.0  # of a service of ROS 2


class Endpoint:
    """One end of a topic or service in ROS 2: its token, and the gid by which it signs."""

    def __init__(self, session: Session, token: EndpointToken, key: str) -> None:
        """`key`: of its data."""
        text = token.encode()
        self.key, self.gid = key, gid_of(text)
        self._numbers = itertools.count(1)
        self._declaration: Declaration = session.declare_token(text)

    def signed(self, source_ns: int | None = None) -> tuple[int, bytes]:
        """The number of its next message or request, and the attachment with it."""
        number = next(self._numbers)
        return number, Attachment(number, time.time_ns() if source_ns is None else source_ns, self.gid).encode()

    def close(self) -> None:
        """Leave the graph."""
        self._declaration.close()


@dataclass(slots=True)
class RmwNode:
    """What every part of the bridge uses. `counts`: what was lost, by cause."""

    hub: Hub
    session: Session
    types: Ros2Types
    token: NodeToken
    counts: Counter[str] = field(default_factory=Counter)
    _numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))

    def endpoint(self, kind: Kind, name: str, type_name: str, type_hash: str, qos: Qos) -> Endpoint:
        """Declare an endpoint of this node.

        Raises:
            ConfigError: the session is closed.
        """
        token = EndpointToken(kind, self.token, next(self._numbers), name, type_name, type_hash, qos)
        return Endpoint(self.session, token, data_key(self.token.domain, name, type_name, type_hash))


@dataclass(frozen=True, slots=True)
class Published:
    """What is to be published: two that are equal are one publication."""

    topic: str
    type_name: str  # in the hub
    type: Ros2Message
    is_latched: bool


class Publication:
    """`close` ends it. What is latched is kept for those who come later, as ROS 2's transient local."""

    def __init__(self, node: RmwNode, topic: Published) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        qos, type_ = LATCHED if topic.is_latched else TELEMETRY, topic.type
        self._node, self._topic = node, topic
        self._endpoint = node.endpoint(Kind.PUBLISHER, topic.topic, type_.name, type_.type_hash, qos)
        self._publisher = node.session.declare_publisher(self._endpoint.key, kept=1 if topic.is_latched else 0)
        self._participant: Participant | None = None
        if topic.is_latched:
            self._subscribe()
        else:
            self._publisher.watch(self._match)
            self._match(self._publisher.is_subscribed)

    def close(self) -> None:
        """Publish no more."""
        self._unsubscribe()
        self._endpoint.close()
        self._publisher.close()

    def _match(self, is_subscribed: bool) -> None:
        if is_subscribed:
            self._subscribe()
        else:
            self._unsubscribe()

    def _subscribe(self) -> None:
        if self._participant is None:
            self._participant = self._node.hub.join(f"ros2 {self._topic.topic}", group=GROUP)
            self._participant.subscribe(self._topic.topic, self._receive)

    def _unsubscribe(self) -> None:
        if self._participant is not None:
            self._participant.leave()
            self._participant = None

    def _receive(self, message: Message) -> None:
        if message.type_name != self._topic.type_name:
            self._node.counts["other_type"] += 1
            return
        try:
            data = self._topic.type.to_cdr(message.payload)
        except BadPayload:
            self._node.counts["malformed_to_ros2"] += 1
            return
        _, attachment = self._endpoint.signed(message.stamp_ns)
        self._publisher.put(data, attachment=attachment)
        self._node.counts["to_ros2"] += 1


@dataclass(frozen=True, slots=True)
class Offered:
    """A service that is to be offered: two that are equal are one."""

    name: str
    known: ServiceType
    type: Ros2Service


class OfferedService:
    """A service of the hub, which ROS 2 can call."""

    def __init__(self, node: RmwNode, offered: Offered) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        self._node, self._name, self._known, self._type = node, offered.name, offered.known, offered.type
        self._calls: Counter[bytes] = Counter()
        self._participant = node.hub.join(f"ros2 {self._name}", group=GROUP)
        self._endpoint = node.endpoint(Kind.SERVER, self._name, self._type.name, self._type.type_hash, SERVICE)
        self._queryable = node.session.serve(self._endpoint.key, self._receive)

    def close(self) -> None:
        """Answer no more."""
        self._endpoint.close()
        self._queryable.close()
        self._participant.leave()

    def _receive(self, query: Query) -> None:
        attachment = Attachment.decode(query.attachment)
        if attachment is None or self._calls[attachment.gid] >= MAX_CALLS_OF_CLIENT:
            self._node.counts["unsigned" if attachment is None else "crowded_calls"] += 1
            query.close()
            return
        self._calls[attachment.gid] += 1
        self._node.hub.spawn(self._answer(query, attachment), name=f"ros2 {self._name}")

    async def _answer(self, query: Query, attachment: Attachment) -> None:
        try:
            answer = await self._call(query.payload)
            if answer is not None:
                signed = attachment._replace(source_ns=time.time_ns()).encode()
                query.reply(answer, key=self._endpoint.key, attachment=signed)
                self._node.counts["calls_from_ros2"] += 1
        finally:
            query.close()
            self._calls[attachment.gid] -= 1
            if not self._calls[attachment.gid]:
                del self._calls[attachment.gid]

    async def _call(self, data: bytes) -> bytes | None:
        """The answer; None: the request is none, or the answer has no field for a failure. ROS 2 has no other way."""
        try:
            request = self._known.request.decode(self._type.request.from_cdr(data))
            answer = await self._participant.call(self._name, request)
            return self._type.response.to_cdr(self._known.response.encode(answer))
        except BadPayload:
            self._node.counts["malformed_from_ros2"] += 1
            return None
        except HostlinkError as error:
            self._node.counts["failed_calls"] += 1
            return self._failure(str(error))

    def _failure(self, reason: str) -> bytes | None:
        fields = {field.name: field.type for field in self._known.response.fields}
        if fields.get("success") != "bool":
            return None
        message = {"message": reason} if fields.get("message") == "string" else {}
        return self._type.response.to_cdr(self._known.response.encode({"success": False, **message}))


class CalledService:
    """A service of ROS 2, which the hub's devices and programs can call."""

    def __init__(self, node: RmwNode, token: EndpointToken, known: ServiceType, type_: Ros2Service) -> None:
        """Provide it.

        Raises:
            ConfigError: the session is closed.
            BadRequest: the name is the daemon's own.
        """
        self._node, self._name, self._known, self._type = node, token.name, known, type_
        self._participant: Participant = node.hub.join(f"ros2 {token.node.full_name}", group=GROUP)
        self._endpoint = node.endpoint(Kind.CLIENT, token.name, type_.name, type_.type_hash, SERVICE)
        try:
            self._participant.provide(token.name, known.name, self._answer)
        except BadRequest:
            self.close()
            raise

    def close(self) -> None:
        """Provide it no more."""
        self._participant.leave()
        self._endpoint.close()

    async def _answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        data = self._type.request.to_cdr(self._known.request.encode(request))
        number, attachment = self._endpoint.signed()
        samples = await self._node.session.get(
            self._endpoint.key, data, attachment=attachment, timeout_s=CALL_TIMEOUT_S
        )
        for sample in samples:
            signed = Attachment.decode(sample.attachment)
            if signed is not None and signed.sequence_number == number:
                self._node.counts["calls_to_ros2"] += 1
                return self._known.response.decode(self._type.response.from_cdr(sample.payload))
        raise ServiceFailed(self._name, "nobody in ROS 2 has answered")
