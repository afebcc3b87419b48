"""Foxglove's WebSocket protocol, version 1: binary frames, and requests as JSON. Pure.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import struct
from typing import Annotated, Any, Final, NamedTuple

import msgspec

from hostlink.components.gateway.rosbridge import MAX_TEXT
from hostlink.core.messages import serialisation
from hostlink.errors import BadRequest

ROS1: Final = serialisation.ROS1  # encoding of messages, requests and responses; rosserial serialises alike
ROS1_SCHEMA: Final = "ros1msg"  # a definition with all that it contains

_PUBLISHED, _CALL = 1, 2  # opcodes from a client
_MESSAGE, _TIME, _RESPONSE = 1, 2, 3  # opcodes to a client
_MESSAGE_HEAD = struct.Struct("<BIQ")  # opcode, subscription, time in ns
_TIME_FRAME = struct.Struct("<BQ")  # opcode, time in ns
_PUBLISHED_HEAD = struct.Struct("<BI")  # opcode, channel of the client
_CALL_HEAD = struct.Struct("<BIII")  # opcode, service, call, length of the encoding's name

MAX_ITEMS = 1024  # in one request
MAX_SETTINGS = 16  # parameters set in one request; each is compared with all existing ones
MAX_REASON = 300  # characters of an error, which may quote the client


class Published(NamedTuple):
    """A message on one of the client's channels."""

    channel_id: int
    payload: bytes


class ServiceCall(NamedTuple):
    """A call of a service, or its response."""

    service_id: int
    call_id: int
    encoding: str
    payload: bytes


def encode_message(subscription_id: int, stamp_ns: int, payload: bytes) -> bytes:
    """Encode a message of a channel that the client has subscribed to."""
    return _MESSAGE_HEAD.pack(_MESSAGE, subscription_id, stamp_ns) + payload


def encode_time(stamp_ns: int) -> bytes:
    """Encode the time of the server."""
    return _TIME_FRAME.pack(_TIME, stamp_ns)


def encode_response(response: ServiceCall) -> bytes:
    """Encode the response to a call."""
    encoding = response.encoding.encode()
    head = _CALL_HEAD.pack(_RESPONSE, response.service_id, response.call_id, len(encoding))
    return head + encoding + response.payload


def decode_frame(data: bytes) -> Published | ServiceCall:
    """Decode a binary frame of a client.

    Raises:
        BadRequest: the opcode is unknown, or the frame is shorter than its head.
    """
    opcode = data[0] if data else None
    if opcode == _PUBLISHED and len(data) >= _PUBLISHED_HEAD.size:
        return Published(_PUBLISHED_HEAD.unpack_from(data)[1], data[_PUBLISHED_HEAD.size :])
    if opcode == _CALL and len(data) >= _CALL_HEAD.size:
        return _decode_call(data)
    if opcode in (_PUBLISHED, _CALL):
        raise BadRequest(f"a binary message of {len(data)} bytes is shorter than its head")
    raise BadRequest(f"a binary message with the unknown opcode {opcode}")


def _decode_call(data: bytes) -> ServiceCall:
    _, service_id, call_id, encoding_bytes = _CALL_HEAD.unpack_from(data)
    end = _CALL_HEAD.size + encoding_bytes
    if end > len(data):
        raise BadRequest(f"a service call whose encoding has {encoding_bytes} bytes, more than the message")
    encoding = data[_CALL_HEAD.size : end].decode(errors="replace")
    return ServiceCall(service_id, call_id, encoding, data[end:])


_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]  # fits a binary message
_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_TEXT)]
_Text = Annotated[str, msgspec.Meta(max_length=MAX_TEXT)]
_Numbers = Annotated[list[_Number], msgspec.Meta(max_length=MAX_ITEMS)]
_Names = Annotated[list[_Name], msgspec.Meta(max_length=MAX_ITEMS)]


class WantedChannel(msgspec.Struct):
    """A subscription; the client chose its id."""

    id: _Number
    channel_id: _Number = msgspec.field(name="channelId")


class ClientChannel(msgspec.Struct):
    """A topic to which the client publishes; the client chose its id."""

    id: _Number
    topic: _Name
    encoding: _Text
    schema_name: _Name = msgspec.field(name="schemaName")


class ParameterSetting(msgspec.Struct):
    """A parameter; without a value it is removed."""

    name: _Name
    value: Any = msgspec.UNSET
    type: _Text | None = None


class Subscribe(msgspec.Struct, tag_field="op", tag="subscribe"):
    """Request for the messages of channels."""

    subscriptions: Annotated[list[WantedChannel], msgspec.Meta(max_length=MAX_ITEMS)]


class Unsubscribe(msgspec.Struct, tag_field="op", tag="unsubscribe"):
    """Request to end subscriptions."""

    subscription_ids: _Numbers = msgspec.field(name="subscriptionIds")


class Advertise(msgspec.Struct, tag_field="op", tag="advertise"):
    """Request to publish on topics."""

    channels: Annotated[list[ClientChannel], msgspec.Meta(max_length=MAX_ITEMS)]


class Unadvertise(msgspec.Struct, tag_field="op", tag="unadvertise"):
    """Request to stop publishing on topics."""

    channel_ids: _Numbers = msgspec.field(name="channelIds")


class GetParameters(msgspec.Struct, tag_field="op", tag="getParameters"):
    """Request for the values of parameters; without names all."""

    names: _Names = msgspec.field(name="parameterNames")
    id: _Text | None = None


class SetParameters(msgspec.Struct, tag_field="op", tag="setParameters"):
    """Request to change parameters."""

    parameters: Annotated[list[ParameterSetting], msgspec.Meta(max_length=MAX_SETTINGS)]
    id: _Text | None = None


class WatchParameters(msgspec.Struct, tag_field="op", tag="subscribeParameterUpdates"):
    """Request for the values of parameters whenever they change; without names of all present ones."""

    names: _Names = msgspec.field(name="parameterNames")


class UnwatchParameters(msgspec.Struct, tag_field="op", tag="unsubscribeParameterUpdates"):
    """Request to stop sending changes of parameters; without names of all."""

    names: _Names = msgspec.field(name="parameterNames")


class WatchGraph(msgspec.Struct, tag_field="op", tag="subscribeConnectionGraph"):
    """Request for the publishers, subscribers and providers of the graph."""


class UnwatchGraph(msgspec.Struct, tag_field="op", tag="unsubscribeConnectionGraph"):
    """Request to stop sending the graph."""


JsonRequest = (
    Subscribe
    | Unsubscribe
    | Advertise
    | Unadvertise
    | GetParameters
    | SetParameters
    | WatchParameters
    | UnwatchParameters
    | WatchGraph
    | UnwatchGraph
)
_decoder: msgspec.json.Decoder[JsonRequest] = msgspec.json.Decoder(JsonRequest)


def decode_request(text: str) -> JsonRequest:
    """Decode one JSON message of a client.

    Raises:
        BadRequest: the text is not JSON, its op is unknown, or a field is missing or invalid.
    """
    try:
        return _decoder.decode(text)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise BadRequest(str(error)[:MAX_REASON]) from None
    except RecursionError:
        raise BadRequest("invalid JSON:nested too deeply") from None
