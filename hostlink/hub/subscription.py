"""Subscription: what a participant receives of one topic, at the pace that it chose."""

from collections.abc import Callable

from hostlink.hub.byte_budget import Share
from hostlink.hub.message import Message
from hostlink.hub.node import is_of
from hostlink.hub.throttle import Throttle


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
