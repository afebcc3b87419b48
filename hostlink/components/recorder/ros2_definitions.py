"""ROS 2 types of a recording's channels, by rosbags, which the extra `export` installs.

A file may be malicious: a type whose messages could grow without limit from few bytes is refused.
"""

import functools
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from hostlink.components.recorder.channel import CDR, ROS1, Channel
from hostlink.components.recorder.ros1_definitions import MAX_REASON, encoding_of, ros1_type, ros2_name
from hostlink.core.messages.catalog import short_name
from hostlink.errors import BadPayload, UnknownFormat

MAX_TYPE_BYTES = 64 * 1024 * 1024  # size of a type's smallest message
MAX_DEPTH = 32  # nesting of messages
_HEADER = "std_msgs/msg/Header"
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_DUMMY = "structure_needs_at_least_one_member"  # ROS 2 adds this field to a message without fields
_IDL_SEPARATOR = "=" * 80 + "\n"
_CDR_HEAD_BYTES = 4
_BYTES = ("uint8", "char", "octet")

Types = dict[str, Any]  # as in rosbags: name -> (constants, fields)


@functools.cache
def _store(which: Stores) -> Typestore:
    return get_typestore(which)


class Ros2Type:
    """ROS 2 type: decodes its messages, and converts ROS 1 messages from and to it."""

    def __init__(self, name: str, store: Typestore) -> None:
        """`name` has the form geometry_msgs/msg/Pose2D. `store` contains the type and its nested types.

        Raises:
            UnknownFormat: a nested type is missing, or the type could grow without limit.
        """
        self.name, self.store = name, store
        self._least_bytes = _least_bytes(store.fielddefs, name, {}, ())

    def decode(self, payload: bytes) -> dict[str, Any]:
        """Decode a CDR message. A time is {"secs", "nsecs"}, as in ROS 1 messages.

        Raises:
            BadPayload: the payload is not a message of this type.
        """
        self._check(payload)
        try:
            return _as_dict(self.store.fielddefs, self.name, self.store.deserialize_cdr(payload, self.name))
        except Exception as error:  # noqa: BLE001 - rosbags raises what it finds in a payload
            raise BadPayload(self.name, _words(error)) from None

    def to_ros1(self, payload: bytes) -> bytes:
        """Convert a CDR message to ROS 1. A header's sequence number is 0.

        Raises:
            BadPayload: the payload is not a message of this type.
        """
        self._check(payload)
        try:
            if payload[1] == 0:  # big-endian
                message = self.store.deserialize_cdr(payload, self.name)
                payload = bytes(self.store.serialize_cdr(message, self.name, little_endian=True))
            return bytes(self.store.cdr_to_ros1(payload, self.name))
        except Exception as error:  # noqa: BLE001 - as above
            raise BadPayload(self.name, _words(error)) from None

    def from_ros1(self, payload: bytes) -> bytes:
        """Convert a ROS 1 message to CDR. The payload must be valid: rosbags would take hours for an invalid one.

        Raises:
            BadPayload: the payload is not a message of this type.
        """
        try:
            return bytes(self.store.ros1_to_cdr(payload, self.name))
        except Exception as error:  # noqa: BLE001 - as above
            raise BadPayload(self.name, _words(error)) from None

    def ros1_definition(self) -> tuple[str, str]:
        """Return the full ROS 1 definition of the type and its md5 sum. An equal type of ROS 1 itself is preferred."""
        ros1 = _store(Stores.ROS1_NOETIC)
        if self.name in ros1.fielddefs and _is_equal(self.store.fielddefs, Stores.ROS1_NOETIC, self.name):
            return ros1.generate_msgdef(self.name)
        types = {name: (constants, _unbounded(fields)) for name, (constants, fields) in self.store.fielddefs.items()}
        own = Typestore()
        own.fielddefs = types | {_HEADER: ros1.fielddefs[_HEADER]}
        return own.generate_msgdef(self.name)

    def _check(self, payload: bytes) -> None:
        if len(payload) - _CDR_HEAD_BYTES < self._least_bytes:
            raise BadPayload(self.name, f"{len(payload)} bytes are too short for this type")


def built_type(channel: Channel) -> Ros2Type:
    """Return the ROS 2 type of a channel with ROS 1 or CDR payloads. An equal type of ROS 2 itself is preferred.

    Raises:
        UnknownFormat: the channel has another encoding, or no readable definition.
    """
    name = ros2_name(channel.type_name)
    if channel.encoding == ROS1:
        ros1_type(channel)
    elif channel.encoding != CDR or channel.schema_encoding not in ("", "ros2msg", "ros2idl", "omgidl"):
        raise UnknownFormat(encoding_of(channel))
    ros2 = _store(Stores.ROS2_KILTED)
    types = _types_of(channel, name)
    if not types:
        if name not in ros2.fielddefs or channel.encoding == ROS1:
            raise UnknownFormat(f"the recording has no definition of {channel.type_name or 'its type'}")
        return Ros2Type(name, ros2)
    for each in (_HEADER, *_TIMES):
        types.setdefault(each, ros2.fielddefs[each])
    if channel.encoding == ROS1:
        types[_HEADER] = ros2.fielddefs[_HEADER]
    _least_bytes(types, name, {}, ())  # before the types are used
    if name in ros2.fielddefs and _is_equal(types, Stores.ROS2_KILTED, name):
        return Ros2Type(name, ros2)
    store = get_typestore(Stores.EMPTY)
    try:
        store.register({each: (constants, _not_empty(fields)) for each, (constants, fields) in types.items()})
        found = Ros2Type(name, store)
        store.get_msgdef(name)
        store.hash_rihs01(name)
    except UnknownFormat:
        raise
    except Exception as error:
        raise UnknownFormat(f"the definition of {channel.type_name} cannot be read: {_words(error)}") from error
    return found


