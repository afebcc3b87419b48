"""Layout: the fields of a message type in ROS 1 and in ROS 2, and whether one is converted into the other. Pure."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from rosbags.interfaces import Nodetype

from hostlink.errors import HostlinkError

FieldDesc = tuple[Nodetype, Any]  # as rosbags has it
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
_BYTES = frozenset({"bool", "byte", "char", "int8", "uint8"})
_SIZES = {"byte": 1, "float32": 4, "float64": 8} | {
    f"{sign}int{8 * size}": size for sign in ("", "u") for size in (2, 4, 8)
}
_TIMES = {"time": ("int32", "uint32"), "duration": ("int32", "uint32")}
_PLACEHOLDER = "structure_needs_at_least_one_member"  # what ROS 2 has in a message without fields
HEADER = "std_msgs/Header"


def ros2_fields(fields_and_types: Mapping[str, str]) -> Fields:
    """The fields of a class of rclpy, from its `get_fields_and_field_types()`, as rosbags has them.

    Raises:
        HostlinkError: ROS 1 has nothing like one of them.
    """
    fields = {name.removeprefix("_"): _described(text) for name, text in fields_and_types.items()}
    return fields or {_PLACEHOLDER: (Nodetype.BASE, ("uint8", 0))}


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


Layout = tuple[object, ...]


def ros2_layout(types: Mapping[str, Fields], name: str) -> Layout:
    """What is on the wire of this type, number by number, in a form that is equal where ROS 1 has the same."""
    return _joined(_layout_of(types, desc) for field, desc in types[name].items() if field != _PLACEHOLDER)


def _layout_of(types: Mapping[str, Fields], desc: FieldDesc) -> Layout:
    kind, inner = desc
    if kind == Nodetype.ARRAY:
        return ((inner[1], _layout_of(types, inner[0])),)
    if kind == Nodetype.SEQUENCE:
        return ((0, _layout_of(types, inner[0])),)
    if kind == Nodetype.NAME:
        return ros2_layout(types, inner)
    return (_base(inner[0]),)


def ros1_layout(typedefs: Iterable[Mapping[str, Any]], name: str) -> Layout:
    """The same of a type of the daemon, from the `typedefs` of /rosapi/message_details."""
    return _ros1_layout({each["type"]: each for each in typedefs}, name)


def _ros1_layout(typedefs: Mapping[str, Mapping[str, Any]], name: str) -> Layout:
    typedef = typedefs[name]
    fields = list(zip(typedef["fieldnames"], typedef["fieldtypes"], typedef["fieldarraylen"], strict=True))
    if name == HEADER:
        fields = [field for field in fields if field[0] != "seq"]  # ROS 2 has none
    return _joined(_ros1_field(typedefs, type_name, count) for _, type_name, count in fields)


def _ros1_field(typedefs: Mapping[str, Mapping[str, Any]], type_name: str, count: int) -> Layout:
    if type_name in _TIMES:
        item: Layout = _TIMES[type_name]
    elif type_name in typedefs:
        item = _ros1_layout(typedefs, type_name)
    else:
        item = (_base(type_name),)
    return item if count < 0 else ((count, item),)


def added_bytes(ros1: Layout, ros2: Layout) -> int | None:
    """How many bytes ROS 2 has behind ROS 1's, as sensor_msgs/Range has its variance; None: they differ otherwise."""
    added = ros2[len(ros1) :]
    if ros2[: len(ros1)] != ros1 or not all(isinstance(item, str) and item in _SIZES for item in added):
        return None
    return sum(_SIZES[str(item)] for item in added)


def _joined(parts: Iterable[Layout]) -> Layout:
    return tuple(item for part in parts for item in part)


def _base(name: str) -> str:
    return "byte" if name in _BYTES else name
