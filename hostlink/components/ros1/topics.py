"""Topics of the hub and of ROS 1 nodes: publications to their subscribers, and connections to their publishers."""

import asyncio
import math
from typing import Any

import structlog

from hostlink.components.graphs.hub_source import HubSource
from hostlink.components.ros1.connections import Wire
from hostlink.components.ros1.local_node import TIMEOUT_S, LocalNode
from hostlink.components.ros1.tcpros import ANY, BadHeader, Header, check_header, decode_answer_header, encode_message
from hostlink.core.host import GraphTopic, Message, Participant
from hostlink.core.messages.message_type import MessageType
from hostlink.core.robot.admission import EarlierMotion, Resumption
from hostlink.core.robot.newest import is_zero_twist, newest
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable
from hostlink.errors import BadPayload, HostlinkError

MAX_SUBSCRIBERS = 64  # of one topic

NEW_S = 1.0  # after the master has named it, a new publisher is connected; later it may be in the middle of a motion
MAX_REASON = 200  # characters in the log
MAX_PORT = 0xFFFF


class RosPublication:
    """Topic of the hub for ROS nodes. It subscribes in the hub while a node is connected, and forwards payloads."""

    def __init__(self, node: LocalNode, topic: str, name: str, type_: MessageType, *, is_latched: bool) -> None:
        """`topic`: its name in the hub, `name` in ROS."""
        self.topic, self.name, self.type, self.is_latched = topic, name, type_, is_latched
        self.subscribers: dict[Wire, str] = {}  # name of the node
        self._node = node
        self._source = HubSource(
            lambda: node.join(name, self.close), topic, self._receive, self._fail, type_name=type_.name
        )
        self._header = {
            "callerid": node.name,
            "topic": name,
            "type": type_.name,
            "md5sum": type_.md5,
            "message_definition": type_.full_definition,
            "latching": str(int(is_latched)),
            "tcp_nodelay": "1",
        }

    def accept(self, wire: Wire, header: Header) -> None:
        """Accept a subscriber: it receives the latched message and all later ones.

        Raises:
            BadHeader: its header does not fit, or there are too many.
        """
        if len(self.subscribers) >= MAX_SUBSCRIBERS:
            raise BadHeader(f"more than {MAX_SUBSCRIBERS} subscribers of {self.name}")
        check_header(header, self.name, self.type)
        wire.send_header(self._header)
        wire.receive = lambda _: None  # a subscriber has nothing more to send
        wire.on_end = lambda: self._remove(wire)
        self._send_latched(wire)
        self.subscribers[wire] = printable(header["callerid"])
        self._source.set_read(True)

    def close(self) -> None:
        """Disconnect every subscriber."""
        for wire in list(self.subscribers):
            wire.close()

    def _fail(self, error: HostlinkError) -> None:
        """Disconnect all subscribers, because the topic has another type now: the graph reports it soon."""
        self._node.log_once("ros1.publication_failed", topic=self.name, reason=str(error))
        self.close()

    def _remove(self, wire: Wire) -> None:
        self._node.counts.dropped_to_slow_subscribers += wire.outgoing.dropped
        self.subscribers.pop(wire, None)
        if not self.subscribers:
            self._source.set_read(False)

    def _send_latched(self, wire: Wire) -> None:
        """Send the latched message to a later subscriber; the first gets it from the hub."""
        if self.is_latched and self._source.is_read:
            visitor = self._node.join(self.name)
            visitor.subscribe(self.topic, lambda message: wire.send(encode_message(message.payload)))
            visitor.leave()

    def _receive(self, message: Message) -> None:
        data = encode_message(message.payload)
        for wire in self.subscribers:
            wire.send(data)
        self._node.counts.messages_to_ros += len(self.subscribers)


log = structlog.get_logger()


