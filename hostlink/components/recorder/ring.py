"""RingMemory and Rings: the black box's memory, in blocks of a tmpfs file that survives the process.

| file          | content                                                                                           |
|---------------|---------------------------------------------------------------------------------------------------|
| ring          | the blocks. The process that uses them holds a lock on it                                         |
| schemas       | definitions of message types, one JSON line each; numbers in the blocks refer to their order      |
| *.json        | one fact each, written atomically: `put_fact`                                                     |
"""

import contextlib
import fcntl
import itertools
import mmap
import os
import shutil
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from hostlink.components.recorder.channel import Channel
from hostlink.core.runtime import remains
from hostlink.core.runtime.whole_file import replace_file

# -- ring memory ------------------------------------------------------------------------------------------------------

BLOCK_BYTES = 16 * 1024
GROWTH_BLOCKS = 16  # allocated at a time, so that unneeded memory is not allocated
FEWEST_BLOCKS = 4
MAX_SCHEMAS = 4096
MAX_SCHEMA_BYTES = 8 * 1024 * 1024
RING, SCHEMAS = "ring", "schemas"

_RECORD = struct.Struct("<IHHqd")
_MARK = 0x9E5D
_MARK_BYTES = struct.pack("<H", _MARK)
HEADER_BYTES = _RECORD.size + len(_MARK_BYTES)  # of a message besides its payload

MAX_MESSAGES = 150_000  # of one ring: a reader creates objects of 200 bytes for each


class _Definition(msgspec.Struct, array_like=True):
    """Channel definition in a block."""

    topic: str
    encoding: str
    type_name: str
    schema: int
    metadata: tuple[tuple[str, str], ...]


