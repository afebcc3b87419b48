"""Definitions: what the payloads of a recording's channels mean, in ROS 1 and in ROS 2.

A file may be made to harm: a type whose messages could grow without end from few bytes is refused.
"""

import functools
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from hostlink.errors import BadPayload, ConfigError, UnknownFormat
from hostlink.messages.catalog import read_full_definition
from hostlink.messages.message_type import MessageType
from hostlink.recording.channel import CDR, ROS1, Channel

MAX_TYPE_BYTES = 64 * 1024 * 1024  # that the smallest message of a type has
MAX_DEPTH = 32  # of messages in messages
MAX_REASON = 200  # characters of a library's words
_HEADER = "std_msgs/msg/Header"
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_DUMMY = "structure_needs_at_least_one_member"  # a message of ROS 2 without a field has this one
_IDL_SEPARATOR = "=" * 80 + "\n"
_CDR_HEAD_BYTES = 4
_PADDING_BYTES = 3  # that may be behind a message
_BYTES = ("uint8", "char", "octet")

Types = dict[str, Any]  # of rosbags: name -> (constants, fields)


@functools.cache
def _store(which: Stores) -> Typestore:
    return get_typestore(which)


def ros2_name(type_name: str) -> str:
    """As ROS 2 and rosbags name a type: geometry_msgs/msg/Pose2D."""
    package, _, base = type_name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{base}"


def ros1_name(type_name: str) -> str:
    """As ROS 1 names a type: geometry_msgs/Pose2D."""
    package, _, base = type_name.rpartition("/")
    return f"{package.removesuffix('/msg')}/{base}"


def ros1_type(channel: Channel) -> MessageType:
    """The type of a channel with payloads of ROS 1.

    Raises:
        UnknownFormat: the channel has another encoding, or no definition.
    """
    if channel.encoding != ROS1 or channel.schema_encoding != "ros1msg":
        raise UnknownFormat(_encoding_of(channel))
    if not channel.schema and channel.type_name != "std_msgs/Empty":
        raise UnknownFormat(f"the recording has no definition of {channel.type_name or 'its type'}")
    try:
        return read_full_definition(channel.type_name, channel.schema)
    except ConfigError as error:
        raise UnknownFormat(f"the definition of {channel.type_name} is not readable: {error}"[:MAX_REASON]) from error


class Ros2Type:
    """A type of ROS 2: decodes its messages, and converts those of ROS 1 from and to it."""

    def __init__(self, name: str, store: Typestore) -> None:
        """`name`: as geometry_msgs/msg/Pose2D; `store`: has all of it.

        Raises:
            UnknownFormat: a part of it is missing, or it could grow without end.
        """
        self.name, self.store = name, store
        self._least_bytes = _least_bytes(store.fielddefs, name, {}, ())

    def decode(self, payload: bytes) -> dict[str, Any]:
        """The fields of a message in CDR; a time is {"secs", "nsecs"}, as in messages of ROS 1.

        Raises:
            BadPayload: it is not a message of this type.
        """
        self._check(payload)
        try:
            return _as_dict(self.store.fielddefs, self.name, self.store.deserialize_cdr(payload, self.name))
        except Exception as error:  # noqa: BLE001 - rosbags raises what it finds in a payload
            raise BadPayload(self.name, _words(error)) from None

    def to_ros1(self, payload: bytes) -> bytes:
        """A message of ROS 1 from one in CDR; a header's number is 0.

        Raises:
            BadPayload: it is not a message of this type.
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
        """A message in CDR from one of ROS 1, which must be one: rosbags would take hours for what is not.

        Raises:
            BadPayload: it is not a message of this type.
        """
        try:
            return bytes(self.store.ros1_to_cdr(payload, self.name))
        except Exception as error:  # noqa: BLE001 - as above
            raise BadPayload(self.name, _words(error)) from None

    def check_cdr(self, payload: bytes) -> None:
        """Refuse what is not a message in CDR.

        Raises:
            BadPayload: it is not one of this type.
        """
        self.decode(payload)

    def ros1_definition(self) -> tuple[str, str]:
        """(definition with all that it contains, md5 sum) of the same type in ROS 1: ROS 1's own, where it is equal."""
        ros1 = _store(Stores.ROS1_NOETIC)
        if self.name in ros1.fielddefs and _is_equal(self.store.fielddefs, ros1.fielddefs, self.name):
            return ros1.generate_msgdef(self.name)
        types = {name: (constants, _unbounded(fields)) for name, (constants, fields) in self.store.fielddefs.items()}
        own = Typestore()
        own.fielddefs = types | {_HEADER: ros1.fielddefs[_HEADER]}
        return own.generate_msgdef(self.name)

    def _check(self, payload: bytes) -> None:
        if len(payload) - _CDR_HEAD_BYTES < self._least_bytes:
            raise BadPayload(self.name, f"{len(payload)} bytes are too few")


