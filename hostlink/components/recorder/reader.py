"""Readers of recordings: an MCAP file with its index, a ROS 1 bag, a folder or file of rosbag2; and their contents."""

import bisect
import contextlib
import heapq
import itertools
import os
import struct
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

from hostlink.components.recorder.channel import CDR, LIBRARY_STEADY, ROS1, Channel, usual_language
from hostlink.components.recorder.definitions import need_rosbags
from hostlink.components.recorder.mcap_format import (
    CHANNEL_OFFSET,
    CHUNK_INDEX,
    FOOTER,
    FOOTER_BYTES,
    MAGIC,
    MESSAGE,
    RECORD_HEAD,
    STATISTICS,
    U16,
    U32,
    U64,
    Damaged,
    Fields,
    Opcode,
    unpack_chunk,
)
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import RecordingFailed

MAX_RECORD_BYTES = 256 * 1024 * 1024  # a larger length is damage and is not read into memory
MAX_DEFINITIONS_BYTES = 64 * 1024 * 1024  # of schemas, channels and metadata, which stay in memory
MAX_DEFINITION_BYTES = 1024 * 1024  # of one of them; a large one has a few kB
_PIECE_BYTES = 64 * 1024
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
# Kinds of records in the summary that are read: schemas before channels, and these before chunks.
_SUMMARY = ((Opcode.SCHEMA,), (Opcode.CHANNEL, Opcode.STATISTICS), (Opcode.CHUNK_INDEX,))
_DAMAGES = (ValueError, struct.error, OverflowError, MemoryError)

MAX_CHUNK_BYTES = 64 * 1024 * 1024  # unpacked; chunks of other writers have a few MB
NOT_FINISHED = "the file was not finished"  # the only damage of a file whose writer was killed
MAX_NAMED = 10  # damaged chunks that are described; the others are counted
MAX_REASON = 200  # characters of a library's error text
MAX_WAITING_BYTES = 256 * 1024 * 1024  # of messages that wait for earlier ones, which are further back in the file
WAITING_BYTES = 200  # memory of a waiting message besides its payload

UNFINISHED_SUFFIX = ".bag.active"  # of a ROS 1 bag that is being written, or that was not closed

CLOCK_STEP_NS = NS_PER_S  # a smaller step is the delay of a message, or a slewed clock
MAX_STEPS = 10  # listed clock steps


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

    def add(self, body: bytes, summary_begin: int, is_wanted: Callable[[int], bool]) -> None:
        """Add the chunk of a CHUNK_INDEX, in the order of the file.

        Raises:
            ValueError: it overlaps the chunk before, or is outside the file.
        """
        first_ns, last_ns, begin, length, listed_bytes = CHUNK_INDEX.unpack_from(body)
        listed_end = CHUNK_INDEX.size + listed_bytes
        channels = [number for number, _ in CHANNEL_OFFSET.iter_unpack(body[CHUNK_INDEX.size : listed_end])]
        (indexes_bytes,) = U64.unpack_from(body, listed_end)
        end = begin + length + indexes_bytes
        least = self.ends[-1] if self.ends else len(MAGIC)
        if begin < least or end > summary_begin or length < RECORD_HEAD.size:
            raise ValueError("a chunk of the index overlaps another, or is outside the file")
        self.begins.append(begin)
        self.ends.append(end)
        self.first_ns.append(first_ns)
        self.last_ns.append(last_ns)
        # A writer may omit the list of channels. Then the chunk may contain any channel.
        self.is_wanted.append(not channels or any(map(is_wanted, channels)))


def read_index(file: IO[bytes], note: Callable[[int, bytes], None], is_wanted: Callable[[int], bool]) -> Index | None:
    """Read the index of a file; None if it has none, or a damaged one.

    `note` is called with each definition, before its channel's number is passed to `is_wanted`.
    """
    index, chunk_count = Index(), None
    try:
        summary = _find_summary(file)
        if summary is None:
            return None
        for wanted in _SUMMARY:
            for opcode, body in _records(file, *summary, wanted):
                if opcode == Opcode.CHUNK_INDEX:
                    index.add(body, summary[0], is_wanted)
                elif opcode == Opcode.STATISTICS:
                    chunk_count = STATISTICS.unpack_from(body)[-1]
                else:
                    note(opcode, body)
    except _DAMAGES:
        return None
    return index if len(index) and chunk_count in (None, len(index)) else None


