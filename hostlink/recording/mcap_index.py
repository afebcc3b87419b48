"""Index at the end of a finished MCAP file: position and channels of each chunk."""

import io
import os
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
MAX_RECORD_BYTES = 256 * 1024 * 1024  # a larger length is damage and is not read into memory
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, start of its offsets, checksum
_FOOTER_BYTES = 20
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last time, start, length, bytes of the channel list
_CHANNEL_OFFSET = struct.Struct("<HQ")
_STATISTICS = struct.Struct("<QHIIII")  # messages, schemas, channels, attachments, metadata, chunks
_LENGTH = struct.Struct("<Q")
_PIECE_BYTES = 64 * 1024
_DAMAGES = (McapError, ValueError, struct.error, OverflowError, MemoryError)


class Index:
    """Chunks of a file in its order, stored as columns: a file of two gigabytes has a hundred thousand chunks."""

    def __init__(self) -> None:
        self.begins = array("Q")  # start of the chunk's record
        self.ends = array("Q")  # start of the record after the chunk and its message indexes
        self.first_ns = array("Q")  # lowest and highest time of its messages; both 0 without messages
        self.last_ns = array("Q")
        self.is_wanted = bytearray()

    def __len__(self) -> int:
        return len(self.begins)

    def add(self, begin: int, end: int, first_ns: int, last_ns: int, *, is_wanted: bool) -> None:
        """Add a chunk, in the order of the file.

        Raises:
            ValueError: it overlaps the chunk before.
        """
        if self.ends and begin < self.ends[-1]:
            raise ValueError("the chunks of the index overlap")
        self.begins.append(begin)
        self.ends.append(end)
        self.first_ns.append(first_ns)
        self.last_ns.append(last_ns)
        self.is_wanted.append(is_wanted)


def read_index(
    file: IO[bytes], note: Callable[[Schema | Channel], None], is_wanted: Callable[[int], bool]
) -> Index | None:
    """Read the index of a file; None if it has none, or a damaged one.

    `note` is called with each definition, before its channel's number is passed to `is_wanted`.
    """
    try:
        summary = _find_summary(file)
        if summary is None:
            return None
        begin, end = summary
        chunk_count = _read_definitions(file, begin, end, note)
        index = Index()
        for opcode, body in _records(file, begin, end, (Opcode.CHUNK_INDEX,)):
            del opcode
            _add_chunk(index, body, begin, is_wanted)
    except _DAMAGES:
        return None
    return index if len(index) and chunk_count in (None, len(index)) else None


def _find_summary(file: IO[bytes]) -> tuple[int, int] | None:
    """Return start and end of the summary; None if the file was not finished or the summary is damaged."""
    tail_bytes = RECORD_HEAD.size + _FOOTER_BYTES + len(MAGIC)
    size = file.seek(0, os.SEEK_END)
    if size < tail_bytes + len(MAGIC):
        return None
    end = file.seek(size - tail_bytes)
    tail = file.read(tail_bytes)
    opcode, length, begin, _, checksum = _FOOTER.unpack_from(tail)
    is_footer = opcode == Opcode.FOOTER and length == _FOOTER_BYTES and tail.endswith(MAGIC)
    if not (is_footer and len(MAGIC) <= begin < end):
        return None
    if checksum and checksum != _checksum(file, begin, end + RECORD_HEAD.size + 2 * _LENGTH.size):
        return None
    return begin, end


def _checksum(file: IO[bytes], begin: int, end: int) -> int:
    file.seek(begin)
    found = 0
    for at in range(begin, end, _PIECE_BYTES):
        found = zlib.crc32(file.read(min(_PIECE_BYTES, end - at)), found)
    return found


def _records(file: IO[bytes], begin: int, end: int, wanted: tuple[Opcode, ...]) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, content) of the records of these kinds.

    Raises:
        ValueError: a length is too large.
        struct.error: a record is cut.
    """
    at = begin
    while at < end:
        file.seek(at)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        at += RECORD_HEAD.size + length
        if length > MAX_RECORD_BYTES or at > end:
            raise ValueError(f"a record of {length} bytes")
        if opcode in wanted:
            yield opcode, file.read(length)


def _read_definitions(file: IO[bytes], begin: int, end: int, note: Callable[[Schema | Channel], None]) -> int | None:
    """Note schemas before channels. Return the number of chunks that the file states, or None."""
    for _, body in _records(file, begin, end, (Opcode.SCHEMA,)):
        note(Schema.read(ReadDataStream(io.BytesIO(body))))
    chunk_count = None
    for opcode, body in _records(file, begin, end, (Opcode.CHANNEL, Opcode.STATISTICS)):
        if opcode == Opcode.CHANNEL:
            note(Channel.read(ReadDataStream(io.BytesIO(body))))
        else:
            chunk_count = _STATISTICS.unpack_from(body)[-1]
    return chunk_count


def _add_chunk(index: Index, body: bytes, summary_begin: int, is_wanted: Callable[[int], bool]) -> None:
    first_ns, last_ns, begin, length, listed_bytes = _CHUNK_INDEX.unpack_from(body)
    listed_end = _CHUNK_INDEX.size + listed_bytes
    channels = [number for number, _ in _CHANNEL_OFFSET.iter_unpack(body[_CHUNK_INDEX.size : listed_end])]
    (indexes_bytes,) = _LENGTH.unpack_from(body, listed_end)
    end = begin + length + indexes_bytes
    if begin < len(MAGIC) or end > summary_begin or length < RECORD_HEAD.size:
        raise ValueError("a chunk of the index is outside the file")
    # A writer may omit the list of channels. Then the chunk may contain any channel.
    index.add(begin, end, first_ns, last_ns, is_wanted=not channels or any(map(is_wanted, channels)))
