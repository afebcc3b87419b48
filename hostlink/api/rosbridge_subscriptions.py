"""Subscriptions of a rosbridge client, at the rate and in the encoding that it chose: JSON, CBOR or cbor-raw."""

import struct
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import cbor2
import msgspec

from hostlink.api.clients import ClientQueue, Outgoing
from hostlink.api.rosbridge_request import Request
from hostlink.errors import BadPayload, BadRequest
from hostlink.hub.message import Message
from hostlink.hub.participant import MAX_SUBSCRIPTIONS, Participant
from hostlink.hub.subscription import Subscription
from hostlink.messages.message_type import MessageType

_NS_PER_S = 1_000_000_000
# RFC 8746, little-endian: the tags that roslibjs reads.
_TAGS = {
    "uint16": (69, "H"),
    "uint32": (70, "I"),
    "uint64": (71, "Q"),
    "int8": (72, "b"),
    "int16": (77, "h"),
    "int32": (78, "i"),
    "int64": (79, "q"),
    "float32": (85, "f"),
    "float64": (86, "d"),
}


def encode_cbor(topic: str, message: Message) -> bytes:
    """Encode the `publish` operation with the fields of the message.

    Raises:
        BadPayload: the bytes are not a message of the type.
    """
    fields: Any = message.decoded
    if message.type is not None:
        fields = _with_typed_arrays(message.type, message.decoded)
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": fields})


def encode_cbor_raw(topic: str, message: Message) -> bytes:
    """Encode the `publish` operation with the serialised message: rosserial and ROS 1 serialise alike."""
    secs, nsecs = divmod(message.stamp_ns, _NS_PER_S)
    raw = {"secs": secs, "nsecs": nsecs, "bytes": message.payload}
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": raw})


def _with_typed_arrays(type_: MessageType, fields: Mapping[str, Any]) -> dict[str, Any]:
    shaped = dict(fields)
    for field in type_.fields:
        value, nested = fields[field.name], type_.nested.get(field.type)
        if nested is not None:
            is_list = isinstance(value, list)
            shaped[field.name] = (
                [_with_typed_arrays(nested, item) for item in value] if is_list else _with_typed_arrays(nested, value)
            )
        elif isinstance(value, list) and field.type in _TAGS:
            tag, layout = _TAGS[field.type]
            shaped[field.name] = cbor2.CBORTag(tag, struct.pack(f"<{len(value)}{layout}", *value))
    return shaped


MAX_QUEUE_LENGTH = 256
Warn = Callable[[str], None]

_BINARY = {"cbor": encode_cbor, "cbor-raw": encode_cbor_raw}
_FORMS = ("none", "cbor", "cbor-raw")  # the highest counts where ids of one topic differ, as in rosbridge


class _Options(NamedTuple):
    """Options of one id of a subscribed topic."""

    interval_s: float
    queue_length: int
    form: str


class _ClientSubscription:
    """One topic as the client spells it. Several ids may share it; each message is sent once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.form = "none"
        self.options: dict[object, _Options] = {}
        self.subscription: Subscription | None = None
        self._prefix = msgspec.json.encode({"op": "publish", "topic": name})[:-1] + b',"msg":'

    def merge(self) -> tuple[float, int]:
        """Set the highest encoding of all ids. Return the shortest interval and the shortest queue."""
        options = self.options.values()
        self.form = max((each.form for each in options), key=_FORMS.index)
        return min(each.interval_s for each in options), min(each.queue_length for each in options)

    def encoded(self, message: Message) -> bytes:
        """Return the encoded `publish`, made once for all clients with the same encoding and name.

        Raises:
            BadPayload: the bytes do not fit the type, or the type is unknown.
        """
        return message.made((self.form, self.name), self._encode)

    def _encode(self, message: Message) -> bytes:
        encode = _BINARY.get(self.form)
        return self._prefix + message.made("json", encode_json) + b"}" if encode is None else encode(self.name, message)


class ClientSubscriptions:
    """Subscriptions by topic as the client spells it: `odom` and `/odom` are two, and each has its own messages."""

    def __init__(self, participant: Participant, queue: ClientQueue, warn: Warn) -> None:
        self._participant, self._queue, self._warn = participant, queue, warn
        self._subscriptions: dict[str, _ClientSubscription] = {}

    def subscribe(self, request: Request) -> None:
        """Add an id to a topic, or change its options.

        Raises:
            BadRequest: a field is wrong, or there are too many subscriptions.
            WrongType: the topic is in use with another type.
        """
        name, form = request.text("topic"), request.text_or("compression", "none")
        chosen = _Options(
            request.number_or("throttle_rate", 0.0) / 1000,
            min(int(request.number_or("queue_length", 0.0)), MAX_QUEUE_LENGTH),
            form if form in _FORMS else "none",
        )
        known = self._subscriptions.get(name)
        is_new = known is None or request.id not in known.options
        if is_new and sum(len(other.options) for other in self._subscriptions.values()) >= MAX_SUBSCRIPTIONS:
            raise BadRequest(f"more than {MAX_SUBSCRIPTIONS} subscriptions")
        mine = _ClientSubscription(name) if known is None else known
        mine.options[request.id] = chosen
        if mine.subscription is None:
            self._subscribe(mine, request.text_or("type", ""))
        else:
            self._update(mine)
        if form not in _FORMS:
            self._warn(f"subscribe: compression {form} is not offered, {name} is sent as JSON")

    def unsubscribe(self, request: Request) -> None:
        """Remove one id, or without an id the whole topic. An unknown id is ignored."""
        name = request.text("topic")
        mine = self._subscriptions.get(name)
        if mine is None:
            return
        if request.id is None:
            mine.options.clear()
        mine.options.pop(request.id, None)
        if mine.options:
            self._update(mine)
            return
        del self._subscriptions[name]
        self._queue.forget(name)
        if mine.subscription is not None:
            mine.subscription.close()

    def _subscribe(self, mine: _ClientSubscription, type_name: str) -> None:
        interval_s, queue_length = mine.merge()
        mine.subscription = self._participant.subscribe(
            mine.name,
            lambda message: self._put(mine, message),
            type_name=type_name,
            interval_s=interval_s,
            queue_length=queue_length,
            on_throttled=self._queue.wake,
        )
        self._subscriptions[mine.name] = mine

    def _update(self, mine: _ClientSubscription) -> None:
        interval_s, queue_length = mine.merge()
        if mine.subscription is not None:
            mine.subscription.change(interval_s=interval_s, queue_length=queue_length)
            self._queue.wake()

    def _put(self, mine: _ClientSubscription, message: Message) -> None:
        try:
            outgoing = Outgoing(mine.encoded(message), mine.form in _BINARY)
        except BadPayload as error:
            self._warn(str(error))
        else:
            self._queue.put_message(mine.name, outgoing, message.at_s)


def encode_json(message: Message) -> bytes:
    """Encode the fields as JSON: NaN is null, uint8[] is base64."""
    return msgspec.json.encode(message.decoded)