class RosPublisher:
    """Node of ROS that publishes a topic. Each call of `receive` connects once; `close` disconnects."""

    def __init__(self, node: LocalNode, topic: GraphTopic, name: str, uri: str, *, is_new: bool) -> None:
        """`name`: of the topic in ROS; `is_new`: it appeared after the subscription, so its first message is new."""
        self.uri = uri
        self._node, self._topic, self._name = node, topic, name
        self._new_until_s = asyncio.get_running_loop().time() + NEW_S if is_new else 0.0
        self._refusals = Budget()
        self._connection: _PublisherConnection | None = None

    @property
    def is_connected(self) -> bool:
        """Whether the publisher's header was accepted."""
        return self._connection is not None and self._connection.is_accepted

    def close(self) -> None:
        """Disconnect: what the publisher drives stops."""
        if self._connection is not None:
            self._connection.wire.close()

    async def receive(self) -> None:
        """Hold one connection, from the request for it to its end.

        Raises:
            Unreachable, Refused, BadHeader, HostlinkError, OSError: no connection; a TimeoutError is an OSError.
        """
        is_new = asyncio.get_running_loop().time() < self._new_until_s
        self._new_until_s = 0.0  # tried again, it may be in the middle of what it did before
        async with asyncio.timeout(TIMEOUT_S):
            found = await self._node.rpc.call(self.uri, "requestTopic", self._node.name, self._name, [["TCPROS"]])
            host, port = _address(found)
        connection = self._connection = _PublisherConnection(self._node, self._topic, self._refusals, is_new=is_new)
        try:
            async with asyncio.timeout(TIMEOUT_S):
                await asyncio.get_running_loop().create_connection(lambda: connection.wire, host, port)
                connection.wire.send_header(_request(self._node, self._topic, self._name))
                await connection.accepted
            await connection.ended
        finally:
            connection.wire.close()


