"""Clients of the API: their operations and queues, what each has received, and the bound on their number."""

import asyncio
import itertools
from collections import Counter, deque
from collections.abc import Callable, Coroutine, Hashable
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, NoReturn, Protocol, TypedDict, TypeVar
from urllib.parse import urlsplit

import msgspec
from aiohttp import web

from hostlink.components.gateway.access import GRANT
from hostlink.components.gateway.program_names import browser_of, client_name
from hostlink.components.gateway.routes import readable
from hostlink.core.host import Queue, Share, VelocityTopic
from hostlink.core.robot.admission import UNORDERED_S, Resumption
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, Twist
from hostlink.core.runtime.logs import printable
from hostlink.errors import BadPayload

MANY = 64  # waiting messages above which a client floods: more than a second of commands at 50 Hz
MAX_MESSAGES = 256  # decoded or not; more wait in the socket
MAX_BYTES = 64 * 1024  # or one larger message
FEW = 32  # messages that each client may have while all clients together have too many
OPERATION_BYTES = 1024  # of memory for a small one; 128 clients that had left with 400 each took 97 MiB

Content = TypeVar("Content")
Spawn = Callable[[Coroutine[Any, Any, None]], object]  # runs a coroutine in the client's task group

NOT_A_VELOCITY = (None, False)  # also for an invalid velocity, which is refused and replaces nothing

MAX_NAMED = 3  # topics in the text about dropped messages


class VelocityOf(NamedTuple):
    """Facts of an operation with a velocity, besides the velocity."""

    operation: str
    target: str  # robot or topic
    terms: Hashable = None  # all else that decides about it, such as priority and epoch


@dataclass(slots=True)
class Operation(Generic[Content]):
    """One decoded message of a client."""

    content: Content
    came_s: float  # earliest time of arrival by the loop's clock
    velocity_of: VelocityOf | None = None  # None: not a velocity
    is_zero: bool = False
    replaced: list[Content] = field(default_factory=list)  # velocities that this one replaces
    since_s: float = field(init=False)  # when the first of those came, or else this one; set by the queue
    is_kept: bool = False  # only a zero replaces it


class ClientProgram(Protocol[Content]):
    """Protocol that a client speaks: RosbridgeClient or FoxgloveClient. Errors of the client are never raised."""

    @property
    def calls(self) -> int:
        """Number of pending service calls. A call begins in the turn of the loop after `do`."""

    def take(self, data: bytes, came_s: float) -> bool:
        """Execute a message if it is a plain velocity. Otherwise do nothing and return False."""

    def read(self, data: str | bytes, came_s: float) -> Operation[Content]:
        """Decode a message."""

    def do(self, operation: Operation[Content]) -> None:
        """Execute a decoded message."""

    def flush(self, now_s: float) -> float | None:
        """Queue what was held back until now. Return when more is due."""

    def close(self) -> None:
        """End the participant."""


