"""Subscription: what a participant receives of one topic, at the rate that it chose."""

from collections import deque
from collections.abc import Callable

from hostlink.hub.byte_budget import SHARES, Share
from hostlink.hub.message import Message
from hostlink.hub.node import is_of


class Subscription:
    """At most one message in `interval_s`, as rosbridge's `throttle_rate` and `queue_length` have it.

    Between two of them, messages are dropped, except the newest `queue_length`, which wait for `flush`. `close` ends
    the subscription.
    """

    __slots__ = (
        "_deliver", "_free_at_s", "_group", "_interval_s", "_on_throttled", "_share", "close", "is_closed", "waiting",
    )  # fmt: skip

    def __init__(
        self,
        deliver: Callable[[Message], None],
        on_throttled: Callable[[], None] = lambda: None,
        *,
        interval_s: float = 0.0,
        queue_length: int = 0,
        group: str = "",
        share: Share | None = None,
    ) -> None:
        """`on_throttled` is called for each message that comes while others wait.

        `group`: what it publishes is not received: messages that go out to a graph must not come again from it.
        `share`: of the bytes that wait in all subscriptions.
        """
        self.close: Callable[[], None] = nothing_to_close  # until it is in the graph
        self.is_closed = False  # then nothing is delivered, not even of what is on its way
        self.waiting: deque[Message] = deque(maxlen=queue_length)
        self._deliver, self._on_throttled, self._group = deliver, on_throttled, group
        self._interval_s, self._free_at_s = interval_s, float("-inf")
        self._share = Share(SHARES["held_back"]) if share is None else share

    def end(self) -> None:
        """Deliver nothing from now on, and drop what waits."""
        self.is_closed = True
        while self.waiting:
            self._pop()

    def change(self, *, interval_s: float, queue_length: int) -> None:
        """Set another rate; what waits and fits continues to wait."""
        if (interval_s, queue_length) != (self._interval_s, self.waiting.maxlen):
            self._free_at_s += interval_s - self._interval_s
            self._interval_s = interval_s
            while len(self.waiting) > queue_length:
                self._pop()
            self.waiting = deque(self.waiting, maxlen=queue_length)

    def receive(self, message: Message) -> None:
        """Deliver a message, or an older one that waits in its place, or keep the message for later."""
        if self.is_closed or (self._group and is_of(message.source, self._group)):
            return
        if self._interval_s <= 0:
            self._deliver(message)
            return
        now_s = message.at_s
        is_free = now_s >= self._free_at_s
        if not is_free or self.waiting:
            self._keep(message)
        if is_free:
            self._free_at_s = now_s + self._interval_s
            self._deliver(self._pop() if self.waiting else message)
        elif self.waiting:
            self._on_throttled()

    def flush(self, now_s: float) -> float | None:
        """Deliver what is due; returns when the next message is due, None if none waits."""
        while not self.is_closed and self.waiting and now_s >= self._free_at_s:
            self._free_at_s = now_s + self._interval_s
            self._deliver(self._pop())
        return self._free_at_s if self.waiting else None

    def _keep(self, message: Message) -> None:
        """Let a message wait; the oldest are dropped where too much waits."""
        if not self.waiting.maxlen:
            return
        if len(self.waiting) == self.waiting.maxlen:
            self._pop()
        self.waiting.append(message)
        self._share.add(len(message.payload))
        while self._share.is_over and self.waiting:
            self._share.refused += 1
            self._pop()

    def _pop(self) -> Message:
        oldest = self.waiting.popleft()
        self._share.give(len(oldest.payload))
        return oldest


def nothing_to_close() -> None:
    """Do nothing: the subscription is not in the graph, or was removed from it."""
