"""RingMemory: blocks of memory that survive the process: a file on tmpfs, with what a reader must know beside it.

| file          | what it has                                                                                       |
|---------------|---------------------------------------------------------------------------------------------------|
| ring          | the blocks: ring.py. The process that uses them holds a lock on it                                |
| schemas       | definitions of message types, a line of JSON each: numbers in the blocks refer to their order     |
| *.json        | one fact each, written whole: `put_fact`                                                          |
"""

import contextlib
import fcntl
import itertools
import mmap
import os
import shutil
import struct
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec

from hostlink import remains
from hostlink.recording.channel import Channel

# -- ring memory ------------------------------------------------------------------------------------------------------

BLOCK_BYTES = 16 * 1024
GROWTH_BLOCKS = 16  # taken from the system at a time: what is never needed is never taken
FEWEST_BLOCKS = 4
MAX_SCHEMAS = 4096
MAX_SCHEMA_BYTES = 8 * 1024 * 1024
RING, SCHEMAS = "ring", "schemas"


class RingMemory:
    """`folder` is None where it does not survive: there is no tmpfs, or no room on it."""

    def __init__(self, max_bytes: int, *, purpose: str | None = None) -> None:
        """`purpose`: who may find it later, letters and digits; None: nobody, it does not survive."""
        self.max_blocks = max(FEWEST_BLOCKS, max_bytes // BLOCK_BYTES)
        self.blocks = 0  # that may be used
        self.folder: Path | None = None
        self._descriptor = -1
        self._schemas: dict[str, int] = {"": 0}
        self._schema_bytes = 0
        if purpose is not None:
            with contextlib.suppress(OSError):
                self._open(purpose)
        if self.folder is None:
            self.bytes = mmap.mmap(-1, self.max_blocks * BLOCK_BYTES)
            self.blocks = self.max_blocks  # the system gives each page when it is first written to

    def _open(self, purpose: str) -> None:
        folder = Path(tempfile.mkdtemp(prefix=remains.prefix_of(purpose), dir=remains.PLACE))
        try:
            free_bytes = shutil.disk_usage(folder).free
            self.max_blocks = max(FEWEST_BLOCKS, min(self.max_blocks, free_bytes // 2 // BLOCK_BYTES))
            self._descriptor = os.open(folder / RING, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            os.ftruncate(self._descriptor, self.max_blocks * BLOCK_BYTES)
            self.bytes = mmap.mmap(self._descriptor, self.max_blocks * BLOCK_BYTES)
            os.posix_fallocate(self._descriptor, 0, FEWEST_BLOCKS * BLOCK_BYTES)  # its OSError: there is no room
            self.blocks = FEWEST_BLOCKS
            (folder / SCHEMAS).touch()
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            if self._descriptor >= 0:
                os.close(self._descriptor)
                self._descriptor = -1
            raise
        self.folder = folder

    def grow(self) -> bool:
        """Take more blocks from the system; False: it has none, or there are as many as may be.

        A page of a full tmpfs would end the process with SIGBUS when it is first written to.
        """
        more = min(GROWTH_BLOCKS, self.max_blocks - self.blocks)
        if more <= 0:
            return False
        try:
            os.posix_fallocate(self._descriptor, self.blocks * BLOCK_BYTES, more * BLOCK_BYTES)
        except OSError:
            self.max_blocks = self.blocks
            return False
        self.blocks += more
        return True

    def schema_number(self, schema: str) -> int:
        """The number of a definition; 0, that of the empty one, where there are too many."""
        number = self._schemas.get(schema)
        if number is not None:
            return number
        line = msgspec.json.encode(schema) + b"\n"
        if len(self._schemas) >= MAX_SCHEMAS or self._schema_bytes + len(line) > MAX_SCHEMA_BYTES:
            return 0
        try:
            if self.folder is not None:
                with (self.folder / SCHEMAS).open("ab") as file:
                    file.write(line)
        except OSError:  # no room
            return 0
        self._schema_bytes += len(line)
        number = self._schemas[schema] = len(self._schemas)
        return number

    def schemas(self) -> list[str]:
        """By their numbers."""
        return list(self._schemas)

    def put_fact(self, name: str, fact: object) -> None:
        """Keep it beside the blocks, whole or not at all."""
        if self.folder is not None:
            with contextlib.suppress(OSError):  # no room
                write_fact(self.folder, name, fact)

    def drop_fact(self, name: str) -> None:
        """Nobody needs to know it any more."""
        if self.folder is not None:
            with contextlib.suppress(OSError):
                (self.folder / f"{name}.json").unlink()

    def release(self) -> Path | None:
        """The process needs it no more: whoever finds it may have it. Returns where it is."""
        if self._descriptor >= 0:
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)  # the map has a descriptor of its own, as long as this process
            os.close(self._descriptor)
            self._descriptor = -1
        return self.folder

    def remove(self) -> None:
        """Nobody needs it."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
        self.release()


def write_fact(folder: Path, name: str, fact: object) -> None:
    """Write it whole, or not at all.

    Raises:
        OSError: there is no room.
    """
    beside = folder / f"{name}.part"
    beside.write_bytes(msgspec.json.encode(fact))
    beside.rename(folder / f"{name}.json")


def read_schemas(folder: Path) -> list[str]:
    """Those of a process that is gone; a line that was not finished is left out."""
    found = [""]
    with contextlib.suppress(OSError):
        for line in (folder / SCHEMAS).read_bytes().splitlines():
            with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError):
                found.append(msgspec.json.decode(line, type=str))
    return found


# -- ring -------------------------------------------------------------------------------------------------------------

_BEGIN = struct.Struct("<Q")
_RECORD = struct.Struct("<IHHqd")
_MARK = 0x9E5D
_MARK_BYTES = struct.pack("<H", _MARK)
HEADER_BYTES = _RECORD.size + len(_MARK_BYTES)  # that a message takes beside its payload
_ZEROS = bytes(BLOCK_BYTES)
_MAX_PACKERS = 4096
MAX_DEFINITIONS = 4096
MAX_MESSAGES = 150_000  # of a ring: as objects, which whoever reads it makes, they take 200 bytes each
_NO_NUMBER = 0
_MAX_NUMBER = 0xFFFF
_MESSAGE, _MORE, _CONTINUED, _NAME, _CHANNEL = 0, 1, 2, 4, 8  # flags
_LEAST_ROOM = 1024  # of the rest of a block for a piece of a message; with less the next block is begun


class Entry(NamedTuple):
    """One message that is kept."""

    channel: Channel
    stamp_ns: int
    payload: bytes
    at_s: float = 0.0  # when it was added, of a clock that nobody sets; 0: it is of a file


Pack = Callable[..., None]


_packers: dict[int, Pack] = {}  # what writes a record into memory in one call, by the size of its payload


def _packer_of(size_bytes: int) -> Pack:
    pack = _packers.get(size_bytes)
    if pack is None:
        if len(_packers) >= _MAX_PACKERS:
            _packers.clear()
        pack = _packers[size_bytes] = struct.Struct(f"{_RECORD.format}{size_bytes}sH").pack_into
    return pack


class _Kept(NamedTuple):
    """A block that is full."""

    block: int
    end: int
    newest_s: float
    messages: int


class Ring:
    """The newest of one robot. Only the last of its blocks is written to."""

    __slots__ = (
        "_channels", "_definitions", "_memory", "_name", "block", "end", "full", "in_full", "last_s", "limit",
        "messages", "numbers",
    )  # fmt: skip

    def __init__(self, name: bytes, memory: RingMemory, definitions: "_Definitions") -> None:
        self._name, self._memory, self._definitions = name, memory, definitions
        self.full: deque[_Kept] = deque()
        self.last_s = float("-inf")
        self.block, self.messages, self.in_full = -1, 0, 0  # none yet; messages in it, and in the full ones
        self.end = self.limit = 0  # of what is in the block, and of the block, in all of the memory
        self.numbers: dict[int, int] = {}  # of channels, by id(); `_channels` keeps these objects alive
        self._channels: list[Channel] = []

    @property
    def blocks(self) -> int:
        """How many it has."""
        return len(self.full) + (self.block >= 0)

    @property
    def room(self) -> int:
        """Bytes that are left in its block."""
        return self.limit - self.end

    def put(self, number: int, flags: int, payload: bytes, stamp_ns: int = 0, at_s: float = 0.0) -> None:
        """Add a record, for which there must be room. `Rings.add` has the same for a whole message."""
        size_bytes = len(payload)
        _packer_of(size_bytes)(self._memory.bytes, self.end, size_bytes, number, flags, stamp_ns, at_s, payload, _MARK)
        self.end += HEADER_BYTES + size_bytes
        if not flags & (_NAME | _CHANNEL):
            self.last_s = at_s
            self.messages += not flags & _MORE

    def number_of(self, channel: Channel) -> int | None:
        """The channel's number in this block, from now on; None: there is no room for its definition."""
        number = self.numbers.get(id(channel))
        if number is not None:
            return number
        number = len(self._channels) + 1
        encoded = self._definitions.of(channel)
        if number > _MAX_NUMBER or self.end + HEADER_BYTES + len(encoded) > self.limit:
            return None
        self.put(number, _CHANNEL, encoded)
        self._channels.append(channel)
        self.numbers[id(channel)] = number
        return number

    def begin(self, block: int, sequence: int) -> None:
        """Write into this block from now on."""
        if self.block >= 0:
            self.full.append(_Kept(self.block, self.end, self.last_s, self.messages))
            self.in_full += self.messages
        self.numbers, self._channels, self.messages = {}, [], 0
        start = block * BLOCK_BYTES
        self.block, self.end, self.limit = block, start + _BEGIN.size, start + BLOCK_BYTES
        self._memory.bytes[start : self.limit] = _ZEROS
        self.put(_NO_NUMBER, _NAME, self._name)
        _BEGIN.pack_into(self._memory.bytes, start, sequence)

    def drop_oldest(self) -> _Kept:
        """The block of its oldest messages, which are gone."""
        if self.full:
            dropped = self.full.popleft()
            self.in_full -= dropped.messages
        else:
            dropped = _Kept(self.block, self.end, self.last_s, self.messages)
            self.block, self.messages, self.end, self.limit = -1, 0, 0, 0
            self.numbers, self._channels = {}, []
        _BEGIN.pack_into(self._memory.bytes, dropped.block * BLOCK_BYTES, 0)
        return dropped

    def copy(self) -> list[bytes]:
        """Its blocks, the oldest first, as they are now."""
        blocks = [(kept.block, kept.end) for kept in self.full]
        if self.block >= 0:
            blocks.append((self.block, self.end))
        return [self._memory.bytes[block * BLOCK_BYTES : end] for block, end in blocks]


class _Definition(msgspec.Struct, array_like=True):
    """A channel in a block."""

    topic: str
    encoding: str
    type_name: str
    schema: int
    metadata: tuple[tuple[str, str], ...]


class _Definitions:
    """Of channels, encoded once: a channel is in many blocks."""

    def __init__(self, memory: RingMemory) -> None:
        self._memory = memory
        self._encoded: dict[int, tuple[Channel, bytes]] = {}  # by id()

    def of(self, channel: Channel) -> bytes:
        """As a record has it."""
        found = self._encoded.get(id(channel))
        if found is not None:
            return found[1]
        if len(self._encoded) >= MAX_DEFINITIONS:
            self._encoded.clear()
        schema = self._memory.schema_number(channel.schema)
        definition = _Definition(channel.topic, channel.encoding, channel.type_name, schema, channel.metadata)
        encoded = msgspec.msgpack.encode(definition)
        self._encoded[id(channel)] = (channel, encoded)
        return encoded


class Rings:
    """A ring for each robot, and one for what is nobody's; each has an equal part of the room, in blocks."""

    def __init__(self, memory: RingMemory, *, keep_s: float) -> None:
        self.dropped = 0  # messages that were not too old
        self._memory, self._keep_s = memory, keep_s
        self._bytes, self._definitions = memory.bytes, _Definitions(memory)
        self._rings: dict[str, Ring] = {}
        self._free: list[int] = []  # used again before the system is requested for more
        self._taken = 0  # blocks that were ever used
        self._sequence = itertools.count(1)

    def add(self, robot: str, channel: Channel, stamp_ns: int, payload: bytes, at_s: float) -> None:
        """Keep a message; `at_s`: now, of a clock that nobody sets."""
        ring = self._rings.get(robot)
        if ring is not None:
            number = ring.numbers.get(id(channel)) or ring.number_of(channel)
            size_bytes = len(payload)
            end = ring.end + HEADER_BYTES + size_bytes
            if number is not None and end <= ring.limit and size_bytes in _packers:  # one in hundreds is not so
                _packers[size_bytes](
                    self._bytes, ring.end, size_bytes, number, _MESSAGE, stamp_ns, at_s, payload, _MARK
                )
                ring.end = end
                ring.last_s = at_s
                ring.messages += 1
                return
        self._add_in_next(robot, channel, stamp_ns, payload, at_s)

    def _add_in_next(self, robot: str, channel: Channel, stamp_ns: int, payload: bytes, at_s: float) -> None:
        """It needs a number, a ring, or more than the rest of a block."""
        ring = self._rings.get(robot)
        if ring is None:
            self._drop_unused(at_s - self._keep_s)
            ring = self._rings[robot] = Ring(robot.encode()[: BLOCK_BYTES // 4], self._memory, self._definitions)
        rest = payload
        if len(payload) > self._room() * (BLOCK_BYTES - _LEAST_ROOM) - _LEAST_ROOM:
            self.dropped += 1
            return
        flags = _MESSAGE
        is_long = len(payload) > BLOCK_BYTES // 2
        while True:
            number = ring.number_of(channel) if ring.block >= 0 else None
            room = ring.room - HEADER_BYTES
            if number is not None and len(rest) <= room:
                ring.put(number, flags, rest, stamp_ns, at_s)
                return
            if number is not None and is_long and room >= _LEAST_ROOM:
                ring.put(number, flags | _MORE, rest[:room], stamp_ns, at_s)
                rest, flags = rest[room:], _CONTINUED
            elif number is None and ring.block >= 0 and room >= BLOCK_BYTES // 2:  # a definition that fits no block
                self.dropped += 1
                return
            ring.begin(self._block_for(ring, at_s), next(self._sequence))

    def _room(self) -> int:
        """Blocks that each ring may have."""
        return max(1, self._memory.max_blocks // max(1, len(self._rings)))

    def _block_for(self, ring: Ring, at_s: float) -> int:
        """A free block, at the cost of what is oldest in the ring that has the most."""
        oldest_s = at_s - self._keep_s
        while ring.full and ring.full[0].newest_s < oldest_s:
            self._free.append(ring.drop_oldest().block)
        if ring.blocks >= self._room() or (ring.full and ring.in_full + ring.messages >= MAX_MESSAGES):
            return self._drop(ring, oldest_s)
        if self._free:
            return self._free.pop()
        if self._taken < self._memory.blocks or self._memory.grow():
            self._taken += 1
            return self._taken - 1
        return self._drop(max(self._rings.values(), key=lambda each: (each.blocks, -each.last_s)), oldest_s)

    def _drop(self, ring: Ring, oldest_s: float) -> int:
        dropped = ring.drop_oldest()
        if dropped.newest_s >= oldest_s:
            self.dropped += dropped.messages
        return dropped.block

    def _drop_unused(self, oldest_s: float) -> None:
        """Those of which all is too old: they would leave less room for the others."""
        for robot in [robot for robot, ring in self._rings.items() if ring.last_s < oldest_s]:
            self.forget(robot)

    def forget(self, robot: str) -> None:
        """The robot is forgotten."""
        ring = self._rings.pop(robot, None)
        while ring is not None and ring.blocks:
            self._free.append(ring.drop_oldest().block)

    def copies(self, robot: str) -> list[Iterator[Entry]]:
        """What is kept of a robot, and of nobody; to be read once, also by another thread."""
        names = (robot, "") if robot else ("",)
        schemas = self._memory.schemas()
        rings = [self._rings[name] for name in names if name in self._rings]
        return [read_entries(ring.copy(), schemas, oldest_s=ring.last_s - self._keep_s) for ring in rings]

    @property
    def size_bytes(self) -> int:
        """Of all."""
        return BLOCK_BYTES * sum(ring.blocks for ring in self._rings.values())


# -- reading ----------------------------------------------------------------------------------------------------------


class _Record(NamedTuple):
    number: int
    flags: int
    stamp_ns: int
    at_s: float
    payload: bytes


def _records(block: bytes) -> Iterator[_Record]:
    """Up to the end, or to what cannot be a record."""
    start = _BEGIN.size
    while start + HEADER_BYTES <= len(block):
        size_bytes, number, flags, stamp_ns, at_s = _RECORD.unpack_from(block, start)
        begin, start = start + _RECORD.size, start + HEADER_BYTES + size_bytes
        if block[start - len(_MARK_BYTES) : start] != _MARK_BYTES:
            return
        yield _Record(number, flags, stamp_ns, at_s, block[begin : begin + size_bytes])


@dataclass(slots=True)
class _ChannelReader:
    """The channels of many blocks, each made once."""

    schemas: Sequence[str]
    _known: dict[bytes, Channel | None] = field(default_factory=dict)

    def read(self, definition: bytes) -> Channel | None:
        """None: it is damaged."""
        if definition not in self._known:
            self._known[definition] = self._read(definition)
        return self._known[definition]

    def _read(self, definition: bytes) -> Channel | None:
        try:
            found = msgspec.msgpack.decode(definition, type=_Definition)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return None
        schema = self.schemas[found.schema] if 0 <= found.schema < len(self.schemas) else ""
        return Channel(found.topic, found.encoding, found.type_name, schema, found.metadata)


def read_entries(blocks: Iterable[bytes], schemas: Sequence[str], *, oldest_s: float = 0.0) -> Iterator[Entry]:
    """The messages of one ring's blocks, as they were added; those that were added before `oldest_s` are left out."""
    reader = _ChannelReader(schemas)
    parts: list[bytes] = []  # of a message over several blocks
    for block in blocks:
        channels: dict[int, Channel | None] = {}
        for record in _records(block):
            if record.flags & _CHANNEL:
                channels[record.number] = reader.read(record.payload)
                continue
            if record.flags & _NAME:
                continue
            if not record.flags & _CONTINUED:
                parts = []
            elif not parts:
                continue  # its beginning is gone
            parts.append(record.payload)
            if record.flags & _MORE:
                continue
            channel = channels.get(record.number)
            if channel is not None and record.at_s >= oldest_s:
                yield Entry(channel, record.stamp_ns, b"".join(parts) if len(parts) > 1 else parts[0], record.at_s)
            parts = []


def read_blocks(memory: bytes) -> dict[str, list[bytes]]:
    """The blocks of a process that is gone, by robot, the oldest first; what is damaged is left out."""
    found: list[tuple[int, str, bytes]] = []
    for start in range(0, len(memory) - BLOCK_BYTES + 1, BLOCK_BYTES):
        (sequence,) = _BEGIN.unpack_from(memory, start)
        block = memory[start : start + BLOCK_BYTES]
        name = next(_records(block), None)
        if sequence and name is not None and name.flags & _NAME:
            found.append((sequence, name.payload.decode("utf-8", "replace"), block))
    by_robot: dict[str, list[bytes]] = {}
    for _, robot, block in sorted(found, key=lambda each: each[0]):
        by_robot.setdefault(robot, []).append(block)
    return by_robot