class _PublisherConnection:
    """Connection to a publisher: first its header, then its messages, which a participant publishes in the hub."""

    def __init__(self, node: LocalNode, topic: GraphTopic, refusals: Budget, *, is_new: bool) -> None:
        self.wire = Wire(node.host, self._begin, self._end)
        self.accepted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.participant: Participant | None = None  # from the header to the end
        self._node, self._topic, self._refusals, self._is_new = node, topic, refusals, is_new
        self._motion = EarlierMotion()
        self._resumption = Resumption()
        self._too_large = 0

    @property
    def is_accepted(self) -> bool:
        return self.participant is not None and not self.ended.done()

    def _begin(self, messages: list[bytes]) -> None:
        """Read the first message, which is the header."""
        if self.accepted.done():  # the deadline was first
            return
        try:
            self._accept(decode_answer_header(messages[0]))
        except (BadHeader, HostlinkError) as error:
            self.accepted.set_exception(error)
        else:
            self.accepted.set_result(None)
            if messages[1:]:
                self.wire.receive(messages[1:])

    def _accept(self, header: Header) -> None:
        """Join the hub.

        Raises:
            BadHeader: the publisher has another type.
            WrongType, BadRequest: the hub has the topic with another type.
        """
        type_ = self._type(header)
        is_latched, is_velocity = header.get("latching") == "1", self._topic.is_velocity
        self._motion = self._earlier_motion(is_latched=is_latched)
        participant = self._node.join(printable(header.get("callerid", self.wire.peer)), self.wire.close)
        self.participant = participant
        participant.advertise(self._topic.name, type_.name, is_latched=is_latched and not is_velocity)
        self.wire.stream.max_bytes = self._node.config.max_message_bytes
        self.wire.receive = lambda messages: self._receive(messages, participant, type_)

    def _earlier_motion(self, *, is_latched: bool) -> EarlierMotion:
        """Return how to treat the first velocity. An earlier publisher's latched one is old whenever it arrives."""
        if self._is_new:
            return EarlierMotion()
        if is_latched:
            return EarlierMotion(math.inf)
        return EarlierMotion.within_a_lease(asyncio.get_running_loop().time())

    def _type(self, header: Header) -> MessageType:
        name, md5 = (printable(header.get(field, "")) for field in ("type", "md5sum"))
        found = self._node.host.messages.message(name)
        if found is None:
            raise BadHeader(f"unknown type {name}; put its .msg into a folder of messages")
        if md5 != found.md5 or self._topic.type_name not in ("", found.name):
            raise BadHeader(f"it publishes {name} with md5 {md5}")
        return found

    def _end(self) -> None:
        """Follow the close of the wire."""
        if self.participant is not None:
            self.participant.leave()
        if not self.accepted.done():
            self.accepted.set_exception(ConnectionResetError("closed before its header"))
            self.accepted.exception()  # the waiter may be gone
        if not self.ended.done():
            self.ended.set_result(None)

    def _receive(self, messages: list[bytes], participant: Participant, type_: MessageType) -> None:
        """Publish messages; of several velocities only the newest, and the newest zero before it.

        After a silence also the first: it shows the admission that they waited for the network.
        """
        counts, stream = self._node.counts, self.wire.stream
        counts.messages_from_ros += len(messages)
        counts.too_large_messages += stream.too_large - self._too_large
        self._too_large = stream.too_large
        is_resumed = self._topic.is_velocity and self._resumption.is_recent(self.wire.came_s)
        if self._topic.is_velocity and len(messages) > 1:
            obeyed = newest(messages, is_zero_twist)
            if is_resumed and len(obeyed) == 1:
                obeyed = [messages[0], *obeyed]
            counts.superseded_velocities += len(messages) - len(obeyed)
            messages = obeyed
        for payload in messages:
            self._publish(payload, participant, type_)

    def _publish(self, payload: bytes, participant: Participant, type_: MessageType) -> None:
        name = self._topic.name
        try:
            _check(payload, type_)
            came_s = self.wire.came_s if self._topic.is_velocity else None
            epoch = None if came_s is None else self._motion.pop_epoch(came_s)
            participant.publish(name, payload, at_s=came_s, epoch=epoch)
        except BadPayload as error:
            self._node.counts.malformed_messages += 1
            self._node.log_once(
                "ros1.message_malformed", topic=printable(name), node=participant.name, reason=type(error).__name__
            )
        except HostlinkError as error:
            self._node.counts.refused_messages += 1
            self._log_refusal(error, participant.name)

    def _log_refusal(self, error: HostlinkError, node: str) -> None:
        """Log a refusal in the daemon's log and on /rosout."""
        topic, kind, reason = printable(self._topic.name), error.kind, printable(str(error), MAX_REASON)
        if counts := self._refusals.due(kind, asyncio.get_running_loop().time()):
            log.warning("ros1.message_refused", topic=topic, node=node, kind=kind, reason=reason, **counts)
            self._node.host.warn(self._node.name, f"{topic} of {node} is refused ({kind}): {reason}")


def _check(payload: bytes, type_: MessageType) -> None:
    """Refuse what a device could not read: devices do not check messages.

    Raises:
        BadPayload: the payload is not exactly one message of the agreed type.
    """
    if type_.fixed_bytes is None:
        type_.decode(payload)
    elif len(payload) != type_.fixed_bytes:
        raise BadPayload(type_.name, f"{len(payload)} bytes instead of {type_.fixed_bytes}")


def _request(node: LocalNode, topic: GraphTopic, name: str) -> Header:
    type_ = topic.type
    return {
        "callerid": node.name,
        "topic": name,
        "type": ANY if type_ is None else type_.name,
        "md5sum": ANY if type_ is None else type_.md5,
        "message_definition": "" if type_ is None else type_.full_definition,
        "tcp_nodelay": "1",
    }


def _address(found: Any) -> tuple[str, int]:
    """Read host and port from the answer to requestTopic.

    Raises:
        BadHeader: the answer has no TCPROS address.
    """
    match found:
        case ["TCPROS", str(host), int(port)] if 0 < port <= MAX_PORT:
            return host, port
    raise BadHeader("it offers no TCPROS")
