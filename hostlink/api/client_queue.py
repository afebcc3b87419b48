"""ClientQueue: what waits for one client of the API; bounded, so that a slow client costs nobody else anything."""

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

MAX_MESSAGES = 1024
MAX_BYTES = 8 * 1024 * 1024
MAX_RESULTS = 256
MAX_RESULT_BYTES = 8 * 1024 * 1024


class Outgoing(NamedTuple):
    """A WebSocket frame to be."""

    order: int
    data: bytes
    is_binary: bool
    since_s: float


class ClientQueue:
    """Telemetry by topic, where the oldest of a full queue goes and is counted; results, which may not be lost.

    Everything leaves in the order in which it came. A client that lets its results pile up is `is_too_slow`.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` is the event loop's."""
        self.dropped = 0
        self._clock = clock
        self.is_too_slow = False
        self._order = 0
        self._messages = 0
        self._bytes = 0
        self._result_bytes = 0
        self._topics: dict[str, deque[Outgoing]] = {}
        self._results: deque[Outgoing] = deque()
        self._news = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()

    @property
    def waiting_messages(self) -> int:
        """Telemetry and results."""
        return self._messages + len(self._results)

    @property
    def waiting_bytes(self) -> int:
        """Of telemetry and results."""
        return self._bytes + self._result_bytes

    @property
    def oldest_s(self) -> float | None:
        """When the oldest was put; None: nothing waits."""
        heads = [waiting[0].since_s for waiting in self._topics.values()]
        if self._results:
            heads.append(self._results[0].since_s)
        return min(heads, default=None)

    def put_message(self, topic: str, data: bytes, *, is_binary: bool = False) -> None:
        """Queue telemetry; over a bound the oldest of this topic goes, else the oldest of the longest."""
        waiting = self._topics.setdefault(topic, deque())
        waiting.append(self._outgoing(data, is_binary=is_binary))
        self._messages += 1
        self._bytes += len(data)
        while self._messages > MAX_MESSAGES or self._bytes > MAX_BYTES:
            self._drop(topic if len(waiting) > 1 else max(self._topics, key=lambda name: len(self._topics[name])))
        self._news.set()

    def put_result(self, data: bytes) -> None:
        """Queue an answer or an event."""
        is_too_large = self._results and self._result_bytes + len(data) > MAX_RESULT_BYTES
        if is_too_large or len(self._results) >= MAX_RESULTS:
            self.is_too_slow = True
        else:
            self._results.append(self._outgoing(data, is_binary=False))
            self._result_bytes += len(data)
        self._note_room()
        self._news.set()

    def forget(self, topic: str) -> None:
        """The client is not interested in this topic any more."""
        for waiting in self._topics.pop(topic, ()):
            self._messages -= 1
            self._bytes -= len(waiting.data)

    def take(self) -> Outgoing | None:
        """The oldest of all, or None."""
        topic = min(self._topics, key=lambda name: self._topics[name][0].order, default=None)
        if self._results and (topic is None or self._results[0].order < self._topics[topic][0].order):
            result = self._results.popleft()
            self._result_bytes -= len(result.data)
            self._note_room()
            return result
        if topic is None:
            self._news.clear()
            return None
        return self._pop(topic)

    def nudge(self) -> None:
        """Let `wait` return: a time limit has changed."""
        self._news.set()

    async def wait(self) -> None:
        """Wait until something was put."""
        await self._news.wait()

    async def room(self) -> None:
        """Wait while results fill half of the queue: whoever asks for more must read first."""
        await self._room.wait()

    def _note_room(self) -> None:
        if len(self._results) > MAX_RESULTS // 2 or self._result_bytes > MAX_RESULT_BYTES // 2:
            self._room.clear()
        else:
            self._room.set()

    def _outgoing(self, data: bytes, *, is_binary: bool) -> Outgoing:
        self._order += 1
        return Outgoing(self._order, data, is_binary, self._clock())

    def _drop(self, topic: str) -> None:
        self._pop(topic)
        self.dropped += 1

    def _pop(self, topic: str) -> Outgoing:
        waiting = self._topics[topic]
        oldest = waiting.popleft()
        if not waiting:
            del self._topics[topic]
        self._messages -= 1
        self._bytes -= len(oldest.data)
        return oldest
