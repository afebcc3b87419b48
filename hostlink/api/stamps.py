"""The times that rosbridge fills in: "now" for a time, and the present for a header's stamp that is missing or zero."""

import functools
from collections.abc import Callable
from typing import Any

from hostlink.errors import BadRequest
from hostlink.messages.fields import SCALAR
from hostlink.messages.message_type import MessageType

HEADER = "std_msgs/Header"
MAX_PARTS = 2000  # some 15 ms; a path of a small robot has a few hundred poses
_NS_PER_S = 1_000_000_000


def fill_stamps(type_: MessageType, message: dict[str, Any], now_ns: int) -> dict[str, Any]:
    """The message with its times filled in; what does not fit the type is left for the codec to refuse.

    Raises:
        BadRequest: it has more parts with times in them than MAX_PARTS; to walk them all would keep robots waiting.
    """
    return _Filler(to_time(now_ns)).fill(type_, message) if type_.has_time else message


def to_time(stamp_ns: int) -> dict[str, int]:
    """As a message has it."""
    secs, nsecs = divmod(stamp_ns, _NS_PER_S)
    return {"secs": secs, "nsecs": nsecs}


class _Filler:
    """Fills one message, part by part."""

    def __init__(self, now: dict[str, int]) -> None:
        self._now = now
        self._parts = 0

    def fill(self, type_: MessageType, message: dict[str, Any]) -> dict[str, Any]:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise BadRequest(f"more than {MAX_PARTS} parts with times: fill in the times, or send it in pieces")
        filled = dict(message)
        if type_.name == HEADER:
            filled = {name: value for name, value in message.items() if value is not None}  # roslibpy leaves fields out
            if _is_zero(filled.get("stamp")):
                filled["stamp"] = self._now
        for field in type_.fields:
            nested = type_.nested.get(field.type)
            if field.type == "time":
                if field.name in filled:
                    filled[field.name] = _each(filled[field.name], self._time)
            elif nested is not None and nested.has_time and (field.name in filled or field.array_length == SCALAR):
                part = filled.get(field.name, {})
                filled[field.name] = _each(part, functools.partial(self._nested, nested))
        return filled

    def _time(self, value: Any) -> Any:
        return self._now if value == "now" else value

    def _nested(self, type_: MessageType, value: Any) -> Any:
        return self.fill(type_, value) if isinstance(value, dict) else value


def _each(value: Any, fill: Callable[[Any], Any]) -> Any:
    return [fill(item) for item in value] if isinstance(value, list) else fill(value)


def _is_zero(stamp: object) -> bool:
    return stamp is None or (isinstance(stamp, dict) and not any(stamp.values()))