def _find_summary(file: IO[bytes]) -> tuple[int, int] | None:
    """Return start and end of the summary; None if the file was not finished or the summary is damaged."""
    tail_bytes = RECORD_HEAD.size + FOOTER_BYTES + len(MAGIC)
    size = file.seek(0, os.SEEK_END)
    if size < tail_bytes + len(MAGIC):
        return None
    end = file.seek(size - tail_bytes)
    tail = file.read(tail_bytes)
    opcode, length, begin, _, checksum = FOOTER.unpack_from(tail)
    is_footer = opcode == Opcode.FOOTER and length == FOOTER_BYTES and tail.endswith(MAGIC)
    if not (is_footer and len(MAGIC) <= begin < end):
        return None
    if checksum and checksum != _checksum(file, begin, end + RECORD_HEAD.size + 2 * U64.size):
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
        Damaged: a record is cut, or too large.
    """
    at = begin
    while at < end:
        opcode, length = _read_head(file, at)
        at += RECORD_HEAD.size + length
        if at > end or (opcode in wanted and length > MAX_DEFINITION_BYTES):
            raise Damaged(f"a record of {length} bytes")
        if opcode in wanted:
            yield opcode, file.read(length)


_NEVER = 2**64
_CHUNK_TIMES = struct.Struct("<QQ")  # lowest and highest time of the messages, at the beginning of a chunk

Wanted = Callable[[Channel], bool]


def _every(_: Channel) -> bool:
    return True


class StoredMessage(NamedTuple):
    """Message of a file."""

    channel: Channel
    stamp_ns: int  # arrival time by the wall clock, which may have been set meanwhile
    payload: bytes
    steady_ns: int  # arrival time by a clock that is never set: for order, gaps and ages


class _FileCut(Damaged):
    """The file ends where a record should be."""


class McapReader:
    """Reader of one MCAP file, by its index if it has one. `damage` describes what was wrong with the read parts.

    hostlink writes messages in the order of arrival. Other writers may use any order, so their messages are sorted.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._damage: list[str] = []  # of the whole file
        self._chunks: list[str] = []  # descriptions of damaged chunks
        self._damaged_chunks = 0
        self.profile = ""
        self.metadata: dict[str, str] = {}
        self.has_steady_times = False
        self._begin_ns = _NEVER
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, text, language
        self._channels: dict[int, Channel] = {}
        self._wanted: Wanted = _every
        self._chosen: dict[int, Channel | None] = {}  # None: its messages are not wanted
        self._definitions_left_bytes = MAX_DEFINITIONS_BYTES
        self._at = 0  # position of the part of the file that is read

    def messages(self, wanted: Wanted = _every, *, after_s: float = 0.0) -> Iterator[StoredMessage]:
        """Yield every readable message of the wanted channels, ordered by time.

        With an index, chunks without such messages are not read. Messages earlier than `after_s` after the first one
        may be omitted if index and steady times of the file show where they are.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        self._wanted, self._begin_ns = wanted, _NEVER
        self._chosen.clear()
        with self._opened() as file:
            index = read_index(file, self._note, self._is_wanted)
            if index is not None and not self.has_steady_times:  # messages of other writers may be in any order
                self._begin_ns = min(
                    (first for first, last in zip(index.first_ns, index.last_ns, strict=True) if last), default=_NEVER
                )
            if index is not None and after_s > 0 and self.has_steady_times:
                self._leave_out(file, index, int(after_s * NS_PER_S))
            if self.has_steady_times:
                yield from self._read(file, index)
            else:
                yield from self._sorted(self._read(file, index), _Parts(file, index))

    def _sorted(self, messages: Iterable[StoredMessage], parts: "_Parts") -> Iterator[StoredMessage]:
        """Yield the messages of `_read` ordered by time; of one time in the order of the file.

        `_read` sorts the messages of a part. A message waits while a part behind it begins earlier.
        """
        waiting: list[tuple[int, int, StoredMessage]] = []
        waiting_bytes, floor_ns, next_at, is_told = 0, 0, 0, False

        def pop() -> StoredMessage:
            nonlocal waiting_bytes
            message = heapq.heappop(waiting)[-1]
            waiting_bytes -= len(message.payload) + WAITING_BYTES
            return message

        for number, message in enumerate(messages):
            if self._at >= next_at:
                floor_ns, next_at = parts.floor_behind(self._at)
            if not waiting and message.steady_ns <= floor_ns:
                yield message
                continue
            heapq.heappush(waiting, (message.steady_ns, number, message))
            waiting_bytes += len(message.payload) + WAITING_BYTES
            while waiting and waiting[0][0] <= min(floor_ns, message.steady_ns):
                yield pop()
            while waiting_bytes > MAX_WAITING_BYTES:
                if not is_told:
                    self._damage.append("its messages are too mixed up to be sorted by time; they are sorted in part")
                is_told = True
                yield pop()
        while waiting:
            yield pop()

    def read_channels(self) -> list[Channel]:
        """Return every channel, also those without a message. A file without an index is read for that.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        for _ in self.messages(lambda _: False):
            pass
        return self.channels

    def read_beginning(self) -> None:
        """Read the header, which says whether the file has steady times, and the metadata behind it.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        with self._opened() as file, contextlib.suppress(*_DAMAGES):
            self._note(*_read_record(file, file.tell()))

    @property
    def damage(self) -> list[str]:
        """Damage of the parts read so far; empty if there is none."""
        others = self._damaged_chunks - len(self._chunks)
        return [*self._chunks, *([f"{others} other chunks or records are damaged"] if others else []), *self._damage]

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
        return self.path.stat().st_size

    # -- the file's records -------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        """Open the file and read its header.

        Raises:
            RecordingFailed: the file cannot be read, or is not an MCAP file.
        """
        try:
            with self.path.open("rb") as file:
                self._read_header(file)
                yield file
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror or error}") from error

    def _read_header(self, file: IO[bytes]) -> None:
        try:
            if file.read(len(MAGIC)) != MAGIC:
                raise Damaged("it does not begin as an MCAP file does")
            opcode, body = _read_record(file, len(MAGIC))
            if opcode != Opcode.HEADER:
                raise RecordingFailed(f"{self.path} is not an MCAP file: it has no header")
            fields = Fields(body)
            self.profile, library = fields.text(), fields.text()
        except _DAMAGES as error:
            raise RecordingFailed(f"{self.path} is not an MCAP file") from error
        self.has_steady_times = library == LIBRARY_STEADY

    def _read(self, file: IO[bytes], index: Index | None) -> Iterator[StoredMessage]:
        """Read record by record. A damaged chunk is skipped with its content."""
        at, number = len(MAGIC), 0
        try:
            while True:
                self._at = at
                if index is not None and number < len(index) and at == index.begins[number]:
                    if not number or index.is_wanted[number]:  # the first chunk has the beginning
                        yield from self._of_indexed_chunk(file, at)
                    at = index.ends[number]
                    number += 1
                    continue
                opcode, length = _read_head(file, at)
                if opcode in _DEFINITIONS and MAX_DEFINITION_BYTES < length <= MAX_RECORD_BYTES:
                    self._note_large(length)
                    at += RECORD_HEAD.size + length
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
                    self._note_stored(opcode, body)
        except _DAMAGES as error:
            is_cut = isinstance(error, _FileCut)
            self._damage.append(NOT_FINISHED if is_cut else f"unreadable from byte {file.tell()}: {error}")

    def _note_large(self, size_bytes: int) -> None:
        """Count a definition or metadata that is omitted for its size."""
        limit = f"exceeds the limit of {MAX_DEFINITION_BYTES}; it is omitted"
        self._note_damage("a record", Damaged(f"a definition of {size_bytes} bytes {limit}"))

    def _note_stored(self, opcode: int, body: bytes) -> None:
        """Note a record outside chunks. A damaged one costs only itself, because its end is known."""
        try:
            self._note(opcode, body)
        except _DAMAGES as error:
            self._note_damage("a record", error)

    def _of_indexed_chunk(self, file: IO[bytes], at: int) -> Iterator[StoredMessage]:
        """Yield the messages of a chunk whose end the index knows; its own length may be damaged."""
        try:
            _, body = _read_record(file, at)
        except _DAMAGES as error:
            self._note_damage("a chunk", error)
        else:
            yield from self._of_chunk(body)

    def _of_chunk(self, body: bytes) -> Iterator[StoredMessage]:
        try:
            yield from self._of_records(unpack_chunk(body, MAX_CHUNK_BYTES))
        except Exception as error:  # noqa: BLE001 - the library's and its decompressors', for damaged bytes
            self._note_damage("a chunk", error)

    def _note_damage(self, part: str, error: Exception) -> None:
        self._damaged_chunks += 1
        if self._damaged_chunks <= MAX_NAMED:
            self._chunks.append(f"{part} is damaged: {type(error).__name__}: {error}"[:MAX_REASON])

    def _of_records(self, data: bytes) -> Iterator[StoredMessage]:
        """Yield the messages of a chunk, which may have millions of records.

        Raises:
            ValueError: a record is cut.
        """
        if not self.has_steady_times:
            data = _in_order(data)
        read_head, read_message, chosen = RECORD_HEAD.unpack_from, MESSAGE.unpack_from, self._chosen
        has_steady_times = self.has_steady_times
        at, end = 0, len(data)
        while at < end:
            opcode, length = read_head(data, at)
            begin = at + RECORD_HEAD.size
            at = begin + length
            if at > end:
                raise ValueError("a record in it is cut")
            if opcode != Opcode.MESSAGE:
                self._note(opcode, data[begin:at])
                continue
            payload_begin = begin + MESSAGE.size
            if payload_begin > at:
                raise ValueError("a message in it is cut")
            number, _, stamp_ns, publish_ns = read_message(data, begin)
            steady_ns = publish_ns if has_steady_times else stamp_ns
            if steady_ns < self._begin_ns:  # noqa: PLR1730 - min() costs as much as the rest
                self._begin_ns = steady_ns
            channel = chosen[number] if number in chosen else self._choose(number)
            if channel is not None:
                yield StoredMessage(channel, stamp_ns, data[payload_begin:at], steady_ns)

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

    def _note(self, opcode: int, body: bytes) -> None:
        """Keep a definition or metadata, if there is room for it. Other records are ignored.

        Raises:
            ValueError: it is damaged.
        """
        if opcode not in _DEFINITIONS:
            return
        if len(body) > MAX_DEFINITION_BYTES:
            self._note_large(len(body))
        elif opcode == Opcode.METADATA:
            fields = Fields(body)
            fields.text()  # its name
            for name, value in fields.texts().items():
                if self.metadata.get(name) != value and self._has_room(name, value):
                    self.metadata[name] = value
        elif opcode == Opcode.SCHEMA:
            self._note_schema(Fields(body))
        else:
            self._note_channel(Fields(body))

    def _note_schema(self, fields: Fields) -> None:
        number, name, language = fields.number(U16), fields.text(), fields.text()
        schema = name, fields.take(fields.number(U32)).decode(errors="replace"), language
        if self._schemas.get(number) != schema and self._has_room(*schema):
            self._schemas[number] = schema

    def _note_channel(self, fields: Fields) -> None:
        number, schema = fields.number(U16), self._schemas.get(fields.number(U16), ("", "", ""))
        topic, encoding, metadata = fields.text(), fields.text(), tuple(fields.texts().items())
        name, text, language = schema
        is_usual = language == usual_language(encoding, text)
        channel = Channel(topic, encoding, name, text, metadata, "" if is_usual else language)
        if self._channels.get(number) != channel and self._has_room(topic, *itertools.chain.from_iterable(metadata)):
            self._channels[number] = channel
            self._chosen.pop(number, None)

    def _has_room(self, *texts: str) -> bool:
        """Whether one more definition may be kept: a few bytes of a file can expand to many definitions."""
        if self._definitions_left_bytes >= 0:
            self._definitions_left_bytes -= sum(map(len, texts))
            if self._definitions_left_bytes < 0:
                self._damage.append(
                    f"the definitions and metadata exceed {MAX_DEFINITIONS_BYTES} bytes; the rest is omitted"
                )
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


def _in_order(data: bytes) -> bytes:
    """Return the records of a chunk with its messages in the order of time, behind the others. A cut rest stays."""
    if _is_ordered(data):
        return data
    begins, ends, times = array("Q"), array("Q"), array("Q")
    others, at, end = [], 0, len(data)
    while at + RECORD_HEAD.size <= end:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        begin, at = at, at + RECORD_HEAD.size + length
        if at > end:
            at = begin
            break
        if opcode == Opcode.MESSAGE and length >= MESSAGE.size:
            begins.append(begin)
            ends.append(at)
            times.append(MESSAGE.unpack_from(data, begin + RECORD_HEAD.size)[2])
        else:
            others.append(data[begin:at])
    order = sorted(range(len(times)), key=times.__getitem__)
    return b"".join((*others, *(data[begins[number] : ends[number]] for number in order), data[at:]))


def _is_ordered(data: bytes) -> bool:
    at, end, before_ns = 0, len(data), 0
    while at + RECORD_HEAD.size + MESSAGE.size <= end:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        if opcode == Opcode.MESSAGE:
            stamp_ns = MESSAGE.unpack_from(data, at + RECORD_HEAD.size)[2]
            if stamp_ns < before_ns:
                return False
            before_ns = stamp_ns
        at += RECORD_HEAD.size + length
    return True


class _Parts:
    """Parts of a file in its order, which are chunks and messages outside chunks: positions and lowest times."""

    def __init__(self, file: IO[bytes], index: Index | None) -> None:
        """Read the index, or the head of each part. A damaged rest is left out."""
        self._begins, self._floors_ns = array("Q"), array("Q")
        with contextlib.suppress(*_DAMAGES):
            self._scan(file, index)
        for number in range(len(self._floors_ns) - 1, 0, -1):  # the lowest time of this part and all behind it
            self._floors_ns[number - 1] = min(self._floors_ns[number - 1], self._floors_ns[number])

    def floor_behind(self, at: int) -> tuple[int, int]:
        """Return the lowest time behind the part at this position, and the position of the next part."""
        behind = bisect.bisect_right(self._begins, at)
        return (self._floors_ns[behind], self._begins[behind]) if behind < len(self._begins) else (_NEVER, _NEVER)

    def _scan(self, file: IO[bytes], index: Index | None) -> None:
        at, number = len(MAGIC), 0
        while True:
            if index is not None and number < len(index) and at == index.begins[number]:
                self._add(at, index.first_ns[number], index.last_ns[number])
                at = index.ends[number]
                number += 1
                continue
            opcode, length = _read_head(file, at)
            if opcode == Opcode.FOOTER:
                return
            if opcode == Opcode.CHUNK:
                self._add(at, *_CHUNK_TIMES.unpack(file.read(_CHUNK_TIMES.size)))
            elif opcode == Opcode.MESSAGE:
                stamp_ns = MESSAGE.unpack(file.read(MESSAGE.size))[2]
                self._add(at, stamp_ns, stamp_ns)
            at += RECORD_HEAD.size + length

    def _add(self, begin: int, first_ns: int, last_ns: int) -> None:
        if last_ns:  # both are 0 without messages
            self._begins.append(begin)
            self._floors_ns.append(first_ns)


def _read_head(file: IO[bytes], at: int) -> tuple[int, int]:
    """Return (opcode, length of the content) of the record at this position.

    Raises:
        _FileCut: the file ends in it.
    """
    file.seek(at)
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise _FileCut
    opcode, length = RECORD_HEAD.unpack(head)
    return int(opcode), int(length)


def _read_record(file: IO[bytes], at: int) -> tuple[int, bytes]:
    """Return (opcode, content) of the record at this position.

    Raises:
        _FileCut: the file ends in it.
        Damaged: the length is damaged.
    """
    opcode, length = _read_head(file, at)
    if length > MAX_RECORD_BYTES:
        raise Damaged(f"a record of {length} bytes exceeds the limit of {MAX_RECORD_BYTES}")
    body = file.read(length)
    if len(body) < length:
        raise _FileCut
    return opcode, body


def _check_end(file: IO[bytes], at: int) -> None:
    """Check the magic bytes after the footer.

    Raises:
        _FileCut: they are missing.
        Damaged: they are wrong.
    """
    file.seek(at)
    end = file.read(len(MAGIC))
    if end != MAGIC:
        raise _FileCut if len(end) < len(MAGIC) else Damaged("it does not end as an MCAP file does")


def _steady_ns_from(file: IO[bytes], index: Index, number: int) -> int:
    """Return the steady time of the first message in this chunk, or in the next readable one."""
    found = (_first_steady_ns(file, index, each) for each in range(number, len(index)))
    return next((steady_ns for steady_ns in found if steady_ns is not None), _NEVER)


def _first_steady_ns(file: IO[bytes], index: Index, number: int) -> int | None:
    try:
        data = unpack_chunk(_read_record(file, index.begins[number])[1], MAX_CHUNK_BYTES)
        at = 0
        while at < len(data):
            opcode, length = RECORD_HEAD.unpack_from(data, at)
            if opcode == Opcode.MESSAGE:
                return int(MESSAGE.unpack_from(data, at + RECORD_HEAD.size)[-1])
            at += RECORD_HEAD.size + length
    except Exception:  # noqa: BLE001 - the library's and its decompressors', for damaged bytes; reading reports them
        return None
    return None


ROS1_SUFFIX, ROS2_SUFFIX = ".bag", ".db3"
BAGS = (ROS1_SUFFIX, UNFINISHED_SUFFIX, ROS2_SUFFIX)


class BagReader:
    """Reader of a ROS 1 or ROS 2 bag, by rosbags."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, str] = {}
        self.damage: list[str] = []
        self.channels: list[Channel] = []
        self.begin_ns = 0  # time of the first message; 0 before it was read

    @property
    def size_bytes(self) -> int:
        """Size of all files of the recording."""
        files = self.path.iterdir() if self.path.is_dir() else [self.path]
        return sum(file.stat().st_size for file in files if file.is_file())

    def read_channels(self) -> list[Channel]:
        """Return the channels that the bag lists.

        Raises:
            RecordingFailed: the bag cannot be read, or is not a bag.
        """
        with self._opened() as bag:
            self.channels = list(dict.fromkeys(map(_bag_channel, bag.connections)))
        return self.channels

    def messages(self, wanted: Wanted = _every, *, after_s: float = 0.0) -> Iterator[StoredMessage]:
        """Yield the messages ordered by time.

        Raises:
            RecordingFailed: the bag cannot be read, or is not a bag.
        """
        with self._opened() as bag:
            channels = {connection.id: _bag_channel(connection) for connection in bag.connections}
            self.channels = list(dict.fromkeys(channels.values()))
            if bag.message_count:
                self.begin_ns = bag.start_time
            chosen = [each for each in bag.connections if wanted(channels[each.id])]
            start_ns = bag.start_time + int(after_s * NS_PER_S) if after_s else None
            found = bag.messages(chosen, start=start_ns) if chosen else iter(())
            try:
                for connection, stamp_ns, payload in found:
                    yield StoredMessage(channels[connection.id], stamp_ns, bytes(payload), stamp_ns)
            except Exception as error:  # noqa: BLE001 - rosbags' readers raise any exception for damaged bytes
                self.damage.append(f"unreadable after a part: {type(error).__name__}: {error}"[:MAX_REASON])

    def _opened(self) -> contextlib.AbstractContextManager[Any]:
        """Open the bag.

        Raises:
            RecordingFailed: the bag cannot be read, or is not a bag.
            LibraryMissing: rosbags is not installed.
        """
        need_rosbags(str(self.path))
        from rosbags.rosbag1 import Reader as Ros1Reader  # noqa: PLC0415 - of the extra `export`
        from rosbags.rosbag2 import Reader as Ros2Reader  # noqa: PLC0415

        is_ros1 = self.path.name.endswith((ROS1_SUFFIX, UNFINISHED_SUFFIX))
        try:
            bag: Any = (Ros1Reader if is_ros1 else Ros2Reader)(self.path)
            bag.open()
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror or error}") from error
        except Exception as error:
            if not is_ros1:
                raise RecordingFailed(f"{self.path} cannot be read: {error}"[:MAX_REASON]) from error
            bag = self._unfinished(error)
        return contextlib.closing(bag)

    def _unfinished(self, why: Exception) -> Any:
        """Open a bag of ROS 1 without an index, which rosbags does not read.

        Raises:
            RecordingFailed: it has no readable message.
        """
        from hostlink.components.recorder.unfinished_bag import UnfinishedBag  # noqa: PLC0415 - as above

        bag = UnfinishedBag(self.path)
        try:
            bag.open()
        except (OSError, ValueError, KeyError, struct.error):
            bag.message_count = 0
        if not bag.message_count:
            raise RecordingFailed(f"{self.path} cannot be read: {why}"[:MAX_REASON]) from why
        if NOT_FINISHED not in self.damage:
            self.damage.append(NOT_FINISHED)
        return bag


