"""Bridge to ROS 2 by rmw_zenoh's protocol: mirrors topics and services of the hub and of ROS 2 into each other."""

import asyncio
import contextlib
import itertools
import re
import socket
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import structlog

from hostlink.components.graphs.hub_source import HubSource
from hostlink.components.graphs.ros2_qos import COMMANDS, Qos
from hostlink.components.graphs.ros2_types import Ros2Message, Ros2Service, Ros2Types
from hostlink.components.zenoh.rmw_protocol import (
    GID_BYTES,
    LATCHED,
    OWN_ENCLAVE,
    SPACE,
    Attachment,
    EndpointToken,
    NodeToken,
    RemoteGraph,
    Removed,
    SourceClock,
    Subject,
    TokenKind,
    data_key,
    gid_of,
    is_hidden,
)
from hostlink.components.zenoh.session import Declaration, Query, Token, ZenohSample, ZenohSession
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.host import GraphService, GraphTopic, Host, Message, Participant
from hostlink.core.messages.message_type import ServiceType
from hostlink.core.messages.ros2_names import is_ros2_name, ros1_type
from hostlink.core.mirror.log_once import LogOnce
from hostlink.core.mirror.mirror import Mirror
from hostlink.core.robot.admission import EarlierMotion
from hostlink.core.robot.newest import TWIST_BYTES, is_zero_twist, newest
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable
from hostlink.errors import BadPayload, BadRequest, CommandRefused, HostlinkError, RefusalKind, ServiceFailed, WrongType

GROUP = "rmw_zenoh"  # of all participants that stand for this graph
MAX_CALLS_OF_CLIENT = 8  # under way at once, of one client and one service
CALL_TIMEOUT_S = 30.0  # of a service of ROS 2

MAX_PUBLISHERS = 1024  # participants
MAX_PUBLISHERS_OF_SESSION = 128  # of one process
MAX_GONE = MAX_PUBLISHERS  # tokens that are remembered; the one that left first is forgotten first
NEW_S = 1.0  # after its token a publisher is new; later it may be in the middle of a motion
MATCH_S = 3.0  # until Zenoh has connected a publisher and a subscription that know of each other
FIRST_NUMBER = 1  # of the messages of a publisher
OWN_TOPICS = frozenset({"/rosout", "/parameter_events"})  # that every node of ROS 2 publishes, for its own tools

MAX_NESTED_BYTES = 32 * 1024  # of a message with lists of messages or texts, each of which costs time
MAX_FLAT_BYTES = 1024 * 1024
MAX_WAITING = 64  # messages of one publisher

UNKNOWN: Final = "ros2.type_unknown"  # of most types of a large graph: robots here do not use them

MAX_CALLED_SERVICES: Final = 256
TROUBLE_INTERVAL_S: Final = 10.0
SLICE_S: Final = 0.003  # of declarations: a hundred robots that come at once cost a second of Zenoh's
NO_LOSS: Final = frozenset(  # counts of what was passed on, and of what has lines of its own
    {"calls_from_ros2", "calls_to_ros2", "from_ros2", "refused", "to_ros2", "unlogged"}
)
REFUSED_NAME: Final = "ROS 2 allows letters, digits and _ in names"
OWN_PACKAGES: Final = ("rcl_interfaces/", "type_description_interfaces/")  # services that every node of ROS 2 has


@dataclass(slots=True)
class RmwNode:
    """Node of this daemon in ROS 2, which its endpoints share. `counts`: losses by cause."""

    host: Host
    session: ZenohSession
    types: Ros2Types
    token: NodeToken
    counts: Counter[str] = field(default_factory=Counter)
    numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))  # of its endpoints


class RmwEndpoint:
    """One end of a topic or service in ROS 2: its token, the key of its data, and the gid by which it signs."""

    def __init__(self, node: RmwNode, kind: TokenKind, name: str, type_: Ros2Message | Ros2Service, qos: Qos) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        token = EndpointToken(kind, node.token, next(node.numbers), name, type_.name, type_.type_hash, qos).encode()
        self.key, self.gid = data_key(node.token.domain, name, type_.name, type_.type_hash), gid_of(token)
        self._numbers = itertools.count(1)
        self._declaration: Declaration = node.session.declare_token(token)

    def signed(self, source_ns: int | None = None) -> tuple[int, bytes]:
        """The number of its next message or request, and the attachment with it."""
        number = next(self._numbers)
        return number, Attachment(number, time.time_ns() if source_ns is None else source_ns, self.gid).encode()

    def close(self) -> None:
        """Leave the graph."""
        self._declaration.close()


