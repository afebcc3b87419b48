"""Binary frames of Foxglove's WebSocket protocol, version 1: an opcode and little-endian numbers. Pure.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import struct
from typing import Final, NamedTuple

from hostlink.errors import BadRequest

ROS1: Final = "ros1"  # the encoding of messages, requests and responses; rosserial's payloads are the same bytes
ROS1_SCHEMA: Final = "ros1msg"  # a definition with all that it contains

_PUBLISHED, _CALL = 1, 2  # opcodes from a client
_MESSAGE, _TIME, _RESPONSE = 1, 2, 3  # opcodes to a client
_MESSAGE_HEAD = struct.Struct("<BIQ")  # opcode, subscription, time in ns
_TIME_FRAME = struct.Struct("<BQ")  # opcode, time in ns
_PUBLISHED_HEAD = struct.Struct("<BI")  # opcode, channel of the client
_CALL_HEAD = struct.Struct("<BIII")  # opcode, service, call, length of the encoding's name


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
    """A message of a channel to which the client has subscribed."""
    return _MESSAGE_HEAD.pack(_MESSAGE, subscription_id, stamp_ns) + payload


def encode_time(stamp_ns: int) -> bytes:
    """The time of the server."""
    return _TIME_FRAME.pack(_TIME, stamp_ns)


def encode_response(response: ServiceCall) -> bytes:
    """The response to a call."""
    encoding = response.encoding.encode()
    head = _CALL_HEAD.pack(_RESPONSE, response.service_id, response.call_id, len(encoding))
    return head + encoding + response.payload


def decode_frame(data: bytes) -> Published | ServiceCall:
    """What a client sent.

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