RecordingSource = McapReader | BagReader


def open_source(path: Path) -> RecordingSource:
    """Choose the reader by name. The file itself is opened when it is read.

    Raises:
        RecordingFailed: it is a folder, but not a bag of ROS 2.
    """
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise RecordingFailed(
            f"{path} is a folder without metadata.yaml, so it is not a bag of ROS 2; {_files_of(path)}"
        )
    is_bag = path.is_dir() or path.name.endswith(BAGS)
    return BagReader(path) if is_bag else McapReader(path)


def _files_of(folder: Path) -> str:
    """Return what to name instead of a folder."""
    with contextlib.suppress(OSError):
        found = sorted(each for each in folder.iterdir() if each.name.endswith((".mcap", *BAGS)))
        if found:
            more = f" ({len(found)} files)" if len(found) > 1 else ""
            return f"name a file of it, such as {found[-1]}{more}"
    return "name a file"


def _bag_channel(connection: Any) -> Channel:
    from rosbags.interfaces import ConnectionExtRosbag1, MessageDefinitionFormat  # noqa: PLC0415 - as above
    from rosbags.rosbag2.metadata import dump_qos_v8  # noqa: PLC0415

    definition, extra = connection.msgdef, connection.ext
    if isinstance(extra, ConnectionExtRosbag1):
        package, _, base = connection.msgtype.partition("/msg/")
        facts = {"callerid": extra.callerid or "", "md5sum": connection.digest, "latching": str(extra.latching or 0)}
        return Channel(connection.topic, ROS1, f"{package}/{base}", definition.data, tuple(facts.items()))
    language = "ros2idl" if definition.format == MessageDefinitionFormat.IDL else ""
    qos = (("offered_qos_profiles", dump_qos_v8(extra.offered_qos_profiles)),) if extra.offered_qos_profiles else ()
    encoding = CDR if extra.serialization_format == "cdr" else extra.serialization_format
    return Channel(connection.topic, encoding, connection.msgtype, definition.data, qos, language)


