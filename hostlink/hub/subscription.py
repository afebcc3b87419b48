"""Subscription: what a participant receives of one topic, at the pace that it chose."""

from collections import deque
from collections.abc import Callable

from hostlink.hub.byte_budget import SHARES, Share
from hostlink.hub.message import Message
from hostlink.hub.node import is_of


class Throttle:
    """At most one message in `interval_s`. In between, messages are dropped, or the newest `queue_length` kept."""

    __slots__ = ("_free_at_s", "_share", "_waiting", "interval_s")

    def __init__(self, *, interval_s: float, queue_length: int, share: Share | None = None) -> None:
        """`share`: of all subscriptions together."""
        self.interval_s = interval_s
        self._share = Share(SHARES["held_back"]) if share is None else share
        self._waiting: deque[Message] = deque(maxlen=queue_length)
        self._free_at_s = float("-inf")

    def change(self, *, interval_s: float, queue_length: int) -> None:
        """Another pace from now on; what waits and fits continues to wait."""
        if (interval_s, queue_length) != (self.interval_s, self._waiting.maxlen):
            self._free_at_s += interval_s - self.interval_s
            self.interval_s = interval_s
            while len(self._waiting) > queue_length:
                self._pop()
            self._waiting = deque(self._waiting, maxlen=queue_length)

    def offer(self, message: Message, now_s: float) -> Message | None:
        """The message to send now, if any: this one, or an older one that waits."""
        if self.interval_s <= 0:
            return message
        if now_s >= self._free_at_s and not self._waiting:
            self._free_at_s = now_s + self.interval_s
            return message
        self._put(message)
        if now_s < self._free_at_s:
            return None
        self._free_at_s = now_s + self.interval_s
        return self._pop() if self._waiting else message

    def pop(self, now_s: float) -> Message | None:
        """A message that waited long enough."""
        if not self._waiting or now_s < self._free_at_s:
            return None
        self._free_at_s = now_s + self.interval_s
        return self._pop()

    def clear(self) -> None:
        """Nothing waits any more."""
        while self._waiting:
            self._pop()

    def _put(self, message: Message) -> None:
        """The oldest go, where too much waits."""
        if not self._waiting.maxlen:
            return
        if len(self._waiting) == self._waiting.maxlen:
            self._pop()
        self._waiting.append(message)
        self._share.add(len(message.payload))
        while self._share.is_over and self._waiting:
            self._share.refused += 1
            self._pop()

    def _pop(self) -> Message:
        oldest = self._waiting.popleft()
        self._share.give(len(oldest.payload))
        return oldest

    def due_s(self) -> float | None:
        """When `pop` has something; None: nothing waits."""
        return self._free_at_s if self._waiting else None


class Subscription:
    """`close` ends it."""

    __slots__ = ("_deliver", "_group", "_on_throttled", "_throttle", "close", "is_closed")

    def __init__(
        self,
        deliver: Callable[[Message], None],
        on_throttled: Callable[[], None],
        *,
        interval_s: float = 0.0,
        queue_length: int = 0,
        group: str = "",
        share: Share | None = None,
    ) -> None:
        """`group`: what it publishes is not received: messages that go out to a graph must not come again from it.

        `share`: of what all subscriptions hold back.
        """
        self.close: Callable[[], None] = nothing_to_close  # until it is in the graph
        self.is_closed = False  # then nothing is delivered, not even of what is on its way
        self._deliver, self._on_throttled, self._group = deliver, on_throttled, group
        self._throttle = Throttle(interval_s=interval_s, queue_length=queue_length, share=share)

    def end(self) -> None:
        """Nothing is delivered any more, nor held back."""
        self.is_closed = True
        self._throttle.clear()

    def change(self, *, interval_s: float, queue_length: int) -> None:
        """Another pace from now on."""
        self._throttle.change(interval_s=interval_s, queue_length=queue_length)

    def receive(self, message: Message) -> None:
        """Deliver a message, or hold it back."""
        if self.is_closed or is_of(message.source, self._group):
            return
        ready = self._throttle.offer(message, message.at_s)
        if ready is not None:
            self._deliver(ready)
        elif self._throttle.due_s() is not None:
            self._on_throttled()

    def flush(self, now_s: float) -> float | None:
        """Deliver what is due; returns when the next is."""
        while not self.is_closed and (message := self._throttle.pop(now_s)) is not None:
            self._deliver(message)
        return None if self.is_closed else self._throttle.due_s()


def nothing_to_close() -> None:
    """It is not in the graph, or no more."""
