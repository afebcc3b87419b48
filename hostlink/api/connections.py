"""Connections: who is connected to the API's port, how long each may wait, and which one is evicted. Pure."""

from collections import Counter
from dataclasses import dataclass

IDLE_TIMEOUT_S = 75.0  # after an answer, as nginx: browsers and proxies keep connections for their next request
KEPT_FOR_REQUESTS = 16  # connections that no WebSocket or event stream may use: a stop needs one of them


@dataclass(slots=True)
class Connection:
    """One TCP connection."""

    number: int
    address: str
    deadline_s: float = 0.0  # of one that waits


class Connections:
    """A connection waits while no request of it is being answered: before the first, between two, in a handshake.

    | a connection comes          | what happens                                                                       |
    |-----------------------------|------------------------------------------------------------------------------------|
    | over the bound of its       | of those of its address that wait, the one that waits longest is evicted;          |
    | address                     | if none waits it is refused: too_many_of_address                                   |
    | over the bound of all       | of those that wait, the one that waits longest, of the address that has most of    |
    |                             | them, is evicted; if none waits it is refused: too_many                            |

    So half a request occupies nothing for long, and a whole one is always served.
    """

    def __init__(self, max_connections: int, max_per_address: int, *, request_timeout_s: float) -> None:
        """`request_timeout_s`: from the connection to the end of the first request's head, a TLS handshake included."""
        self.request_timeout_s = request_timeout_s
        self.closed: Counter[str] = Counter()  # by hostlink: by cause
        self._max, self._max_per_address = max_connections, max_per_address
        self._last_number = 0
        self._all: dict[int, Connection] = {}
        self._waiting: dict[int, Connection] = {}  # longest first

    def __len__(self) -> int:
        return len(self._all)

    def enter(self, address: str, now_s: float) -> tuple[Connection | None, Connection | None]:
        """(the new connection, or None: it is refused; the evicted one, or None)."""
        mine = sum(each.address == address for each in self._all.values())
        leaving = None
        if mine >= self._max_per_address:
            leaving = self._longest_waiting(address)
            if leaving is None:
                return self._refuse("too_many_of_address")
        elif len(self._all) >= self._max:
            leaving = self._longest_waiting(None)
            if leaving is None:
                return self._refuse("too_many")
        if leaving is not None:
            self.closed["evicted"] += 1
            self.leave(leaving)
        self._last_number += 1
        new = self._all[self._last_number] = Connection(self._last_number, address)
        self._wait_until(new, now_s + self.request_timeout_s)
        return new, leaving

    def serve(self, connection: Connection) -> None:
        """A whole request came."""
        self._waiting.pop(connection.number, None)

    def wait(self, connection: Connection, now_s: float) -> None:
        """The request is answered."""
        if connection.number in self._all:
            self._wait_until(connection, now_s + IDLE_TIMEOUT_S)

    def leave(self, connection: Connection) -> None:
        """It is closed; once is enough."""
        self._all.pop(connection.number, None)
        self._waiting.pop(connection.number, None)

    def overdue(self, now_s: float) -> list[Connection]:
        """Those that have waited too long; they are no longer among the others."""
        found = [each for each in self._waiting.values() if each.deadline_s <= now_s]
        for each in found:
            self.closed["timeout"] += 1
            self.leave(each)
        return found

    def _wait_until(self, connection: Connection, deadline_s: float) -> None:
        connection.deadline_s = deadline_s
        self._waiting.pop(connection.number, None)
        self._waiting[connection.number] = connection

    def _longest_waiting(self, address: str | None) -> Connection | None:
        if address is None:
            counts = Counter(each.address for each in self._waiting.values())
            return max(self._waiting.values(), key=lambda each: counts[each.address], default=None)  # first of equals
        return next((each for each in self._waiting.values() if each.address == address), None)

    def _refuse(self, cause: str) -> tuple[None, None]:
        self.closed[cause] += 1
        return None, None
