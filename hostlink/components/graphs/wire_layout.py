"""Layouts of messages on the wire, by which a type of ROS 1 and one of ROS 2 are compared. Pure."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from rosbags.interfaces import Nodetype

FieldDesc = tuple[Nodetype, Any]  # a field of ROS 2, as rosbags describes it
Ros1Field = tuple[str, str, int]  # name, type and array length: -1 without, 0 of any length
Layout = tuple[object, ...]

PLACEHOLDER: Final = "structure_needs_at_least_one_member"  # what ROS 2 has in a message without fields
_ROS1_HEADER, _ROS2_HEADER = "std_msgs/Header", "std_msgs/msg/Header"
_BYTES: Final = frozenset({"bool", "byte", "char", "int8", "uint8"})
_TIMES: Final = ("time", "duration")
_TIME: Final = ("int32", "uint32")


def ros1_layout(fields_of: Callable[[str], Iterable[Ros1Field] | None], name: str) -> Layout:
    """Return the layout of a type of ROS 1; `fields_of`: its fields and those of the types in it, None if built in.

    rosbags drops a header's `seq`, so a header is marked: another type with the same values is not one.
    """
    is_header = name == _ROS1_HEADER
    found: list[object] = [_ROS1_HEADER] * is_header
    for field, type_name, length in fields_of(name) or ():
        if is_header and field == "seq":
            continue
        if type_name in _TIMES:
            item: Layout = _TIME
        else:
            item = (_base(type_name),) if fields_of(type_name) is None else ros1_layout(fields_of, type_name)
        found += item if length < 0 else ((length, item),)
    return tuple(found)


def ros2_layout(fields_of: Callable[[str], Mapping[str, FieldDesc]], name: str) -> Layout:
    """Return the layout of a type of ROS 2, which is equal for the same layout in ROS 1."""
    found: list[object] = [_ROS1_HEADER] * (name == _ROS2_HEADER)
    for field, desc in fields_of(name).items():
        found += _layout_of(fields_of, desc) if field != PLACEHOLDER else ()
    return tuple(found)


def _layout_of(fields_of: Callable[[str], Mapping[str, FieldDesc]], desc: FieldDesc) -> Layout:
    kind, inner = desc
    if kind == Nodetype.BASE:
        return (_base(inner[0]),)
    if kind == Nodetype.NAME:
        return ros2_layout(fields_of, inner)
    item, length = inner
    return ((length if kind == Nodetype.ARRAY else 0, _layout_of(fields_of, item)),)


def _base(name: str) -> str:
    return "byte" if name in _BYTES else name