class OperationQueue(Generic[Content]):
    """Received operations of one client, executed in their order of arrival.

    A velocity replaces the waiting one for the same robot or topic under three conditions. Priority, epoch and all
    other terms are equal. Between the two came only velocities for other robots or topics, by the same operation: any
    other message may change the decision about the newer one. And the newer one came less than UNORDERED_S after the
    older one: if another client stopped the robot between them, the older one must disarm its source. A zero replaces
    velocities of any age, and is never replaced. After a silence of the connection, the first velocity of those that
    wait is kept: it shows the admission that they waited for the network.
    """

    def __init__(
        self, program: ClientProgram[Content], on_replaced: Callable[[], None], messages_s: float, share: Share
    ) -> None:
        """Create an empty queue. `on_replaced` is called for each replaced velocity; `messages_s`: allowed rate.

        `share`: of the operations of all clients.
        """
        self._program, self._on_replaced, self._share = program, on_replaced, share
        self._held_bytes = 0  # of the share
        self._messages: deque[tuple[str | bytes, float]] = deque()  # in order of arrival, not decoded
        self._bytes = 0
        self._operations: dict[int, Operation[Content]] = {}  # by number, in order of arrival
        self._velocities: dict[str, int] = {}  # numbers of velocities that may be replaced, by robot or topic
        self._velocities_by = ""  # the operation of all of them
        self._last_number = 0
        self.waiting = 0  # messages and operations
        self.is_flooding = False  # more than MANY wait: executed after other clients' turns until none waits
        self.has_room = True  # otherwise the rest waits in the socket
        self._came_s: float | None = None  # of the newest message; None: none yet
        self._resumption = Resumption()
        self._messages_s, self._credit = messages_s, messages_s  # a token bucket
        self._credit_at_s = float("-inf")
        self.debt_s = 0.0  # time for which the client must be silent to be within its message rate again

    def take(self, data: bytes, came_s: float, now_s: float) -> bool:
        """Execute a message at once, if nothing waits and it is a plain velocity. Return whether it was executed."""
        credit = self._credit_after(now_s)
        if self.waiting or credit < 0 or not self._program.take(data, came_s):
            return False
        self._credit, self._credit_at_s = credit, now_s
        self._came_s = came_s
        self._resumption.is_recent(came_s)
        return True

    def _credit_after(self, now_s: float) -> float:
        """Return the credit that one more message leaves."""
        credit = self._credit + (now_s - self._credit_at_s) * self._messages_s
        return (credit if credit < self._messages_s else self._messages_s) - 1

    def put(self, data: str | bytes, came_s: float, now_s: float, *, is_behind: bool = False) -> None:
        """Add a message. `is_behind`: it was read together with the one before it, and may be as old."""
        self._credit, self._credit_at_s = self._credit_after(now_s), now_s
        self.debt_s = -self._credit / self._messages_s if self._credit < 0 else 0.0
        if self._came_s is None or not is_behind:
            self._came_s = came_s
        self._messages.append((data, self._came_s))
        self._bytes += len(data)
        self.waiting += 1
        self._hold(self.waiting * OPERATION_BYTES + self._bytes)
        if self.waiting > self._max_messages or self._bytes > MAX_BYTES:
            self.has_room = False
        if self.waiting > MANY or not self.has_room:
            self.is_flooding = True

    def close(self) -> None:
        """Give the share back: the client has ended, and what waits is not executed."""
        self._hold(0)

    @property
    def _max_messages(self) -> int:
        return FEW if self._share.is_over else MAX_MESSAGES

    def _hold(self, held_bytes: int) -> None:
        more = held_bytes - self._held_bytes
        self._held_bytes = held_bytes
        if more > 0:
            self._share.add(more)
        else:
            self._share.give(-more)

    def work(self) -> None:
        """Decode all messages, and execute the next operation."""
        operations, velocities = self._operations, self._velocities
        while self._messages:
            new = self._program.read(*self._messages.popleft())
            new.since_s = new.came_s
            self._last_number += 1
            velocity_of = new.velocity_of
            if velocity_of is None:
                velocities.clear()
            else:
                if velocity_of.operation != self._velocities_by:
                    velocities.clear()
                    self._velocities_by = velocity_of.operation
                new.is_kept = self._resumption.is_recent(new.came_s) and velocity_of.target not in velocities
                older = velocities.pop(velocity_of.target, None)
                if older is not None and _is_replaced(operations[older], new):
                    replaced = operations.pop(older)
                    new.replaced, new.since_s = [*replaced.replaced, replaced.content], replaced.since_s
                    self.waiting -= 1
                    self._on_replaced()
                if not new.is_zero:
                    velocities[velocity_of.target] = self._last_number
            operations[self._last_number] = new
        number = next(iter(operations))
        operation = operations.pop(number)
        if operation.velocity_of is not None and velocities.get(operation.velocity_of.target) == number:
            del velocities[operation.velocity_of.target]
        self.waiting -= 1
        try:
            self._program.do(operation)
        finally:
            if not operations:
                self._bytes, self.is_flooding = 0, False
            self._hold(self.waiting * OPERATION_BYTES + self._bytes)
            if len(operations) <= self._max_messages // 2 and (not operations or self._bytes <= MAX_BYTES):
                self.has_room = True


def _is_replaced(older: Operation[Content], newer: Operation[Content]) -> bool:
    is_soon = newer.is_zero or (newer.came_s < older.since_s + UNORDERED_S and not older.is_kept)
    return is_soon and older.velocity_of == newer.velocity_of


_TWISTS = frozenset({TWIST_TYPE, TWIST_STAMPED_TYPE})