@dataclass(frozen=True, slots=True)
class PublicationSpec:
    """Specification of a publication."""

    topic: str
    type_name: str  # in the hub
    type: Ros2Message
    is_latched: bool


class RmwPublication:
    """`close` ends it. What is latched is kept for those who come later, as ROS 2's transient local."""

    def __init__(self, node: RmwNode, topic: PublicationSpec) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        qos = LATCHED if topic.is_latched else Qos()
        self._node, self._topic = node, topic
        self._endpoint = RmwEndpoint(node, TokenKind.PUBLISHER, topic.topic, topic.type, qos)
        self._publisher = node.session.declare_publisher(self._endpoint.key, kept=1 if topic.is_latched else 0)
        self._source = HubSource(
            lambda: node.host.join(f"ros2 {topic.topic}", group=GROUP),
            topic.topic,
            self._receive,
            lambda _: node.counts.update(("failed_endpoints",)),
        )
        if topic.is_latched:
            self._source.set_read(True)
        else:
            self._publisher.watch(self._source.set_read)

    def close(self) -> None:
        """Withdraw the publication."""
        self._source.set_read(False)
        self._endpoint.close()
        self._publisher.close()

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
class ServiceSpec:
    """Specification of an offered service."""

    name: str
    known: ServiceType
    type: Ros2Service


class OfferedService:
    """A service of the hub, which ROS 2 can call."""

    def __init__(self, node: RmwNode, offered: ServiceSpec) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        self._node, self._name, self._known, self._type = node, offered.name, offered.known, offered.type
        self._calls: Counter[bytes] = Counter()
        self._participant = node.host.join(f"ros2 {self._name}", group=GROUP)
        self._endpoint = RmwEndpoint(node, TokenKind.SERVER, self._name, self._type, Qos())
        self._queryable = node.session.serve(self._endpoint.key, self._receive)

    def close(self) -> None:
        """Withdraw the service from ROS 2."""
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
        self._node.host.spawn(self._answer(query, attachment), name=f"ros2 {self._name}")

    async def _answer(self, query: Query, attachment: Attachment) -> None:
        try:
            with self._node.host.around("task", task=f"ros2 {self._name}"):
                answer = await self._call(query.payload)
                if answer is not None:
                    signed = attachment._replace(source_ns=time.time_ns()).encode()
                    query.reply(answer, key=self._endpoint.key, attachment=signed)
                    self._node.counts["calls_from_ros2"] += 1
        finally:
            query.close()
            self._calls -= Counter((attachment.gid,))  # without those that have none left

    async def _call(self, data: bytes) -> bytes | None:
        """Return the answer; None for a malformed request, or a failure that the response type cannot express."""
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
        self._participant: Participant = node.host.join(f"ros2 {token.node.full_name}", group=GROUP)
        self._endpoint = RmwEndpoint(node, TokenKind.CLIENT, token.name, type_, Qos())
        try:
            self._participant.provide(token.name, known.name, self._answer)
        except BadRequest:
            self.close()
            raise

    def close(self) -> None:
        """Withdraw the service from the hub."""
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
        raise ServiceFailed(self._name, "no answer from ROS 2")


log = structlog.get_logger()


