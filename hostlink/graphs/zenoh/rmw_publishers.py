"""What ROS 2 publishes by rmw_zenoh's protocol: a subscription for each topic, a participant for each publisher.

The velocities of a publisher end when it leaves its graph.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import structlog

from hostlink.errors import BadPayload, BadRequest, CommandRefused, HostlinkError, RefusalKind, WrongType
from hostlink.graphs.refusal_log import RefusalLog
from hostlink.graphs.ros2_types import Ros2Message, ros1_type
from hostlink.graphs.zenoh.rmw_endpoints import GROUP, RmwNode
from hostlink.graphs.zenoh.rmw_graph import RemoteGraph, Removed, SourceClock, Subject
from hostlink.graphs.zenoh.rmw_protocol import (
    COMMANDS,
    GID_BYTES,
    TELEMETRY,
    Attachment,
    EndpointToken,
    Kind,
    Qos,
    is_hidden,
)
from hostlink.graphs.zenoh.session import Sample
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.mirror.log_once import LogOnce
from hostlink.mirror.mirror import Mirror
from hostlink.robot.admission import EarlierMotion

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
TWIST_BYTES = 48  # at the end of a TwistStamped

log = structlog.get_logger()


class Publisher:
    """One publisher of ROS 2."""

    def __init__(self, node: RmwNode, token: EndpointToken, leave: Callable[[], None]) -> None:
        """`leave` is called when a failure of its own ends its participant."""
        self.token = token
        self.clock = SourceClock()
        self.motion = EarlierMotion()
        self.participant: Participant = node.hub.join(f"ros2 {token.node.full_name}", group=GROUP, on_end=leave)
        self._node = node
        self._is_advertised = False
        self._refusals = RefusalLog()

    def advertise(self) -> None:
        """Show its topic in the hub.

        Raises:
            WrongType: the topic has another type here.
            BadRequest: nobody knows the type here.
        """
        if not self._is_advertised:
            token = self.token
            self.participant.advertise(token.name, ros1_type(token.type_name), is_latched=token.qos.is_transient_local)
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
            count = self._refusals.count(error.kind, asyncio.get_running_loop().time())
            if count:
                by, reason = printable(self.participant.name), printable(str(error), 200)
                log.warning("ros2.refused", topic=topic, by=by, kind=error.kind, reason=reason, count=count)
                node = self._node.token.full_name
                self._node.hub.rosout.warn(node, f"{topic} of {by} is refused ({error.kind}): {reason}")


class _Token(NamedTuple):
    """A publisher's token, and when it came."""

    token: EndpointToken
    came_s: float


