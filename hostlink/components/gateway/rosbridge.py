"""RosbridgeClient: one client that speaks rosbridge v2. Decodes operations and calls the host, without a socket."""

import asyncio
import base64
import functools
import itertools
import math
import reprlib
import struct
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import cbor2
import msgspec
import structlog

from hostlink.components.gateway.bodies import convert_velocity, has_velocity, size_bytes_of
from hostlink.components.gateway.clients import (
    NOT_A_VELOCITY,
    ClientQueue,
    Operation,
    Outgoing,
    Spawn,
    VelocityOf,
    dropped_text,
    put_json,
    velocity_of_payload,
)
from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.gateway.views import velocity_answer
from hostlink.core.host import (
    MAX_ADVERTISED,
    MAX_CALLS,
    MAX_SUBSCRIPTIONS,
    PROGRAM_PRIORITY,
    Graph,
    Host,
    Message,
    NodeGraph,
    Participant,
    PlanarVelocity,
    RobotHandle,
    Role,
    Share,
    Subscription,
    resolve,
)
from hostlink.core.messages.catalog import Catalog, to_time
from hostlink.core.messages.fields import SCALAR
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.core.messages.serialisation import ROS1
from hostlink.core.robot.admission import EARLIER_EPOCH
from hostlink.core.robot.state import MAX_PRIORITY
from hostlink.core.robot.velocity import TWIST_TYPE, Twist
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.rate_limit import REFUSED_VELOCITIES_S, RateLimit
from hostlink.errors import BadPayload, BadRequest, CommandRefused, HostlinkError, ServiceFailed, without_frames

MAX_REASON = 120  # characters of why a program stops; longer ones are cut
MAX_TEXT = 1024  # characters of a name or an id; roslib's longest ids are a name and 50 more

MAX_PENDING = 4  # incomplete messages of one client
MAX_PIECES = 1024  # fragments of one message
TIMEOUT_S = 60.0  # since the last fragment of a message

HEADER = "std_msgs/Header"
MAX_PARTS = 2000  # about 15 ms; a path of a small robot has a few hundred poses

MAX_QUEUE_LENGTH = 256

MAX_ANSWERS = 64  # calls of one client that wait for another daemon

MAX_MESSAGE_BYTES = ApiConfig().max_message_bytes  # of a message in fragments, unless it is configured
MAX_UNKNOWN_OPS = 8  # logged for each client; the number of invalid operations is unbounded


class DriveOperation(msgspec.Struct, forbid_unknown_fields=True, tag_field="op", tag="drive"):
    """Fields of the operation `drive`: m/s and rad/s, counter-clockwise positive; `linear_y` is to the left.

    Only programs that send commands by themselves need the fields from `sent_s` on.
    """

    robot: str
    linear: float = 0.0
    angular: float = 0.0
    linear_y: float = 0.0
    is_planar: bool = True  # False: other components of the Twist are not zero, and no robot obeys it
    priority: int = PROGRAM_PRIORITY
    take_over: bool = False  # from a source of the same priority that drives
    sent_s: float | None = None  # time of sending by the client's own clock
    epoch: int | None = None  # of the robot, from the previous answer
    stops: int | None = None  # synonym of `epoch`
    link: int | None = None  # number of the device's connection; for another number the epoch counts as an earlier one
    reason: str = ""  # of a zero: why the program drives no more
    id: object = None

    @property
    def velocity(self) -> PlanarVelocity:
        """The velocity, without the components that make it not planar."""
        return PlanarVelocity(self.linear, self.linear_y, self.angular)


class _Vector(msgspec.Struct, forbid_unknown_fields=True, frozen=True, gc=False):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class _Twist(msgspec.Struct, forbid_unknown_fields=True, frozen=True, gc=False):
    linear: _Vector = _Vector()
    angular: _Vector = _Vector()


class _TwistOperation(msgspec.Struct, forbid_unknown_fields=True, tag_field="op", tag="publish"):
    """A `publish` of a Twist with the fields that clients send. A `Request` reads one with other fields."""

    topic: str
    msg: _Twist
    type: str = ""
    priority: int = PROGRAM_PRIORITY
    latch: bool = False
    id: object = None


_PLAIN_VELOCITY = msgspec.json.Decoder(DriveOperation | _TwistOperation)


