"""Inbox: what Zenoh's threads deliver, until the event loop has time for it."""

import asyncio
import contextlib
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import Generic, TypeVar

from hostlink.hub.isolation import Isolation

Item = TypeVar("Item")

MAX_WAITING = 256  # items of one source; the oldest goes
MAX_SOURCES = 512  # with items that wait; an item of one more is dropped
MAX_WAITING_BYTES = 16 * 1024 * 1024  # of all sources; an item that would be more is dropped
SLICE_S = 0.0005  # of one turn of the loop; a stop that comes by another way waits no longer


class Inbox(Generic[Item]):
    """A bounded queue for each source, emptied in turns: who floods loses his own items only.

    `put` may be called in any thread, and raises nothing. The loop delivers, a slice in each of its turns.
    """

    def __init__(
        self,
        deliver: Callable[[Item], None],
        isolation: Isolation,
        counts: Counter[str],
        *,
        max_waiting: int = MAX_WAITING,
    ) -> None:
        """`counts`: `dropped` counts what did not fit. A failure of `deliver` is logged and counted by `isolation`."""
        self._deliver, self._isolation, self._counts = deliver, isolation, counts
        self._max_waiting = max_waiting
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()  # Zenoh has threads of its own
        self._waiting: OrderedDict[str, deque[Item]] = OrderedDict()
        self._bytes = 0
        self._is_due = False
        self._is_closed = False

    def put(self, source: str, item: Item) -> None:
        """Queue an item of this source."""
        with self._lock:
            if self._is_closed or not self._has_room(source, _size_bytes(item)):
                return
            self._bytes += _size_bytes(item)
            self._waiting.setdefault(source, deque()).append(item)
            if self._is_due:
                return
            self._is_due = True
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._drain)

    def close(self) -> None:
        """Deliver nothing more."""
        with self._lock:
            self._is_closed = True
            self._waiting.clear()
            self._bytes = 0

    def _has_room(self, source: str, size_bytes: int) -> bool:
        queue = self._waiting.get(source)
        is_excess = queue is None and len(self._waiting) >= MAX_SOURCES
        is_full = queue is not None and len(queue) >= self._max_waiting
        replaced_bytes = _size_bytes(queue[0]) if queue is not None and is_full else 0
        has_room = not is_excess and self._bytes - replaced_bytes + size_bytes <= MAX_WAITING_BYTES
        if not has_room or is_full:
            self._counts["dropped"] += 1
        if queue is not None and is_full and has_room:
            queue.popleft()
            self._bytes -= replaced_bytes
        return has_room

    def _drain(self) -> None:
        ends_s = self._loop.time() + SLICE_S
        while (item := self._pop()) is not None:
            with self._isolation.around("graph", graph="zenoh"):
                self._deliver(item[0])
            if self._loop.time() >= ends_s:
                self._loop.call_soon(self._drain)
                return

    def _pop(self) -> tuple[Item] | None:
        """The next item, of the source that has waited the longest."""
        with self._lock:
            if not self._waiting:
                self._is_due = False
                return None
            source, queue = self._waiting.popitem(last=False)
            item = queue.popleft()
            self._bytes -= _size_bytes(item)
            if queue:
                self._waiting[source] = queue
            return (item,)


def _size_bytes(item: object) -> int:
    """Of what somebody else has chosen the size."""
    return len(getattr(item, "payload", b""))