class Publishers:
    """All publishers of ROS 2, by their tokens."""

    def __init__(self, node: RmwNode, remote: RemoteGraph, log_once: LogOnce) -> None:
        self._node, self._remote, self._log_once = node, remote, log_once
        self._gone: dict[str, None] = {}  # tokens that may be back after a cut
        self._began_s = asyncio.get_running_loop().time()
        self._publishers = Mirror[str, _Token, Publisher](
            self._open,
            lambda _, error: node.hub.isolation.crashed("graph", error, graph="ros2"),
            limit=MAX_PUBLISHERS,
            group_of=session_of,
            group_limit=MAX_PUBLISHERS_OF_SESSION,
            is_same=lambda before, now: before.token == now.token,
            on_crowded=lambda _: node.counts.update(("crowded_publishers",)),
        )

    def add(self, token: EndpointToken, key: str) -> None:
        """A publisher has come."""
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
        for each in removed.unsure:
            self._publishers.put(each.key, None)
            if each.key != removed.publisher.key:
                self.add(each.token, each.key)

    def advertise_all(self) -> None:
        """The hub's graph has changed: types that were wrong may be right."""
        for each in self._publishers.endpoints.values():
            self._advertise(each)

    def join(self, subject: Subject) -> None:
        """A velocity is subscribed from now on: publishers that are there may be in the middle of a motion."""
        for each in self._publishers.endpoints.values():
            if (each.token.name, each.token.type_name) == subject:
                self._expect_earlier(each)

    def has_signed(self, gid: bytes) -> bool:
        """Whether a publisher has signed by it; in any thread."""
        return self._remote.is_known(gid)

    def clear(self) -> None:
        """All leave."""
        self._publishers.close()

    def publish(self, attachment: Attachment, subject: Subject, payload: bytes, *, topic: str) -> None:
        """Publish as the publisher that has signed the message, with the time that it waited on its way."""
        remote = self._remote.publisher(attachment.gid, subject)
        publisher = None if remote is None else self._publishers.endpoints.get(remote.key)
        if publisher is None:
            self._node.counts["unidentified"] += 1
            return
        now_s = asyncio.get_running_loop().time()
        late_s = publisher.clock.late_s(attachment.sequence_number, attachment.source_ns, now_s)
        epoch = publisher.motion.pop_epoch(self._node.hub.gates.came_s(now_s))
        if attachment.sequence_number <= FIRST_NUMBER:
            epoch = None  # it is the first that it has ever sent
        publisher.publish(topic, payload, received_s=now_s - late_s, epoch=epoch)

    def _open(self, key: str, spec: _Token) -> Publisher:
        made = Publisher(self._node, spec.token, lambda: self._publishers.put(key, None))
        now_s, is_back = asyncio.get_running_loop().time(), key in self._gone
        self._gone.pop(key, None)
        has_waited = now_s > spec.came_s + NEW_S  # for room
        if is_back or has_waited or now_s < self._began_s + MATCH_S:  # it was there before this daemon
            self._expect_earlier(made)
        self._advertise(made)
        return made

    @staticmethod
    def _expect_earlier(publisher: Publisher) -> None:
        publisher.motion = EarlierMotion(asyncio.get_running_loop().time() + MATCH_S)

    def _advertise(self, publisher: Publisher) -> None:
        token = publisher.token
        try:
            publisher.advertise()
        except WrongType as error:
            self._log_once("ros2.topic_refused", name=token.name, type=token.type_name, reason=str(error))
        except BadRequest as error:
            self._log_once("ros2.type_unknown", name=token.type_name, topic=token.name, reason=str(error))


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to be subscribed, and what becomes of it: two that are equal are one subscription."""

    name: str  # of the topic in ROS 2
    type: Ros2Message
    topic: str  # in the hub
    is_velocity: bool = False
    is_stripped: bool = False  # of a TwistStamped the Twist alone is published
    has_history: bool = False  # what publishers keep for those who come later is requested

    @property
    def qos(self) -> Qos:
        """As the tools of ROS 2 show it."""
        if self.is_velocity:
            return COMMANDS
        return Qos(is_transient_local=self.has_history, depth=TELEMETRY.depth)


class Subscription:
    """`close` ends it."""

    def __init__(self, node: RmwNode, wanted: Wanted, publishers: Publishers) -> None:
        """Declare it.

        Raises:
            ConfigError: the session is closed.
        """
        self._node, self._wanted, self._publishers = node, wanted, publishers
        type_ = wanted.type
        self._endpoint = node.endpoint(Kind.SUBSCRIPTION, wanted.name, type_.name, type_.type_hash, wanted.qos)
        if wanted.is_velocity:
            publishers.join((wanted.name, type_.name))
        self._subscription = node.session.subscribe(
            self._endpoint.key,
            self._receive,
            signer_of=self._signer_of,
            max_bytes=MAX_FLAT_BYTES if type_.is_flat else MAX_NESTED_BYTES,
            max_waiting=1 if wanted.is_velocity else MAX_WAITING,
            has_history=wanted.has_history,
        )

    def close(self) -> None:
        """Subscribe no more."""
        self._endpoint.close()
        self._subscription.close()

    def _signer_of(self, attachment: bytes) -> str:
        """In a thread of Zenoh's: those who are not known share one queue."""
        gid = attachment[-GID_BYTES:]
        return gid.hex() if self._publishers.has_signed(gid) else ""

    def _receive(self, sample: Sample) -> None:
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
