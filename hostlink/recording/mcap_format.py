"""Records of MCAP files: reading those that recordings need, and a writer of files in chunks compressed with zstd.

https://mcap.dev/spec describes the format. The library `mcap` would bring two compressors of 30 MB; the tests read
files of this writer with it.
"""

import struct
import sys
import zlib
from collections.abc import Mapping
from enum import IntEnum
from typing import IO, Final, NamedTuple

from hostlink.errors import LibraryMissing

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    try:
        from backports import zstd
    except ImportError:  # an incomplete installation: hostlink's own wheel depends on it
        raise LibraryMissing("recordings", "backports.zstd", "") from None

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD_HEAD: Final = struct.Struct("<BQ")  # opcode, length
MESSAGE: Final = struct.Struct("<HIQQ")  # channel, number, log time, publish time; the payload follows
FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, start of the summary, start of its offsets, checksum
FOOTER_BYTES: Final = FOOTER.size - RECORD_HEAD.size
CHUNK_INDEX: Final = struct.Struct("<QQQQI")  # first and last time, start, length, bytes of the channel list
CHANNEL_OFFSET: Final = struct.Struct("<HQ")
STATISTICS: Final = struct.Struct("<QHIIII")  # messages, schemas, channels, attachments, metadata, chunks
_MESSAGE_TIME: Final = struct.Struct("<QQ")  # log time, offset in the chunk
_SUMMARY_OFFSET: Final = struct.Struct("<BQQ")
_CHUNK: Final = struct.Struct("<QQQI")  # first and last time, size and checksum of the unpacked records
_U16: Final = struct.Struct("<H")
_U32: Final = struct.Struct("<I")
_U64: Final = struct.Struct("<Q")


class Opcode(IntEnum):
    """Kind of a record."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


# -- reading ----------------------------------------------------------------------------------------------------------


class Damaged(ValueError):
    """Bytes that are not what the format says."""


class _Fields:
    """Reader of the fields of one record. Its methods raise Damaged when the record is cut."""

    def __init__(self, body: bytes) -> None:
        self._body, self._at = body, 0

    def number(self, of: struct.Struct) -> int:
        (value,) = of.unpack(self.take(of.size))
        return int(value)

    def take(self, length: int) -> bytes:
        end = self._at + length
        if end > len(self._body):
            raise Damaged("a record is shorter than its fields")
        found = self._body[self._at : end]
        self._at = end
        return found

    def text(self) -> str:
        return self.take(self.number(_U32)).decode()

    def texts(self) -> dict[str, str]:
        end = self.number(_U32) + self._at
        found = {}
        while self._at < end:
            key = self.text()
            found[key] = self.text()
        return found


class Header(NamedTuple):
    """Beginning of a file."""

    profile: str
    library: str

    @classmethod
    def read(cls, body: bytes) -> "Header":
        fields = _Fields(body)
        return cls(fields.text(), fields.text())


class SchemaRecord(NamedTuple):
    """Definition of a type."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def read(cls, body: bytes) -> "SchemaRecord":
        fields = _Fields(body)
        return cls(fields.number(_U16), fields.text(), fields.text(), fields.take(fields.number(_U32)))


class ChannelRecord(NamedTuple):
    """Channel: a topic with its type."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]

    @classmethod
    def read(cls, body: bytes) -> "ChannelRecord":
        fields = _Fields(body)
        return cls(fields.number(_U16), fields.number(_U16), fields.text(), fields.text(), fields.texts())


def read_metadata(body: bytes) -> dict[str, str]:
    """Return the values of a METADATA record.

    Raises:
        Damaged: the record is cut.
    """
    fields = _Fields(body)
    fields.text()  # its name
    return fields.texts()


def unpack_chunk(body: bytes, limit_bytes: int) -> bytes:
    """Return the records of a chunk, but not more than it states: a few bytes could expand to all memory.

    Raises:
        ValueError: the stated size is too large, or size, compression or checksum is wrong; also a decompressor's
            error.
    """
    fields = _Fields(body)
    _, _, size, checksum = _CHUNK.unpack(fields.take(_CHUNK.size))
    compression, packed = fields.text(), fields.take(fields.number(_U64))
    if size > limit_bytes:
        raise Damaged(f"its stated size of {size} bytes is too large")
    if compression == "zstd":
        data = zstd.ZstdDecompressor().decompress(packed, max_length=size + 1)
    elif compression == "lz4":
        try:
            import lz4.frame  # noqa: PLC0415 - only files of other programs use it
        except ImportError:
            raise Damaged(LibraryMissing("lz4", "lz4", "export").problem) from None
        data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    elif compression:
        raise Damaged(f"its compression {compression[:20]!r} is unknown")
    else:
        data = packed
    if len(data) != size:
        raise Damaged(f"it has {len(data)} bytes{' or more' * (len(data) > size)}, its stated size is {size}")
    if checksum not in (0, zlib.crc32(data)):
        raise Damaged("its checksum is wrong")
    return data


# -- writing ----------------------------------------------------------------------------------------------------------


def _text(value: str) -> bytes:
    data = value.encode()
    return _U32.pack(len(data)) + data


def _texts(values: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in values.items())
    return _U32.pack(len(data)) + data


def _record(opcode: Opcode, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return RECORD_HEAD.pack(opcode, len(body)) + body


class _Chunk:
    """Records that are not in the file yet."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.offsets: dict[int, list[bytes]] = {}  # of the messages of each channel
        self.first_ns = self.last_ns = 0

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        self.first_ns = min(self.first_ns, log_ns) if self.offsets else log_ns
        self.last_ns = max(self.last_ns, log_ns)
        self.offsets.setdefault(channel_id, []).append(_MESSAGE_TIME.pack(log_ns, len(self.data)))
        self.data += RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE.size + len(payload))
        self.data += MESSAGE.pack(channel_id, sequence, log_ns, publish_ns)
        self.data += payload