class Request:
    """A JSON object with an `op`. Methods raise a BadRequest that names the invalid field."""

    def __init__(self, text: str | bytes) -> None:
        """Decode one message of a client.

        Raises:
            BadRequest: the text is not JSON, or not an object with an `op`.
        """
        try:
            fields = msgspec.json.decode(text)
        except (msgspec.DecodeError, UnicodeError) as error:
            raise BadRequest(f"invalid JSON: {error}") from None
        except RecursionError:
            raise BadRequest("invalid JSON: nested too deeply") from None
        if not isinstance(fields, dict) or "op" not in fields:
            raise BadRequest('a message is a JSON object with an "op"')
        op = fields["op"]
        if not isinstance(op, str) or not op:
            raise BadRequest(f"{reprlib.repr(op)}: op must be a text")
        self.op, self.fields, self.size_bytes = op, fields, len(text)
        self.came_s: float | None = None  # earliest time of arrival; None: now
        self.replaced: list[Request] = []  # velocities that this one replaces
        self._drive: DriveOperation | None = None
        self._payload: tuple[MessageType, bytes] | None = None

    def drive_operation(self) -> DriveOperation:
        """Return the fields of a `drive`.

        Raises:
            BadRequest: a field is unknown, missing or has another type.
        """
        if self._drive is None:
            self._drive = convert_velocity(self.fields, DriveOperation, "drive")
        return self._drive

    def payload(self, type_: MessageType) -> bytes:
        """Return the message of a `publish`, serialised: that of the field `raw`, which is base64, or of `msg`.

        Raises:
            BadRequest: `raw` is not base64, or `msg` is not a message of the type.
            BadPayload: the bytes of `raw` are not a message of the type.
        """
        if self._payload is None or self._payload[0] is not type_:
            message = self.fields.get("msg", {})
            if not isinstance(message, dict):
                raise BadRequest("publish: msg must be an object")
            payload = _raw_payload(self, type_) or type_.encode(fill_stamps(type_, message, time.time_ns()))
            self._payload = type_, payload
        return self._payload[1]

    @property
    def id(self) -> object:
        """Return the id as the client wrote it; None without an id.

        Raises:
            BadRequest: the id is neither a number nor a short text.
        """
        found = self.fields.get("id")
        if isinstance(found, list | dict) or (isinstance(found, str) and len(found) > MAX_TEXT):
            raise BadRequest(f"{self.op}: id must be a number, or a text of at most {MAX_TEXT} characters")
        return found

    def text(self, key: str) -> str:
        """Return a required text.

        Raises:
            BadRequest: the field is missing, not a text, or too long.
        """
        value = self.fields.get(key)
        if not isinstance(value, str) or not value:
            raise BadRequest(f"{self.op}: {key} must be a text")
        if len(value) > MAX_TEXT:
            raise BadRequest(f"{self.op}: {key} is longer than {MAX_TEXT} characters")
        return value

    def text_or(self, key: str, default: str = "") -> str:
        """Return a text; `default` if it is missing, empty or null.

        Raises:
            BadRequest: the field is not a text, or too long.
        """
        return self.text(key) if self.fields.get(key) else default

    def number(self, key: str) -> float:
        """Return a number of 0 or more; 0 if it is missing or null.

        Raises:
            BadRequest: the field is not such a number.
        """
        value = self.fields.get(key)
        if value is None:
            return 0.0
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise BadRequest(f"{self.op}: {key} must be a number of 0 or more")
        return float(min(value, 2**53))  # an integer may be too large for a float

    def whole(self, key: str, default: int, largest: int) -> int:
        """Return an integer from 0 to `largest`.

        Raises:
            BadRequest: the field is not such an integer.
        """
        value = self.fields.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= largest:
            raise BadRequest(f"{self.op}: {key} must be an integer from 0 to {largest}")
        return value

    @property
    def is_latched(self) -> bool:
        """Whether the topic is to be latched."""
        return self.fields.get("latch") is True


@dataclass(slots=True)
class _Pending:
    total: int
    fed_at_s: float
    pieces: dict[int, str] = field(default_factory=dict)


class Fragments:
    """Incomplete messages of one client by id. Together they are at most as large as one message."""

    def __init__(self, max_bytes: int, share: Share) -> None:
        """Create the store of one client. `share`: byte budget of all clients."""
        self._max_bytes, self._share = max_bytes, share
        self._bytes = 0
        self._pending: dict[object, _Pending] = {}

    def add(self, key: object, *, number: int, total: int, data: str, now_s: float) -> str | None:
        """Add a fragment. Return the whole message with its last one.

        Raises:
            BadRequest: the fragment is invalid or has no room; its message is dropped.
        """
        self._expire(now_s)
        pending = self._pending.get(key)
        if pending is None:
            if len(self._pending) >= MAX_PENDING:
                raise BadRequest(f"fragment: more than {MAX_PENDING} messages are incomplete")
            pending = self._pending[key] = _Pending(total, now_s)
        problem = self._problem(pending, number, total, data)
        if problem:
            self._drop(key)
            raise BadRequest(f"fragment: {problem}; the message is dropped")
        size = size_bytes_of(data)
        if not self._share.take(size):
            self._drop(key)
            raise BadRequest(
                f"fragment: all clients together have {self._share.max_bytes} bytes of fragments; send it later"
            )
        pending.pieces[number] = data
        pending.fed_at_s = now_s
        self._bytes += size
        if len(pending.pieces) < total:
            return None
        self._drop(key)
        return "".join(pending.pieces[index] for index in range(total))

    def close(self) -> None:
        """Drop everything: the client has disconnected."""
        for key in list(self._pending):
            self._drop(key)

    def _problem(self, pending: _Pending, number: int, total: int, data: str) -> str:
        if not 1 <= total <= MAX_PIECES:
            return f"total must be from 1 to {MAX_PIECES}"
        if total != pending.total:
            return f"total was {pending.total} and is {total}"
        if not 0 <= number < total:
            return f"num must be from 0 to {total - 1}"
        if number in pending.pieces:
            return f"fragment {number} was sent twice"
        if self._bytes + size_bytes_of(data) > self._max_bytes:
            return f"more than {self._max_bytes} bytes of fragments"
        return ""

    def _expire(self, now_s: float) -> None:
        for key in [key for key, pending in self._pending.items() if now_s >= pending.fed_at_s + TIMEOUT_S]:
            self._drop(key)

    def _drop(self, key: object) -> None:
        size = sum(map(size_bytes_of, self._pending.pop(key).pieces.values()))
        self._bytes -= size
        self._share.give(size)


