"""Messages in CDR, written value by value: as ROS 2 does it, and as a board of micro-ROS does."""

import struct
from random import Random
from typing import Any, Final

from hostlink.core.messages.fields import FORMATS, SCALAR, SIZES, VARIABLE, Field, Layout

Message = dict[str, Any]
_COUNT_BYTES: Final = 4


def written(layout: Layout, message: Message) -> bytes:
    """The message as ROS 2 writes it."""
    data = bytearray()
    _write(data, layout, message, is_micro_ros=False)
    return bytes(data)


def written_by_micro_ros(layout: Layout, message: Message, random: Random) -> bytes:
    """The message as micro-ROS writes it, if each empty text was never set.

    The library announces a size before it writes (get_serialized_size of rosidl_typesupport_microxrcedds), and leaves
    what it does not need as it is.
    """
    data = bytearray()
    _write(data, layout, message, is_micro_ros=True)
    return bytes(data) + random.randbytes(_announced_bytes(0, layout, message) - len(data))


def has_array_of_texts(layout: Layout) -> bool:
    """Whether micro-ROS cannot write the type: it leaves out arrays of a fixed number of texts."""
    return any(field.type == "string" and field.array_length > 0 for field in layout.fields) or any(
        has_array_of_texts(layout.nested[field.type]) for field in layout.fields if field.type in layout.nested
    )


def _fields(layout: Layout) -> list[Field]:
    return [field for field in layout.fields if (layout.name, field.name) != ("std_msgs/Header", "seq")]


def _values(field: Field, message: Message) -> Any:
    value = message[field.name]
    return [value] if field.array_length == SCALAR else value


def _write(data: bytearray, layout: Layout, message: Message, *, is_micro_ros: bool) -> None:
    if not layout.fields:
        data += b"\0"
    for field in _fields(layout):
        values = _values(field, message)
        if field.array_length == VARIABLE:
            _write_number(data, "uint32", len(values))
        for value in values:
            if field.type in SIZES:
                _write_number(data, field.type, value)
            elif field.type == "string":
                text = b"" if is_micro_ros and not value else value.encode() + b"\0"
                _write_number(data, "uint32", len(text))
                data += text
            else:
                _write(data, layout.nested[field.type], value, is_micro_ros=is_micro_ros)


def _write_number(data: bytearray, type_name: str, value: object) -> None:
    data += bytes(-len(data) % SIZES[type_name])
    data += struct.pack(f"<{FORMATS[type_name]}", value)


def _announced_bytes(begin: int, layout: Layout, message: Message) -> int:
    """The size that micro-ROS announces for a message that begins at that position."""
    end = begin + (not layout.fields)
    for field in _fields(layout):
        values = _values(field, message)
        is_list = field.array_length == VARIABLE
        if is_list:
            end += -end % _COUNT_BYTES + _COUNT_BYTES
        if field.type in SIZES:
            size = SIZES[field.type]
            end += (-end % size + len(values) * size) if len(values) else 0
            continue
        for value in values:
            if field.type == "string":
                end += -end % _COUNT_BYTES + _COUNT_BYTES + len(value.encode()) + 1
                continue
            size = _announced_bytes(end, layout.nested[field.type], value)
            alignment = min(size, _COUNT_BYTES) if is_list else 1
            end += ((alignment - end % alignment) & (alignment - 1)) + size
    return end - begin
