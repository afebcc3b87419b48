"""Clients of the API: their queues, what each has received, and the bound on their number."""

import asyncio
import itertools
from typing import NamedTuple, NoReturn, Protocol, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.access import Grant
from hostlink.api.routes import readable
from hostlink.hub.byte_budget import ByteBudget
from hostlink.hub.queue import Queue


class Outgoing(NamedTuple):
    """A message to a client: text (JSON) or binary (CBOR). `before`, if not empty, is a binary message sent first."""

    data: bytes
    is_binary: bool = False
    before: bytes = b""


class ClientQueue(Queue[Outgoing]):
    """Send queue of one client."""

    def __init__(self, budget: ByteBudget | None = None) -> None:
        share = None if budget is None else budget["queues"]
        super().__init__(_size_bytes, asyncio.get_running_loop().time, share)
        self.is_flush_due = True  # whether throttled subscriptions have messages

    def wake(self) -> None:
        self.is_flush_due = True
        super().wake()


def _size_bytes(outgoing: Outgoing) -> int:
    return len(outgoing.data) + len(outgoing.before)


def put_json(queue: ClientQueue, answer: object) -> None:
    """Encode and queue an answer or an event."""
    queue.put_result(Outgoing(msgspec.json.encode(answer)))


class Backlog(Protocol):
    """Messages that wait for a client."""

    dropped: int

    @property
    def waiting_messages(self) -> int: ...

    @property
    def waiting_bytes(self) -> int: ...

    @property
    def oldest_s(self) -> float | None: ...


class ClientView(TypedDict):
    """One client: its name, program and role, what it received, and what was dropped."""

    name: str
    kind: str
    peer: str
    token: str
    role: str
    program: str
    seconds: float
    messages_from_client: int
    messages_to_client: int
    bytes_to_client: int
    waiting_messages: int
    waiting_bytes: int
    lag_s: float
    dropped: int


class Client:
    """One WebSocket or event stream."""

    def __init__(self, number: int, kind: str, request: web.Request, grant: Grant, backlog: Backlog | None) -> None:
        self.kind = kind
        self.name = f"client {number}" + (f" ({grant.who})" if grant.who else "")
        self.peer = request.remote or ""
        self.grant = grant
        self.program = readable(request.headers.get("User-Agent", ""))[:120]
        self.backlog = backlog
        self.since_s = asyncio.get_running_loop().time()
        self.messages_from_client = self.messages_to_client = self.bytes_to_client = 0

    def sent(self, size: int) -> None:
        """Count a sent message."""
        self.messages_to_client += 1
        self.bytes_to_client += size

    def view(self, now_s: float) -> ClientView:
        """Return the client as the API shows it."""
        oldest_s = None if self.backlog is None else self.backlog.oldest_s
        return {
            "name": self.name,
            "kind": self.kind,
            "peer": self.peer,
            "token": self.grant.who,
            "role": self.grant.role.name.lower(),
            "program": self.program,
            "seconds": round(now_s - self.since_s, 3),
            "messages_from_client": self.messages_from_client,
            "messages_to_client": self.messages_to_client,
            "bytes_to_client": self.bytes_to_client,
            "waiting_messages": 0 if self.backlog is None else self.backlog.waiting_messages,
            "waiting_bytes": 0 if self.backlog is None else self.backlog.waiting_bytes,
            "lag_s": 0.0 if oldest_s is None else round(now_s - oldest_s, 6),
            "dropped": 0 if self.backlog is None else self.backlog.dropped,
        }


class Clients:
    """All clients, up to a bound."""

    def __init__(self, max_clients: int, *, max_per_address: int) -> None:
        self.refused = 0
        self.gone_dropped = 0  # messages dropped for clients that have disconnected
        self._max_clients, self._max_per_address = max_clients, max_per_address
        self._numbers = itertools.count(1)
        self._clients: list[Client] = []  # in order of arrival

    def enter(self, kind: str, request: web.Request, grant: Grant, backlog: Backlog | None = None) -> Client:
        """Add a client. Raise 503 when there are too many."""
        if len(self._clients) >= self._max_clients:
            self._refuse(f"{self._max_clients} clients are connected: close one, or raise api.max_clients")
        if sum(client.peer == (request.remote or "") for client in self._clients) >= self._max_per_address:
            self._refuse(
                f"{self._max_per_address} clients of {request.remote} are connected: close one, "
                "or raise api.max_connections_per_address"
            )
        client = Client(next(self._numbers), kind, request, grant, backlog)
        self._clients.append(client)
        return client

    def _refuse(self, reason: str) -> NoReturn:
        self.refused += 1
        raise web.HTTPServiceUnavailable(reason=reason)

    def leave(self, client: Client) -> None:
        """Remove a disconnected client."""
        self._clients.remove(client)
        self.gone_dropped += 0 if client.backlog is None else client.backlog.dropped

    def all(self) -> list[Client]:
        """Return all clients, the oldest first."""
        return list(self._clients)

    def views(self) -> list[ClientView]:
        """Return all clients as the API shows them."""
        now_s = asyncio.get_running_loop().time()
        return [client.view(now_s) for client in self._clients]
