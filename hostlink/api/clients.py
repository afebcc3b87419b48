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
    """JSON is text; CBOR is binary. `before`, if not empty, is a binary message that leaves before it."""

    data: bytes
    is_binary: bool = False
    before: bytes = b""


class ClientQueue(Queue[Outgoing]):
    """The queue of one client."""

    def __init__(self, budget: ByteBudget | None = None) -> None:
        share = None if budget is None else budget["queues"]
        super().__init__(_size_bytes, asyncio.get_running_loop().time, share)
        self.is_flush_due = True  # what subscriptions hold back has changed

    def wake(self) -> None:
        self.is_flush_due = True
        super().wake()


def _size_bytes(outgoing: Outgoing) -> int:
    return len(outgoing.data) + len(outgoing.before)


def put_json(queue: ClientQueue, answer: object) -> None:
    """Queue an answer or an event."""
    queue.put_result(Outgoing(msgspec.json.encode(answer)))


class Backlog(Protocol):
    """What waits for a client."""

    dropped: int

    @property
    def waiting_messages(self) -> int: ...

    @property
    def waiting_bytes(self) -> int: ...

    @property
    def oldest_s(self) -> float | None: ...


class ClientView(TypedDict):
    """One client: who it is, what it received, what it was too slow for."""

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
        """Count a message that left."""
        self.messages_to_client += 1
        self.bytes_to_client += size

    def view(self, now_s: float) -> ClientView:
        """For the API."""
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
    """All of them, up to a bound."""

    def __init__(self, max_clients: int, *, max_per_address: int) -> None:
        self.refused = 0
        self.gone_dropped = 0  # messages that clients which are gone were too slow for
        self._max_clients, self._max_per_address = max_clients, max_per_address
        self._numbers = itertools.count(1)
        self._clients: list[Client] = []  # oldest first

    def enter(self, kind: str, request: web.Request, grant: Grant, backlog: Backlog | None = None) -> Client:
        """A new client; 503 when there are too many already."""
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
        """It is gone."""
        self._clients.remove(client)
        self.gone_dropped += 0 if client.backlog is None else client.backlog.dropped

    def all(self) -> list[Client]:
        """Oldest first."""
        return list(self._clients)

    def views(self) -> list[ClientView]:
        """For the API."""
        now_s = asyncio.get_running_loop().time()
        return [client.view(now_s) for client in self._clients]