def fill_stamps(type_: MessageType, message: dict[str, Any], now_ns: int) -> dict[str, Any]:
    """Return the message with its times filled in. Values that do not fit the type are left to the codec.

    Raises:
        BadRequest: more than MAX_PARTS parts have times; walking through them would delay commands.
    """
    return _Filler(to_time(now_ns)).fill(type_, message) if type_.has_time else message


class _Filler:
    """Fills in the times of one message, part by part."""

    def __init__(self, now: dict[str, int]) -> None:
        self._now = now
        self._parts = 0

    def fill(self, type_: MessageType, message: dict[str, Any]) -> dict[str, Any]:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise BadRequest(f"more than {MAX_PARTS} parts with times: fill in the times, or send several messages")
        filled = dict(message)
        if type_.name == HEADER:
            filled = {name: value for name, value in message.items() if value is not None}  # roslibpy's unset
            if _is_zero(filled.get("stamp")):
                filled["stamp"] = self._now
        for each in type_.fields:
            nested = type_.nested.get(each.type)
            if each.type == "time":
                if each.name in filled:
                    filled[each.name] = _each(filled[each.name], self._time)
            elif nested is not None and nested.has_time and (each.name in filled or each.array_length == SCALAR):
                part = filled.get(each.name, {})
                filled[each.name] = _each(part, functools.partial(self._nested, nested))
        return filled

    def _time(self, value: Any) -> Any:
        return self._now if value == "now" else value

    def _nested(self, type_: MessageType, value: Any) -> Any:
        return self.fill(type_, value) if isinstance(value, dict) else value


def _each(value: Any, fill: Callable[[Any], Any]) -> Any:
    return [fill(item) for item in value] if isinstance(value, list) else fill(value)


def _is_zero(stamp: object) -> bool:
    return stamp is None or (isinstance(stamp, dict) and not any(stamp.values()))


def velocity_of_request(request: Request, graph: NodeGraph) -> tuple[VelocityOf | None, bool]:
    """Return what a velocity is of (None: not a velocity) and whether it is zero."""
    if request.op == "drive":
        try:
            wanted = request.drive_operation()
        except BadRequest:
            return NOT_A_VELOCITY
        is_timed, is_sideways = wanted.sent_s is not None, wanted.linear_y != 0
        epochs = (wanted.epoch, wanted.stops, wanted.link)
        terms = (wanted.priority, *epochs, is_timed, is_sideways, wanted.is_planar, wanted.take_over)
        is_zero = wanted.is_planar and not (wanted.linear or wanted.linear_y or wanted.angular)
        return VelocityOf("drive", wanted.robot.strip("/"), terms), is_zero
    fields = request.fields
    name = fields.get("topic")
    topic = graph.velocity_topic(name) if request.op == "publish" and isinstance(name, str) else None
    priority, type_name = fields.get("priority"), fields.get("type")
    is_valid = type(priority) in (int, type(None)) and isinstance(type_name, str | None)
    if topic is None or topic.type is None or not is_valid:
        return NOT_A_VELOCITY
    try:
        payload = request.payload(topic.type)
    except HostlinkError:
        return NOT_A_VELOCITY
    return velocity_of_payload(topic, payload, (priority, type_name, request.is_latched))


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
    fields = message.decoded
    assert message.type is not None  # noqa: S101 - it is decoded
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": _with_typed_arrays(message.type, fields)})


def encode_cbor_raw(topic: str, message: Message) -> bytes:
    """Encode the `publish` operation with the serialised message: rosserial and ROS 1 serialise alike.

    Raises:
        BadPayload: the bytes are of another serialisation, which a reader of `cbor-raw` would misread.
    """
    if message.encoding != ROS1:
        raise BadPayload(
            message.type_name,
            f'its messages are {message.encoding}, because it has no definition; subscribe with "any_encoding": true, '
            "or put its .msg into a folder named in message_folders",
        )
    return encode_cbor_any(topic, message)


def encode_cbor_any(topic: str, message: Message) -> bytes:
    """Encode as `encode_cbor_raw`, in any serialisation. Of one that is not that of ROS 1, `msg` has the name."""
    raw = {**to_time(message.stamp_ns), "bytes": message.payload}
    if message.encoding != ROS1:
        raw["encoding"] = message.encoding
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": raw})


def _with_typed_arrays(type_: MessageType, fields: Mapping[str, Any]) -> dict[str, Any]:
    shaped = dict(fields)
    for each in type_.fields:
        value, nested = fields[each.name], type_.nested.get(each.type)
        if nested is not None:
            is_list = isinstance(value, list)
            shaped[each.name] = (
                [_with_typed_arrays(nested, item) for item in value] if is_list else _with_typed_arrays(nested, value)
            )
        elif isinstance(value, list) and each.type in _TAGS:
            tag, layout = _TAGS[each.type]
            shaped[each.name] = cbor2.CBORTag(tag, struct.pack(f"<{len(value)}{layout}", *value))
    return shaped


Warn = Callable[[str], None]

