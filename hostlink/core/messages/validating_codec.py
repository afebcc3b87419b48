"""Slow codec: accepts missing fields and uncommon values, and names what is wrong with bad ones.

It accepts everything that the compiled codec accepts, with the same result.
"""

import base64
import math
import reprlib
import struct
from collections.abc import Iterable, Mapping
from typing import Final, NoReturn

from hostlink.core.messages.fields import (
    COUNT_BYTES,
    DURATION,
    EMPTY_ELEMENTS_MAX,
    ENCODED_BYTES_MAX,
    FLOATS,
    FORMATS,
    SCALAR,
    SIZES,
    TIME,
    VARIABLE,
    Field,
    Layout,
    range_text,
)
from hostlink.errors import BadPayload, BadRequest

UNFIT: Final = (struct.error, OverflowError, TypeError, ValueError)  # what struct raises for unsuitable values
ROS2_TIME: Final = {"sec": "secs", "nanosec": "nsecs"}


def encode(layout: Layout, message: object) -> bytes:
    """Encode a message. Missing fields are zero.

    Raises:
        BadRequest: a field is unknown or has a wrong value; the first one is named by its path.
    """
    return _encode_message(layout, message, layout.name)


def decode(layout: Layout, payload: bytes) -> dict[str, object]:
    """Decode a whole payload to a dict.

    Raises:
        BadPayload: the payload ends before a field, or continues after the last one.
    """
    reader = _Reader(layout.name, payload)
    message = reader.read_message(layout, "")
    if reader.offset != len(payload):
        raise BadPayload(layout.name, f"the message ends after {reader.offset} bytes, the payload has {len(payload)}")
    return message


def _encode_message(layout: Layout, message: object, path: str) -> bytes:
    if not isinstance(message, Mapping):
        _refuse(path, "an object with fields", message)
    if layout in (TIME, DURATION) and message.keys() <= ROS2_TIME.keys():
        message = {ROS2_TIME[name]: value for name, value in message.items()}
    known = [field.name for field in layout.fields]
    for name in message:
        if name not in known:
            raise BadRequest(f"{path} has no field {reprlib.repr(name)}; its fields: {', '.join(known) or 'none'}")
    return _joined(
        path,
        (
            _encode_field(layout, field, message[field.name], f"{path}.{field.name}")
            if field.name in message
            else bytes(layout.field_minimum_bytes(field))
            for field in layout.fields
        ),
    )


def _encode_field(layout: Layout, field: Field, value: object, path: str) -> bytes:
    if field.array_length == SCALAR:
        return _encode_one(layout, field, value, path)
    elements = _octets(value, path) if field.is_octets else _elements(value, path)
    count = b""
    if field.array_length == VARIABLE:
        is_empty = layout.element_minimum_bytes(field) == 0
        if is_empty and len(elements) > EMPTY_ELEMENTS_MAX:
            raise BadRequest(f"{path}: at most {EMPTY_ELEMENTS_MAX} elements without fields, got {len(elements)}")
        count = struct.pack("<I", len(elements))
    elif len(elements) != field.array_length:
        raise BadRequest(f"{path}: wanted {field.array_length} elements, got {len(elements)}")
    if isinstance(elements, bytes):
        return count + elements
    if field.type in FORMATS and field.type != "bool":
        return count + _numbers(field.type, elements, path)
    check_size(len(elements) * layout.element_minimum_bytes(field), path)  # before any element is encoded
    encoded = (_encode_one(layout, field, element, f"{path}[{index}]") for index, element in enumerate(elements))
    return count + _joined(path, encoded)


def check_size(size_bytes: int, path: str) -> None:
    """Check the size of an encoded message.

    Raises:
        BadRequest: the message is larger than ENCODED_BYTES_MAX.
    """
    if size_bytes > ENCODED_BYTES_MAX:
        raise BadRequest(f"{path}: more than {ENCODED_BYTES_MAX} bytes")


def _joined(path: str, parts: Iterable[bytes]) -> bytes:
    """Join the parts and check the size after each: a short request may mean a long message of zeros."""
    joined = bytearray()
    for part in parts:
        joined += part
        check_size(len(joined), path)
    return bytes(joined)


def _encode_one(layout: Layout, field: Field, value: object, path: str) -> bytes:
    if field.type == "string":
        text = _text(value, path)
        return struct.pack("<I", len(text)) + text
    if field.type == "bool":
        if not isinstance(value, int) or value not in (0, 1):
            _refuse(path, "true or false", value)
        return bytes([value])
    if field.type in FORMATS:
        return _number(field.type, value, path)
    return _encode_message(layout.nested[field.type], value, path)


