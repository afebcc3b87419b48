"""ByteBudget: limits on the bytes that the daemon keeps for all clients together. Pure.

Counts alone bound no memory: sixty programs with sixteen latched messages of a megabyte each are within every count.
"""

import contextlib
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator
from typing import Protocol

from hostlink.errors import BadRequest

MIB = 1024 * 1024
OWN_LATCHED_BYTES = 4 * MIB  # of one participant
OWN_QUEUE_BYTES = 128 * 1024  # of every client, independent of the other queues

# Kinds of kept data, and the limit of each. With the daemon's own 80 MiB, and the copies that reading a message makes,
# it stays below the 250 MiB of docs/reliability.md.
SHARES = {
    "receiving": 8 * MIB,  # messages over LARGE_BYTES that are not whole yet: over it they wait in their sockets
    "operations": 4
    * MIB,  # of clients, not executed yet: over it each client has few, and the rest waits in its socket
    "bodies": 4 * MIB,  # of large requests: over it they are refused (503)
    "latched": 28 * MIB,  # over it a message is delivered and not kept
    "queues": 40 * MIB,  # messages and answers for clients: over it the largest queue loses its oldest telemetry
    "held_back": 8 * MIB,  # by the pace of subscriptions: over it the oldest of the subscription is dropped
    "fragments": 8 * MIB,  # over it the message is dropped
    "calls": 12 * MIB,  # arguments of services that have not answered: over it a call is refused
    "devices": 4 * MIB,  # unfinished messages and objects in devices' sessions: over it the largest loses them
    "watches": 4 * MIB,  # names that Foxglove's clients watch: over it a watch is refused
}


class TelemetryQueue(Protocol):
    """Queue of telemetry, as its share knows it."""

    @property
    def telemetry_bytes(self) -> int:
        """Size of queued telemetry, which may be dropped."""

    def drop_oldest(self) -> None:
        """Drop and count the oldest item of telemetry."""


class Share:
    """Bytes of one kind, with their limit."""

    __slots__ = ("_waiting", "held_bytes", "max_bytes", "queues", "refused")

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self.held_bytes = 0
        self.refused = 0  # number of times that data found no room
        self.queues: dict[TelemetryQueue, None] = {}  # those with telemetry; each adds and removes itself
        self._waiting: deque[Callable[[], None]] = deque()

    @property
    def is_over(self) -> bool:
        """Whether the held bytes exceed the limit."""
        return self.held_bytes > self.max_bytes

    def take(self, count: int) -> bool:
        """Add to the held bytes. Return False, and add none, if there is no room."""
        if self.held_bytes + count > self.max_bytes:
            self.refused += 1
            return False
        self.held_bytes += count
        return True

    def add(self, count: int) -> None:
        """Add to the held bytes even above the limit. Their owner makes room while the share `is_over`."""
        self.held_bytes += count

    def give(self, count: int) -> None:
        """Subtract from the held bytes, and call every `retry` that waits for room."""
        self.held_bytes -= count
        waiting, self._waiting = self._waiting, deque()
        for retry in waiting:
            retry()

    @contextlib.contextmanager
    def holding(self, count: int, what: str) -> Iterator[None]:
        """Hold the bytes during the block.

        Raises:
            BadRequest: there is no room.
        """
        if not self.take(count):
            raise BadRequest(f"all clients together have {self.max_bytes} bytes in {what}; try again later")
        try:
            yield
        finally:
            self.give(count)

    def wait(self, retry: Callable[[], None]) -> None:
        """Call `retry` once when there may be room. It may wait again."""
        self._waiting.append(retry)


class ByteBudget:
    """All shares, by kind."""

    def __init__(self) -> None:
        self.shares = {kind: Share(max_bytes) for kind, max_bytes in SHARES.items()}
        self._latched: Counter[Hashable] = Counter()  # by publisher

    def __getitem__(self, kind: str) -> Share:
        return self.shares[kind]

    def can_latch(self, source: Hashable, before: bytes | None, after: bytes) -> bool:
        """Whether a latched message may be replaced by this one."""
        more = len(after) - len(before or b"")
        share = self.shares["latched"]
        return self._latched[source] + more <= OWN_LATCHED_BYTES and share.held_bytes + more <= share.max_bytes

    def latch(self, source: Hashable, before: bytes | None, after: bytes | None) -> None:
        """Replace a latched message by another; None means no message."""
        more = len(after or b"") - len(before or b"")
        self._latched[source] += more
        if not self._latched[source]:
            del self._latched[source]
        if more > 0:
            self.shares["latched"].add(more)
        else:
            self.shares["latched"].give(-more)
