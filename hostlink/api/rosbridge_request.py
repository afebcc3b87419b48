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

MAX_TEXT = 1024  # characters of a name or an id; roslib's longest ids are a name and 50 more


class Request:
    """A JSON object with an `op`. Methods raise a BadRequest that names the invalid field."""

    def __init__(self, fields: dict[str, Any], size_bytes: int = 0) -> None:
        """Check `op`. `size_bytes`: size of the message."""
        self.fields, self.size_bytes = fields, size_bytes
        self.came_s: float | None = None  # earliest time of arrival; None: now
        self.replaced: list[Request] = []  # velocities that this one replaces
        op = fields["op"]
        if not isinstance(op, str) or not op:
            raise BadRequest(f"{reprlib.repr(op)}: op must be a text")
        self.op = op

    @classmethod
    def read(cls, text: str | bytes) -> "Request":
        """Decode one message of a client.

        Raises:
            BadRequest: the text is not JSON, or not an object with an `op`.
        """
        try:
            fields = msgspec.json.decode(text)
        except (msgspec.DecodeError, UnicodeError) as error:
            raise BadRequest(f"invalid JSON: {error}") from None
        except RecursionError:
            raise BadRequest("invalid JSON: nested too deeply") from None
        if not isinstance(fields, dict) or "op" not in fields:
            raise BadRequest('a message is a JSON object with an "op"')
        return cls(fields, len(text))

    @property
    def id(self) -> object:
        """Return the id as the client wrote it; None without an id.

        Raises:
            BadRequest: the id is neither a number nor a short text.
        """
        found = self.fields.get("id")
        if isinstance(found, list | dict) or (isinstance(found, str) and len(found) > MAX_TEXT):
            raise BadRequest(f"{self.op}: id must be a number, or a text of at most {MAX_TEXT} characters")
        return found

    def text(self, key: str) -> str:
        """Return a required text.

        Raises:
            BadRequest: the field is missing, not a text, or too long.
        """
        value = self.fields.get(key)
        if not isinstance(value, str) or not value:
            raise BadRequest(f"{self.op}: {key} must be a text")
        if len(value) > MAX_TEXT:
            raise BadRequest(f"{self.op}: {key} is longer than {MAX_TEXT} characters")
        return value

    def text_or(self, key: str, default: str) -> str:
        """Return a text; `default` if it is missing, empty or null.

        Raises:
            BadRequest: the field is not a text, or too long.
        """
        return self.text(key) if self.fields.get(key) else default

    def number_or(self, key: str, default: float) -> float:
        """Return a number of 0 or more; `default` if it is missing or null.

        Raises:
            BadRequest: the field is not such a number.
        """
        value = self.fields.get(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise BadRequest(f"{self.op}: {key} must be a number of 0 or more")
        return float(min(value, 2**53))  # an integer may be too large for a float

    def whole(self, key: str, default: int, largest: int) -> int:
        """Return an integer from 0 to `largest`.

        Raises:
            BadRequest: the field is not such an integer.
        """
        value = self.fields.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= largest:
            raise BadRequest(f"{self.op}: {key} must be an integer from 0 to {largest}")
        return value

    def table(self, key: str) -> dict[str, Any]:
        """Return an object; an empty one if the field is missing.

        Raises:
            BadRequest: the field is not an object.
        """
        value = self.fields.get(key, {})
        if not isinstance(value, dict):
            raise BadRequest(f"{self.op}: {key} must be an object")
        return value

    def is_set(self, key: str) -> bool:
        """Whether a field is true."""
        return self.fields.get(key) is True


MAX_PENDING = 4  # incomplete messages of one client
MAX_PIECES = 1024  # fragments of one message
TIMEOUT_S = 60.0  # since the last fragment of a message


@dataclass(slots=True)
class _Pending:
    total: int
    fed_at_s: float
    pieces: dict[int, str] = field(default_factory=dict)


class Fragments:
    """Incomplete messages of one client by id. Together they are at most as large as one message."""

    def __init__(self, max_bytes: int, share: Share) -> None:
        """Create the store of one client. `share`: byte budget of all clients."""
        self._max_bytes, self._share = max_bytes, share
        self._bytes = 0
        self._pending: dict[object, _Pending] = {}

    def add(self, key: object, *, number: int, total: int, data: str, now_s: float) -> str | None:
        """Add a fragment. Return the whole message with its last one.

        Raises:
            BadRequest: the fragment is invalid or has no room; its message is dropped.
        """
        self._expire(now_s)
        pending = self._pending.get(key)
        if pending is None:
            if len(self._pending) >= MAX_PENDING:
                raise BadRequest(f"fragment: more than {MAX_PENDING} messages are incomplete")
            pending = self._pending[key] = _Pending(total, now_s)
        problem = self._problem(pending, number, total, data)
        if problem:
            self._drop(key)
            raise BadRequest(f"fragment: {problem}; the message is dropped")
        size = _size(data)
        if not self._share.take(size):
            self._drop(key)
            raise BadRequest(
                f"fragment: all clients together have {self._share.max_bytes} bytes of fragments; send it later"
            )
        pending.pieces[number] = data
        pending.fed_at_s = now_s
        self._bytes += size
        if len(pending.pieces) < total:
            return None
        self._drop(key)
        return "".join(pending.pieces[index] for index in range(total))

    def close(self) -> None:
        """Drop everything: the client has disconnected."""
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
            return f"fragment {number} was sent twice"
        if self._bytes + _size(data) > self._max_bytes:
            return f"more than {self._max_bytes} bytes of fragments"
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
MAX_PARTS = 2000  # about 15 ms; a path of a small robot has a few hundred poses
_NS_PER_S = 1_000_000_000


def fill_stamps(type_: MessageType, message: dict[str, Any], now_ns: int) -> dict[str, Any]:
    """Return the message with its times filled in. Values that do not fit the type are left to the codec.

    Raises:
        BadRequest: more than MAX_PARTS parts have times; walking through them would delay commands.
    """
    return _Filler(to_time(now_ns)).fill(type_, message) if type_.has_time else message


def to_time(stamp_ns: int) -> dict[str, int]:
    """Return a time as a message has it."""
    secs, nsecs = divmod(stamp_ns, _NS_PER_S)
    return {"secs": secs, "nsecs": nsecs}


class _Filler:
    """Fills in the times of one message, part by part."""

    def __init__(self, now: dict[str, int]) -> None:
        self._now = now
        self._parts = 0

    def fill(self, type_: MessageType, message: dict[str, Any]) -> dict[str, Any]:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise BadRequest(f"more than {MAX_PARTS} parts with times: fill in the times, or send several messages")
        filled = dict(message)
        if type_.name == HEADER:
            filled = {name: value for name, value in message.items() if value is not None}  # roslibpy's unset
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
