"""Rings: the newest messages of every robot, bounded in seconds and in bytes. Pure."""

from collections import deque
from typing import NamedTuple

from hostlink.recording.channel import Channel

ENTRY_BYTES = 200  # that an entry takes beside its payload


class Entry(NamedTuple):
    """One message that is kept."""

    channel: Channel
    stamp_ns: int
    payload: bytes


class Ring:
    """The newest of one robot."""

    __slots__ = ("entries", "size_bytes")

    def __init__(self) -> None:
        self.entries: deque[Entry] = deque()
        self.size_bytes = 0

    def add(self, entry: Entry, *, keep_ns: int, max_bytes: int) -> int:
        """Keep it; returns how many went that were not too old: for want of room."""
        entries = self.entries
        entries.append(entry)
        self.size_bytes += len(entry.payload) + ENTRY_BYTES
        oldest_ns = entry.stamp_ns - keep_ns
        dropped = 0
        while entries[0].stamp_ns < oldest_ns or self.size_bytes > max_bytes:
            gone = entries.popleft()
            self.size_bytes -= len(gone.payload) + ENTRY_BYTES
            dropped += gone.stamp_ns >= oldest_ns
            if not entries:
                break
        return dropped


class Rings:
    """A ring for each robot, and one for what is nobody's; each has an equal part of the room."""

    def __init__(self, *, keep_s: float, max_bytes: int) -> None:
        self.dropped = 0  # messages that were not too old
        self._keep_ns, self._max_bytes = int(keep_s * 1e9), max_bytes
        self._rings: dict[str, Ring] = {}

    def add(self, robot: str, entry: Entry) -> None:
        """Keep a message."""
        ring = self._rings.get(robot)
        if ring is None:
            ring = self._rings[robot] = Ring()
        room = self._max_bytes // len(self._rings)
        self.dropped += ring.add(entry, keep_ns=self._keep_ns, max_bytes=room)

    def forget(self, robot: str) -> None:
        """The robot is forgotten."""
        self._rings.pop(robot, None)

    def of(self, robot: str) -> list[Entry]:
        """What is kept of a robot, then of nobody."""
        names = (robot, "") if robot else ("",)
        return [entry for name in names if name in self._rings for entry in list(self._rings[name].entries)]

    @property
    def size_bytes(self) -> int:
        """Of all."""
        return sum(ring.size_bytes for ring in self._rings.values())