class RingMemory:
    """Memory of the rings. `folder` is None if it does not survive: there is no tmpfs, or no room on it."""

    def __init__(self, max_bytes: int, *, purpose: str | None = None) -> None:
        """`purpose` identifies the memory for a later process (letters and digits); None: it does not survive."""
        self.max_blocks = max(FEWEST_BLOCKS, max_bytes // BLOCK_BYTES)
        self.blocks = 0  # usable blocks
        self.folder: Path | None = None
        self._descriptor = -1
        self._schemas: dict[str, int] = {"": 0}
        self._schema_bytes = 0
        if purpose is not None:
            with contextlib.suppress(OSError):
                self._open(purpose)
        if self.folder is None:
            self.bytes = mmap.mmap(-1, self.max_blocks * BLOCK_BYTES)
            self.blocks = self.max_blocks  # the system allocates each page at its first write

    def _open(self, purpose: str) -> None:
        folder = Path(tempfile.mkdtemp(prefix=remains.prefix_of(purpose), dir=remains.PLACE))
        try:
            free_bytes = shutil.disk_usage(folder).free
            self.max_blocks = max(FEWEST_BLOCKS, min(self.max_blocks, free_bytes // 2 // BLOCK_BYTES))
            self._descriptor = os.open(folder / RING, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            os.ftruncate(self._descriptor, self.max_blocks * BLOCK_BYTES)
            self.bytes = mmap.mmap(self._descriptor, self.max_blocks * BLOCK_BYTES)
            os.posix_fallocate(self._descriptor, 0, FEWEST_BLOCKS * BLOCK_BYTES)  # raises OSError if there is no room
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
        """Allocate more blocks. False: there is no room, or the maximum is reached.

        Writing to a page of a full tmpfs would end the process with SIGBUS, so blocks are allocated first.
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
        """Return the number of a definition; 0, the empty one, if there are too many."""
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
        except OSError:  # no room on the tmpfs
            return 0
        self._schema_bytes += len(line)
        number = self._schemas[schema] = len(self._schemas)
        return number

    def definition_of(self, channel: Channel) -> bytes:
        """Return the definition of a channel as a record contains it."""
        schema = self.schema_number(channel.schema)
        definition = _Definition(channel.topic, channel.encoding, channel.type_name, schema, channel.metadata)
        return msgspec.msgpack.encode(definition)

    def schemas(self) -> list[str]:
        """Return the definitions in the order of their numbers."""
        return list(self._schemas)

    def put_fact(self, name: str, fact: object) -> None:
        """Store a fact with the blocks, atomically."""
        if self.folder is not None:
            with contextlib.suppress(OSError):  # no room on the tmpfs
                write_fact(self.folder, name, fact)

    def drop_fact(self, name: str) -> None:
        """Remove a fact that is no longer needed."""
        if self.folder is not None:
            with contextlib.suppress(OSError):
                (self.folder / f"{name}.json").unlink()

    def release(self) -> Path | None:
        """Release the lock, so that another process may take the memory. Return its folder."""
        if self._descriptor >= 0:
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)  # the map keeps a descriptor of its own until the process ends
            os.close(self._descriptor)
            self._descriptor = -1
        return self.folder

    def remove(self) -> None:
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
        self.release()


def write_fact(folder: Path, name: str, fact: object) -> None:
    """Write a fact atomically.

    Raises:
        OSError: there is no room.
    """
    replace_file(folder / f"{name}.json", msgspec.json.encode(fact))


def read_schemas(folder: Path) -> list[str]:
    """Read the definitions of an ended process. Skip an unfinished line."""
    found = [""]
    with contextlib.suppress(OSError):
        for line in (folder / SCHEMAS).read_bytes().splitlines():
            with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError):
                found.append(msgspec.json.decode(line, type=str))
    return found


# -- ring -------------------------------------------------------------------------------------------------------------

_BEGIN = struct.Struct("<Q")
_ZEROS = bytes(BLOCK_BYTES)
_MAX_PACKERS = 4096
_NO_NUMBER = 0
_MAX_NUMBER = 0xFFFF
_MESSAGE, _MORE, _CONTINUED, _NAME, _CHANNEL = 0, 1, 2, 4, 8  # flags
_LEAST_ROOM = 1024  # smallest rest of a block for a part of a message; below it the next block is used


class Entry(NamedTuple):
    """Message in a ring."""

    channel: Channel
    stamp_ns: int
    payload: bytes
    at_s: float = 0.0  # time of `add` by a clock that is never set; 0 if read from a file


Pack = Callable[..., None]


_packers: dict[int, Pack] = {}  # by payload size: writes a whole record into memory in one call


def _packer_of(size_bytes: int) -> Pack:
    pack = _packers.get(size_bytes)
    if pack is None:
        if len(_packers) >= _MAX_PACKERS:
            _packers.clear()
        pack = _packers[size_bytes] = struct.Struct(f"{_RECORD.format}{size_bytes}sH").pack_into
    return pack


class _Kept(NamedTuple):
    """Full block."""

    block: int
    end: int
    newest_s: float
    messages: int


class Ring:
    """Newest messages of one robot. Only the last block is written to."""

    __slots__ = (
        "_channels", "_memory", "_name", "block", "end", "full", "in_full", "last_s", "limit",
        "messages", "numbers",
    )  # fmt: skip

    def __init__(self, name: bytes, memory: RingMemory) -> None:
        self._name, self._memory = name, memory
        self.full: list[_Kept] = []  # oldest first; a deque would need 700 bytes for each robot
        self.last_s = float("-inf")
        self.block, self.messages, self.in_full = -1, 0, 0  # no block yet; messages in it, and in the full ones
        self.end = self.limit = 0  # end of the data and of the block, as offsets in the memory
        self.numbers: dict[int, int] = {}  # channel numbers by id(); `_channels` keeps these objects alive
        self._channels: list[Channel] = []

    @property
    def blocks(self) -> int:
        return len(self.full) + (self.block >= 0)

    def put(self, number: int, flags: int, payload: bytes, stamp_ns: int = 0, at_s: float = 0.0) -> None:
        """Add a record; there must be room for it. `Rings.add` repeats this code for a whole message."""
        size_bytes = len(payload)
        _packer_of(size_bytes)(self._memory.bytes, self.end, size_bytes, number, flags, stamp_ns, at_s, payload, _MARK)
        self.end += HEADER_BYTES + size_bytes
        if not flags & (_NAME | _CHANNEL):
            self.last_s = at_s
            self.messages += not flags & _MORE

    def number_of(self, channel: Channel) -> int | None:
        """Return the channel's number in this block, and define it if needed; None if there is no room for that."""
        number = self.numbers.get(id(channel))
        if number is not None:
            return number
        number = len(self._channels) + 1
        encoded = self._memory.definition_of(channel)
        if number > _MAX_NUMBER or self.end + HEADER_BYTES + len(encoded) > self.limit:
            return None
        self.put(number, _CHANNEL, encoded)
        self._channels.append(channel)
        self.numbers[id(channel)] = number
        return number

    def begin(self, block: int, sequence: int) -> None:
        """Continue in this block."""
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
        """Remove and return the block of the oldest messages."""
        if self.full:
            dropped = self.full.pop(0)
            self.in_full -= dropped.messages
        else:
            dropped = _Kept(self.block, self.end, self.last_s, self.messages)
            self.block, self.messages, self.end, self.limit = -1, 0, 0, 0
            self.numbers, self._channels = {}, []
        _BEGIN.pack_into(self._memory.bytes, dropped.block * BLOCK_BYTES, 0)
        return dropped

    def copy(self) -> list[bytes]:
        """Return copies of the blocks, oldest first."""
        blocks = [(kept.block, kept.end) for kept in self.full]
        if self.block >= 0:
            blocks.append((self.block, self.end))
        return [self._memory.bytes[block * BLOCK_BYTES : end] for block, end in blocks]


class Rings:
    """One ring for each robot and one for messages without a robot. Each gets an equal number of blocks."""

    def __init__(self, memory: RingMemory, *, keep_s: float) -> None:
        self.dropped = 0  # messages dropped before they were too old
        self._memory, self._keep_s = memory, keep_s
        self._bytes = memory.bytes
        self._rings: dict[str, Ring] = {}
        self._free: list[int] = []  # reused before more are allocated
        self._taken = 0  # blocks that were ever used
        self._sequence = itertools.count(1)

    def add(self, robot: str, channel: Channel, stamp_ns: int, payload: bytes, at_s: float) -> None:
        """Keep a message. `at_s` is the current time of a clock that is never set."""
        ring = self._rings.get(robot)
        if ring is not None:
            number = ring.numbers.get(id(channel)) or ring.number_of(channel)
            size_bytes = len(payload)
            end = ring.end + HEADER_BYTES + size_bytes
            if number is not None and end <= ring.limit and size_bytes in _packers:  # false for one message in hundreds
                _packers[size_bytes](
                    self._bytes, ring.end, size_bytes, number, _MESSAGE, stamp_ns, at_s, payload, _MARK
                )
                ring.end = end
                ring.last_s = at_s
                ring.messages += 1
                return
        self._add_in_next(robot, channel, stamp_ns, payload, at_s)

    def _add_in_next(self, robot: str, channel: Channel, stamp_ns: int, payload: bytes, at_s: float) -> None:
        """Add a message that needs a channel number, a ring or another block."""
        ring = self._rings.get(robot)
        if ring is None:
            self._drop_unused(at_s - self._keep_s)
            ring = self._rings[robot] = Ring(robot.encode()[: BLOCK_BYTES // 4], self._memory)
        rest = payload
        if len(payload) > self._room() * (BLOCK_BYTES - _LEAST_ROOM) - _LEAST_ROOM:
            self.dropped += 1
            return
        flags = _MESSAGE
        is_long = len(payload) > BLOCK_BYTES // 2
        while True:
            number = ring.number_of(channel) if ring.block >= 0 else None
            room = ring.limit - ring.end - HEADER_BYTES
            if number is not None and len(rest) <= room:
                ring.put(number, flags, rest, stamp_ns, at_s)
                return
            if number is not None and is_long and room >= _LEAST_ROOM:
                ring.put(number, flags | _MORE, rest[:room], stamp_ns, at_s)
                rest, flags = rest[room:], _CONTINUED
            elif number is None and ring.block >= 0 and room >= BLOCK_BYTES // 2:  # the definition fits no block
                self.dropped += 1
                return
            ring.begin(self._block_for(ring, at_s), next(self._sequence))

    def _room(self) -> int:
        """Number of blocks that each ring may have."""
        return max(1, self._memory.max_blocks // max(1, len(self._rings)))

    def _block_for(self, ring: Ring, at_s: float) -> int:
        """Return a free block. If there is none, drop the oldest block of the ring that has the most."""
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
        """Remove rings with only old messages, because they reduce the room of the others."""
        for robot in [robot for robot, ring in self._rings.items() if ring.last_s < oldest_s]:
            self.forget(robot)

    def forget(self, robot: str) -> None:
        ring = self._rings.pop(robot, None)
        while ring is not None and ring.blocks:
            self._free.append(ring.drop_oldest().block)

    def copies(self, robot: str) -> list[Iterator[Entry]]:
        """Return the entries of a robot and of no robot. They can be read once, also by another thread."""
        names = (robot, "") if robot else ("",)
        schemas = self._memory.schemas()
        rings = [self._rings[name] for name in names if name in self._rings]
        return [read_entries(ring.copy(), schemas, oldest_s=ring.last_s - self._keep_s) for ring in rings]

    @property
    def size_bytes(self) -> int:
        return BLOCK_BYTES * sum(ring.blocks for ring in self._rings.values())


# -- reading ----------------------------------------------------------------------------------------------------------


class _Record(NamedTuple):
    number: int
    flags: int
    stamp_ns: int
    at_s: float
    payload: bytes


def _records(block: bytes) -> Iterator[_Record]:
    """Yield records up to the end, or up to damage."""
    start = _BEGIN.size
    while start + HEADER_BYTES <= len(block):
        size_bytes, number, flags, stamp_ns, at_s = _RECORD.unpack_from(block, start)
        begin, start = start + _RECORD.size, start + HEADER_BYTES + size_bytes
        if block[start - len(_MARK_BYTES) : start] != _MARK_BYTES:
            return
        yield _Record(number, flags, stamp_ns, at_s, block[begin : begin + size_bytes])


def _decode_channel(definition: bytes, schemas: Sequence[str]) -> Channel | None:
    """Decode a definition; None if it is damaged."""
    try:
        found = msgspec.msgpack.decode(definition, type=_Definition)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
    schema = schemas[found.schema] if 0 <= found.schema < len(schemas) else ""
    return Channel(found.topic, found.encoding, found.type_name, schema, found.metadata)


def read_entries(blocks: Iterable[bytes], schemas: Sequence[str], *, oldest_s: float = 0.0) -> Iterator[Entry]:
    """Yield the messages of one ring's blocks in order, without those added before `oldest_s`."""
    known: dict[bytes, Channel | None] = {}  # by definition, which many blocks have
    parts: list[bytes] = []  # parts of a message in several blocks
    for block in blocks:
        channels: dict[int, Channel | None] = {}
        for record in _records(block):
            if record.flags & _CHANNEL:
                if record.payload not in known:
                    known[record.payload] = _decode_channel(record.payload, schemas)
                channels[record.number] = known[record.payload]
                continue
            if record.flags & _NAME:
                continue
            if not record.flags & _CONTINUED:
                parts = []
            elif not parts:
                continue  # the beginning of the message is lost
            parts.append(record.payload)
            if record.flags & _MORE:
                continue
            channel = channels.get(record.number)
            if channel is not None and record.at_s >= oldest_s:
                yield Entry(channel, record.stamp_ns, b"".join(parts) if len(parts) > 1 else parts[0], record.at_s)
            parts = []


def read_blocks(memory: bytes) -> dict[str, list[bytes]]:
    """Return the blocks of an ended process by robot, oldest first, without damaged ones."""
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
