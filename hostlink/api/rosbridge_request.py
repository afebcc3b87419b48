"""Requests of rosbridge: checked fields, messages sent in fragments, and times that the server fills in."""

import functools
import math
import reprlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from hostlink.errors import BadRequest
from hostlink.hub.byte_budget import Share
from hostlink.messages.fields import SCALAR
from hostlink.messages.message_type import MessageType

MAX_TEXT = 1024  # characters of a name or an id; the longest that roslib makes is a name and 50 more


class Request:
    """A JSON object with an `op`. Its methods raise a BadRequest that names a wrong field."""

    def __init__(self, fields: dict[str, Any], size_bytes: int = 0) -> None:
        """`size_bytes`: of the message that it was."""
        self.fields, self.size_bytes = fields, size_bytes
        self.came_s: float | None = None  # when it came, at the earliest; None: now
        self.replaced: list[Request] = []  # velocities in the place of which it is done
        op = fields["op"]
        if not isinstance(op, str) or not op:
            raise BadRequest(f"{reprlib.repr(op)}: op must be a text")
        self.op = op

    @classmethod
    def read(cls, text: str | bytes) -> "Request":
        """Decode one message of a client.

        Raises:
            BadRequest: it is no JSON, or no object with an `op`.
        """
        try:
            fields = msgspec.json.decode(text)
        except (msgspec.DecodeError, UnicodeError) as error:
            raise BadRequest(f"no JSON: {error}") from None
        except RecursionError:
            raise BadRequest("no JSON: nested too deeply") from None
        if not isinstance(fields, dict) or "op" not in fields:
            raise BadRequest('a message is a JSON object with an "op"')
        return cls(fields, len(text))

    @property
    def id(self) -> object:
        """As the client wrote it; None: it has none.

        Raises:
            BadRequest: it is neither a number nor a short text.
        """
        found = self.fields.get("id")
        if isinstance(found, list | dict) or (isinstance(found, str) and len(found) > MAX_TEXT):
            raise BadRequest(f"{self.op}: id must be a number, or a text of at most {MAX_TEXT} characters")
        return found

    def text(self, key: str) -> str:
        """A text that must be there.

        Raises:
            BadRequest: it is missing, no text, or too long.
        """
        value = self.fields.get(key)
        if not isinstance(value, str) or not value:
            raise BadRequest(f"{self.op}: {key} must be a text")
        if len(value) > MAX_TEXT:
            raise BadRequest(f"{self.op}: {key} is longer than {MAX_TEXT} characters")
        return value

    def text_or(self, key: str, default: str) -> str:
        """A text; `default` where it is missing, empty or null.

        Raises:
            BadRequest: it is no text, or too long.
        """
        return self.text(key) if self.fields.get(key) else default

    def number_or(self, key: str, default: float) -> float:
        """A number, not negative; `default` where it is missing or null.

        Raises:
            BadRequest: it is no such number.
        """
        value = self.fields.get(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise BadRequest(f"{self.op}: {key} must be a number, not negative")
        return float(min(value, 2**53))  # a whole number may be too large for a float

    def whole(self, key: str, default: int, largest: int) -> int:
        """A whole number from 0 to `largest`.

        Raises:
            BadRequest: it is none.
        """
        value = self.fields.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= largest:
            raise BadRequest(f"{self.op}: {key} must be a number from 0 to {largest}")
        return value

    def table(self, key: str) -> dict[str, Any]:
        """An object; an empty one where it is missing.

        Raises:
            BadRequest: it is no object.
        """
        value = self.fields.get(key, {})
        if not isinstance(value, dict):
            raise BadRequest(f"{self.op}: {key} must be an object")
        return value

    def is_set(self, key: str) -> bool:
        """Whether a switch is on."""
        return self.fields.get(key) is True


MAX_PENDING = 4  # messages of a client that are not whole yet
MAX_PIECES = 1024  # of one message
TIMEOUT_S = 60.0  # since the last piece; whoever sends a message sends all of it


@dataclass(slots=True)
class _Pending:
    total: int
    fed_at_s: float
    pieces: dict[int, str] = field(default_factory=dict)


class Fragments:
    """The pieces of one client, by the id of their message. All of them together are no larger than one message."""

    def __init__(self, max_bytes: int, share: Share) -> None:
        """`share`: of all clients together."""
        self._max_bytes, self._share = max_bytes, share
        self._bytes = 0
        self._pending: dict[object, _Pending] = {}

    def add(self, key: object, *, number: int, total: int, data: str, now_s: float) -> str | None:
        """The whole message with its last piece; BadRequest for a piece that cannot be, and its message is dropped."""
        self._expire(now_s)
        pending = self._pending.get(key)
        if pending is None:
            if len(self._pending) >= MAX_PENDING:
                raise BadRequest(f"fragment: more than {MAX_PENDING} messages in pieces")
            pending = self._pending[key] = _Pending(total, now_s)
        problem = self._problem(pending, number, total, data)
        if problem:
            self._drop(key)
            raise BadRequest(f"fragment: {problem}; the message is dropped")
        size = _size(data)
        if not self._share.take(size):
            self._drop(key)
            raise BadRequest(
                f"fragment: all clients together have {self._share.max_bytes} bytes in pieces; send it later"
            )
        pending.pieces[number] = data
        pending.fed_at_s = now_s
        self._bytes += size
        if len(pending.pieces) < total:
            return None
        self._drop(key)
        return "".join(pending.pieces[index] for index in range(total))

    def close(self) -> None:
        """The client has left: nothing is kept of it."""
        for key in list(self._pending):
            self._drop(key)

    def _problem(self, pending: _Pending, number: int, total: int, data: str) -> str:
        if not 1 <= total <= MAX_PIECES:
            return f"total must be from 1 to {MAX_PIECES}"
        if total != pending.total:
            return f"total was {pending.total} and is {total}"
        if not 0 <= number < total:
            return f"num must be from 0 to {total - 1}"
        if number in pending.pieces:
            return f"piece {number} is there twice"
        if self._bytes + _size(data) > self._max_bytes:
            return f"more than {self._max_bytes} bytes in pieces"
        return ""

    def _expire(self, now_s: float) -> None:
        for key in [key for key, pending in self._pending.items() if now_s >= pending.fed_at_s + TIMEOUT_S]:
            self._drop(key)

    def _drop(self, key: object) -> None:
        size = sum(map(_size, self._pending.pop(key).pieces.values()))
        self._bytes -= size
        self._share.give(size)


def _size(data: str) -> int:
    return len(data.encode("utf-8", "surrogatepass"))


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
        for each in type_.fields:
            nested = type_.nested.get(each.type)
            if each.type == "time":
                if each.name in filled:
                    filled[each.name] = _each(filled[each.name], self._time)
            elif nested is not None and nested.has_time and (each.name in filled or each.array_length == SCALAR):
                part = filled.get(each.name, {})
                filled[each.name] = _each(part, functools.partial(self._nested, nested))
        return filled

    def _time(self, value: Any) -> Any:
        return self._now if value == "now" else value

    def _nested(self, type_: MessageType, value: Any) -> Any:
        return self.fill(type_, value) if isinstance(value, dict) else value


def _each(value: Any, fill: Callable[[Any], Any]) -> Any:
    return [fill(item) for item in value] if isinstance(value, list) else fill(value)


def _is_zero(stamp: object) -> bool:
    return stamp is None or (isinstance(stamp, dict) and not any(stamp.values()))