def ros2_type(channel: Channel) -> Ros2Type:
    """The type of ROS 2 of a channel with payloads of ROS 1 or in CDR: ROS 2's own, where it is equal.

    Raises:
        UnknownFormat: the channel has another encoding, or no definition that can be read.
    """
    name = ros2_name(channel.type_name)
    if channel.encoding == ROS1:
        ros1_type(channel)
    elif channel.encoding != CDR or channel.schema_encoding not in ("ros2msg", "ros2idl", "omgidl"):
        raise UnknownFormat(_encoding_of(channel))
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
    _least_bytes(types, name, {}, ())  # before anything is made of it
    if name in ros2.fielddefs and _is_equal(types, ros2.fielddefs, name):
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
        raise UnknownFormat(f"the definition of {channel.type_name} is not readable: {_words(error)}") from error
    return found


def why_unknown(channel: Channel) -> str:
    """Why hostlink cannot convert the messages of a channel; empty: it can."""
    try:
        if not channel.content and channel.encoding != "json":
            ros2_type(channel)
    except UnknownFormat as error:
        return str(error)
    return ""


def _encoding_of(channel: Channel) -> str:
    schema = f", its definitions are {channel.schema_encoding!r}" if channel.schema_encoding else ""
    return f"its messages are {channel.encoding!r}{schema}; hostlink reads ros1, cdr and json"


def _types_of(channel: Channel, name: str) -> Types:
    """From the definition in the file; empty: it has none.

    Raises:
        UnknownFormat: it is none.
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
        raise UnknownFormat(f"the definition of {channel.type_name} is not readable: {_words(error)}") from error
    return types


def _least_bytes(types: Types, name: str, known: dict[str, int], outer: tuple[str, ...]) -> int:
    """How many bytes the smallest message has.

    Raises:
        UnknownFormat: something of it is missing, it contains itself, or a list of it costs no bytes.
    """
    if name in known:
        return known[name]
    if name not in types:
        raise UnknownFormat(f"the definition of {ros1_name(name)} is not in the recording")
    if name in outer or len(outer) > MAX_DEPTH:
        raise UnknownFormat(f"{ros1_name(name)} contains itself, or too many others")
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
                raise UnknownFormat(f"a list of {ros1_name(inner)} costs no bytes")
        if total > MAX_TYPE_BYTES:
            raise UnknownFormat(f"a message of {ros1_name(name)} has more than {MAX_TYPE_BYTES} bytes")
    known[name] = total
    return total


def _is_equal(types: Types, others: Types, name: str) -> bool:
    """Whether a message of this type has the same bytes in both; headers differ by a number that is left out."""
    if name == _HEADER:
        return True
    if name not in types or name not in others:
        return False
    ours, theirs = ([(field, kind) for field, kind in each[name][1] if field != _DUMMY] for each in (types, others))
    return len(ours) == len(theirs) and all(
        one[0].lower() == other[0].lower() and _is_equal_kind(types, others, one[1], other[1])
        for one, other in zip(ours, theirs, strict=True)
    )


def _is_equal_kind(types: Types, others: Types, one: Any, other: Any) -> bool:
    if one[0] != other[0]:
        return False
    if one[0] == Nodetype.NAME:
        return bool(one[1] == other[1]) and _is_equal(types, others, one[1])
    if one[0] == Nodetype.BASE:
        return bool(one[1][0] == other[1][0])
    is_same_count = one[0] == Nodetype.SEQUENCE or one[1][1] == other[1][1]
    return bool(is_same_count) and _is_equal_kind(types, others, one[1][0], other[1][0])


def _not_empty(fields: list[Any]) -> list[Any]:
    return fields or [(_DUMMY, (Nodetype.BASE, ("uint8", 0)))]


def _unbounded(fields: list[Any]) -> list[Any]:
    """Without the limits of lists and texts, which ROS 1 does not have."""
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