def _types_of(channel: Channel, name: str) -> Types:
    """Return the types of the definition in the file; empty if it has none.

    Raises:
        UnknownFormat: the definition cannot be read.
    """
    text = channel.schema
    if not text.strip():
        return {name: ([], [])} if name == "std_msgs/msg/Empty" else {}
    try:
        if channel.schema_encoding not in ("ros2idl", "omgidl"):
            return dict(get_types_from_msg(text, name))
        parts = text.split(_IDL_SEPARATOR)[1:] if text.startswith(f"{_IDL_SEPARATOR}IDL: ") else [f"\n{text}"]
        types: Types = {}
        for part in parts:
            types.update(get_types_from_idl(part.partition("\n")[2]))
    except Exception as error:
        raise UnknownFormat(f"the definition of {channel.type_name} cannot be read: {_words(error)}") from error
    return types


def _least_bytes(types: Types, name: str, known: dict[str, int], outer: tuple[str, ...]) -> int:
    """Return the size of the smallest message.

    Raises:
        UnknownFormat: a nested type is missing, the type contains itself, or list elements have no bytes.
    """
    if name in known:
        return known[name]
    if name not in types:
        raise UnknownFormat(f"the definition of {short_name(name)} is not in the recording")
    if name in outer or len(outer) > MAX_DEPTH:
        raise UnknownFormat(f"{short_name(name)} contains itself, or is nested too deeply")
    total = 0
    for _, (kind, content) in types[name][1]:
        if kind == Nodetype.NAME:
            total += _least_bytes(types, content, known, (*outer, name))
        elif kind == Nodetype.BASE:
            total += 1
        else:
            (inner_kind, inner), count = content
            each = _least_bytes(types, inner, known, (*outer, name)) if inner_kind == Nodetype.NAME else 1
            total += each * count if kind == Nodetype.ARRAY else 1
            if each == 0 and types[inner][1]:
                raise UnknownFormat(f"a list of {short_name(inner)} has no bytes per element")
        if total > MAX_TYPE_BYTES:
            raise UnknownFormat(f"a message of {short_name(name)} has more than {MAX_TYPE_BYTES} bytes")
    known[name] = total
    return total


def _is_equal(types: Types, which: Stores, name: str) -> bool:
    """Whether messages of this type have the same bytes there. Headers count as equal despite the sequence number."""
    ours, theirs = _comparable(types), _comparable_store(which)
    try:
        return name in types and ours.hash_rihs01(name) == theirs.hash_rihs01(name)
    except KeyError:  # it has no such type, or a nested type is missing
        return False


def _comparable(types: Types) -> Typestore:
    """Return the types without what ROS 1 and ROS 2 write differently. The hash of one has no constants in it."""
    store = Typestore()
    store.fielddefs = {
        name: ([], [(field.lower(), kind) for field, kind in _not_empty(_unbounded(fields))])
        for name, (_, fields) in types.items()
    }
    store.fielddefs[_HEADER] = ([], _not_empty([]))
    return store


@functools.cache
def _comparable_store(which: Stores) -> Typestore:
    return _comparable(_store(which).fielddefs)


def _not_empty(fields: list[Any]) -> list[Any]:
    return fields or [(_DUMMY, (Nodetype.BASE, ("uint8", 0)))]


def _unbounded(fields: list[Any]) -> list[Any]:
    """Remove the bounds of lists and strings, which ROS 1 does not have."""
    return [(name, _unbounded_kind(kind)) for name, kind in fields]


def _unbounded_kind(kind: Any) -> Any:
    number, content = kind
    if number == Nodetype.BASE:
        return number, (content[0], 0)
    if number == Nodetype.NAME:
        return kind
    inner, count = content
    return number, (_unbounded_kind(inner), count if number == Nodetype.ARRAY else 0)


def _as_dict(types: Types, name: str, message: Any) -> dict[str, Any]:
    if name in _TIMES:
        return {"secs": int(message.sec), "nsecs": int(message.nanosec)}
    return {
        field: _value(types, kind, getattr(message, normalize_fieldname(field)))
        for field, kind in types[name][1]
        if field != _DUMMY
    }


def _value(types: Types, kind: Any, value: Any) -> Any:
    number, content = kind
    if number == Nodetype.NAME:
        return _as_dict(types, content, value)
    if number == Nodetype.BASE:
        return value
    inner_number, inner = content[0]
    if inner_number == Nodetype.NAME:
        return [_as_dict(types, inner, each) for each in value]
    if isinstance(value, np.ndarray):
        return value.tobytes() if inner[0] in _BYTES else value.tolist()
    return list(value)


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:MAX_REASON]
