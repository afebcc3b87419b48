"""Deliveries: the order in which messages reach subscribers. What a callback publishes is delivered after its cause."""

from collections import deque
from collections.abc import Callable, Hashable
from typing import NamedTuple, TypeVar

from hostlink.errors import BadRequest
from hostlink.hub.message import Message

MAX_NESTED = 8  # messages and commands of one sender, each sent in a callback that the one before caused
MAX_WAITING = 1024  # messages that callbacks have published, and that wait for the message before them

Deliver = Callable[[Message], None]
Result = TypeVar("Result")


class _Waiting(NamedTuple):
    deliver: Deliver
    message: Message
    senders: tuple[Hashable, ...]


class Deliveries:
    """Of one hub: one message is delivered at a time. Over MAX_WAITING one is delivered at once, before its turn."""

    def __init__(self) -> None:
        self.out_of_order = 0  # messages that were delivered before their turn
        self.senders: tuple[Hashable, ...] = ()  # each sends in a callback that the one before caused
        self._waiting: deque[_Waiting] = deque()
        self._is_under_way = False

    def add(self, deliver: Deliver, message: Message) -> None:
        """Deliver a message, now or after those before it."""
        if not self._is_under_way:
            self._is_under_way = True  # as `run` does, on the path of every message
            try:
                deliver(message)
                if self._waiting:
                    self._drain()
            finally:
                self._is_under_way = False
        elif len(self._waiting) < MAX_WAITING:
            self._waiting.append(_Waiting(deliver, message, self.senders))
        else:
            self.out_of_order += 1
            deliver(message)

    def run(self, work: Callable[[Message], Result], message: Message) -> Result:
        """Do something with a message; what is to be delivered meanwhile is delivered afterwards."""
        if self._is_under_way:
            return work(message)
        self._is_under_way = True
        try:
            result = work(message)
            if self._waiting:
                self._drain()
        finally:
            self._is_under_way = False
        return result

    def sending(self, sender: Hashable) -> "Sending":
        """For the length of a block it sends; refused when its own callback has sent too often: it would never end.

        Raises:
            BadRequest: it is refused.
        """
        return Sending(self, sender)

    def _drain(self) -> None:
        senders = self.senders
        try:
            while self._waiting:
                deliver, message, self.senders = self._waiting.popleft()
                deliver(message)
        finally:
            self.senders = senders


class Sending:
    """A block in which somebody sends; a class, as it is entered for every message."""

    __slots__ = ("_deliveries", "_sender", "_senders")

    def __init__(self, deliveries: Deliveries, sender: Hashable) -> None:
        self._deliveries, self._sender = deliveries, sender
        self._senders = deliveries.senders

    def __enter__(self) -> None:
        if self._senders and self._senders.count(self._sender) >= MAX_NESTED:
            raise BadRequest(f"{self._sender} sends in a callback what calls it back, again and again")
        self._deliveries.senders = (*self._senders, self._sender)

    def __exit__(self, *_: object) -> None:
        self._deliveries.senders = self._senders
