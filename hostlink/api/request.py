"""Request: one operation that a client of rosbridge sent, with its fields checked as they are read."""

import math
import reprlib
from typing import Any

import msgspec

from hostlink.errors import BadRequest

MAX_TEXT = 1024  # characters of a name or an id; the longest that roslib makes is a name and 50 more


class Request:
    """A JSON object with an `op`. Its methods raise a BadRequest that names a wrong field."""

    def __init__(self, fields: dict[str, Any], size_bytes: int = 0) -> None:
        """`size_bytes`: of the message that it was."""
        self.fields, self.size_bytes = fields, size_bytes
        self.came_s: float | None = None  # when it came, at the earliest; None: now
        self.replaced: list[Request] = []  # velocities in the place of which it is done
        self.op: str = self._operation()

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

    def _operation(self) -> str:
        value = self.fields["op"]
        if not isinstance(value, str) or not value:
            raise BadRequest(f"{reprlib.repr(value)}: op must be a text")
        return value