class RmwPublisher:
    """Publisher of another node in ROS 2, which is a participant of the hub."""

    def __init__(self, node: RmwNode, token: EndpointToken, log_once: LogOnce, leave: Callable[[], None]) -> None:
        """Join the hub. `leave` is called when a failure of its own ends its participant."""
        self.token = token
        self.clock = SourceClock()
        self.motion = EarlierMotion()
        self.participant: Participant = node.host.join(f"ros2 {token.node.full_name}", group=GROUP, on_end=leave)
        self._node, self._log_once = node, log_once
        self._is_advertised = False
        self._refusals = Budget()
        self.advertise()

    def advertise(self) -> None:
        """Show its topic in the hub, unless it has another type there or one that is unknown, which is logged once."""
        if self._is_advertised:
            return
        token = self.token
        try:
            self.participant.advertise(token.name, ros1_type(token.type_name), is_latched=token.qos.is_latched)
        except WrongType as error:
            self._log_once("ros2.topic_refused", name=token.name, type=token.type_name, reason=str(error))
        except BadRequest as error:
            self._log_once(UNKNOWN, name=token.type_name, topic=token.name, reason=str(error))
        else:
            self._is_advertised = True

    def close(self) -> None:
        """Leave: what it drives stops."""
        self.participant.leave()

    def publish(self, topic: str, payload: bytes, *, received_s: float, epoch: int | None = None) -> None:
        """Pass a payload on; what the hub refuses is counted, and now and then in both logs: here and in ROS 2."""
        try:
            self.participant.publish(topic, payload, at_s=received_s, epoch=epoch)
            self._node.counts["from_ros2"] += 1
        except HostlinkError as error:
            is_late = isinstance(error, CommandRefused) and error.kind is RefusalKind.LATE
            self._node.counts["late" if is_late else "refused"] += 1
            if counts := self._refusals.due(error.kind, asyncio.get_running_loop().time()):
                by, reason = printable(self.participant.name), printable(str(error), 200)
                log.warning("ros2.refused", topic=topic, by=by, kind=error.kind, reason=reason, **counts)
                node = self._node.token.full_name
                self._node.host.warn(node, f"{topic} of {by} is refused ({error.kind}): {reason}")


class _Token(NamedTuple):
    """A publisher's token, and when it came."""

    token: EndpointToken
    came_s: float


class Publishers:
    """All publishers of ROS 2, by their tokens."""

    def __init__(self, node: RmwNode, remote: RemoteGraph, log_once: LogOnce) -> None:
        self._node, self._remote, self._log_once = node, remote, log_once
        self.is_known = remote.is_known  # whether a gid is that of a publisher; in any thread
        self._gone: dict[str, None] = {}  # tokens that may be back after a cut
        self._has_forgotten = False  # one of them: each message may be from it
        self._began_s = asyncio.get_running_loop().time()
        self._publishers = Mirror[str, _Token, RmwPublisher](
            self._open,
            lambda _, error: node.host.crashed("graph", error, graph="ros2"),
            limit=MAX_PUBLISHERS,
            group_of=session_of,
            group_limit=MAX_PUBLISHERS_OF_SESSION,
            is_same=lambda before, now: before.token == now.token,
            on_crowded=lambda _: node.counts.update(("crowded_publishers",)),
        )

    def add(self, token: EndpointToken, key: str) -> None:
        """Add a publisher of ROS 2 by its token."""
        if token.name not in OWN_TOPICS and not is_hidden(token.name):
            self._publishers.put(key, _Token(token, asyncio.get_running_loop().time()))

    def remove(self, removed: Removed) -> None:
        """A publisher has gone: what it drives stops. So does what those drive who cannot be distinguished from it."""
        if removed.publisher is None:
            return
        self._publishers.put(removed.publisher.key, None)
        self._gone[removed.publisher.key] = None
        if len(self._gone) > MAX_GONE:
            del self._gone[next(iter(self._gone))]
            self._has_forgotten = True
        for each in removed.unsure:
            self._publishers.put(each.key, None)
            if each.key != removed.publisher.key:
                self.add(each.token, each.key)

    def advertise_all(self) -> None:
        """The hub's graph has changed: types that were wrong may be right."""
        for each in self._publishers.endpoints.values():
            each.advertise()

    def join(self, subject: Subject) -> None:
        """A velocity is subscribed from now on: publishers that are there may be in the middle of a motion."""
        for each in self._publishers.endpoints.values():
            if (each.token.name, each.token.type_name) == subject:
                self._expect_earlier(each)

    def clear(self) -> None:
        """Remove all publishers: what they drive stops."""
        self._publishers.close()

    def publish(self, attachment: Attachment, subject: Subject, payload: bytes, *, topic: str) -> None:
        """Publish as the publisher that has signed the message, with the time that it waited on its way."""
        remote = self._remote.publisher(attachment.gid, subject)
        publisher = None if remote is None else self._publishers.endpoints.get(remote.key)
        if publisher is None:
            self._node.counts["unidentified"] += 1
            return
        host = self._node.host
        now_s = host.now_s
        late_s = publisher.clock.late_s(attachment.sequence_number, attachment.source_ns, now_s)
        epoch = publisher.motion.pop_epoch(host.came_s(now_s))
        if attachment.sequence_number <= FIRST_NUMBER:
            epoch = None  # it is the first that it has ever sent
        publisher.publish(topic, payload, received_s=now_s - late_s, epoch=epoch)

    def _open(self, key: str, spec: _Token) -> RmwPublisher:
        made = RmwPublisher(self._node, spec.token, self._log_once, lambda: self._publishers.put(key, None))
        now_s, is_back = asyncio.get_running_loop().time(), self._has_forgotten or key in self._gone
        self._gone.pop(key, None)
        has_waited = now_s > spec.came_s + NEW_S  # for room
        if is_back or has_waited or now_s < self._began_s + MATCH_S:  # it was there before this daemon
            self._expect_earlier(made)
        return made

    @staticmethod
    def _expect_earlier(publisher: RmwPublisher) -> None:
        publisher.motion = EarlierMotion(asyncio.get_running_loop().time() + MATCH_S)


