"""Fragments: messages that a client of rosbridge sends in pieces, put together again within bounds."""

from dataclasses import dataclass, field

from hostlink.errors import BadRequest
from hostlink.hub.byte_budget import Share

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
