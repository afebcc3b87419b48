"""UnfinishedBag: a bag of ROS 1 without its index, read record by record: https://wiki.ros.org/Bags/Format/2.0.

rosbag names a file FILE.bag.active until it is closed. A writer that was killed leaves the last chunk with a length of
0 and its records behind it.
"""

import bz2
import heapq
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from hostlink.core.runtime.units import NS_PER_S

MAGIC = b"#ROSBAG V2.0\n"
MAX_RECORD_BYTES = 256 * 1024 * 1024  # a larger length is damage and is not read into memory
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_DAMAGES = (ValueError, KeyError, struct.error, EOFError, OSError, RuntimeError, IndexError)
_NEVER = 2**63


class _Message(NamedTuple):
    stamp_ns: int
    number: int  # in the file
    connection: int
    payload: bytes


class UnfinishedBag:
    """Reader with the part of rosbags' interface that BagReader needs."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.connections: list[Connection] = []
        self.message_count = 0
        self.start_time = _NEVER
        self._floors_ns: list[int] = []  # the lowest time of each part and of those behind it

    def open(self) -> None:
        """Read the connections and times of all messages.

        Raises:
            OSError: the file cannot be read.
            ValueError: it is not a bag.
        """
        for part in self._parts():
            self._floors_ns.append(min(message.stamp_ns for message in part))
            self.message_count += len(part)
        for number in range(len(self._floors_ns) - 1, 0, -1):
            self._floors_ns[number - 1] = min(self._floors_ns[number - 1], self._floors_ns[number])
        self.start_time = min(self._floors_ns, default=_NEVER)

    def close(self) -> None:
        """Close nothing: the file is open only while it is read."""

    def messages(
        self, connections: Collection[Connection], start: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield the messages of these connections ordered by time, from the time `start` on."""
        chosen = {each.id: each for each in connections}
        waiting: list[_Message] = []
        for number, part in enumerate(self._parts(), 1):
            for message in part:
                if message.connection in chosen and (start is None or message.stamp_ns >= start):
                    heapq.heappush(waiting, message)
            floor_ns = self._floors_ns[number] if number < len(self._floors_ns) else _NEVER
            while waiting and waiting[0].stamp_ns <= floor_ns:
                message = heapq.heappop(waiting)
                yield chosen[message.connection], message.stamp_ns, message.payload

    def _parts(self) -> Iterator[list[_Message]]:
        """Yield the messages of each chunk, and of the one that was not ended. Damage ends the reading."""
        known: dict[int, Connection] = {}
        count, part = 0, list[_Message]()
        with self._path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError(f"{self._path} is not a bag of ROS 1")
            for header, data in _records(file):
                for inner, content in _unpacked(header, data):
                    if inner["op"][0] == _CONNECTION:
                        _note(known, inner, content)
                    elif inner["op"][0] == _MESSAGE:
                        seconds, rest_ns = _TIME.unpack(inner["time"])
                        stamp_ns, (number,) = seconds * NS_PER_S + rest_ns, _U32.unpack(inner["conn"])
                        if number in known:
                            part.append(_Message(stamp_ns, count, number, content))
                            count += 1
                if part:
                    yield part
                    part = []
        self.connections = list(known.values())


def _records(file: IO[bytes]) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Yield header and data of the records of a file, up to its end or to damage. A chunk may be cut."""
    try:
        while True:
            header = _header(_sized(file))
            data = _sized(file, may_be_cut=header["op"][:1] == bytes((_CHUNK,)))
            yield header, data
    except _DAMAGES:
        return


def _sized(file: IO[bytes], *, may_be_cut: bool = False) -> bytes:
    (size,) = _U32.unpack(file.read(_U32.size))
    data = file.read(size) if size <= MAX_RECORD_BYTES else b""
    if len(data) != size and not may_be_cut:
        raise EOFError
    return data


def _header(data: bytes) -> dict[str, bytes]:
    fields, at = dict[str, bytes](), 0
    while at < len(data):
        (size,) = _U32.unpack_from(data, at)
        name, separator, value = data[at + _U32.size : at + _U32.size + size].partition(b"=")
        if not separator or at + _U32.size + size > len(data):
            raise ValueError("a field of a header")
        fields[name.decode()] = value
        at += _U32.size + size
    return fields


def _unpacked(header: dict[str, bytes], data: bytes) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Yield the records of a chunk up to damage, or the record itself, if it has a kind."""
    if not header.get("op"):
        return
    if header["op"][0] != _CHUNK:
        yield header, data
        return
    try:
        (size,) = _U32.unpack(header["size"])
        compression = header["compression"]
        if size > MAX_RECORD_BYTES:
            return
        if compression == b"bz2":
            data = bz2.BZ2Decompressor().decompress(data, size + 1)
        elif compression == b"lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        at = 0
        while at < len(data):
            (length,) = _U32.unpack_from(data, at)
            inner = _header(data[at + _U32.size : at + _U32.size + length])
            at += _U32.size + length
            (length,) = _U32.unpack_from(data, at)
            content = data[at + _U32.size : at + _U32.size + length]
            at += _U32.size + length
            if at > len(data):
                return
            if inner.get("op"):
                yield inner, content
    except _DAMAGES:
        return


def _note(known: dict[int, Connection], header: dict[str, bytes], data: bytes) -> None:
    """Keep a connection; it is repeated in each chunk."""
    (number,) = _U32.unpack(header["conn"])
    if number in known:
        return
    facts = {name: value.decode(errors="replace") for name, value in _header(data).items()}
    latching = facts.get("latching", "")
    known[number] = Connection(
        number,
        header["topic"].decode(errors="replace"),
        normalize_msgtype(facts["type"]),
        MessageDefinition(MessageDefinitionFormat.MSG, facts["message_definition"]),
        facts["md5sum"],
        0,
        ConnectionExtRosbag1(facts.get("callerid"), int(latching) if latching in ("0", "1") else None),
        None,
    )
