"""ClientSubscriptions: what one client of rosbridge listens to, in the form and at the pace that it asked for."""

import asyncio
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from hostlink.api.cbor import encode_cbor, encode_cbor_raw
from hostlink.api.client_queue import ClientQueue
from hostlink.api.request import Request
from hostlink.api.throttle import Throttle
from hostlink.errors import BadPayload, BadRequest
from hostlink.hub.message import Message
from hostlink.hub.topic_graph import TopicGraph, Unsubscribe

MAX_SUBSCRIPTIONS = 256  # ids of all topics together
MAX_QUEUE_LENGTH = 256
TellWarning = Callable[[str], None]

_BINARY = {"cbor": encode_cbor, "cbor-raw": encode_cbor_raw}
_FORMS = ("none", "cbor", "cbor-raw")  # a later one wins where ids of one topic differ, as in rosbridge


class _Wish(NamedTuple):
    """What one id of a topic asked for."""

    interval_s: float
    queue_length: int
    form: str


class _Subscription:
    """One topic as the client spells it; several ids may share it, and each message is sent once for all of them."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.prefix = msgspec.json.encode({"op": "publish", "topic": name})[:-1] + b',"msg":'
        self.wishes: dict[object, _Wish] = {}
        self.form = "none"
        self.throttle = Throttle(interval_s=0.0, queue_length=0)
        self.unsubscribe: Unsubscribe = _nothing

    def merge(self) -> None:
        """Suit the most eager: the shortest interval, the shortest queue, the rawest form."""
        wishes = self.wishes.values()
        self.form = max((wish.form for wish in wishes), key=_FORMS.index)
        self.throttle.change(
            interval_s=min(wish.interval_s for wish in wishes), queue_length=min(wish.queue_length for wish in wishes)
        )

    def encoded(self, message: Message) -> bytes:
        """A frame for the client, made once for all clients that want the same; BadPayload."""
        key = (self.form, self.name)
        if key not in message.frames:
            encode = _BINARY.get(self.form)
            message.frames[key] = self.prefix + message.json + b"}" if encode is None else encode(self.name, message)
        return message.frames[key]


class ClientSubscriptions:
    """Subscriptions by topic, spelled as the client spells it: `odom` and `/odom` are two, and each gets its own."""

    def __init__(self, client: str, topics: TopicGraph, queue: ClientQueue, tell_warning: TellWarning) -> None:
        self._client, self._topics, self._queue, self._tell_warning = client, topics, queue, tell_warning
        self._subscriptions: dict[str, _Subscription] = {}

    @property
    def names(self) -> list[str]:
        """The topics, as the client spells them."""
        return list(self._subscriptions)

    def subscribe(self, request: Request) -> None:
        """Add an id to a topic, or change what it wished; BadRequest, WrongType."""
        name, form = request.text("topic"), request.text_or("compression", "none")
        wish = _Wish(
            request.number_or("throttle_rate", 0.0) / 1000,
            min(int(request.number_or("queue_length", 0.0)), MAX_QUEUE_LENGTH),
            form if form in _FORMS else "none",
        )
        subscription = self._subscriptions.get(name)
        is_new = subscription is None or request.id not in subscription.wishes
        if is_new and sum(len(other.wishes) for other in self._subscriptions.values()) >= MAX_SUBSCRIPTIONS:
            raise BadRequest(f"more than {MAX_SUBSCRIPTIONS} subscriptions")
        subscription = subscription or _Subscription(name)
        subscription.wishes[request.id] = wish
        subscription.merge()
        if name not in self._subscriptions:
            subscription.unsubscribe = self._topics.subscribe(
                name,
                lambda message: self._deliver(subscription, message),
                type_name=request.text_or("type", ""),
                key=self._client,
            )
            self._subscriptions[name] = subscription
        if form not in _FORMS:
            self._tell_warning(f"subscribe: compression {form} is not offered, {name} comes as plain JSON")

    def unsubscribe(self, request: Request) -> None:
        """Take back one id, or without an id the whole topic; one that is not there is no error."""
        name = request.text("topic")
        subscription = self._subscriptions.get(name)
        if subscription is None:
            return
        if request.id is None:
            subscription.wishes.clear()
        subscription.wishes.pop(request.id, None)
        if subscription.wishes:
            subscription.merge()
        else:
            del self._subscriptions[name]
            self._queue.forget(name)
            subscription.unsubscribe()

    def flush(self, now_s: float) -> float | None:
        """Queue what throttled subscriptions held back until now; returns when the next is due."""
        due: list[float] = []
        for subscription in self._subscriptions.values():
            while (message := subscription.throttle.take(now_s)) is not None:
                self._put(subscription, message)
            if (at_s := subscription.throttle.due_s()) is not None:
                due.append(at_s)
        return min(due, default=None)

    def close(self) -> None:
        """The client is gone."""
        for subscription in self._subscriptions.values():
            subscription.unsubscribe()
        self._subscriptions.clear()

    def _deliver(self, subscription: _Subscription, message: Message) -> None:
        ready = subscription.throttle.offer(message, asyncio.get_running_loop().time())
        if ready is not None:
            self._put(subscription, ready)
        elif subscription.throttle.due_s() is not None:
            self._queue.nudge()

    def _put(self, subscription: _Subscription, message: Message) -> None:
        try:
            self._queue.put_message(
                subscription.name, subscription.encoded(message), is_binary=subscription.form in _BINARY
            )
        except BadPayload as error:
            self._tell_warning(str(error))


def _nothing() -> None:
    """Not subscribed yet."""
