"""Rings: the newest messages of every robot, bounded in seconds and in bytes. Pure."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from hostlink.recording.channel import Channel

ENTRY_BYTES = 200  # that an entry takes beside its payload
MOST_AT_ONCE = 500  # that go for one that comes: a robot more makes the room of each less


class Entry(NamedTuple):
    """One message that is kept."""

    channel: Channel
    stamp_ns: int
    payload: bytes
    at_s: float = 0.0  # when it was added, of a clock that nobody sets; 0: it is of a file


class Ring:
    """The newest of one robot, in columns: the garbage collector would go through an object for each message."""

    __slots__ = ("_channels", "_payloads", "_stamps_ns", "_times_s", "size_bytes")

    def __init__(self) -> None:
        self.size_bytes = 0
        self._channels: deque[Channel] = deque()
        self._stamps_ns: deque[int] = deque()
        self._times_s: deque[float] = deque()
        self._payloads: deque[bytes] = deque()

    def add(
        self, channel: Channel, stamp_ns: int, payload: bytes, at_s: float, *, keep_s: float, max_bytes: int
    ) -> int:
        """Keep a message; returns how many went that were not too old: for want of room."""
        self._channels.append(channel)
        self._stamps_ns.append(stamp_ns)
        self._payloads.append(payload)
        self._times_s.append(at_s)
        self.size_bytes += len(payload) + ENTRY_BYTES
        oldest_s = at_s - keep_s
        if self._times_s[0] >= oldest_s and self.size_bytes <= max_bytes:
            return 0
        return self._make_room(oldest_s, max_bytes)

    def _make_room(self, oldest_s: float, max_bytes: int) -> int:
        dropped = 0
        for _ in range(MOST_AT_ONCE):
            if not self._times_s or (self._times_s[0] >= oldest_s and self.size_bytes <= max_bytes):
                break
            self._channels.popleft()
            self._stamps_ns.popleft()
            self.size_bytes -= len(self._payloads.popleft()) + ENTRY_BYTES
            dropped += self._times_s.popleft() >= oldest_s
        return dropped

    def is_used_since(self, oldest_s: float) -> bool:
        """Whether its newest message is of then or later."""
        return bool(self._times_s) and self._times_s[-1] >= oldest_s

    def copy(self) -> Iterator[Entry]:
        """What is kept now, copied as fast as can be; the entries are made as they are read, in any thread."""
        columns = self._channels, self._stamps_ns, self._payloads, self._times_s
        return map(Entry, *(column.copy() for column in columns))


class Rings:
    """A ring for each robot, and one for what is nobody's; each has an equal part of the room."""

    def __init__(self, *, keep_s: float, max_bytes: int) -> None:
        self.dropped = 0  # messages that were not too old
        self._keep_s, self._max_bytes = keep_s, max_bytes
        self._rings: dict[str, Ring] = {}

    def add(self, robot: str, channel: Channel, stamp_ns: int, payload: bytes, at_s: float) -> None:
        """Keep a message; `at_s`: now, of a clock that nobody sets."""
        ring = self._rings.get(robot)
        if ring is None:
            self._drop_unused(at_s - self._keep_s)
            ring = self._rings[robot] = Ring()
        room = self._max_bytes // len(self._rings)
        self.dropped += ring.add(channel, stamp_ns, payload, at_s, keep_s=self._keep_s, max_bytes=room)

    def _drop_unused(self, oldest_s: float) -> None:
        """Those of which all is too old: they would leave less room for the others."""
        self._rings = {robot: ring for robot, ring in self._rings.items() if ring.is_used_since(oldest_s)}

    def forget(self, robot: str) -> None:
        """The robot is forgotten."""
        self._rings.pop(robot, None)

    def copies(self, robot: str) -> list[Iterator[Entry]]:
        """What is kept of a robot, and of nobody; to be read once, also by another thread."""
        names = (robot, "") if robot else ("",)
        return [self._rings[name].copy() for name in names if name in self._rings]

    @property
    def size_bytes(self) -> int:
        """Of all."""
        return sum(ring.size_bytes for ring in self._rings.values())