@dataclass(slots=True)
class TopicContents:
    """Contents of one channel."""

    channel: Channel
    messages: int = 0
    payload_bytes: int = 0
    first_ns: int = 0  # steady time, as is last_ns
    last_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Messages per second; None with fewer than two messages."""
        seconds = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.messages - 1) / seconds if seconds > 0 else None


class ClockStep(NamedTuple):
    """Step of the wall clock: its time and size."""

    at_s: float  # since the beginning of the recording
    step_s: float


@dataclass(slots=True)
class Contents:
    """Contents of a recording."""

    path: Path
    size_bytes: int
    metadata: dict[str, str]
    damage: list[str]
    topics: list[TopicContents] = field(default_factory=list)
    begin_ns: int = 0  # wall time of the first message; 0 without messages
    clock_steps: list[ClockStep] = field(default_factory=list)  # the first MAX_STEPS

    @property
    def messages(self) -> int:
        """Number of messages of all topics."""
        return sum(topic.messages for topic in self.topics)

    @property
    def seconds(self) -> float:
        """Time from the first to the last message, by a clock that is never set."""
        met = [topic for topic in self.topics if topic.messages]
        last_ns = max((topic.last_ns for topic in met), default=0)
        return (last_ns - min((topic.first_ns for topic in met), default=0)) / NS_PER_S


def contents_of(path: Path) -> Contents:
    """Read the contents of a file.

    Raises:
        RecordingFailed: the file cannot be read, or is not a recording.
    """
    source = open_source(path)
    found = Contents(path, 0, {}, [])
    topics: dict[Channel, TopicContents] = {}
    ahead_ns: int | None = None  # wall time minus steady time
    for message in source.messages():
        topic = topics.get(message.channel)
        if topic is None:
            topic = topics[message.channel] = TopicContents(message.channel)
            topic.first_ns = topic.last_ns = message.steady_ns
        topic.messages += 1
        topic.payload_bytes += len(message.payload)
        topic.first_ns, topic.last_ns = min(topic.first_ns, message.steady_ns), max(topic.last_ns, message.steady_ns)
        if ahead_ns is None:
            found.begin_ns, ahead_ns = message.stamp_ns, message.stamp_ns - message.steady_ns
        step_ns = message.stamp_ns - message.steady_ns - ahead_ns
        ahead_ns += step_ns
        if abs(step_ns) > CLOCK_STEP_NS and len(found.clock_steps) < MAX_STEPS:
            at_s = (message.steady_ns - source.begin_ns) / NS_PER_S
            found.clock_steps.append(ClockStep(at_s, step_ns / NS_PER_S))
    for channel in source.channels:
        topics.setdefault(channel, TopicContents(channel))
    found.topics = sorted(topics.values(), key=lambda topic: topic.channel.topic)
    found.size_bytes, found.metadata, found.damage = source.size_bytes, source.metadata, source.damage
    return found
