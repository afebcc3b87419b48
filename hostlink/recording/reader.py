"""Reader of MCAP files, including unfinished ones of a killed daemon, a full disk or a power failure."""

import bisect
import itertools
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, InvalidMagic, McapError, RecordLengthLimitExceeded
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import Chunk, Header, McapRecord, Metadata, Schema
from mcap.stream_reader import StreamReader

from hostlink.errors import RecordingFailed
from hostlink.recording.channel import LIBRARY, LIBRARY_STEADY, NS_PER_S, SCHEMA_ENCODINGS, Channel
from hostlink.recording.mcap_index import MAGIC, MAX_RECORD_BYTES, RECORD_HEAD, Index, read_index

MAX_CHUNK_BYTES = 64 * 1024 * 1024  # unpacked; chunks of other writers have a few MB
MAX_DEFINITIONS_BYTES = 64 * 1024 * 1024  # of schemas and channels, which stay in memory; a large one has a few kB
MAX_NAMED = 10  # damaged chunks that are described; the others are counted
MAX_REASON = 200  # characters of a library's error text
# Between two messages of a file without steady times; a larger gap means that the clock was set.
LONGEST_GAP_NS = 3600 * NS_PER_S
_DAMAGES = (McapError, ValueError, OverflowError, MemoryError, struct.error)  # of an invalid length
_MESSAGE = struct.Struct("<HIQQ")  # channel, number, log time, publish time; the payload follows
_NEVER = 2**64

Wanted = Callable[[Channel], bool]


class StoredMessage(NamedTuple):
    """Message of a file."""

    channel: Channel
    stamp_ns: int  # arrival time by the wall clock, which may have been set meanwhile
    payload: bytes
    steady_ns: int  # arrival time by a clock that is never set: for order, gaps and ages


class _FileCut(EndOfFile):
    """The file ends where a record should be."""


class SteadyTimes:
    """Steady times for a file without them: wall times with the steps of the clock removed."""

    def __init__(self) -> None:
        self._offset_ns = 0
        self._newest_ns: int | None = None

    def at(self, stamp_ns: int) -> int:
        """Return the steady time of the next message in the file's order."""
        newest_ns = self._newest_ns
        if newest_ns is not None and not -LONGEST_GAP_NS < stamp_ns - newest_ns < LONGEST_GAP_NS:
            self._offset_ns += newest_ns - stamp_ns
        self._newest_ns = stamp_ns
        return stamp_ns + self._offset_ns

    def skip(self, first_ns: int, last_ns: int) -> None:
        """Account for a chunk that is not read.

        A chunk with a clock step has no usable times; the next one shows the step.
        """
        if last_ns and last_ns - first_ns < LONGEST_GAP_NS:
            self.at(first_ns)
            self.at(last_ns)


