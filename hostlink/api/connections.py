"""Connections: TCP connections to the API's port, their timeouts, and which is evicted when they are too many. Pure."""

from collections import Counter
from dataclasses import dataclass

IDLE_TIMEOUT_S = 75.0  # after an answer, as in nginx: browsers and proxies reuse connections
KEPT_FOR_REQUESTS = 16  # connections reserved for requests, not for WebSockets and event streams: a stop needs one


@dataclass(slots=True)
class Connection:
    """One TCP connection."""

    number: int
    address: str
    deadline_s: float = 0.0  # of a waiting connection


class Connections:
    """All connections. One waits while no request of it is being answered: before, between requests, in a handshake.

    | a new connection exceeds    | what happens                                                                       |
    |-----------------------------|------------------------------------------------------------------------------------|
    | the bound of its address    | the connection of this address that has waited longest is evicted;                 |
    |                             | if none waits, the new one is refused: too_many_of_address                         |
    | the bound of all addresses  | of the address with most waiting connections, the one that has waited longest is   |
    |                             | evicted; if none waits, the new one is refused: too_many                           |

    So an incomplete request holds a connection only for a short time, and a complete one is always answered.
    """

    def __init__(self, max_connections: int, max_per_address: int, *, request_timeout_s: float) -> None:
        """Create an empty table. `request_timeout_s`: from accepting to the end of the first head, TLS included."""
        self.request_timeout_s = request_timeout_s
        self.closed: Counter[str] = Counter()  # closed by hostlink, by cause
        self._max, self._max_per_address = max_connections, max_per_address
        self._last_number = 0
        self._all: dict[int, Connection] = {}
        self._waiting: dict[int, Connection] = {}  # longest first

    def __len__(self) -> int:
        return len(self._all)

    def enter(self, address: str, now_s: float) -> tuple[Connection | None, Connection | None]:
        """Add a connection. Return it (None: refused), and the connection that is evicted for it (None: none)."""
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
        """Note that a complete request is being answered."""
        self._waiting.pop(connection.number, None)

    def wait(self, connection: Connection, now_s: float) -> None:
        """Note that the request is answered."""
        if connection.number in self._all:
            self._wait_until(connection, now_s + IDLE_TIMEOUT_S)

    def leave(self, connection: Connection) -> None:
        """Remove a closed connection. An unknown one is ignored."""
        self._all.pop(connection.number, None)
        self._waiting.pop(connection.number, None)

    def overdue(self, now_s: float) -> list[Connection]:
        """Remove and return the connections whose timeout has passed."""
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
            return max(self._waiting.values(), key=lambda each: counts[each.address], default=None)  # the first
        return next((each for each in self._waiting.values() if each.address == address), None)

    def _refuse(self, cause: str) -> tuple[None, None]:
        self.closed[cause] += 1
        return None, None