class Writer:
    """Writer of one file. A chunk ends by itself above `chunk_bytes`; `finish` writes the index.

    A channel or schema is in the file with the next chunk that has a message, and in the index.
    """

    def __init__(self, file: IO[bytes], *, profile: str, library: str, chunk_bytes: int) -> None:
        self._file, self._chunk_bytes = file, chunk_bytes
        self._chunk = _Chunk()
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._metadata_indexes: list[bytes] = []
        self._messages: dict[int, int] = {}  # by channel
        self._first_ns: int | None = None
        self._last_ns = 0
        file.write(MAGIC + _record(Opcode.HEADER, _text(profile), _text(library)))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a definition and return its number."""
        number = len(self._schemas) + 1
        parts = (_U16.pack(number), _text(name), _text(encoding), _U32.pack(len(data)), data)
        self._define(self._schemas, _record(Opcode.SCHEMA, *parts))
        return number

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Add a channel and return its number."""
        number = len(self._channels) + 1
        parts = (_U16.pack(number), _U16.pack(schema_id), _text(topic), _text(encoding), _texts(metadata))
        self._define(self._channels, _record(Opcode.CHANNEL, *parts))
        return number

    def add_message(self, channel_id: int, log_ns: int, payload: bytes, publish_ns: int, sequence: int) -> None:
        self._first_ns = log_ns if self._first_ns is None else min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)
        self._messages[channel_id] = self._messages.get(channel_id, 0) + 1
        self._chunk.add_message(channel_id, sequence, log_ns, publish_ns, payload)
        self._end_full_chunk()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write values that describe the file, at once."""
        record = _record(Opcode.METADATA, _text(name), _texts(values))
        index = (_U64.pack(self._file.tell()), _U64.pack(len(record)), _text(name))
        self._metadata_indexes.append(_record(Opcode.METADATA_INDEX, *index))
        self._file.write(record)

    def end_chunk(self) -> None:
        """Write the chunk, so that everything added so far can be read. Without a message nothing is written."""
        chunk = self._chunk
        if not chunk.offsets:
            return
        data = bytes(chunk.data)
        packed = zstd.compress(data)
        times = _U64.pack(chunk.first_ns) + _U64.pack(chunk.last_ns)
        sizes = _U64.pack(len(data)) + _U32.pack(zlib.crc32(data))
        record = _record(Opcode.CHUNK, times, sizes, _text("zstd"), _U64.pack(len(packed)), packed)
        begin = self._file.tell()
        self._file.write(record)
        indexes, offsets = bytearray(), bytearray()
        for channel_id, entries in chunk.offsets.items():
            offsets += CHANNEL_OFFSET.pack(channel_id, begin + len(record) + len(indexes))
            length = _U32.pack(_MESSAGE_TIME.size * len(entries))
            indexes += _record(Opcode.MESSAGE_INDEX, _U16.pack(channel_id), length, *entries)
        self._file.write(indexes)
        head = CHUNK_INDEX.pack(chunk.first_ns, chunk.last_ns, begin, len(record), len(offsets))
        tail = (_U64.pack(len(indexes)), _text("zstd"), _U64.pack(len(packed)), _U64.pack(len(data)))
        self._chunk_indexes.append(_record(Opcode.CHUNK_INDEX, head, bytes(offsets), *tail))
        self._chunk = _Chunk()

    def finish(self) -> None:
        """Write the chunk and the index. The file stays open."""
        self.end_chunk()
        self._file.write(_record(Opcode.DATA_END, _U32.pack(0)))  # without a checksum of the data
        begin = self._file.tell()
        groups = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        )
        summary, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            group = b"".join(records)
            place = _SUMMARY_OFFSET.pack(opcode, begin + len(summary), len(group))
            offsets += _record(Opcode.SUMMARY_OFFSET, place) if group else b""
            summary += group
        offsets_begin = begin + len(summary)
        summary += offsets
        footer = FOOTER.pack(Opcode.FOOTER, FOOTER_BYTES, begin, offsets_begin, 0)[: -_U32.size]
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        self._file.write(bytes(summary) + footer + _U32.pack(checksum) + MAGIC)

    def _define(self, among: list[bytes], record: bytes) -> None:
        among.append(record)
        self._chunk.data += record
        self._end_full_chunk()

    def _end_full_chunk(self) -> None:
        if len(self._chunk.data) > self._chunk_bytes:
            self.end_chunk()

    def _statistics(self) -> bytes:
        counts = (len(self._schemas), len(self._channels), 0, len(self._metadata_indexes), len(self._chunk_indexes))
        head = STATISTICS.pack(sum(self._messages.values()), *counts)
        times = _U64.pack(self._first_ns or 0) + _U64.pack(self._last_ns)
        of_channels = b"".join(CHANNEL_OFFSET.pack(*item) for item in self._messages.items())
        return _record(Opcode.STATISTICS, head, times, _U32.pack(len(of_channels)), of_channels)
