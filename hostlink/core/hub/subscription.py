"""Subscription: messages of one topic for a participant, at its chosen rate."""

from collections import deque
from collections.abc import Callable, Hashable
from typing import Protocol

from hostlink.core.hub.byte_budget import SHARES, Share
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node
from hostlink.core.hub.topic import Topic


class Owner(Hashable, Protocol):
    """Participant that has a subscription."""

    def fail(self, error: Exception) -> None:
        """End the owner, because `deliver` has failed."""
        ...

    def unsubscribe(self, subscription: "Subscription", topic: Topic, number: int) -> None:
        """Remove a closed subscription from the topic, where it has this number."""
        ...


class Subscription:
    """Subscription with at most one message in `interval_s`, as rosbridge's `throttle_rate` and `queue_length`.

    Between two of them, messages are dropped, except the newest `queue_length`, which wait for `flush`. `close` ends
    the subscription. It is the subscriber of its topic: a thousand robots have four thousand subscriptions.
    """

    __slots__ = (
        "_deliver", "_free_at_s", "_group", "_interval_s", "_number", "_on_throttled", "_share", "_topic", "is_closed",
        "key", "type_name", "waiting",
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
        owner: Owner | None = None,
        type_name: str = "",
    ) -> None:
        """`on_throttled` is called for each message that arrives while others wait.

        Messages of `group` are not received: messages to another graph must not return from it. `share` bounds the
        waiting bytes of all subscriptions. `owner` and `type_name` are those of a `Subscriber`.
        """
        self.key, self.type_name = owner, type_name
        self._topic: Topic | None = None  # while it is in the graph, where it has this number
        self._number = 0
        self.is_closed = False  # then no message is delivered, not even one on its way
        self.waiting = _queue(queue_length)
        self._deliver, self._on_throttled, self._group = deliver, on_throttled, group
        self._interval_s, self._free_at_s = interval_s, float("-inf")
        self._share = Share(SHARES["held_back"]) if share is None else share

    def enter(self, topic: Topic, number: int) -> None:
        """Note that it is in the graph."""
        self._topic, self._number = topic, number

    def close(self) -> None:
        """Deliver nothing from now on, drop waiting messages, and leave the graph."""
        self.is_closed = True
        while self.waiting:
            self._pop()
        topic, self._topic = self._topic, None  # otherwise they form a reference cycle
        self._deliver, self._on_throttled = _ignore, _call_nothing  # another one: a client's callback has it
        if topic is not None and self.key is not None:
            self.key.unsubscribe(self, topic, self._number)

    def fail(self, error: Exception) -> None:
        """End the owner, because `deliver` has failed."""
        if self.key is not None:
            self.key.fail(error)

    def change(self, *, interval_s: float, queue_length: int) -> None:
        """Set another rate. Waiting messages that fit the new queue length are kept."""
        if (interval_s, queue_length) != (self._interval_s, self.waiting.maxlen):
            self._free_at_s += interval_s - self._interval_s
            self._interval_s = interval_s
            while len(self.waiting) > queue_length:
                self._pop()
            waiting, self.waiting = self.waiting, _queue(queue_length)
            self.waiting.extend(waiting)

    def receive(self, message: Message) -> None:
        """Deliver a message, or a waiting older one in its place, or keep the message for later."""
        source = message.source
        if self.is_closed or (self._group and isinstance(source, Node) and source.group == self._group):
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
        """Deliver due messages. Return the time at which the next one is due; None if none waits."""
        while not self.is_closed and self.waiting and now_s >= self._free_at_s:
            self._free_at_s = now_s + self._interval_s
            self._deliver(self._pop())
        return self._free_at_s if self.waiting else None

    def _keep(self, message: Message) -> None:
        """Let a message wait. Above a bound, the oldest are dropped."""
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


def _ignore(_: Message) -> None:
    """Replace the callback of a closed subscription."""


def _call_nothing() -> None:
    """Do nothing: a closed subscription has no owner to tell."""


_NO_ROOM: deque[Message] = deque(maxlen=0)  # shared: it stays empty, and an empty deque has 600 bytes


def _queue(length: int) -> deque[Message]:
    return deque(maxlen=length) if length else _NO_ROOM