def _numbers(type_name: str, values: list[object], path: str) -> bytes:
    try:
        if bool in map(type, values):
            raise TypeError  # struct would pack it as a number
        return struct.pack(f"<{len(values)}{FORMATS[type_name]}", *values)
    except UNFIT:
        return b"".join(_number(type_name, value, f"{path}[{index}]") for index, value in enumerate(values))


def _number(type_name: str, value: object, path: str) -> bytes:
    if value is None and type_name in FLOATS:  # JSON has no NaN
        value = math.nan
    if isinstance(value, bool):  # `true` in a velocity would drive at 1 m/s
        _refuse(path, "a number" if type_name in FLOATS else "a whole number", value)
    try:
        return struct.pack(f"<{FORMATS[type_name]}", value)
    except UNFIT:
        if type_name in FLOATS and isinstance(value, int | float):
            raise BadRequest(f"{path}: {reprlib.repr(value)} is too large for a {type_name}") from None
        if type_name not in FLOATS and isinstance(value, int):
            raise BadRequest(f"{path}: {reprlib.repr(value)} is outside {range_text(type_name)}") from None
        _refuse(path, "a number" if type_name in FLOATS else "a whole number", value)


def _text(value: object, path: str) -> bytes:
    if not isinstance(value, str):
        _refuse(path, "text", value)
    try:
        return value.encode()
    except UnicodeEncodeError as error:
        raise BadRequest(f"{path}: half a surrogate pair at character {error.start}") from None


def _elements(value: object, path: str) -> list[object]:
    """Return the elements of a list, a tuple or a numpy array."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        _refuse(path, "a list", value)
    return list(value)


def _octets(value: object, path: str) -> bytes:
    """Convert bytes, base64 or a list of numbers to bytes."""
    if isinstance(value, bytes | bytearray):
        return bytes(value)
    if isinstance(value, str):
        try:
            return base64.b64decode(value, validate=True)
        except ValueError:
            _refuse(path, "base64", value)
    return _numbers("uint8", _elements(value, path), path)


def _refuse(path: str, wanted: str, value: object) -> NoReturn:
    raise BadRequest(f"{path}: wanted {wanted}, got {reprlib.repr(value)}")


class _Reader:
    """Sequential reader of one payload."""

    def __init__(self, type_name: str, payload: bytes) -> None:
        self.offset = 0
        self._type_name = type_name
        self._payload = payload

    @property
    def _left_bytes(self) -> int:
        return len(self._payload) - self.offset

    def read_message(self, layout: Layout, path: str) -> dict[str, object]:
        return {field.name: self._read_field(layout, field, f"{path}{field.name}") for field in layout.fields}

    def _read_field(self, layout: Layout, field: Field, path: str) -> object:
        if field.array_length == SCALAR:
            return self._read_one(layout, field, path)
        count = field.array_length
        if count == VARIABLE:
            count = self._read_count(path, layout.element_minimum_bytes(field))
        if field.is_octets:
            return self._read_bytes(count, path)
        if field.type in FORMATS and count * SIZES[field.type] <= self._left_bytes:
            data = self._read_bytes(count * SIZES[field.type], path)
            return list(struct.unpack(f"<{count}{FORMATS[field.type]}", data))
        return [self._read_one(layout, field, f"{path}[{index}]") for index in range(count)]

    def _read_one(self, layout: Layout, field: Field, path: str) -> object:
        if field.type == "string":
            return self._read_bytes(self._read_count(path, 1), path).decode("utf-8", "replace")
        if field.type in FORMATS:
            return struct.unpack(f"<{FORMATS[field.type]}", self._read_bytes(SIZES[field.type], path))[0]
        return self.read_message(layout.nested[field.type], f"{path}.")

    def _read_count(self, path: str, element_bytes: int) -> int:
        count = int.from_bytes(self._read_bytes(COUNT_BYTES, path), "little")
        if count * element_bytes > self._left_bytes:
            size = f"{count} elements of at least {element_bytes} bytes" if element_bytes > 1 else f"{count} bytes"
            self._refuse(f"{path}: {size} announced, {self._left_bytes} left")
        if not element_bytes and count > EMPTY_ELEMENTS_MAX:
            self._refuse(f"{path}: {count} elements without fields, at most {EMPTY_ELEMENTS_MAX} are accepted")
        return count

    def _read_bytes(self, size: int, path: str) -> bytes:
        data = self._payload[self.offset : self.offset + size]
        if len(data) < size:
            self._refuse(f"{path}: needs {size} bytes at {self.offset}, {len(data)} left")
        self.offset += size
        return data

    def _refuse(self, problem: str) -> NoReturn:
        raise BadPayload(self._type_name, problem)