_ANY = "cbor-raw any"  # of a client that reads `encoding`
_BINARY = {"cbor": encode_cbor, _ANY: encode_cbor_any, "cbor-raw": encode_cbor_raw}
_COMPRESSIONS = ("none", "cbor", "cbor-raw")
_FORMS = ("none", "cbor", _ANY, "cbor-raw")  # the highest counts where ids of one topic differ, as in rosbridge


class _SubscriptionOptions(NamedTuple):
    """Options of one id of a subscribed topic."""

    interval_s: float
    queue_length: int
    form: str


class _ClientSubscription:
    """One topic as the client spells it. Several ids may share it; each message is sent once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.form = "none"
        self.options: dict[object, _SubscriptionOptions] = {}
        self.subscription: Subscription
        self._prefix = msgspec.json.encode({"op": "publish", "topic": name})[:-1] + b',"msg":'

    def merge(self) -> tuple[float, int]:
        """Set the highest encoding of all ids. Return the shortest interval and the shortest queue."""
        options = self.options.values()
        self.form = max((each.form for each in options), key=_FORMS.index)
        return min(each.interval_s for each in options), min(each.queue_length for each in options)

    def encode(self, message: Message) -> bytes:
        """Encode a `publish` operation.

        Raises:
            BadPayload: the bytes do not fit the type, or the type is unknown.
        """
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
        name, compression = request.text("topic"), request.text_or("compression", "none")
        is_any = compression == "cbor-raw" and request.fields.get("any_encoding") is True
        form = _ANY if is_any else compression if compression in _COMPRESSIONS else "none"
        chosen = _SubscriptionOptions(
            request.number("throttle_rate") / 1000,
            min(int(request.number("queue_length")), MAX_QUEUE_LENGTH),
            form,
        )
        known = self._subscriptions.get(name)
        is_new = known is None or request.id not in known.options
        if is_new and sum(len(other.options) for other in self._subscriptions.values()) >= MAX_SUBSCRIPTIONS:
            raise BadRequest(f"more than {MAX_SUBSCRIPTIONS} subscriptions")
        mine = _ClientSubscription(name) if known is None else known
        mine.options[request.id] = chosen
        if known is None:
            interval_s, queue_length = mine.merge()
            mine.subscription = self._participant.subscribe(
                name,
                functools.partial(self._put, mine),
                type_name=request.text_or("type"),
                interval_s=interval_s,
                queue_length=queue_length,
                on_throttled=self._queue.wake,
            )
            self._subscriptions[name] = mine
        else:
            self._update(mine)
        if compression not in _COMPRESSIONS:
            self._warn(f"subscribe: compression {compression} is not offered, {name} is sent as JSON")

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
        mine.subscription.close()

    def _update(self, mine: _ClientSubscription) -> None:
        interval_s, queue_length = mine.merge()
        mine.subscription.change(interval_s=interval_s, queue_length=queue_length)
        self._queue.wake()

    def _put(self, mine: _ClientSubscription, message: Message) -> None:
        """Queue a message. It is encoded once for all clients with the same encoding and name."""
        try:
            outgoing = Outgoing(message.made((mine.form, mine.name), mine.encode), mine.form in _BINARY)
        except BadPayload as error:
            self._warn(str(error))
        else:
            self._queue.put_message(mine.name, outgoing, message.at_s)


def encode_json(message: Message) -> bytes:
    """Encode the fields as JSON: NaN is null, uint8[] is base64."""
    return msgspec.json.encode(message.decoded)


class ClientTopics:
    """Topics that a client advertises. The client may use several ids for one topic; the last id withdraws it."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._ids: defaultdict[str, set[object]] = defaultdict(set)
        self._latched: set[str] = set()

    def advertise(self, request: Request) -> None:
        """Advertise a topic.

        Raises:
            BadRequest: the type is unknown, or more than MAX_ADVERTISED topics are advertised.
            WrongType: the topic is in use with another type.
        """
        name, is_latched = resolve(request.text("topic")), request.is_latched
        type_name = request.text("type")
        if sum(map(len, self._ids.values())) >= MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} topics advertised")
        self._participant.advertise(name, type_name, is_latched=is_latched)
        self._ids[name].add(request.id)
        if is_latched:
            self._latched.add(name)

    def publish(self, request: Request) -> None:
        """Advertise the topic of a `publish` that names its type, if that is not done yet. Raises as `advertise`."""
        name = resolve(request.text("topic"))
        is_known = name in self._latched or (name in self._ids and not request.is_latched)
        if not is_known and request.fields.get("type"):
            self.advertise(request)

    def has_advertised(self, topic: str) -> bool:
        """Whether the client has advertised a topic."""
        return resolve(topic) in self._ids

    def unadvertise(self, request: Request) -> None:
        """Withdraw one id, or without an id the whole topic. An unknown id is ignored."""
        name = resolve(request.text("topic"))
        ids = self._ids.get(name, set())
        ids.discard(request.id)
        if ids and request.id is not None:
            return
        self._ids.pop(name, None)
        self._latched.discard(name)
        self._participant.unadvertise(name)


Values = Mapping[str, object]


class _PendingCall(NamedTuple):
    """A service call that the client has not answered yet."""

    service: str  # name as the client spells it
    type: ServiceType | None
    answer: asyncio.Future[Values]

    def completed(self, values: Values) -> Values:
        """Complete the values by the type of the service, as ROS does. Raise BadRequest for values that do not fit."""
        return values if self.type is None else self.type.response.decode(self.type.response.encode(values))


