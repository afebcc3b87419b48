"""ThreadInbox: what other threads deliver, until the event loop has time for it."""

import asyncio
import contextlib
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from contextlib import AbstractContextManager
from typing import Any, Final, Generic, TypeVar

Item = TypeVar("Item")

MAX_WAITING = 256  # items of one source; the oldest is dropped
MAX_SOURCES = 512  # with items that wait; an item of one more is dropped
MAX_WAITING_BYTES = 16 * 1024 * 1024  # of all sources; an item that would be more is dropped
SLICE_S = 0.0005  # of one turn of the loop; a stop that arrives otherwise waits no longer
SHARED: Final = None  # the key of the queue of all sources that are not known


class ThreadInbox(Generic[Item]):
    """A bounded queue for each known source, and one for all others, emptied in turns.

    A source that floods loses its own items only. The items of a source are delivered in the order of their `put`, also
    while it becomes known or unknown: all that wait are in one queue.

    `put` may be called in any thread, and raises nothing. The loop calls `deliver`, for a slice in each of its turns;
    without `deliver` the items are read with `async for`.
    """

    def __init__(
        self,
        deliver: Callable[[Item], None] | None = None,
        *,
        guarded: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext,
        counts: Counter[str] | None = None,
        max_waiting: int = MAX_WAITING,
        needed: Callable[[Sequence[Item]], list[Item]] | None = None,
        is_known: Callable[[Any], bool] = lambda _: True,
    ) -> None:
        """`guarded`: a block around each delivery, which keeps what it raises; `counts`: `dropped` did not fit.

        `needed` returns those of a source's items that still matter, after each `put`, in the thread of `put`.

        `is_known`: whether a source has a queue of its own, called in the thread of `put`. It may change at any time.
        """
        self.counts: Counter[str] = Counter() if counts is None else counts
        self._deliver, self._guarded, self._max_waiting, self._is_known = deliver, guarded, max_waiting, is_known
        self._needed = needed
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()  # other threads put
        self._waiting: OrderedDict[Hashable, deque[tuple[Hashable, Item]]] = OrderedDict()  # sources and their items
        self._bytes = 0
        self._is_due = False  # the loop's own queue has no bound, so it holds one call of each inbox
        self._is_closed = False
        self._news = asyncio.Event()

    def put(self, source: Hashable, item: Item) -> None:
        """Queue an item of this source."""
        with self._lock:
            if self._is_closed:
                return
            key = self._key_of(source)
            if not self._has_room(key, _size_bytes(item)):
                return
            self._bytes += _size_bytes(item)
            self._waiting.setdefault(key, deque()).append((source, item))
            self._drop_needless(source, key)
            if self._is_due:
                return
            self._is_due = True
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._news.set if self._deliver is None else self._drain)

    def close(self) -> None:
        """Drop the items that wait, and later ones."""
        with self._lock:
            self._is_closed = True
            self._waiting.clear()
            self._bytes = 0

    def _key_of(self, source: Hashable) -> Hashable:
        """Return the key of the queue for the next item of a source; those of it that wait are in that queue.

        A source that has become known takes them along from the shared queue. One that is unknown again keeps its
        queue until that is empty.
        """
        if source in self._waiting:
            return source
        if not self._is_known(source):
            return SHARED
        shared = self._waiting.get(SHARED, ())
        own = [each for each in shared if each[0] == source]
        if not own:
            return source
        if len(own) == len(shared):
            del self._waiting[SHARED]
        elif len(self._waiting) < MAX_SOURCES:
            self._waiting[SHARED] = deque(each for each in shared if each[0] != source)
        else:
            return SHARED
        self._waiting[source] = deque(own)
        return source

    def _drop_needless(self, source: Hashable, key: Hashable) -> None:
        if self._needed is None:
            return
        queue = self._waiting[key]
        own = [item for each, item in queue if each == source]
        needed = {id(item) for item in self._needed(own)}
        gone = {id(item): item for item in own if id(item) not in needed}
        if gone:
            self._waiting[key] = deque(each for each in queue if id(each[1]) not in gone)
            self._bytes -= sum(map(_size_bytes, gone.values()))
            self.counts["dropped"] += len(gone)

    def _has_room(self, key: Hashable, size_bytes: int) -> bool:
        queue = self._waiting.get(key)
        is_excess = queue is None and len(self._waiting) >= MAX_SOURCES
        is_full = queue is not None and len(queue) >= self._max_waiting
        replaced_bytes = _size_bytes(queue[0][1]) if queue is not None and is_full else 0
        has_room = not is_excess and self._bytes - replaced_bytes + size_bytes <= MAX_WAITING_BYTES
        if not has_room or is_full:
            self.counts["dropped"] += 1
        if queue is not None and is_full and has_room:
            queue.popleft()
            self._bytes -= replaced_bytes
        return has_room

    def __aiter__(self) -> "ThreadInbox[Item]":
        return self

    async def __anext__(self) -> Item:
        while True:
            item = self._pop()
            if item is not None:
                return item[1]
            self._news.clear()
            await self._news.wait()

    def _drain(self) -> None:
        assert self._deliver is not None  # noqa: S101 - otherwise it is not called
        ends_s = self._loop.time() + SLICE_S
        while (item := self._pop()) is not None:
            with self._guarded():
                self._deliver(item[1])
            if self._loop.time() >= ends_s:
                self._loop.call_soon(self._drain)
                return

    def _pop(self) -> tuple[Hashable, Item] | None:
        """The next item with its source, of the queue that has waited the longest."""
        with self._lock:
            if not self._waiting:
                self._is_due = False
                return None
            key, queue = self._waiting.popitem(last=False)
            source, item = queue.popleft()
            self._bytes -= _size_bytes(item)
            if queue:
                self._waiting[key] = queue
            return source, item


def _size_bytes(item: object) -> int:
    """Return the size of the part whose size a peer chooses."""
    return len(item if isinstance(item, bytes) else getattr(item, "payload", b""))
