"""Queue: bounded send queue of one participant: what a slow client loses, and the counters of it."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from hostlink.core.hub.byte_budget import OWN_QUEUE_BYTES, SHARES, Share
from hostlink.core.runtime.compiled import mypyc_attr

MAX_MESSAGES = 1024
MAX_BYTES = 8 * 1024 * 1024
MAX_RESULTS = 256
MAX_RESULT_BYTES = 8 * 1024 * 1024

Item = TypeVar("Item")


class Waiting(NamedTuple, Generic[Item]):
    """Item with its order, size and time of arrival."""

    order: int
    item: Item
    size_bytes: int
    since_s: float


@mypyc_attr(allow_interpreted_subclasses=True)
class Queue(Generic[Item]):
    """Queue of telemetry by topic and of results. When it is full, telemetry is dropped and counted.

    It is the oldest of the topic of which most waits: in messages or in bytes, whichever bound is exceeded. So a topic
    that floods takes nothing from one that has a message now and then. Items leave in their order of arrival. Results
    are never dropped: a participant with too many `is_too_slow`.
    """

    def __init__(self, size_of: Callable[[Item], int], clock: Callable[[], float], share: Share | None = None) -> None:
        """`size_of` returns the bytes of an item. `clock` is the event loop's. `share` bounds all queues together."""
        self.dropped = 0
        self.is_too_slow = False
        self.is_closed = False
        self._is_released = False
        self._size_of, self._clock = size_of, clock
        self._share = Share(SHARES["queues"]) if share is None else share
        self._order = 0
        self._messages = 0
        self._bytes = 0
        self._result_bytes = 0
        self._topics: dict[str, deque[Waiting[Item]]] = {}
        self._bytes_of: dict[str, int] = {}  # by topic
        self._results: deque[Waiting[Item]] = deque()
        self.on_news: Callable[[], None] = _ignore_news  # set by the owner, who then pops
        self.on_dropped: Callable[[str], None] = _ignore_dropped  # set by the owner; called with the topic
        self._room = asyncio.Event()
        self._room.set()

    @property
    def waiting_messages(self) -> int:
        """Number of queued telemetry items and results."""
        return self._messages + len(self._results)

    @property
    def waiting_bytes(self) -> int:
        """Size of queued telemetry and results."""
        return self._bytes + self._result_bytes

    @property
    def telemetry_bytes(self) -> int:
        """Size of queued telemetry, which may be dropped."""
        return self._bytes

    @property
    def oldest_s(self) -> float | None:
        """Time of arrival of the oldest item; None if the queue is empty."""
        heads = [waiting[0].since_s for waiting in self._topics.values()]
        if self._results:
            heads.append(self._results[0].since_s)
        return min(heads, default=None)

    def put_message(self, topic: str, item: Item, at_s: float | None = None) -> None:
        """Queue telemetry that arrived `at_s`. Above a bound, drop the oldest of the topic of which most waits."""
        if self._is_released:
            return
        waiting = self._topics.get(topic)
        if waiting is None:
            waiting = self._topics[topic] = deque()
        self._order += 1
        new = Waiting(self._order, item, self._size_of(item), self._clock() if at_s is None else at_s)
        waiting.append(new)
        if not self._messages:
            self._share.queues[self] = None
        self._messages += 1
        self._bytes += new.size_bytes
        self._bytes_of[topic] = self._bytes_of.get(topic, 0) + new.size_bytes
        self._share.held_bytes += new.size_bytes
        while self._messages > MAX_MESSAGES:
            self._drop(max(self._topics, key=lambda name: len(self._topics[name])))
        while self._bytes > MAX_BYTES:
            self.drop_oldest()
        if self._share.held_bytes > self._share.max_bytes:
            self._make_room()
        self.on_news()

    def put_result(self, item: Item) -> None:
        """Queue an answer or an event."""
        if self._is_released:
            return
        self._order += 1
        new = Waiting(self._order, item, self._size_of(item), self._clock())
        is_over = self._share.held_bytes > self._share.max_bytes
        most_bytes = OWN_QUEUE_BYTES if is_over else MAX_RESULT_BYTES
        is_too_large = self._results and self._result_bytes + new.size_bytes > most_bytes
        if is_too_large or len(self._results) >= MAX_RESULTS:
            self.is_too_slow = True
            self._share.refused += is_over
        else:
            self._results.append(new)
            self._result_bytes += new.size_bytes
            self._share.held_bytes += new.size_bytes
            if not self._is_roomy():
                self._room.clear()
        self.on_news()

    def forget(self, topic: str) -> None:
        """Remove all telemetry of a topic."""
        while topic in self._topics:
            self._pop(topic)

    def pop(self) -> Waiting[Item] | None:
        """Remove and return the oldest item; None if the queue is empty."""
        topic, order = None, self._order + 1
        for name, waiting in self._topics.items():
            if waiting[0].order < order:
                topic, order = name, waiting[0].order
        if self._results and self._results[0].order < order:
            result = self._results.popleft()
            self._result_bytes -= result.size_bytes
            self._share.held_bytes -= result.size_bytes
            if not self._room.is_set() and self._is_roomy():
                self._room.set()
            return result
        if topic is None:
            return None
        return self._pop(topic)

    def close(self) -> None:
        """Mark the queue as closed, and tell its owner."""
        self.is_closed = True
        self.on_news()

    def clear(self) -> None:
        """Remove all items."""
        while self.pop() is not None:
            continue

    def release(self) -> None:
        """Remove all items, and forget the owner: it and the queue are a reference cycle. Later items are ignored."""
        self._is_released = True
        self.clear()
        self.on_news, self.on_dropped = _ignore_news, _ignore_dropped

    def wake(self) -> None:
        """Tell the owner that a time limit has changed."""
        self.on_news()

    @property
    def has_room(self) -> bool:
        """Whether `room` would return at once."""
        return self._room.is_set()

    async def room(self) -> None:
        """Wait while results fill half of the queue. A client must read them before its next request is read."""
        await self._room.wait()

    def _make_room(self) -> None:
        """Drop the oldest telemetry of the largest queues until all queues fit their share, down to OWN_QUEUE_BYTES."""
        while self._share.is_over:
            largest = max(self._share.queues, key=lambda queue: queue.telemetry_bytes)
            if largest.telemetry_bytes <= OWN_QUEUE_BYTES:
                break
            self._share.refused += 1
            largest.drop_oldest()

    def _is_roomy(self) -> bool:
        return len(self._results) <= MAX_RESULTS // 2 and self._result_bytes <= MAX_RESULT_BYTES // 2

    def drop_oldest(self) -> None:
        """Drop and count the oldest item of the topic with most bytes; one with a single item only if all have one."""
        self._drop(max(self._topics, key=lambda name: (len(self._topics[name]) > 1, self._bytes_of[name])))

    def _drop(self, topic: str) -> None:
        self._pop(topic)
        self.dropped += 1
        self.on_dropped(topic)

    def _pop(self, topic: str) -> Waiting[Item]:
        waiting = self._topics[topic]
        oldest = waiting.popleft()
        self._bytes_of[topic] -= oldest.size_bytes
        if not waiting:
            del self._topics[topic], self._bytes_of[topic]
        self._messages -= 1
        if not self._messages:
            self._share.queues.pop(self, None)
        self._bytes -= oldest.size_bytes
        self._share.held_bytes -= oldest.size_bytes
        return oldest


def _ignore_news() -> None:
    """Stand for an owner who pops."""


def _ignore_dropped(_: str) -> None:
    """Stand for an owner who is told."""