class ClientServices:
    """Services that a client provides: advertised, called and answered."""

    def __init__(self, participant: Participant, catalog: Catalog, queue: ClientQueue, warn: Warn) -> None:
        """Create the services of one participant. `warn` sends the client a status of level warning."""
        self._participant, self._catalog, self._queue, self._warn = participant, catalog, queue, warn
        self._numbers = itertools.count(1)
        self._waiting: dict[str, _PendingCall] = {}

    def advertise(self, request: Request) -> None:
        """Provide a service. The newest provider of a name replaces the others.

        Raises:
            BadRequest: a field is wrong, there are too many services, or the name is reserved for the daemon.
        """
        name, type_name = request.text("service"), request.text("type")
        answer = functools.partial(self._call, name, type_name)
        self._participant.provide(name, type_name, answer, notify=self._warn)

    def unadvertise(self, request: Request) -> None:
        """Withdraw a service."""
        self._participant.withdraw(request.text("service"))

    def respond(self, request: Request) -> None:
        """Accept the client's `service_response`. Answer one that no call waits for with a warning.

        Raises:
            BadRequest: the response is invalid; the call has failed.
        """
        call = self._waiting.get(str(request.id))
        if call is None or call.answer.done():
            self._warn("service_response: no call waits for an answer with this id")
            return
        try:
            self._accept(call, request)
        except BadRequest as error:
            call.answer.set_exception(error)
            raise

    def _accept(self, call: _PendingCall, request: Request) -> None:
        """Pass an object to the caller even if `result` is false, as rosbridge does: success is a field of the object.

        Fail the call only if the response cannot be one of the service.
        """
        values, is_right = request.fields.get("values"), request.fields.get("result")
        if is_right not in (True, False, None):  # roslibpy sends null for a function that returns None
            raise BadRequest(f"{call.service}: result must be true or false")
        if is_right is False and not isinstance(values, dict):
            reason = values if isinstance(values, str) else reprlib.repr(values)
            call.answer.set_exception(ServiceFailed(call.service, reason))
        elif isinstance(values, dict | None):
            call.answer.set_result(call.completed(values or {}))
        else:
            raise BadRequest(f"{call.service}: the answer is not an object")

    async def _call(self, name: str, type_name: str, arguments: Values) -> Values:
        """Call the client. With a known type, arguments and answer are checked and completed, as in ROS."""
        type_ = self._catalog.service(type_name)
        if type_ is not None:
            arguments = type_.request.decode(type_.request.encode(arguments))
        key = f"{self._participant.name} {next(self._numbers)}"
        call = self._waiting[key] = _PendingCall(name, type_, asyncio.get_running_loop().create_future())
        request = {"op": "call_service", "id": key, "service": name, "args": arguments}
        try:
            put_json(self._queue, request)
            return await call.answer
        finally:
            del self._waiting[key]


class Asked(NamedTuple):
    """The id of a `drive`, and the ids of those that it replaced."""

    id: object
    replaced: Sequence[object]


class DriveCommands:
    """Velocity commands of one client. Each is answered, so that the client learns of a refusal at once.

    A robot of another daemon is answered for by that daemon, at most MAX_ANSWERS commands at a time. Above that the
    answer is the velocity as sent.
    """

    def __init__(self, participant: Participant, host: Host, queue: ClientQueue, spawn: Spawn) -> None:
        """Create the commands of one client. `spawn` runs a wait for another daemon."""
        self._participant, self._host, self._queue, self._spawn = participant, host, queue, spawn
        self._waiting = 0

    def receive(self, request: Request) -> None:
        """Execute a `drive`. The answer is also sent for each operation that it replaced."""
        replaced = [each.fields.get("id") for each in request.replaced]
        try:
            self._participant.check(Role.DRIVE, "drive")
            wanted = request.drive_operation()
        except HostlinkError as error:
            self._refuse(Asked(request.fields.get("id"), replaced), None, error)
            return
        self.execute(wanted, request.came_s, replaced)

    def execute(self, wanted: DriveOperation, came_s: float | None, replaced: Sequence[object] = ()) -> None:
        """Execute a decoded `drive`. `replaced`: the ids of those that it replaced."""
        asked = Asked(wanted.id, replaced)
        robot: RobotHandle | None = None
        try:
            if not 0 <= wanted.priority <= MAX_PRIORITY:
                raise BadRequest(f"drive: priority must be a number from 0 to {MAX_PRIORITY}")
            velocity = wanted.velocity
            is_zero = velocity.is_zero and wanted.is_planar
            robot = self._host.find(wanted.robot, driver=None if is_zero else lambda: self._participant)
            epoch = wanted.stops if wanted.epoch is None else wanted.epoch
            if wanted.link is not None and robot.link is not None:
                is_same = robot.resumed_link <= wanted.link <= robot.link
                epoch = epoch if is_same else EARLIER_EPOCH
            limited = robot.drive(
                self._participant,
                velocity,
                priority=wanted.priority,
                received_s=came_s,
                sent_s=wanted.sent_s,
                epoch=epoch,
                is_planar=wanted.is_planar,
                take_over=wanted.take_over,
                reason=printable(wanted.reason, MAX_REASON) if wanted.reason else "",
            )
        except HostlinkError as error:
            self._refuse(asked, robot, error)
            return
        answer = robot.answer(self._participant) if self._waiting < MAX_ANSWERS else None
        if answer is None:
            self._accept(asked, robot, velocity, limited)
        else:
            self._waiting += 1
            self._spawn(self._wait(asked, robot, velocity, answer))

    async def _wait(
        self, asked: Asked, robot: RobotHandle, velocity: PlanarVelocity, answer: Awaitable[PlanarVelocity]
    ) -> None:
        try:
            self._accept(asked, robot, velocity, await answer)
        except HostlinkError as error:
            self._refuse(asked, robot, error)
        finally:
            self._waiting -= 1

    def _accept(self, asked: Asked, robot: RobotHandle, velocity: PlanarVelocity, limited: PlanarVelocity) -> None:
        answer: dict[str, object] = {
            "op": "drive_result",
            "result": True,
            "link": robot.link,
            "stops": robot.epoch,
            "client": self._participant.name,
        }
        self._put(asked, answer | velocity_answer(robot, velocity, limited))

    def _refuse(self, asked: Asked, robot: RobotHandle | None, error: HostlinkError) -> None:
        answer: dict[str, object] = {"op": "drive_result", "result": False, "kind": error.kind, "reason": str(error)}
        if isinstance(error, CommandRefused) and robot is not None:
            answer["epoch"] = robot.epoch
            answer["holder"] = None if error.holder is None else str(error.holder)
            answer["by"] = error.by
        self._put(asked, answer)

    def _put(self, asked: Asked, answer: dict[str, object]) -> None:
        for replaced in asked.replaced:
            put_json(self._queue, answer | {"id": replaced, "is_replaced": True})
        answer["id"] = asked.id
        self._queue.put_result(Outgoing(msgspec.json.encode(answer)))


