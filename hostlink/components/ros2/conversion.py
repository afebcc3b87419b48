"""Conversion between the daemon's messages and those of ROS 2: layouts, serialised bytes, and fields as JSON. Pure."""

import array
import base64
import importlib
import math
import re
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from hostlink.components.graphs.wire_layout import PLACEHOLDER, FieldDesc, Layout, Ros1Field
from hostlink.errors import BadPayload, HostlinkError

Fields = dict[str, FieldDesc]
_ARRAY = re.compile(r"(?P<item>.+)\[(?P<count>\d+)\]")
_SEQUENCE = re.compile(r"sequence<(?P<item>.+?)(?:, (?P<limit>\d+))?>")
_STRING = re.compile(r"string(?:<(?P<limit>\d+)>)?")
_BASES = {  # as rclpy's classes name them
    "boolean": "bool",
    "octet": "byte",
    "float": "float32",
    "double": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
_SIZES = {"byte": 1, "float32": 4, "float64": 8} | {
    f"{sign}int{8 * size}": size for sign in ("", "u") for size in (2, 4, 8)
}

HEADER = "std_msgs/msg/Header"

MAX_REMEMBERED = 64  # messages of a topic; an echo arrives within milliseconds


def load_type(type_name: str) -> Any:
    """The class of a message or service, as `geometry_msgs/msg/Twist` names it.

    Raises:
        HostlinkError: it is not installed.
    """
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        apt = f"ros-$ROS_DISTRO-{package.replace('_', '-')}"
        raise HostlinkError(
            f"{type_name} is not installed here, so what is of this type stays out of ROS 2: install {apt}, "
            "or build and source its package"
        ) from error


def ros2_fields(fields_and_types: Mapping[str, str]) -> Fields:
    """The fields of a class of rclpy, from its `get_fields_and_field_types()`, as rosbags has them.

    Raises:
        HostlinkError: ROS 1 has nothing like one of them.
    """
    fields = {name.removeprefix("_"): _described(text) for name, text in fields_and_types.items()}
    return fields or {PLACEHOLDER: (Nodetype.BASE, ("uint8", 0))}


def nested_types(fields: Fields) -> list[str]:
    """The types of its fields that are messages."""
    items = (desc[1][0] if desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else desc for desc in fields.values())
    return [item[1] for item in items if item[0] == Nodetype.NAME]


def _described(text: str) -> FieldDesc:
    if array := _ARRAY.fullmatch(text):
        return Nodetype.ARRAY, (_described(array["item"]), int(array["count"]))
    if sequence := _SEQUENCE.fullmatch(text):
        return Nodetype.SEQUENCE, (_described(sequence["item"]), int(sequence["limit"] or 0))
    if string := _STRING.fullmatch(text):
        return Nodetype.BASE, ("string", int(string["limit"] or 0))
    if text in _BASES:
        return Nodetype.BASE, (_BASES[text], 0)
    package, _, name = text.partition("/")
    if not name:
        raise HostlinkError(f"a field of type {text}, which ROS 1 has not")
    return Nodetype.NAME, f"{package}/msg/{name}"


def ros1_fields(typedefs: Iterable[Mapping[str, Any]]) -> dict[str, list[Ros1Field]]:
    """Return the fields of types of the daemon, from the `typedefs` of /rosapi/message_details."""
    return {
        each["type"]: list(zip(each["fieldnames"], each["fieldtypes"], each["fieldarraylen"], strict=True))
        for each in typedefs
        if each["type"] not in ("time", "duration")
    }


def added_bytes(ros1: Layout, ros2: Layout) -> int | None:
    """Return the bytes that ROS 2 appends, as the variance of sensor_msgs/Range; None for any other difference."""
    added = ros2[len(ros1) :]
    if ros2[: len(ros1)] != ros1 or not all(isinstance(item, str) and item in _SIZES for item in added):
        return None
    return sum(_SIZES[str(item)] for item in added)


_STAMP = slice(4, 12)  # after the head of CDR: the seconds and nanoseconds of a leading header


class Conversion:
    """Conversion of serialised messages of known types, by their ROS 2 names."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.EMPTY)
        self._added: dict[str, bytes] = {}  # zeros that ROS 2 has behind ROS 1's fields

    def add(self, types: Mapping[str, Fields], type_name: str = "", *, added_bytes: int = 0) -> None:
        """Learn types; one that is known already stays. `type_name` has so many bytes more in ROS 2 than in ROS 1."""
        if added_bytes:
            self._added[type_name] = bytes(added_bytes)
        known = self._store.fielddefs
        new: Any = {name: ([], list(fields.items())) for name, fields in types.items() if name not in known}
        if new:
            self._store.register(new)

    def to_cdr(self, payload: bytes, type_name: str) -> bytes:
        """Convert ROS 1's bytes to CDR.

        Raises:
            BadPayload: the bytes are not a message of the type.
        """
        try:
            return bytes(self._store.ros1_to_cdr(payload + self._added.get(type_name, b""), type_name))
        except (SerdeError, IndexError) as error:
            raise BadPayload(type_name, str(error)) from error

    def to_ros1(self, data: bytes, type_name: str) -> bytes:
        """Convert CDR to ROS 1's bytes; a header's `seq` is 0.

        Raises:
            BadPayload: the bytes are not a message of the type.
        """
        try:
            payload = bytes(self._store.cdr_to_ros1(data, type_name))
        except (SerdeError, IndexError) as error:
            raise BadPayload(type_name, str(error)) from error
        return payload[: len(payload) - len(self._added.get(type_name, b""))]

    def begins_with_header(self, type_name: str) -> bool:
        """Whether the first field is a header."""
        fields = self._store.fielddefs[type_name][1]
        return bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)


def stamped(data: bytes, stamp: bytes) -> bytes:
    """CDR that begins with a header, with another stamp: its eight bytes, little-endian."""
    return data[: _STAMP.start] + stamp + data[_STAMP.stop :]


_TIMES = {"sec": "secs", "nanosec": "nsecs"}
_BYTE_TYPES = ("uint8", "octet", "char")


def to_json(message: Any) -> dict[str, Any]:
    """The fields of a message, as the daemon reads them."""
    fields = message.get_fields_and_field_types()
    if list(fields) == list(_TIMES):
        return {_TIMES[name]: getattr(message, name) for name in fields}
    return {name: _value_to_json(getattr(message, name)) for name in fields}


def _value_to_json(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return to_json(value)
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else base64.b64encode(value).decode()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | bool | int):
        return value
    if isinstance(value, array.array) and value.typecode == "B":
        return base64.b64encode(value.tobytes()).decode()
    items = value.tolist() if hasattr(value, "tolist") else value
    return [_value_to_json(item) for item in items]


def fill(message: Any, values: Mapping[str, Any]) -> None:
    """Set the fields of a message of rclpy; what is missing stays as it is, and ROS 1's `seq` is left out.

    Raises:
        HostlinkError: a value does not fit its field.
    """
    for name, type_name in message.get_fields_and_field_types().items():
        key = _TIMES.get(name, name) if name not in values else name
        if key in values:
            try:
                setattr(message, name, _value_of(getattr(message, name), type_name, values[key]))
            except (AssertionError, TypeError, ValueError, KeyError) as error:  # rclpy asserts the types of fields
                raise HostlinkError(f"{name}: {values[key]!r} is not a {type_name}") from error


def _value_of(before: Any, type_name: str, value: Any) -> Any:
    if hasattr(before, "get_fields_and_field_types"):
        fill(before, value)
        return before
    item_type = type_name.removeprefix("sequence<").partition(">")[0].partition(",")[0].partition("[")[0]
    if item_type == type_name or isinstance(before, str):  # the type of a text may have a bound
        return _one_of(type_name, value)
    if item_type in _BYTE_TYPES and isinstance(value, str):
        value = base64.b64decode(value)
    if "/" in item_type:
        raise HostlinkError(f"a list of {item_type} in a service, which is not converted")
    return [_one_of(item_type, item) for item in value]


def _one_of(type_name: str, value: Any) -> Any:
    if type_name in ("float", "double"):
        return math.nan if value is None else float(value)
    return bytes([value]) if type_name == "octet" else value


class Echoes:
    """Messages of one topic that the bridge published, and that ROS 2 delivers to it again as echoes."""

    def __init__(self) -> None:
        self._published: deque[bytes] = deque(maxlen=MAX_REMEMBERED)

    def publish(self, data: bytes) -> None:
        """Note a message that the bridge publishes."""
        self._published.append(data)

    def is_echo(self, data: bytes) -> bool:
        """Whether a received message is the bridge's own. Each published message is one echo."""
        try:
            self._published.remove(data)
        except ValueError:
            return False
        return True
