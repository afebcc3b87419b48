"""Publisher: a node of ROS that publishes a topic for us; each is a participant of its own while it is connected.

So the robot that it drives stops when its connection ends, or the master names it no more.
"""

import asyncio
import math
from typing import Any

import structlog

from hostlink.errors import BadPayload, HostlinkError
from hostlink.graphs.refusal_log import RefusalLog
from hostlink.graphs.ros1.parts import TIMEOUT_S, Parts
from hostlink.graphs.ros1.tcpros import ANY, BadHeader, Header, decode_header
from hostlink.graphs.ros1.wire import Wire
from hostlink.hub.graph_view import GraphTopic
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.messages.message_type import MessageType
from hostlink.robot.admission import EarlierMotion

log = structlog.get_logger()

NEW_S = 1.0  # after the master has named it, a new publisher is connected; later it may be in the middle of a motion
MAX_REASON = 200  # characters in the log
MAX_PORT = 0xFFFF


class Publisher:
    """`receive` connects once; whoever calls it again connects again. `close` comes before its end."""

    def __init__(self, parts: Parts, topic: GraphTopic, name: str, uri: str, *, is_new: bool) -> None:
        """`name`: of the topic in ROS; `is_new`: it came after the subscription, so what it publishes first is new."""
        self.uri = uri
        self._parts, self._topic, self._name = parts, topic, name
        self._new_until_s = asyncio.get_running_loop().time() + NEW_S if is_new else 0.0
        self._refusals = RefusalLog()
        self._connection: _Connection | None = None

    @property
    def is_connected(self) -> bool:
        """Whether its messages come."""
        return self._connection is not None and self._connection.is_accepted

    def close(self) -> None:
        """What it drives stops."""
        if self._connection is not None:
            self._connection.wire.close()

    async def receive(self) -> None:
        """Hold one connection, from the request for it to its end.

        Raises:
            Unreachable, Refused, BadHeader, HostlinkError, OSError: there is none; a TimeoutError is an OSError.
        """
        is_new = asyncio.get_running_loop().time() < self._new_until_s
        self._new_until_s = 0.0  # tried again, it may be in the middle of what it did before
        async with asyncio.timeout(TIMEOUT_S):
            found = await self._parts.rpc.call(self.uri, "requestTopic", self._parts.node, self._name, [["TCPROS"]])
            host, port = _address(found)
        connection = self._connection = _Connection(self._parts, self._topic, self._refusals, is_new=is_new)
        try:
            async with asyncio.timeout(TIMEOUT_S):
                await asyncio.get_running_loop().create_connection(lambda: connection.wire, host, port)
                connection.wire.send_header(_request(self._parts, self._topic, self._name))
                await connection.accepted
            await connection.ended
        finally:
            connection.wire.close()


class _Connection:
    """One connection to the publisher: first its header, then messages."""

    def __init__(self, parts: Parts, topic: GraphTopic, refusals: RefusalLog, *, is_new: bool) -> None:
        self.wire = Wire(parts.hub, self._begin, self._end)
        self.accepted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._parts, self._topic, self._refusals, self._is_new = parts, topic, refusals, is_new
        self._source: _Source | None = None

    @property
    def is_accepted(self) -> bool:
        return self._source is not None and not self.ended.done()

    def _begin(self, messages: list[bytes]) -> None:
        """The first message is its header."""
        if self.accepted.done():  # the deadline was first
            return
        try:
            self._accept(decode_header(messages[0]))
        except (BadHeader, HostlinkError) as error:
            self.accepted.set_exception(error)
        else:
            self.accepted.set_result(None)
            if messages[1:]:
                self.wire.receive(messages[1:])

    def _accept(self, header: Header) -> None:
        """Join the hub.

        Raises:
            BadHeader: it publishes something else.
            WrongType, BadRequest: the hub has the topic with another type.
        """
        type_ = self._type(header)
        is_latched, is_velocity = header.get("latching") == "1", self._topic.is_velocity
        participant = self._parts.join(printable(header.get("callerid", self.wire.peer)), self.wire.close)
        motion = self._earlier_motion(is_latched=is_latched)
        self._source = _Source(self._parts, self._topic, type_, participant, self.wire, motion, self._refusals)
        participant.advertise(self._topic.name, type_.name, is_latched=is_latched and not is_velocity)
        self.wire.stream.max_bytes = self._parts.max_message_bytes
        self.wire.receive = self._source.receive

    def _earlier_motion(self, *, is_latched: bool) -> EarlierMotion:
        """What a publisher that was there before has latched is of then, whenever it comes."""
        if self._is_new:
            return EarlierMotion()
        if is_latched:
            return EarlierMotion(math.inf)
        return EarlierMotion.within_a_lease(asyncio.get_running_loop().time())

    def _type(self, header: Header) -> MessageType:
        if "error" in header:
            raise BadHeader(header["error"])
        name, md5 = (printable(header.get(field, "")) for field in ("type", "md5sum"))
        found = self._parts.hub.catalog.message(name)
        if found is None:
            raise BadHeader(f"unknown type {name}; put its .msg into a folder of messages")
        if md5 != found.md5 or self._topic.type_name not in ("", found.name):
            raise BadHeader(f"it publishes {name} with md5 {md5}")
        return found

    def _end(self) -> None:
        """The wire is closed."""
        if self._source is not None:
            self._source.participant.leave()
        if not self.accepted.done():
            self.accepted.set_exception(ConnectionResetError("closed before its header"))
            self.accepted.exception()  # nobody may wait for it any more
        if not self.ended.done():
            self.ended.set_result(None)


