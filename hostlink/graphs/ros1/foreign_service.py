"""ForeignService: one service of another node of ROS, which devices and programs call here."""

import asyncio
import urllib.parse
from collections.abc import Mapping
from struct import Struct

from hostlink.errors import HostlinkError, ServiceFailed
from hostlink.graphs.ros1.parts import TIMEOUT_S, Parts
from hostlink.graphs.ros1.tcpros import (
    ANY,
    LENGTH_BYTES,
    MAX_HEADER_BYTES,
    BadHeader,
    Header,
    decode_header,
    encode_header,
    encode_message,
)
from hostlink.graphs.ros1.xml_rpc import Refused, Unreachable
from hostlink.hub.participant import Participant
from hostlink.logs import printable
from hostlink.messages.message_type import ServiceType

_LENGTH = Struct("<I")
_FAILURES = (Unreachable, Refused, BadHeader, OSError, EOFError)  # a TimeoutError is an OSError


class ForeignService:
    """A participant that provides it, until it is withdrawn."""

    def __init__(self, parts: Parts, service: str, name: str, type_: ServiceType) -> None:
        """`service`: its name in the hub, `name` in ROS.

        Raises:
            BadRequest: hostlink has a service of that name itself.
        """
        self.name, self._parts, self._type = name, parts, type_
        self._participant: Participant = parts.join(name)
        try:
            self._participant.provide(service, type_.name, self._answer)
        except HostlinkError:
            self._participant.leave()
            raise

    def close(self) -> None:
        """Nobody provides it in ROS any more."""
        self._participant.leave()

    async def _answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        payload = self._type.request.encode(request)
        try:
            answer = await self._call(payload)
        except _FAILURES as error:
            self._parts.counts.failed_services += 1
            raise ServiceFailed(self.name, printable(str(error) or type(error).__name__, 200)) from error
        except HostlinkError:
            self._parts.counts.failed_services += 1
            raise
        return self._type.response.decode(answer)

    async def _call(self, payload: bytes) -> bytes:
        """The payload of the answer; Provider.call sets the deadline."""
        fields = {"md5sum": self._type.md5, "type": self._type.name}
        reader, writer, _ = await connect(self._parts, self.name, fields)
        try:
            writer.write(encode_message(payload))
            is_done = await reader.readexactly(1) == b"\x01"
            answer = await _read_message(reader, self._parts.max_message_bytes)
        finally:
            writer.transport.abort()
        if not is_done:
            raise ServiceFailed(self.name, printable(answer.decode(errors="replace"), 200))
        return answer


async def find_type(parts: Parts, name: str) -> tuple[str, str]:
    """(type, md5 sum) of a service of ROS, as its node announces it.

    Raises:
        Unreachable, Refused, BadHeader, OSError, EOFError: nobody answers for it.
    """
    _, writer, header = await connect(parts, name, {"md5sum": ANY, "probe": "1"})
    writer.transport.abort()
    return header.get("type", ""), header.get("md5sum", "")


async def connect(
    parts: Parts, name: str, fields: Header
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, dict[str, str]]:
    """A connection to the service, and the header of its answer.

    Raises:
        Unreachable, Refused, BadHeader, OSError, EOFError: nobody answers for it.
    """
    async with asyncio.timeout(TIMEOUT_S):
        where = urllib.parse.urlsplit(str(await parts.master.call("lookupService", name)))
        if where.scheme != "rosrpc" or not where.hostname or not where.port:
            raise BadHeader("its address is no rosrpc://HOST:PORT")
        reader, writer = await asyncio.open_connection(where.hostname, where.port)
        try:
            writer.write(encode_header({"callerid": parts.node, "service": name, **fields}))
            header = _accepted(decode_header(await _read_message(reader, MAX_HEADER_BYTES)))
        except BaseException:
            writer.transport.abort()
            raise
    return reader, writer, header


def _accepted(header: dict[str, str]) -> dict[str, str]:
    if "error" in header:
        raise BadHeader(header["error"])
    return header


async def _read_message(reader: asyncio.StreamReader, max_bytes: int) -> bytes:
    size = int(_LENGTH.unpack(await reader.readexactly(LENGTH_BYTES))[0])
    if size > max_bytes:
        raise BadHeader(f"an answer of {size} bytes, over {max_bytes}")
    return await reader.readexactly(size)
