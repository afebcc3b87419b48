"""Services in both directions: services of the hub for ROS, and services of ROS nodes for the hub."""

import asyncio
import urllib.parse
from collections.abc import Mapping

from hostlink.components.ros1.connections import Wire
from hostlink.components.ros1.local_node import TIMEOUT_S, LocalNode
from hostlink.components.ros1.tcpros import (
    ANY,
    LENGTH_BYTES,
    MAX_HEADER_BYTES,
    BadHeader,
    Header,
    check_header,
    decode_answer_header,
    encode_answer,
    encode_failure,
    encode_header,
    encode_message,
)
from hostlink.components.ros1.xml_rpc import CallRefused, Unreachable
from hostlink.core.host import Participant
from hostlink.core.messages.message_type import ServiceType
from hostlink.core.runtime.logs import printable
from hostlink.errors import HostlinkError, ServiceFailed

MAX_CALLERS = 64  # of one service
MAX_WAITING = 8  # calls of one connection; nodes of ROS send the next one after the answer
FAILURES = (Unreachable, CallRefused, BadHeader, OSError, EOFError)  # a TimeoutError is an OSError


class ServiceOffer:
    """Service of the hub that ROS nodes call. Each connection is a participant, so its calls end with it."""

    def __init__(self, node: LocalNode, service: str, name: str, type_: ServiceType) -> None:
        """`service`: its name in the hub, `name` in ROS."""
        self.service, self.name, self.type = service, name, type_
        self.callers: dict[Wire, _Caller] = {}  # oldest first
        self._node = node

    def accept(self, wire: Wire, header: Header) -> None:
        """A node requests the type of the service, or calls it.

        Raises:
            BadHeader: its header does not fit, or there are too many callers.
        """
        is_probe = header.get("probe") == "1"
        check_header(header, self.name, self.type)
        if not is_probe and len(self.callers) >= MAX_CALLERS and not self._make_room():
            raise BadHeader(f"more than {MAX_CALLERS} callers of {self.name}")
        wire.send_header(
            {
                "callerid": self._node.name,
                "service": self.name,
                "type": self.type.name,
                "md5sum": self.type.md5,
                "request_type": self.type.request.name,
                "response_type": self.type.response.name,
            }
        )
        if is_probe:
            wire.close()
            return
        caller = self.callers[wire] = _Caller(self, wire, self._node, header)
        wire.stream.max_bytes = self._node.config.max_message_bytes
        wire.receive, wire.on_end = caller.receive, caller.end

    def close(self) -> None:
        for wire in list(self.callers):
            wire.close()

    def _make_room(self) -> bool:
        """Close the oldest idle caller. Return whether one was idle."""
        idle = next((wire for wire, caller in self.callers.items() if not caller.is_working), None)
        if idle is not None:
            self._node.counts.crowded_out += 1
            idle.close()
        return idle is not None


class _Caller:
    """Connection that calls the service, one call after another."""

    def __init__(self, offer: ServiceOffer, wire: Wire, node: LocalNode, header: Header) -> None:
        self._offer, self._wire, self._node = offer, wire, node
        self._name = printable(header["callerid"])
        self._participant: Participant = node.join(self._name, wire.close)
        self._waiting: list[bytes] = []
        self.is_working = False

    def receive(self, requests: list[bytes]) -> None:
        self._waiting += requests
        if len(self._waiting) > MAX_WAITING:
            self._node.counts.failed_services += 1
            self._wire.close()
        elif not self.is_working:
            self.is_working = True
            self._node.spawn(self._work(), name=f"ROS 1 call of {printable(self._offer.name)}")

    def end(self) -> None:
        if self._wire.outgoing.is_too_slow:
            self._node.counts.failed_services += 1
            self._node.log_once("ros1.caller_too_slow", service=self._offer.name, caller=self._name)
        self._offer.callers.pop(self._wire, None)
        self._waiting.clear()
        self._participant.leave()

    async def _work(self) -> None:
        try:
            while self._waiting and not self._wire.is_closed:
                self._wire.send(await self._answer(self._waiting.pop(0)), is_answer=True)
        finally:
            self.is_working = False

    async def _answer(self, request: bytes) -> bytes:
        type_ = self._offer.type
        try:
            answer = await self._participant.call(self._offer.service, type_.request.decode(request))
            return encode_answer(type_.response.encode(answer))
        except HostlinkError as error:
            self._node.counts.failed_services += 1
            return encode_failure(str(error))


class ForeignService:
    """Service of a ROS node, which a participant provides in the hub."""

    def __init__(self, node: LocalNode, service: str, name: str, type_: ServiceType) -> None:
        """`service`: its name in the hub, `name` in ROS.

        Raises:
            BadRequest: hostlink has a service of that name itself.
        """
        self.name, self._node, self._type = name, node, type_
        self._participant: Participant = node.join(name)
        try:
            self._participant.provide(service, type_.name, self._answer)
        except HostlinkError:
            self._participant.leave()
            raise

    def close(self) -> None:
        """Withdraw the service from the hub."""
        self._participant.leave()

    async def _answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        payload = self._type.request.encode(request)
        try:
            answer = await self._call(payload)
        except FAILURES as error:
            self._node.counts.failed_services += 1
            raise ServiceFailed(self.name, printable(str(error) or type(error).__name__, 200)) from error
        except HostlinkError:
            self._node.counts.failed_services += 1
            raise
        return self._type.response.decode(answer)

    async def _call(self, payload: bytes) -> bytes:
        """Return the payload of the answer. Provider.call sets the deadline."""
        fields = {"md5sum": self._type.md5, "type": self._type.name}
        reader, writer, _ = await connect(self._node, self.name, fields)
        try:
            writer.write(encode_message(payload))
            is_done = await reader.readexactly(1) == b"\x01"
            answer = await _read_message(reader, self._node.config.max_message_bytes)
        finally:
            writer.transport.abort()
        if not is_done:
            raise ServiceFailed(self.name, printable(answer.decode(errors="replace"), 200))
        return answer


async def find_type(node: LocalNode, name: str) -> tuple[str, str]:
    """Return type and md5 sum of a service, as its node announces them.

    Raises:
        Unreachable, CallRefused, BadHeader, OSError, EOFError: the node does not answer.
    """
    _, writer, header = await connect(node, name, {"md5sum": ANY, "probe": "1"})
    writer.transport.abort()
    return header.get("type", ""), header.get("md5sum", "")


async def connect(
    node: LocalNode, name: str, fields: Header
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, dict[str, str]]:
    """Connect to a service; return the streams and the header of its answer.

    Raises:
        Unreachable, CallRefused, BadHeader, OSError, EOFError: the node does not answer.
    """
    async with asyncio.timeout(TIMEOUT_S):
        where = urllib.parse.urlsplit(str(await node.call_master("lookupService", name)))
        if where.scheme != "rosrpc" or not where.hostname or not where.port:
            raise BadHeader("its address is not of the form rosrpc://HOST:PORT")
        reader, writer = await asyncio.open_connection(where.hostname, where.port)
        try:
            writer.write(encode_header({"callerid": node.name, "service": name, **fields}))
            header = decode_answer_header(await _read_message(reader, MAX_HEADER_BYTES))
        except BaseException:
            writer.transport.abort()
            raise
    return reader, writer, header


async def _read_message(reader: asyncio.StreamReader, max_bytes: int) -> bytes:
    size = int.from_bytes(await reader.readexactly(LENGTH_BYTES), "little")
    if size > max_bytes:
        raise BadHeader(f"an answer of {size} bytes, over {max_bytes}")
    return await reader.readexactly(size)
