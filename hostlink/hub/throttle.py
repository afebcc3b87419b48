"""Throttle: the pace of one subscription, as rosbridge's `throttle_rate` and `queue_length` have it."""

from collections import deque

from hostlink.hub.byte_budget import SHARES, Share
from hostlink.hub.message import Message


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
