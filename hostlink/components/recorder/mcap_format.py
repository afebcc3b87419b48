"""Records of MCAP files: reading and writing those that recordings need, with chunks compressed with zstd.

https://mcap.dev/spec describes the format. The library `mcap` would bring two compressors of 30 MB; the tests read
files of this writer with it.
"""

import struct
import sys
import zlib
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Final

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
U16: Final = struct.Struct("<H")
U32: Final = struct.Struct("<I")
U64: Final = struct.Struct("<Q")


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


class Fields:
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
        return self.take(self.number(U32)).decode()

    def texts(self) -> dict[str, str]:
        end = self.number(U32) + self._at
        found = {}
        while self._at < end:
            key = self.text()
            found[key] = self.text()
        return found


def unpack_chunk(body: bytes, limit_bytes: int) -> bytes:
    """Return the records of a chunk, but not more than it states: a few bytes could expand to all memory.

    Raises:
        ValueError: the stated size is too large, or size, compression or checksum is wrong; also a decompressor's
            error.
    """
    fields = Fields(body)
    _, _, size, checksum = _CHUNK.unpack(fields.take(_CHUNK.size))
    compression, packed = fields.text(), fields.take(fields.number(U64))
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


def text(value: str) -> bytes:
    data = value.encode()
    return U32.pack(len(data)) + data


def texts(values: Mapping[str, str]) -> bytes:
    data = b"".join(text(key) + text(value) for key, value in values.items())
    return U32.pack(len(data)) + data


def record(opcode: Opcode, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return RECORD_HEAD.pack(opcode, len(body)) + body


class Chunk:
    """Messages, and definitions before them, that are not in the file yet."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.first_ns = self.last_ns = 0
        self._offsets: dict[int, list[bytes]] = {}  # of the messages of each channel

    def __len__(self) -> int:
        """Number of channels with messages."""
        return len(self._offsets)

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        self.first_ns = min(self.first_ns, log_ns) if self._offsets else log_ns
        self.last_ns = max(self.last_ns, log_ns)
        self._offsets.setdefault(channel_id, []).append(_MESSAGE_TIME.pack(log_ns, len(self.data)))
        self.data += RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE.size + len(payload))
        self.data += MESSAGE.pack(channel_id, sequence, log_ns, publish_ns)
        self.data += payload

    def records(self, begin: int) -> tuple[bytes, bytes]:
        """Return the chunk with its message indexes, as a file has them from `begin` on, and its CHUNK_INDEX."""
        data = bytes(self.data)
        packed = zstd.compress(data)
        times = U64.pack(self.first_ns) + U64.pack(self.last_ns)
        sizes = U64.pack(len(data)) + U32.pack(zlib.crc32(data))
        chunk = record(Opcode.CHUNK, times, sizes, text("zstd"), U64.pack(len(packed)), packed)
        indexes, offsets = bytearray(), bytearray()
        for channel_id, entries in self._offsets.items():
            offsets += CHANNEL_OFFSET.pack(channel_id, begin + len(chunk) + len(indexes))
            length = U32.pack(_MESSAGE_TIME.size * len(entries))
            indexes += record(Opcode.MESSAGE_INDEX, U16.pack(channel_id), length, *entries)
        head = CHUNK_INDEX.pack(self.first_ns, self.last_ns, begin, len(chunk), len(offsets))
        tail = (U64.pack(len(indexes)), text("zstd"), U64.pack(len(packed)), U64.pack(len(data)))
        return chunk + indexes, record(Opcode.CHUNK_INDEX, head, bytes(offsets), *tail)


def file_end(begin: int, summary: Mapping[Opcode, Sequence[bytes]]) -> bytes:
    """Return what follows the data of a file, as it has it from `begin` on: the records of the summary by kind."""
    data_end = record(Opcode.DATA_END, U32.pack(0))  # without a checksum of the data
    begin += len(data_end)
    groups, offsets = bytearray(), bytearray()
    for opcode, records in summary.items():
        group = b"".join(records)
        place = _SUMMARY_OFFSET.pack(opcode, begin + len(groups), len(group))
        offsets += record(Opcode.SUMMARY_OFFSET, place) if group else b""
        groups += group
    footer = FOOTER.pack(Opcode.FOOTER, FOOTER_BYTES, begin, begin + len(groups), 0)[: -U32.size]
    checksum = zlib.crc32(footer, zlib.crc32(offsets, zlib.crc32(groups)))
    return b"".join((data_end, groups, offsets, footer, U32.pack(checksum), MAGIC))