@dataclass(frozen=True, slots=True)
class SubscriptionSpec:
    """Specification of a subscription."""

    name: str  # of the topic in ROS 2
    type: Ros2Message
    topic: str  # in the hub
    is_velocity: bool = False
    is_stripped: bool = False  # of a TwistStamped the Twist alone is published
    has_history: bool = False  # what publishers keep for those who come later is requested

    @property
    def qos(self) -> Qos:
        """Quality of service, as tools of ROS 2 show it."""
        if self.is_velocity:
            return COMMANDS
        return Qos(is_latched=self.has_history)


def _newest_samples(waiting: Sequence[ZenohSample]) -> list[ZenohSample]:
    return newest(waiting, lambda sample: is_zero_twist(sample.payload))  # a Twist in CDR is its numbers, too


class RmwSubscription:
    """Subscription in ROS 2 whose messages are published in the hub."""

    def __init__(self, node: RmwNode, wanted: SubscriptionSpec, publishers: Publishers) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        self._node, self._wanted, self._publishers = node, wanted, publishers
        type_ = wanted.type
        self._endpoint = RmwEndpoint(node, TokenKind.SUBSCRIPTION, wanted.name, type_, wanted.qos)
        if wanted.is_velocity:
            publishers.join((wanted.name, type_.name))
        self._subscription = node.session.subscribe(
            self._endpoint.key,
            self._receive,
            source_of=lambda sample: sample.attachment[-GID_BYTES:],
            is_known=publishers.is_known,
            max_bytes=MAX_FLAT_BYTES if type_.is_flat else MAX_NESTED_BYTES,
            max_waiting=MAX_WAITING,
            needed=_newest_samples if wanted.is_velocity else None,
            has_history=wanted.has_history,
        )

    def close(self) -> None:
        """Withdraw the subscription."""
        self._endpoint.close()
        self._subscription.close()

    def _receive(self, sample: ZenohSample) -> None:
        attachment = Attachment.decode(sample.attachment)
        if attachment is None:
            self._node.counts["unsigned"] += 1
            return
        try:
            payload = self._wanted.type.from_cdr(sample.payload)
        except BadPayload:
            self._node.counts["malformed_from_ros2"] += 1
            return
        self._publishers.publish(
            attachment,
            (self._wanted.name, self._wanted.type.name),
            payload[-TWIST_BYTES:] if self._wanted.is_stripped else payload,
            topic=self._wanted.topic,
        )


def session_of(key: str) -> str:
    """The process whose token has this key."""
    return key.split("/")[2]


_Declared = SubscriptionSpec | PublicationSpec | ServiceSpec
_Endpoint = RmwSubscription | RmwPublication | OfferedService


class UnusableType(Exception):
    """A service's type is unknown here or has another definition, which was logged."""