class ClientGraph:
    """The operation `watch_graph`: sends the whole graph after each change, at most every 50 ms.

    Of a topic and a service it sends what participants outside the client's group do with it. A robot is of this
    daemon, with the types of its velocity topics by their names; its `link` is null while its device is disconnected.
    """

    def __init__(self, participant: Participant, graph: NodeGraph, queue: ClientQueue) -> None:
        self._participant, self._graph, self._queue = participant, graph, queue
        self._sent = b""

    def watch(self, _: Request) -> None:
        """Send `graph` now and after each change.

        Raises:
            BadRequest: the participant has left.
        """
        self._sent = b""
        self._participant.watch_graph(self._send)

    def _send(self) -> None:
        graph = self._participant.graph()
        gated = {topic.name for topic in graph.topics if topic.is_velocity}
        robots = [
            {
                "name": robot.name,
                "link": robot.link,
                "velocity_topics": {name: type_ for name, type_ in robot.velocity_topics.items() if name in gated},
            }
            for robot in self._graph.robots()
        ]
        data = msgspec.json.encode({"op": "graph", **graph_view(graph), "robots": robots})
        if data != self._sent:
            self._sent = data
            self._queue.put_result(Outgoing(data))


def graph_view(graph: Graph) -> dict[str, list[dict[str, object]]]:
    """Return topics and services as JSON objects."""
    return {
        "topics": [
            {
                "name": each.name,
                "type": each.type_name,
                "published": each.is_published,
                "subscribed": each.is_subscribed,
                "latched": each.is_latched,
                "velocity": each.is_velocity,
                "encoding": each.encoding,
            }
            for each in graph.topics
        ],
        "services": [{"name": each.name, "type": each.type_name} for each in graph.services],
    }


log = structlog.get_logger()

# `drive` checks the role itself: it is always answered
_FOR_READERS = frozenset(
    {"subscribe", "unsubscribe", "call_service", "set_level", "auth", "fragment", "watch_graph", "drive"}
)
_LEVELS = ("info", "warning", "error", "none")  # of `set_level`: the client receives `status` of this level and above
_WARNING, _ERROR = 1, 2
_NO_STATUS = "AutobahnPython"  # roslibpy 2.1.0 has no handler for a `status`, and logs a traceback for each