def velocity_of_payload(
    topic: VelocityTopic | None, payload: bytes, terms: Hashable = None
) -> tuple[VelocityOf | None, bool]:
    """Return what a serialised message is a velocity of (None: it is not a valid one) and whether it is zero.

    The components for which a robot may refuse a velocity are among its terms, because a velocity replaces only one
    with equal terms: one that will be refused must not replace one that the robot obeys.
    """
    if topic is None or topic.type is None or topic.type_name not in _TWISTS:
        return NOT_A_VELOCITY
    try:
        if topic.type_name == TWIST_TYPE:
            twist = Twist.decode(payload)
        else:
            fields: Any = topic.type.decode(payload)
            twist = Twist.from_fields(fields["twist"])
    except BadPayload:
        return NOT_A_VELOCITY
    components = (twist.is_finite, twist.is_planar, twist.linear_y_m_s != 0)
    return VelocityOf("publish", topic.name, (terms, components)), twist.is_zero


class Outgoing(NamedTuple):
    """A message to a client: text (JSON) or binary (CBOR). `before`, if not empty, is a binary message sent first."""

    data: bytes
    is_binary: bool = False
    before: bytes = b""


class ClientQueue(Queue[Outgoing]):
    """Send queue of one client."""

    def __init__(self, share: Share | None = None) -> None:
        """`share`: of the messages and answers that wait for all clients."""
        super().__init__(_size_bytes, asyncio.get_running_loop().time, share)
        self.is_flush_due = True  # whether throttled subscriptions have messages

    def wake(self) -> None:
        self.is_flush_due = True
        super().wake()


def _size_bytes(outgoing: Outgoing) -> int:
    return len(outgoing.data) + len(outgoing.before)


def dropped_text(counts: Counter[str]) -> str:
    """Return what a client has lost, by topic, since it was told the last time."""
    named = ", ".join(f"{printable(topic)} {count}" for topic, count in counts.most_common(MAX_NAMED))
    rest = ", ..." if len(counts) > MAX_NAMED else ""
    return (
        f"this client reads too slowly; messages dropped: {counts.total()} ({named}{rest}); "
        "read faster, or receive less: throttle_rate of a subscription"
    )


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

    def __init__(self, number: int, kind: str, request: web.Request, backlog: Backlog | None) -> None:
        self.grant = grant = request[GRANT]
        self.kind = kind
        user_agent, asked = request.headers.get("User-Agent", ""), request.query.get("name", "")
        self.name = client_name(number, user_agent, who=grant.who, asked=asked, is_page=_is_own_page(request))
        self.peer = request.remote or ""
        self.program = readable(request.headers.get("User-Agent", ""))[:120]
        self.backlog = backlog
        self.since_s = asyncio.get_running_loop().time()
        self.messages_from_client = self.messages_to_client = self.bytes_to_client = 0

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


def _is_own_page(request: web.Request) -> bool:
    """Whether a browser has it from this daemon: its origin is the address that it asked."""
    return urlsplit(request.headers.get("Origin", "")).netloc == request.host and bool(
        browser_of(request.headers.get("User-Agent", ""))
    )


class Clients:
    """All clients, up to a bound."""

    def __init__(self, max_clients: int, *, max_per_address: int) -> None:
        self.refused = 0
        self.gone_dropped = 0  # messages dropped for clients that have disconnected
        self.velocities_replaced = Counter[str]()  # by newer ones before they were executed, by kind of client
        self._max_clients, self._max_per_address = max_clients, max_per_address
        self._numbers = itertools.count(1)
        self._clients: list[Client] = []  # in order of arrival

    def enter(self, kind: str, request: web.Request, backlog: Backlog | None = None) -> Client:
        """Add a client. Raise 503 when there are too many."""
        if len(self._clients) >= self._max_clients:
            self._refuse(f"{self._max_clients} clients are connected: close one, or raise api.max_clients")
        if sum(client.peer == (request.remote or "") for client in self._clients) >= self._max_per_address:
            self._refuse(
                f"{self._max_per_address} clients of {request.remote} are connected: close one, "
                "or raise api.max_connections_per_address"
            )
        client = Client(next(self._numbers), kind, request, backlog)
        self._clients.append(client)
        return client

    def _refuse(self, reason: str) -> NoReturn:
        self.refused += 1
        raise web.HTTPServiceUnavailable(reason=reason)

    def leave(self, client: Client) -> None:
        """Remove a disconnected client."""
        self._clients.remove(client)
        self.gone_dropped += 0 if client.backlog is None else client.backlog.dropped

    def views(self) -> list[ClientView]:
        """Return all clients as the API shows them, the oldest first."""
        now_s = asyncio.get_running_loop().time()
        return [client.view(now_s) for client in self._clients]