class Reader:
    """Reader of one file, by its index if it has one. `damage` describes what was wrong with the read parts."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._damage: list[str] = []  # of the whole file
        self._chunks: list[str] = []  # descriptions of damaged chunks
        self._damaged_chunks = 0
        self.profile = ""
        self.metadata: dict[str, str] = {}
        self.has_steady_times = False
        self._is_ours = False
        self._steady = SteadyTimes()
        self._begin_ns = _NEVER
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, text, language
        self._channels: dict[int, Channel] = {}
        self._wanted: Wanted = _all
        self._chosen: dict[int, Channel | None] = {}  # None: its messages are not wanted
        self._definitions_left_bytes = MAX_DEFINITIONS_BYTES

    def messages(self, wanted: Wanted | None = None, *, after_s: float = 0.0) -> Iterator[StoredMessage]:
        """Yield every readable message of the wanted channels, in the order of writing.

        With an index, chunks without such messages are not read. Messages earlier than `after_s` after the first one
        may be omitted if index and steady times of the file show where they are.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        self._wanted, self._steady, self._begin_ns = wanted or _all, SteadyTimes(), _NEVER
        self._chosen.clear()
        try:
            with self.path.open("rb") as file:
                self._read_header(file)
                index = read_index(file, self._note, self._is_wanted)
                if index is not None and not self._is_ours:  # messages of other writers may be in any order
                    self._begin_ns = min(
                        (first for first, last in zip(index.first_ns, index.last_ns, strict=True) if last),
                        default=_NEVER,
                    )
                if index is not None and after_s > 0 and self.has_steady_times:
                    self._leave_out(file, index, int(after_s * NS_PER_S))
                yield from self._read(file, index)
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror or error}") from error

    def read_channels(self) -> list[Channel]:
        """Return every channel, also those without a message. A file without an index is read for that.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        for _ in self.messages(lambda _: False):
            pass
        return self.channels

    def reads_steady_times(self) -> bool:
        """Whether the file has steady times; otherwise they are derived from wall times.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        try:
            with self.path.open("rb") as file:
                self._read_header(file)
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror or error}") from error
        return self.has_steady_times

    @property
    def damage(self) -> list[str]:
        """Damage of the parts read so far; empty if there is none."""
        others = self._damaged_chunks - len(self._chunks)
        return [*self._chunks, *([f"{others} other chunks are damaged"] if others else []), *self._damage]

    @property
    def channels(self) -> list[Channel]:
        """Channels read so far, also those without a message."""
        return list(dict.fromkeys(self._channels.values()))

    @property
    def begin_ns(self) -> int:
        """Steady time of the earliest message read so far, wanted or not; 0 if there is none."""
        return 0 if self._begin_ns == _NEVER else self._begin_ns

    @property
    def size_bytes(self) -> int:
        """Size of the file."""
        return self.path.stat().st_size

    # -- the file's records -------------------------------------------------------------------------------------------

    def _read_header(self, file: IO[bytes]) -> None:
        try:
            record = next(stored_records(file))
        except _DAMAGES as error:
            raise RecordingFailed(f"{self.path} is not an MCAP file") from error
        if not isinstance(record, Header):
            raise RecordingFailed(f"{self.path} is not an MCAP file: it has no header")
        self.profile = record.profile
        self.has_steady_times = record.library == LIBRARY_STEADY
        self._is_ours = record.library in (LIBRARY, LIBRARY_STEADY)

    def _read(self, file: IO[bytes], index: Index | None) -> Iterator[StoredMessage]:
        """Read record by record. A damaged chunk is skipped with its content."""
        at, number = len(MAGIC), 0
        try:
            while True:
                if index is not None and number < len(index) and at == index.begins[number]:
                    if number and not index.is_wanted[number]:  # the first chunk has the beginning
                        self._steady.skip(index.first_ns[number], index.last_ns[number])
                    else:
                        _, body = _read_record(file, at)
                        yield from self._of_chunk(body)
                    at = index.ends[number]
                    number += 1
                    continue
                opcode, body = _read_record(file, at)
                at += RECORD_HEAD.size + len(body)
                if opcode == Opcode.FOOTER:
                    _check_end(file, at)
                    return
                if opcode == Opcode.CHUNK:
                    yield from self._of_chunk(body)
                elif opcode == Opcode.MESSAGE:
                    yield from self._of_records(RECORD_HEAD.pack(opcode, len(body)) + body)
                else:
                    self._note_record(opcode, body)
        except _DAMAGES as error:
            is_cut = isinstance(error, _FileCut)
            self._damage.append(
                "the file was not finished" if is_cut else f"unreadable from byte {file.tell()}: {error}"
            )

    def _of_chunk(self, body: bytes) -> Iterator[StoredMessage]:
        try:
            yield from self._of_records(_unpacked(Chunk.read(ReadDataStream(BytesIO(body)))))
        except Exception as error:  # noqa: BLE001 - the library's and its decompressors', for damaged bytes
            self._damaged_chunks += 1
            if self._damaged_chunks <= MAX_NAMED:
                self._chunks.append(f"a chunk is damaged: {type(error).__name__}: {error}"[:MAX_REASON])

    def _of_records(self, data: bytes) -> Iterator[StoredMessage]:
        """Yield the messages of a chunk, which may have millions of records.

        Raises:
            ValueError: a record is cut.
        """
        read_head, read_message, chosen = RECORD_HEAD.unpack_from, _MESSAGE.unpack_from, self._chosen
        has_steady_times, is_ours, steady_at = self.has_steady_times, self._is_ours, self._steady.at
        at, end = 0, len(data)
        while at < end:
            opcode, length = read_head(data, at)
            begin = at + RECORD_HEAD.size
            at = begin + length
            if at > end:
                raise ValueError("a record in it is cut")
            if opcode != Opcode.MESSAGE:
                self._note_record(opcode, data[begin:at])
                continue
            payload_begin = begin + _MESSAGE.size
            if payload_begin > at:
                raise ValueError("a message in it is cut")
            number, _, stamp_ns, publish_ns = read_message(data, begin)
            steady_ns = publish_ns if has_steady_times else steady_at(stamp_ns) if is_ours else stamp_ns
            if steady_ns < self._begin_ns:  # noqa: PLR1730 - min() costs as much as the rest
                self._begin_ns = steady_ns
            channel = chosen[number] if number in chosen else self._choose(number)
            if channel is not None:
                yield StoredMessage(channel, stamp_ns, data[payload_begin:at], steady_ns)

    def _note_record(self, opcode: int, body: bytes) -> None:
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            return
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.METADATA:
            self.metadata |= Metadata.read(stream).metadata
        else:
            self._note(Schema.read(stream) if opcode == Opcode.SCHEMA else McapChannel.read(stream))

    # -- definitions --------------------------------------------------------------------------------------------------

    def _is_wanted(self, number: int) -> bool:
        """Whether a chunk of the index has to be read for this channel; also true for an unknown one."""
        return number not in self._channels or self._choose(number) is not None

    def _choose(self, number: int) -> Channel | None:
        channel = self._channels.get(number)
        chosen = channel if channel is not None and self._wanted(channel) else None
        if channel is not None:
            self._chosen[number] = chosen
        return chosen

    def _note(self, record: Schema | McapChannel) -> None:
        if isinstance(record, Schema):
            schema = record.name, record.data.decode(errors="replace"), record.encoding
            if self._schemas.get(record.id) != schema and self._has_room(*schema):
                self._schemas[record.id] = schema
        else:
            channel = _channel(record, self._schemas.get(record.schema_id, ("", "", "")))
            is_new = self._channels.get(record.id) != channel
            if is_new and self._has_room(channel.topic, *itertools.chain.from_iterable(channel.metadata)):
                self._channels[record.id] = channel
                self._chosen.pop(record.id, None)

    def _has_room(self, *texts: str) -> bool:
        """Whether one more definition may be kept: a few bytes of a file can expand to many definitions."""
        if self._definitions_left_bytes >= 0:
            self._definitions_left_bytes -= sum(map(len, texts))
            if self._definitions_left_bytes < 0:
                self._damage.append(f"the definitions exceed {MAX_DEFINITIONS_BYTES} bytes; the rest is omitted")
        return self._definitions_left_bytes >= 0

    # -- times --------------------------------------------------------------------------------------------------------

    def _leave_out(self, file: IO[bytes], index: Index, after_ns: int) -> None:
        """Mark the chunks before the one with this time after the beginning as not wanted."""
        begin_ns = _first_steady_ns(file, index, 0)
        if begin_ns is not None:
            last = bisect.bisect_right(
                range(len(index)), begin_ns + after_ns, key=lambda number: _steady_ns_from(file, index, number)
            )
            for number in range(last - 1):
                index.is_wanted[number] = False


