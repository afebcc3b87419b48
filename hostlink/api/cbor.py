"""The binary forms of a rosbridge message: `cbor`, decoded with typed arrays, and `cbor-raw`, bytes as they came."""

import struct
from collections.abc import Mapping
from typing import Any

import cbor2

from hostlink.hub.message import Message
from hostlink.messages.message_type import MessageType

_NS_PER_S = 1_000_000_000
# RFC 8746, little-endian: what roslibjs knows how to read.
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
    """The publish operation with its fields.

    Raises:
        BadPayload: the bytes are no message of the type.
    """
    fields: Any = message.decoded
    if message.type is not None:
        fields = _with_typed_arrays(message.type, message.decoded)
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": fields})


def encode_cbor_raw(topic: str, message: Message) -> bytes:
    """The publish operation with the serialised message: rosserial's payload is ROS 1's."""
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