class RmwBridge:
    """Keeps both graphs equal while the session lives. `counts`: messages both ways, and what was lost by cause."""

    def __init__(self, host: Host, session: ZenohSession, types: Ros2Types, token: NodeToken) -> None:
        """`token`: of the node that this daemon is.

        Raises:
            ConfigError: the session is closed.
        """
        self._node = RmwNode(host, session, types, token)
        self.counts = self._node.counts
        self._log_once = LogOnce(self.counts, at_info=(UNKNOWN,), by=("name", "type"))
        self._remote = RemoteGraph(token.domain, self.counts)
        self._publishers = Publishers(self._node, self._remote, self._log_once)
        self._endpoints: Mirror[_Declared, _Declared, _Endpoint] = Mirror(
            lambda _, each: self._declare(each), self._fail, slice_s=SLICE_S
        )
        self._called = Mirror[EndpointToken, EndpointToken, CalledService](
            lambda _, each: self._call(each),
            self._fail_call,
            limit=MAX_CALLED_SERVICES,
            on_crowded=lambda _: self.counts.update(("crowded_services",)),
        )
        self._participant = host.join("ros2", group=GROUP)
        self._declared = [
            session.declare_token(token.encode()),
            session.subscribe_tokens(f"{SPACE}/{token.domain}/**", self._receive_token),
        ]
        self._participant.watch_graph(self._update)

    def close(self) -> None:
        """Leave both graphs: what ROS 2 drives stops."""
        self._publishers.clear()
        self._participant.leave()
        self._endpoints.close()
        self._called.close()
        for each in self._declared:
            each.close()

    # -- from ROS 2 ---------------------------------------------------------------------------------------------------

    def _receive_token(self, token: Token) -> None:
        if not token.is_alive:
            self._remove(token.key)
            return
        added = self._remote.add(token.key)
        if not isinstance(added, EndpointToken):
            return
        if added.kind is TokenKind.PUBLISHER:
            self._publishers.add(added, token.key)
            self._check_hash(added)
        elif (
            added.kind is TokenKind.SERVER
            and not is_hidden(added.name)
            and not added.type_name.startswith(OWN_PACKAGES)
        ):
            self._called.put(added, added)

    def _remove(self, key: str) -> None:
        removed = self._remote.remove(key)
        if removed is None:
            return
        self._publishers.remove(removed)
        if isinstance(removed.token, EndpointToken):
            self._called.put(removed.token, None)

    def _check_hash(self, token: EndpointToken) -> None:
        """Log a type whose definition there is another: none of its messages arrives."""
        known = self._node.types.message(ros1_type(token.type_name))
        if known is not None and known.type_hash != token.type_hash:
            self._log_difference(token, known.type_hash, topic=token.name)

    def _log_difference(self, token: EndpointToken, here: str, **facts: str) -> None:
        self._log_once("ros2.type_differs", name=token.type_name, **facts, here=here, there=token.type_hash)

    def _call(self, token: EndpointToken) -> CalledService:
        name = ros1_type(token.type_name)
        known, type_ = self._node.host.messages.service(name), self._node.types.service(name)
        if known is None or type_ is None:
            self._log_once(UNKNOWN, name=token.type_name, service=token.name)
            raise UnusableType(token.type_name)
        if type_.type_hash != token.type_hash:
            self._log_difference(token, type_.type_hash, service=token.name)
            raise UnusableType(token.type_name)
        return CalledService(self._node, token, known, type_)

    def _fail_call(self, token: EndpointToken, error: Exception) -> None:
        if isinstance(error, HostlinkError):
            self._log_once("ros2.service_refused", name=token.name, type=token.type_name, reason=str(error))
        elif not isinstance(error, UnusableType):
            self._fail(token, error)

    def _fail(self, _: object, error: Exception) -> None:
        """A ConfigError of the session: it is closed."""
        if isinstance(error, HostlinkError):
            self.counts["failed_endpoints"] += 1
        else:
            self._node.host.crashed("graph", error, graph="ros2")

    # -- from the hub -------------------------------------------------------------------------------------------------

    def _update(self) -> None:
        """The hub's graph has changed: declare what is new, withdraw what is gone."""
        graph = self._participant.graph()
        topics = [(topic, type_) for topic in graph.topics if (type_ := self._type(topic)) is not None]
        stamped = {each.name for each in graph.topics if each.is_velocity and each.type_name == TWIST_STAMPED_TYPE}
        wanted: list[_Declared] = [
            each for topic, type_ in topics if topic.is_subscribed for each in self._wanted(topic, type_, stamped)
        ]
        wanted += [
            PublicationSpec(topic.name, topic.type_name, type_, topic.is_latched)
            for topic, type_ in topics
            if topic.is_published and not topic.is_velocity
        ]
        wanted += [each for service in graph.services if (each := self._service(service)) is not None]
        self._endpoints.want({each: each for each in wanted})
        self._publishers.advertise_all()

    def _declare(self, each: _Declared) -> _Endpoint:
        match each:
            case SubscriptionSpec():
                return RmwSubscription(self._node, each, self._publishers)
            case PublicationSpec():
                return RmwPublication(self._node, each)
            case ServiceSpec():
                return OfferedService(self._node, each)

    def _wanted(self, topic: GraphTopic, type_: Ros2Message, stamped_topics: Container[str]) -> list[SubscriptionSpec]:
        """A robot's velocity is received as a Twist and as a TwistStamped, by the same name.

        `stamped_topics`: velocities whose type is TwistStamped in the hub.
        """
        if not topic.is_velocity:
            has_history = any(each.token.qos.is_latched for each in self._remote.publishers((topic.name, type_.name)))
            return [SubscriptionSpec(topic.name, type_, topic.name, has_history=has_history)]
        wanted = [SubscriptionSpec(topic.name, type_, topic.name, is_velocity=True)]
        stamped = self._node.types.message(TWIST_STAMPED_TYPE)
        if topic.type_name == TWIST_TYPE and stamped is not None:
            beside = f"{topic.name}_stamped"  # the robot's own topic of that type, which checks the age of commands
            is_there = beside in stamped_topics
            target = beside if is_there else topic.name
            wanted.append(SubscriptionSpec(topic.name, stamped, target, is_velocity=True, is_stripped=not is_there))
        return wanted

    def _type(self, topic: GraphTopic) -> Ros2Message | None:
        """Return the type of a topic in ROS 2; None if it cannot exist there, which is logged once."""
        if not topic.type_name or not self._is_shown(topic.name, "ros2.topic_refused"):
            return None
        found = self._node.types.message(topic.type_name)
        if found is None:
            self._log_once(UNKNOWN, name=topic.type_name, topic=topic.name)
        return found

    def _is_shown(self, name: str, refused: str) -> bool:
        """Whether a name can exist in ROS 2, else `refused` is logged; another daemon shows those of its robots."""
        if is_hidden(name) or self._node.host.is_remote(name.split("/")[1]):
            return False
        if not is_ros2_name(name):
            self._log_once(refused, name=name, reason=REFUSED_NAME)
        return is_ros2_name(name)

    def _service(self, service: GraphService) -> ServiceSpec | None:
        if not self._is_shown(service.name, "ros2.service_refused"):
            return None
        known, found = self._node.host.messages.service(service.type_name), self._node.types.service(service.type_name)
        if known is None or found is None:
            self._log_once(UNKNOWN, name=service.type_name, service=service.name)
            return None
        return ServiceSpec(service.name, known, found)