def stored_records(file: IO[bytes]) -> Iterator[McapRecord]:
    """Yield the records of a file, with chunks as stored.

    Raises:
        McapError: the file is damaged, or is not an MCAP file.
    """
    yield from StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records


def _all(channel: Channel) -> bool:
    del channel
    return True


def _read_record(file: IO[bytes], at: int) -> tuple[int, bytes]:
    """Return (opcode, content) of the record at this position.

    Raises:
        _FileCut: the file ends in it.
        RecordLengthLimitExceeded: the length is damaged.
    """
    file.seek(at)
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise _FileCut
    opcode, length = RECORD_HEAD.unpack(head)
    if length > MAX_RECORD_BYTES:
        raise RecordLengthLimitExceeded(opcode, length, MAX_RECORD_BYTES)
    body = file.read(length)
    if len(body) < length:
        raise _FileCut
    return opcode, body


def _check_end(file: IO[bytes], at: int) -> None:
    """Check the magic bytes after the footer.

    Raises:
        _FileCut: they are missing.
        InvalidMagic: they are wrong.
    """
    file.seek(at)
    end = file.read(len(MAGIC))
    if end != MAGIC:
        raise _FileCut if len(end) < len(MAGIC) else InvalidMagic(tuple(end))


def _steady_ns_from(file: IO[bytes], index: Index, number: int) -> int:
    """Return the steady time of the first message in this chunk, or in the next readable one."""
    found = (_first_steady_ns(file, index, each) for each in range(number, len(index)))
    return next((steady_ns for steady_ns in found if steady_ns is not None), _NEVER)


def _first_steady_ns(file: IO[bytes], index: Index, number: int) -> int | None:
    try:
        data = _unpacked(Chunk.read(ReadDataStream(BytesIO(_read_record(file, index.begins[number])[1]))))
        at = 0
        while at < len(data):
            opcode, length = RECORD_HEAD.unpack_from(data, at)
            if opcode == Opcode.MESSAGE:
                return int(_MESSAGE.unpack_from(data, at + RECORD_HEAD.size)[-1])
            at += RECORD_HEAD.size + length
    except Exception:  # noqa: BLE001 - the library's and its decompressors', for damaged bytes; reading reports them
        return None
    return None


def _unpacked(chunk: Chunk) -> bytes:
    """Unpack a chunk, but not more than the size that it states: a few bytes could expand to all memory.

    Raises:
        ValueError: the stated size is too large, or size, compression or checksum is wrong; also a decompressor's
            error.
    """
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"its stated size of {size} bytes is too large")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"its compression {chunk.compression[:20]!r} is unknown")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes{' or more' * (len(data) > size)}, its stated size is {size}")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("its checksum is wrong")
    return data


def _channel(record: McapChannel, schema: tuple[str, str, str]) -> Channel:
    name, text, language = schema
    is_usual = language == SCHEMA_ENCODINGS.get(record.message_encoding, "")
    metadata = tuple(record.metadata.items())
    return Channel(record.topic, record.message_encoding, name, text, metadata, "" if is_usual else language)
