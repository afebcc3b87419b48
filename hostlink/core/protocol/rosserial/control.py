"""Payloads of rosserial's control frames: TopicInfo, Parameter, Log, Time.

`decode_*` returns None for a malformed payload and raises nothing.
"""

import sys
from collections.abc import Callable
from functools import partial
from struct import Struct
from typing import Any, NamedTuple, TypeVar

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import LOG_LEVELS, Parameter
from hostlink.core.runtime.units import NS_PER_S

_U32 = Struct("<I")
_I32 = Struct("<i")
_TIME = Struct("<II")
_TOPIC_ID = Struct("<H")
_MAX_NAME_BYTES = 255

Item = TypeVar("Item")


class Log(NamedTuple):
    """Log line of the device's program; `level` indexes LOG_LEVELS."""

    level: int
    text: str


def encode_topic_info(info: DeviceEndpoint) -> bytes:
    """Encode the payload of a TopicInfo frame."""
    strings = b"".join(_encode_string(text) for text in (info.name, info.type, info.md5))
    return _TOPIC_ID.pack(info.id) + strings + _I32.pack(info.buffer_bytes)


def decode_topic_info(kind: EndpointKind, payload: bytes) -> DeviceEndpoint | None:
    """Decode a TopicInfo; None if it is malformed or if a name, type or md5 is empty, too long or unprintable."""
    return _decode(payload, partial(_read_topic_info, kind))


def _read_topic_info(kind: EndpointKind, reader: "_PayloadReader") -> DeviceEndpoint:
    (topic_id,) = reader.unpack(_TOPIC_ID)
    name, type_name, md5 = (_word(reader.string()) for _ in range(3))
    (buffer_bytes,) = reader.unpack(_I32)
    # A thousand robots keep the same few types once.
    return DeviceEndpoint(kind, topic_id, name, sys.intern(type_name), sys.intern(md5), buffer_bytes)


def decode_parameter_request(payload: bytes) -> str | None:
    """Decode the name of the parameter that the device requests; None if malformed."""
    return _decode(payload, lambda reader: reader.string().decode(errors="replace"))


def encode_parameter(parameter: Parameter) -> bytes:
    """Encode the payload of the answer to a parameter request."""
    ints = Struct(f"<I{len(parameter.ints)}i").pack(len(parameter.ints), *parameter.ints)
    floats = Struct(f"<I{len(parameter.floats)}f").pack(len(parameter.floats), *parameter.floats)
    strings = b"".join(_encode_string(text) for text in parameter.strings)
    return ints + floats + _U32.pack(len(parameter.strings)) + strings


def decode_parameter(payload: bytes) -> Parameter | None:
    """Decode the answer to a parameter request, as a device does; None if malformed."""
    return _decode(payload, _read_parameter)


def _read_parameter(reader: "_PayloadReader") -> Parameter:
    ints = reader.unpack(Struct(f"<{reader.count(4)}i"))
    floats = reader.unpack(Struct(f"<{reader.count(4)}f"))
    strings = tuple(reader.string().decode(errors="replace") for _ in range(reader.count(4)))
    return Parameter(ints, floats, strings)


def decode_log(payload: bytes) -> Log | None:
    """Decode a log line; None if malformed. A level above fatal is read as fatal."""
    return _decode(payload, _read_log)


def _read_log(reader: "_PayloadReader") -> Log:
    level = reader.read(1)[0]
    return Log(min(level, len(LOG_LEVELS) - 1), reader.string().decode(errors="replace"))


def encode_time(wall_ns: int) -> bytes:
    """Encode a time answer: seconds and nanoseconds since 1970."""
    seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
    return _TIME.pack(seconds & 0xFFFFFFFF, nanoseconds)


class _PayloadReader:
    """Sequential reader of one payload.

    Raises:
        ValueError: the payload ends before the value.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload, self._at = payload, 0

    def read(self, size: int) -> bytes:
        data = self._payload[self._at : self._at + size]
        if len(data) != size:
            raise ValueError("the payload ends early")
        self._at += size
        return data

    def unpack(self, layout: Struct) -> tuple[Any, ...]:
        return layout.unpack(self.read(layout.size))

    def count(self, item_bytes: int) -> int:
        """Read a length field. Reject a count whose items would exceed the rest of the payload."""
        count: int = self.unpack(_U32)[0]
        if count * item_bytes > len(self._payload) - self._at:
            raise ValueError("a count larger than the payload")
        return count

    def string(self) -> bytes:
        return self.read(self.count(1))

    def expect_end(self) -> None:
        if self._at != len(self._payload):
            raise ValueError("bytes after the end")


def _decode(payload: bytes, read: Callable[[_PayloadReader], Item]) -> Item | None:
    reader = _PayloadReader(payload)
    try:
        item = read(reader)
        reader.expect_end()
    except ValueError:
        return None
    return item


def _encode_string(text: str) -> bytes:
    data = text.encode()
    return _U32.pack(len(data)) + data


def _word(data: bytes) -> str:
    """Decode a name, type or md5: printable ASCII without spaces."""
    text = data.decode("ascii")
    if not text or len(text) > _MAX_NAME_BYTES or not text.isprintable() or " " in text:
        raise ValueError("not a name")
    return text
