"""Publishers of ROS 2 in the hub: a participant for each, whose velocities end when it leaves its graph."""

import asyncio
from collections import Counter
from collections.abc import Callable

import structlog

from hostlink.errors import BadRequest, CommandRefused, HostlinkError, RefusalKind, WrongType
from hostlink.graphs.refusal_log import RefusalLog
from hostlink.graphs.ros2_types import ros1_type
from hostlink.graphs.zenoh.rmw_attachment import Attachment
from hostlink.graphs.zenoh.rmw_freshness import SourceClock
from hostlink.graphs.zenoh.rmw_graph import RemoteGraph, Removed, Subject
from hostlink.graphs.zenoh.rmw_names import is_hidden
from hostlink.graphs.zenoh.rmw_node import GROUP, RmwNode
from hostlink.graphs.zenoh.rmw_once import Once
from hostlink.graphs.zenoh.rmw_token import EndpointToken
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.robot.admission import EarlierMotion

MAX_PUBLISHERS = 1024  # participants
MAX_PUBLISHERS_OF_SESSION = 128  # of one process
MAX_GONE = MAX_PUBLISHERS  # tokens that are remembered; the one that left first is forgotten first
MATCH_S = 3.0  # until Zenoh has connected a publisher and a subscription that know of each other
FIRST_NUMBER = 1  # of the messages of a publisher
OWN_TOPICS = frozenset({"/rosout", "/parameter_events"})  # that every node of ROS 2 publishes, for its own tools

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


class Publishers:
    """All publishers of ROS 2, by their tokens."""

    def __init__(self, node: RmwNode, remote: RemoteGraph, once: Once) -> None:
        self._node, self._remote, self._once = node, remote, once
        self._publishers: dict[str, Publisher] = {}
        self._of_session: Counter[str] = Counter()
        self._gone: dict[str, None] = {}  # tokens that may be back after a cut
        self._began_s = asyncio.get_running_loop().time()

    def add(self, token: EndpointToken, key: str) -> None:
        """A publisher has come."""
        if token.name in OWN_TOPICS or is_hidden(token.name) or key in self._publishers:
            return
        of_session = self._of_session[token.node.session]
        if len(self._publishers) >= MAX_PUBLISHERS or of_session >= MAX_PUBLISHERS_OF_SESSION:
            self._node.counts["crowded_publishers"] += 1
            return
        self._of_session[token.node.session] += 1
        made = self._publishers[key] = Publisher(self._node, token, lambda: self._drop(key))
        is_back = key in self._gone
        self._gone.pop(key, None)
        if is_back or asyncio.get_running_loop().time() < self._began_s + MATCH_S:  # it was there before this daemon
            self._expect_earlier(made)
        self._advertise(made)

    def remove(self, removed: Removed) -> None:
        """A publisher has gone: what it drives stops. So does what those drive who cannot be distinguished from it."""
        if removed.publisher is None:
            return
        self._drop(removed.publisher.key)
        self._gone[removed.publisher.key] = None
        if len(self._gone) > MAX_GONE:
            del self._gone[next(iter(self._gone))]
        for each in removed.unsure:
            self._drop(each.key)
            if each.key != removed.publisher.key:
                self.add(each.token, each.key)

    def advertise_all(self) -> None:
        """The hub's graph has changed: types that were wrong may be right."""
        for each in self._publishers.values():
            self._advertise(each)

    def join(self, subject: Subject) -> None:
        """A velocity is subscribed from now on: publishers that are there may be in the middle of a motion."""
        for each in self._publishers.values():
            if (each.token.name, each.token.type_name) == subject:
                self._expect_earlier(each)

    def has_signed(self, gid: bytes) -> bool:
        """Whether a publisher has signed by it; in any thread."""
        return self._remote.is_known(gid)

    def clear(self) -> None:
        """All leave."""
        for key in list(self._publishers):
            self._drop(key)

    def publish(self, attachment: Attachment, subject: Subject, payload: bytes, *, topic: str) -> None:
        """Publish as the publisher that has signed the message, with the time that it waited on its way."""
        remote = self._remote.publisher(attachment.gid, subject)
        publisher = None if remote is None else self._publishers.get(remote.key)
        if publisher is None:
            self._node.counts["unidentified"] += 1
            return
        now_s = asyncio.get_running_loop().time()
        late_s = publisher.clock.late_s(attachment.sequence_number, attachment.source_ns, now_s)
        epoch = publisher.motion.pop_epoch(self._node.hub.gates.came_s(now_s))
        if attachment.sequence_number <= FIRST_NUMBER:
            epoch = None  # it is the first that it has ever sent
        publisher.publish(topic, payload, received_s=now_s - late_s, epoch=epoch)

    @staticmethod
    def _expect_earlier(publisher: Publisher) -> None:
        publisher.motion = EarlierMotion(asyncio.get_running_loop().time() + MATCH_S)

    def _advertise(self, publisher: Publisher) -> None:
        token = publisher.token
        try:
            publisher.advertise()
        except WrongType as error:
            self._once.log("ros2.topic_refused", token.name, token.type_name, reason=str(error))
        except BadRequest as error:
            self._once.log("ros2.type_unknown", token.type_name, topic=token.name, reason=str(error))

    def _drop(self, key: str) -> None:
        publisher = self._publishers.pop(key, None)
        if publisher is not None:
            self._of_session -= Counter([publisher.token.node.session])
            publisher.participant.leave()