@contextlib.asynccontextmanager
async def ros2_bridged(host: Host, session: ZenohSession, config: ZenohSettings) -> AsyncIterator[RmwBridge]:
    """Be a node of the ROS 2 graph for the length of the block.

    Raises:
        ConfigError: the session is closed.
    """
    types = await asyncio.to_thread(Ros2Types, host.messages, config.ros_distribution)
    name = re.sub(r"\W", "_", config.name or socket.gethostname(), flags=re.ASCII)
    token = NodeToken(config.ros_domain_id, session.zid, 0, "/", f"hostlink_{name}", OWN_ENCLAVE)
    bridge = RmwBridge(host, session, types, token)
    host.count_by(lambda: bridge.counts, part="ros2")
    log.info("ros2.joined", node=token.full_name, domain=token.domain, distribution=config.ros_distribution)
    try:
        async with asyncio.TaskGroup() as tasks:
            watcher = tasks.create_task(log_trouble(bridge.counts), name="ros2 trouble")
            try:
                yield bridge
            finally:
                watcher.cancel()
    finally:
        bridge.close()
        log.info("ros2.left", **bridge.counts)


async def log_trouble(counts: Counter[str]) -> None:
    """One line in ten seconds about what was lost since the last."""
    before: Counter[str] = Counter()
    while True:
        await asyncio.sleep(TROUBLE_INTERVAL_S)
        lost = {cause: count for cause, count in (counts - before).items() if cause not in NO_LOSS}
        before = counts.copy()
        if lost:
            log.warning("ros2.trouble", **lost)
