"""The times that rosbridge fills in: "now" for a time, and the present for a header's stamp that is missing or zero."""

from typing import Any

from hostlink.messages.fields import SCALAR
from hostlink.messages.message_type import MessageType

HEADER = "std_msgs/Header"
_NS_PER_S = 1_000_000_000


def fill_stamps(type_: MessageType, message: dict[str, Any], now_ns: int) -> dict[str, Any]:
    """The message with its times filled in; what does not fit the type is left for the codec to refuse."""
    return _filled(type_, message, to_time(now_ns)) if type_.has_time else message


def to_time(stamp_ns: int) -> dict[str, int]:
    """As a message has it."""
    secs, nsecs = divmod(stamp_ns, _NS_PER_S)
    return {"secs": secs, "nsecs": nsecs}


def _filled(type_: MessageType, message: dict[str, Any], now: dict[str, int]) -> dict[str, Any]:
    filled = dict(message)
    if type_.name == HEADER:
        filled = {name: value for name, value in message.items() if value is not None}  # as roslibpy leaves fields out
        if _is_zero(filled.get("stamp")):
            filled["stamp"] = now
    for field in type_.fields:
        nested = type_.nested.get(field.type)
        if field.type == "time":
            if field.name in filled:
                filled[field.name] = _each(filled[field.name], lambda value: now if value == "now" else value)
        elif nested is not None and nested.has_time and (field.name in filled or field.array_length == SCALAR):
            filled[field.name] = _each(
                filled.get(field.name, {}), lambda value, type_=nested: _nested(type_, value, now)
            )
    return filled


def _nested(type_: MessageType, value: Any, now: dict[str, int]) -> Any:
    return _filled(type_, value, now) if isinstance(value, dict) else value


def _each(value: Any, fill: Any) -> Any:
    return [fill(item) for item in value] if isinstance(value, list) else fill(value)


def _is_zero(stamp: object) -> bool:
    return stamp is None or (isinstance(stamp, dict) and not any(stamp.values()))