class RosbridgeClient:
    """One participant and its rosbridge operations."""

    def __init__(
        self,
        name: str,
        host: Host,
        queue: ClientQueue,
        *,
        spawn: Spawn,
        role: Role = Role.DRIVE,
        group: str = "",
        program: str = "",
        max_message_bytes: int = MAX_MESSAGE_BYTES,
    ) -> None:
        """Join the graph. `spawn` runs a service call; `group`: the mirrored graph; `program`: its User-Agent."""
        self.participant = host.join(name, role=role, group=group, on_end=queue.close)
        self._topics = ClientTopics(self.participant)
        services = ClientServices(self.participant, host.messages, queue, self._warn)
        subscriptions = ClientSubscriptions(self.participant, queue, self._warn)
        self._host = host
        self._queue = queue
        self._queue.on_dropped = self._tell_dropped
        self._dropped = Budget()  # messages that the queue has dropped
        self._spawn = spawn
        self.calls = 0  # pending
        self._status_from: int | None = None  # index in _LEVELS; None: not set by the client
        self._reads_status = not program.startswith(_NO_STATUS)
        self._refused_velocities = RateLimit(REFUSED_VELOCITIES_S)
        self._unknown_ops: set[str] = set()
        self._fragments = Fragments(max_message_bytes, host.share("fragments"))
        self._drive = DriveCommands(self.participant, host, queue, spawn)
        self._operations: dict[str, Callable[[Request], None]] = {
            "advertise": self._topics.advertise,
            "unadvertise": self._topics.unadvertise,
            "publish": self._publish,
            "subscribe": subscriptions.subscribe,
            "unsubscribe": subscriptions.unsubscribe,
            "call_service": self._call_service,
            "advertise_service": services.advertise,
            "unadvertise_service": services.unadvertise,
            "service_response": services.respond,
            "set_level": self._set_level,
            "watch_graph": ClientGraph(self.participant, host.graph, queue).watch,
            "auth": lambda _: None,  # old clients send it; tokens are checked when the WebSocket opens
            "fragment": self._add_fragment,
            "drive": self._drive.receive,
            "send_action_goal": self._refuse_goal,
            **dict.fromkeys(("cancel_action_goal", "advertise_action", "unadvertise_action"), _refuse_action),
            **dict.fromkeys(("action_feedback", "action_result"), _refuse_action),
        }

    def receive(self, text: str | bytes, came_s: float | None = None) -> None:
        """Execute one message of the client. An error becomes a status and is never raised."""
        self.do(self.read(text, asyncio.get_running_loop().time() if came_s is None else came_s))

    def take(self, data: bytes, came_s: float) -> bool:
        """Execute a message at once if it is a velocity without a peculiarity. Otherwise do nothing and return False.

        It is decoded once, and a Twist is not encoded in between. What it cannot decode or refuses is left to `read`
        and `do`, whose decision about a velocity is the same.
        """
        try:
            wanted = _PLAIN_VELOCITY.decode(data)
        except (msgspec.DecodeError, UnicodeError, RecursionError):
            return False
        if self.participant.has_left or self.participant.role < Role.DRIVE:
            return False
        if isinstance(wanted, _TwistOperation):
            return self._take_twist(wanted, came_s)
        if not any(wanted.velocity) and not has_velocity(msgspec.json.decode(data)):
            return False
        self._drive.execute(wanted, came_s)
        return True

    def _take_twist(self, wanted: _TwistOperation, came_s: float) -> bool:
        topic, linear, angular = wanted.topic, wanted.msg.linear, wanted.msg.angular
        is_plain = 0 < len(topic) <= MAX_TEXT and 0 <= wanted.priority <= MAX_PRIORITY and not wanted.latch
        is_known = not wanted.type or (wanted.type == TWIST_TYPE and self._topics.has_advertised(topic))
        if not (is_plain and is_known):
            return False
        twist = Twist(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
        try:
            return self.participant.publish_twist(topic, twist, priority=wanted.priority, at_s=came_s)
        except HostlinkError as error:
            self._put_error(error, wanted.id, topic)
            return True

    def read(self, data: str | bytes, came_s: float) -> Operation[Request | BadRequest]:
        """Decode a message. An error is returned as the content, and sent to the client by `do`."""
        try:
            request = Request(data)
        except BadRequest as error:
            return Operation(without_frames(error), came_s)
        request.came_s = came_s
        velocity_of, is_zero = velocity_of_request(request, self._host.graph)
        return Operation(request, came_s, velocity_of, is_zero)

    def do(self, operation: Operation[Request | BadRequest]) -> None:
        """Execute a decoded message. An error becomes a status and is never raised."""
        if isinstance(operation.content, BadRequest):
            self._put_error(operation.content)
            return
        request = operation.content
        if operation.replaced:
            request.replaced = [each for each in operation.replaced if isinstance(each, Request)]
        try:
            act = self._operations.get(request.op)
            if act is None:
                if request.op not in self._unknown_ops and len(self._unknown_ops) < MAX_UNKNOWN_OPS:
                    self._unknown_ops.add(request.op)
                    log.warning("client.unknown_op", op=printable(request.op))
                raise BadRequest(f"unknown op {printable(request.op)!r}")
            self.participant.check(Role.READ if request.op in _FOR_READERS else Role.DRIVE, request.op)
            act(request)
        except HostlinkError as error:
            self._put_error(
                error, request.fields.get("id"), request.fields.get("topic") if request.op == "publish" else None
            )

    def flush(self, now_s: float) -> float | None:
        """Queue messages that throttled subscriptions hold back. Return when the next one is due."""
        return self.participant.flush(now_s)

    def close(self) -> None:
        """End the participant and release everything that it has."""
        self.participant.leave()
        self._fragments.close()
        self._operations.clear()  # otherwise they form a reference cycle, which keeps all that the client had

    # -- operations ---------------------------------------------------------------------------------------------------

    def _publish(self, request: Request) -> None:
        topic, type_name = request.text("topic"), request.text_or("type")
        priority = request.whole("priority", PROGRAM_PRIORITY, MAX_PRIORITY)
        self._topics.publish(request)
        try:
            type_ = self.participant.message_type(topic, type_name)
        except HostlinkError:
            self.participant.note_publishing(topic)
            raise
        self.participant.publish(topic, request.payload(type_), priority=priority, at_s=request.came_s)

    def _call_service(self, request: Request) -> None:
        if self.calls >= MAX_CALLS:
            self._answer(request, f"more than {MAX_CALLS} calls are pending", is_right=False, kind=BadRequest.kind)
            return
        request.id  # noqa: B018 - raises for an invalid id before the service is called
        self.calls += 1
        self._spawn(self._finish_call(request))

    async def _finish_call(self, request: Request) -> None:
        try:
            with self._host.share("calls").holding(request.size_bytes, "pending calls"):
                name = request.text("service")
                timeout_s = request.number("timeout") or None
                arguments = _arguments(request, self._host.graph.service_type(name))
                values = await self.participant.call(name, arguments, timeout_s=timeout_s)
            self._answer(request, values, is_right=True)
        except HostlinkError as error:
            self._answer(request, str(error), is_right=False, kind=error.kind)
        finally:
            self.calls -= 1

    def _add_fragment(self, request: Request) -> None:
        data = request.fields.get("data")
        if request.id is None or not isinstance(data, str):
            raise BadRequest("fragment: id and data are required")
        number, total = request.whole("num", -1, MAX_PIECES), request.whole("total", -1, MAX_PIECES)
        now_s = asyncio.get_running_loop().time()
        whole = self._fragments.add(request.id, number=number, total=total, data=data, now_s=now_s)
        if whole is not None:
            self.receive(whole, request.came_s)

    def _refuse_goal(self, request: Request) -> None:
        """Refuse a goal at once: rosserial has no actions."""
        answer = {"op": "action_result", "action": request.text("action"), "values": "actions are unsupported"}
        self._put(request, answer | {"status": 6, "result": False})

    def _set_level(self, request: Request) -> None:
        level = request.text("level")
        if level not in _LEVELS:
            raise BadRequest(f"set_level: level must be one of {', '.join(_LEVELS)}")
        self._status_from = _LEVELS.index(level)

    # -- to the client ------------------------------------------------------------------------------------------------

    def _answer(
        self, request: Request, values: Mapping[str, object] | str, *, is_right: bool, kind: str | None = None
    ) -> None:
        service = request.fields.get("service")
        name = service if isinstance(service, str) else ""
        answer: dict[str, object] = {"op": "service_response", "service": name, "values": values, "result": is_right}
        self._put(request, answer if kind is None else answer | {"kind": kind})

    def _put(self, request: Request, answer: dict[str, object]) -> None:
        """Queue an answer with the id of its request."""
        put_json(self._queue, answer | ({"id": request.id} if "id" in request.fields else {}))

    def _warn(self, text: str) -> None:
        log.debug("client.refused", client=self.participant.name, reason=text)
        if self._status_from is not None and self._status_from <= _WARNING:
            put_json(self._queue, {"op": "status", "level": "warning", "msg": text})

    def _put_error(self, error: HostlinkError, request_id: object = None, published: object = None) -> None:
        """Send an error as a status, if the client has asked for it. `published`: the topic of a `publish`.

        rosbridge's document has "error" as the default level, but its own clients log an exception for each status.
        A client that has set no level receives only statuses of refused velocities, at a limited rate, and none if it
        is known to fail by one.
        """
        log.debug("client.refused", client=self.participant.name, reason=str(error))
        level = self._status_from
        is_shown = self._is_shown_velocity(error, published) if level is None else level <= _ERROR
        if not is_shown:
            return
        status = {"op": "status", "level": "error", "msg": str(error), "kind": error.kind}
        if isinstance(request_id, str | int | float):
            status["id"] = str(request_id)
        put_json(self._queue, status)

    def _tell_dropped(self, topic: str) -> None:
        """Tell the client at once, and then every ten seconds, what it has lost because it reads too slowly."""
        counts = self._dropped.due("dropped", asyncio.get_running_loop().time(), topic)
        if counts and self._status_from is not None and self._status_from <= _ERROR:
            status = {"op": "status", "level": "error", "msg": dropped_text(counts), "kind": "TooSlow"}
            put_json(self._queue, status)

    def _is_shown_velocity(self, error: HostlinkError, published: object) -> bool:
        """Whether the error refuses a published velocity, and the rate limit of its topic and kind admits a status."""
        if not self._reads_status:
            return False
        topic = self._host.graph.velocity_topic(published) if isinstance(published, str) else None
        if topic is None:
            return False
        return self._refused_velocities.allows((topic.name, error.kind), asyncio.get_running_loop().time())


def _refuse_action(request: Request) -> None:
    raise BadRequest(f"{request.op}: actions are unsupported")


def _raw_payload(request: Request, type_: MessageType) -> bytes:
    """Return the serialised message of the field `raw`, which is base64; empty without that field.

    Raises:
        BadRequest: the field is not base64.
        BadPayload: the bytes are not a message of the type.
    """
    raw = request.fields.get("raw")
    if raw is None:
        return b""
    try:
        payload = base64.b64decode(raw, validate=True)
    except (TypeError, ValueError):  # binascii.Error is a ValueError
        raise BadRequest("publish: raw must be base64") from None
    type_.decode(payload)
    return payload


def _arguments(request: Request, type_: ServiceType | None) -> Mapping[str, object]:
    """Return the arguments of a service call: an object, or a list whose items are the request's fields in order."""
    arguments = request.fields.get("args") or {}
    if isinstance(arguments, list) and type_ is not None:
        return {field.name: value for field, value in zip(type_.request.fields, arguments, strict=False)}
    if not isinstance(arguments, dict):
        raise BadRequest("call_service: args must be an object, or a list for a service whose type has a definition")
    return arguments