class _Source:
    """The messages of one connection, and the participant that publishes them here."""

    def __init__(
        self,
        parts: Parts,
        topic: GraphTopic,
        type_: MessageType,
        participant: Participant,
        wire: Wire,
        motion: EarlierMotion,
        refusals: RefusalLog,
    ) -> None:
        self.participant = participant
        self._parts, self._topic, self._type, self._stream = parts, topic, type_, wire.stream
        self._motion, self._refusals = motion, refusals
        self._too_large = 0

    def receive(self, messages: list[bytes]) -> None:
        """Publish them; of velocities the newest alone, for those before it are over."""
        counts = self._parts.counts
        counts.messages_from_ros += len(messages)
        counts.too_large_messages += self._stream.too_large - self._too_large
        self._too_large = self._stream.too_large
        if self._topic.is_velocity and len(messages) > 1:
            counts.superseded_velocities += len(messages) - 1
            del messages[:-1]
        for payload in messages:
            self._publish(payload)

    def _publish(self, payload: bytes) -> None:
        name = self._topic.name
        try:
            self._check(payload)
            self.participant.publish(name, payload, epoch=self._epoch())
        except BadPayload as error:
            self._parts.counts.malformed_messages += 1
            self._parts.log_once(
                "ros1.message_malformed",
                topic=printable(name),
                node=self.participant.name,
                reason=type(error).__name__,
            )
        except HostlinkError as error:
            self._parts.counts.refused_messages += 1
            self._log_refusal(error)

    def _epoch(self) -> int | None:
        """Of a velocity; other messages have none."""
        if not self._topic.is_velocity:
            return None
        return self._motion.pop_epoch(self._parts.hub.gates.came_s(asyncio.get_running_loop().time()))

    def _log_refusal(self, error: HostlinkError) -> None:
        """In the daemon's log and in that of ROS."""
        topic, kind, reason = printable(self._topic.name), error.kind, printable(str(error), MAX_REASON)
        count = self._refusals.count(kind, asyncio.get_running_loop().time())
        if count:
            node = self.participant.name
            log.warning("ros1.message_refused", topic=topic, node=node, kind=kind, reason=reason, count=count)
            self._parts.hub.rosout.warn(self._parts.node, f"{topic} of {node} is refused ({kind}): {reason}")

    def _check(self, payload: bytes) -> None:
        """A device reads what it is sent without checking it.

        Raises:
            BadPayload: it is not exactly one message of the type that was agreed upon.
        """
        fixed_bytes = self._type.fixed_bytes
        if fixed_bytes is None:
            self._type.decode(payload)
        elif len(payload) != fixed_bytes:
            raise BadPayload(self._type.name, f"{len(payload)} bytes instead of {fixed_bytes}")


def _request(parts: Parts, topic: GraphTopic, name: str) -> Header:
    type_ = topic.type
    return {
        "callerid": parts.node,
        "topic": name,
        "type": ANY if type_ is None else type_.name,
        "md5sum": ANY if type_ is None else type_.md5,
        "message_definition": "" if type_ is None else type_.full_definition,
        "tcp_nodelay": "1",
    }


def _address(found: Any) -> tuple[str, int]:
    """Of the answer to requestTopic.

    Raises:
        BadHeader: it is none.
    """
    match found:
        case ["TCPROS", str(host), int(port)] if 0 < port <= MAX_PORT:
            return host, port
    raise BadHeader("it offers no TCPROS")
