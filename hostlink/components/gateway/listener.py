"""ApiListener: the API's port. Accepts connections by the rules of `ApiConnections` and aborts those that time out."""

import asyncio
import contextlib
import socket
import ssl
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import cast

import structlog
from aiohttp import web

from hostlink.components.gateway.frames import ClientFrames
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.host import Host
from hostlink.core.runtime.acceptor import Acceptor
from hostlink.core.runtime.arrival import Arrival
from hostlink.core.runtime.forwarding_protocol import ForwardingProtocol
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.transport.base import READ_BYTES

IDLE_TIMEOUT_S = 75.0  # after an answer, as in nginx: browsers and proxies reuse connections

REQUEST_BYTES = 2 * READ_BYTES  # in one read, while the connection speaks HTTP
SOCKET_BYTES = 64 * 1024  # in one read of a WebSocket, within a message that is larger than READ_BYTES
CONTROL_FRAME_BYTES = 6  # of a client's ping or pong, without payload
HEAD_END = b"\r\n\r\n"  # of a request
LARGE_BYTES = SOCKET_BYTES  # a larger message needs room in the byte budget before it is read

# Nothing drops, replaces or counts messages behind a client's queue: little fits there.
UNSENT_BYTES = 16 * 1024  # in the kernel while the client does not read, and one write in the process
SEND_BUFFER_BYTES = 64 * 1024  # in the kernel with what is on its way; Linux takes twice as much

SWEEP_INTERVAL_S = 1.0  # a connection may exceed its timeout by this time
UNAVAILABLE = b"HTTP/1.1 503 Too many connections\r\nConnection: close\r\nRetry-After: 1\r\nContent-Length: 0\r\n\r\n"


@dataclass(slots=True, eq=False)
class ApiConnection:
    """One TCP connection, from accepting to its end."""

    address: str
    deadline_s: float = 0.0  # of a waiting connection
    accepted: socket.socket | None = None  # until its protocol is ready, after the TLS handshake
    transport: asyncio.BaseTransport | None = None

    def abort(self) -> None:
        """Close the connection without waiting. Its owner notices."""
        if self.transport is not None:
            cast("asyncio.Transport", self.transport).abort()
        elif self.accepted is not None:
            with contextlib.suppress(OSError):
                self.accepted.shutdown(socket.SHUT_RDWR)


class ApiConnections:
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
        self._all: dict[ApiConnection, None] = {}  # oldest first
        self._waiting: dict[ApiConnection, None] = {}  # longest first

    def __len__(self) -> int:
        return len(self._all)

    def all(self) -> list[ApiConnection]:
        """Return all connections, the oldest first."""
        return list(self._all)

    def enter(self, address: str, now_s: float) -> tuple[ApiConnection | None, ApiConnection | None]:
        """Add a connection. Return it (None: refused), and the connection that is evicted for it (None: none)."""
        mine = sum(each.address == address for each in self._all)
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
        new = ApiConnection(address)
        self._all[new] = None
        self._wait_until(new, now_s + self.request_timeout_s)
        return new, leaving

    def serve(self, connection: ApiConnection) -> None:
        """Note that a complete request is being answered."""
        self._waiting.pop(connection, None)

    def wait(self, connection: ApiConnection, now_s: float) -> None:
        """Note that the request is answered."""
        if connection in self._all:
            self._wait_until(connection, now_s + IDLE_TIMEOUT_S)

    def leave(self, connection: ApiConnection) -> None:
        """Remove a closed connection. An unknown one is ignored."""
        self._all.pop(connection, None)
        self._waiting.pop(connection, None)

    def overdue(self, now_s: float) -> list[ApiConnection]:
        """Remove and return the connections whose timeout has passed."""
        found = [each for each in self._waiting if each.deadline_s <= now_s]
        for each in found:
            self.closed["timeout"] += 1
            self.leave(each)
        return found

    def _wait_until(self, connection: ApiConnection, deadline_s: float) -> None:
        connection.deadline_s = deadline_s
        self._waiting.pop(connection, None)
        self._waiting[connection] = None

    def _longest_waiting(self, address: str | None) -> ApiConnection | None:
        if address is None:
            counts = Counter(each.address for each in self._waiting)
            return max(self._waiting, key=lambda each: counts[each.address], default=None)  # the first
        return next((each for each in self._waiting if each.address == address), None)

    def _refuse(self, cause: str) -> tuple[None, None]:
        self.closed[cause] += 1
        return None, None


_INTO = memoryview(bytearray(SOCKET_BYTES))  # receive buffer of all connections, copied before the next read


class PacedReading(ForwardingProtocol, asyncio.BufferedProtocol):
    """The protocol of one connection. Paces reading, and passes the bytes to the HTTP or WebSocket protocol inside.

    | protocol    | what is read                                                                                       |
    |-------------|----------------------------------------------------------------------------------------------------|
    | HTTP        | one piece in each turn (FairShare); not the rest of a body that no handler reads (`refuse_body`)   |
    | WebSocket   | one piece in each turn, passed on at once, because a newer command may be behind it; nothing while |
    |             | the client's operations have no room (`pause`). The rest of a large message is read in large       |
    |             | pieces, and waits in the socket until the byte budget has room for it. A read that is one whole    |
    |             | text message is offered to `on_message` first, while nothing waits inside                          |
    """

    def __init__(
        self,
        inner: asyncio.Protocol,
        host: Host,
        config: ApiConfig,
        connections: ApiConnections,
        connection: ApiConnection,
        behind_since_s: float | None = None,
    ) -> None:
        """Wrap a protocol. `behind_since_s`: time since when the first bytes may have waited to be accepted."""
        super().__init__(inner)
        self.came_s = behind_since_s or 0.0  # earliest arrival of the bytes read last
        self.request_came_s = 0.0  # of the request that is being answered
        self.reads = 0  # number of reads so far
        self.unread_bytes = 0  # of an incomplete message
        self.transport: asyncio.Transport
        self.has_room = False  # whether the byte budget has room for a large message
        self.is_writing_paused = False  # whether the transport's buffer is full
        self._connections, self._connection = connections, connection
        self._turns, self._share, self._came = host.turns(), host.share("receiving"), host.came_s
        # A message that may be larger than the whole share takes all of it.
        self._room_bytes = min(config.max_message_bytes, self._share.max_bytes)
        self._timeout_s = config.request_timeout_s
        self._loop = asyncio.get_running_loop()
        self._held = b""  # read, but not passed on; reading is paused
        self._offered_bytes = 0  # size of the buffer of the next read
        self._arrival = Arrival(behind_since_s)
        self._next_request_came_s: float | None = None
        self._is_web_socket = self._is_refusing = self._is_lost = False
        self._is_full = False  # whether the operations of the client have no room
        self._is_last_request = False  # whether bytes were passed on while the transport was closing
        self._on_read = self._on_full = self._on_writable = _call_nothing  # callbacks of the WebSocket's owner
        self._on_message: Callable[[bytes], bool] = _take_nothing
        self._frames = ClientFrames()
        self._http_end = b""  # the last bytes that were passed on before it became a WebSocket
        self._deadline: asyncio.TimerHandle | None = None

    # -- what the API says --------------------------------------------------------------------------------------------

    def begin_request(self) -> None:
        """Note a complete head. A request that was read before its predecessor was answered is as old as that one."""
        self._connections.serve(self._connection)
        if self._next_request_came_s is not None:
            self.request_came_s = self._next_request_came_s

    def end_request(self) -> None:
        """Note that the request is answered."""
        self._next_request_came_s = None
        self._connections.wait(self._connection, self._loop.time())
        self.note_reading()

    @contextlib.contextmanager
    def receiving_body(self) -> Iterator[None]:
        """Restart the timeout of the connection within the block: the body of a request is incomplete."""
        self._connections.wait(self._connection, self._loop.time())
        try:
            yield
        finally:
            self._connections.serve(self._connection)

    def refuse_body(self) -> None:
        """Stop reading: the answer is decided. The connection is closed when the client had time to read it."""
        self._is_refusing = True

    def become_web_socket(
        self,
        *,
        on_message: Callable[[bytes], bool],
        on_read: Callable[[], None],
        on_full: Callable[[], None],
        on_writable: Callable[[], None],
    ) -> None:
        """Switch to reading messages. `on_read` is called after each read.

        `on_message` gets the text of a read that is one whole message, if nothing that was read before waits. It
        returns False to leave the message to the protocol inside; then `on_read` is called. `on_full` is called when
        the transport has kept bytes that the system did not take, `on_writable` when it has sent them.
        """
        self._is_web_socket = True
        self.transport.set_write_buffer_limits(0)
        tcp = self.transport.get_extra_info("socket")
        tcp.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # Linux and macOS
            tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
        self._on_read, self._on_full, self._on_writable = on_read, on_full, on_writable
        if self._http_end == HEAD_END:  # otherwise a part of a frame may have been passed on behind the request
            self._on_message = on_message

    def leave_web_socket(self) -> None:
        """Remove the callbacks of the WebSocket."""
        self._on_read = self._on_full = self._on_writable = _call_nothing
        self._on_message = _take_nothing

    def pause(self) -> None:
        """Leave what arrives in the socket until `resume`: the operations of the client have no room."""
        if self.transport.is_reading():
            self._is_full = True
            self._arrival.arrive(self._came(self._loop.time()))
            self.transport.pause_reading()

    def resume(self) -> None:
        """Read again, unless reading was paused before `pause` by the protocol inside: it resumes by itself."""
        if self._is_full:
            self._is_full = False
            if not self.transport.is_closing():
                self.transport.resume_reading()
                self.note_reading()

    def note_reading(self) -> None:
        """Note that the protocol inside may read again: what waited in the system is read soon, or nothing did."""
        self._leave(is_more=True)

    def receive_control(self, payload_bytes: int) -> None:
        """Subtract a ping or a pong, which belongs to no message: a client may send only those for days."""
        self.unread_bytes = max(0, self.unread_bytes - payload_bytes - CONTROL_FRAME_BYTES)

    # -- what asyncio calls -------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport  # type: ignore[assignment]  # uvloop's is not a subclass
        self._connection.transport = transport
        super().connection_made(transport)

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 - asyncio's signature
        if not self._is_web_socket:
            self._offered_bytes = REQUEST_BYTES
        else:
            self._offered_bytes = READ_BYTES if self.unread_bytes < READ_BYTES else SOCKET_BYTES
        return _INTO[: self._offered_bytes]

    def buffer_updated(self, nbytes: int) -> None:
        data = bytes(_INTO[:nbytes])
        self.reads += 1
        self.came_s = self._arrival.arrive(self._came(self._loop.time()))
        is_full = nbytes == self._offered_bytes
        if self._next_request_came_s is None:
            self._next_request_came_s = self.came_s
        if self._held or self._is_refusing:
            self._hold(data)
        elif self._is_web_socket:
            if (
                is_full
                or self.unread_bytes
                or (text := self._frames.text_of(data)) is None
                or not self._on_message(text)
            ):
                self._receive(data)
        elif nbytes < READ_BYTES and self._turns.share.is_free(is_flooding=False):
            self._pass_on(data)
        else:
            self._hold(data)
            self._turns.call(self._release, is_flooding=nbytes >= READ_BYTES)
        self._leave(is_more=is_full)

    def connection_lost(self, exc: Exception | None) -> None:
        self._is_lost, self._held = True, b""
        self.give_room()
        self._connections.leave(self._connection)
        if self._is_last_request:  # a turn later, because aiohttp has not called its handler yet and would forget it
            self._loop.call_soon(super().connection_lost, exc)
        else:
            super().connection_lost(exc)

    def pause_writing(self) -> None:
        self.is_writing_paused = True
        super().pause_writing()
        self._on_full()

    def resume_writing(self) -> None:
        self.is_writing_paused = False
        super().resume_writing()
        self._on_writable()

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _leave(self, *, is_more: bool) -> None:
        """Note that all bytes were passed on and more are read, unless the protocol inside has paused that."""
        if not self._held and not self._is_lost and self.transport.is_reading():
            self._turns.leave(self._arrival, asyncio.get_running_loop().time(), is_more=is_more)

    def _hold(self, data: bytes) -> None:
        self._held = b"" if self._is_refusing else self._held + data
        self.transport.pause_reading()

    def _release(self) -> None:
        """Pass on the bytes held back. Reading resumes before, because the inner protocol may pause it again."""
        data, self._held = self._held, b""
        if self._is_lost or self._is_refusing:
            return
        self._is_last_request = self.transport.is_closing()
        if not self._is_last_request:
            self.transport.resume_reading()
        self._pass_on(data)
        self.note_reading()

    def _pass_on(self, data: bytes) -> None:
        began_s = self._loop.time()
        if self._is_web_socket:
            self._frames.skip(data)
        else:
            self._http_end = (self._http_end + data)[-len(HEAD_END) :]
        self._inner.data_received(data)
        self._turns.end(began_s)

    def _receive(self, data: bytes) -> None:
        """Pass on bytes of a WebSocket, unless they belong to a large message for which the budget has no room."""
        self.unread_bytes += len(data)
        if self.unread_bytes > LARGE_BYTES and not self.has_room:
            if not self._share.take(self._room_bytes):
                self._hold(data)
                self._share.wait(self._try_again)
                return
            self.has_room = True
            self._deadline = self._loop.call_later(self._timeout_s, self.transport.abort)
        self._frames.skip(data)
        self._inner.data_received(data)
        self._on_read()

    def _try_again(self) -> None:
        if self._is_lost:
            return
        data, self._held = self._held, b""
        self.unread_bytes -= len(data)
        if not self.transport.is_closing():
            self.transport.resume_reading()
        self._receive(data)
        self.note_reading()

    def give_room(self) -> None:
        """Return the room of a large message to the budget."""
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
        if self.has_room:
            self.has_room = False
            self._share.give(self._room_bytes)


def _call_nothing() -> None:
    """Replace the callbacks of a connection that is not a WebSocket."""


def _take_nothing(_: bytes) -> bool:
    """Leave every message to the protocol inside."""
    return False


log = structlog.get_logger()


MakeProtocol = Callable[[], asyncio.Protocol]


class ApiListener:
    """Accepts connections, and aborts those that wait too long or are too many."""

    def __init__(self, connections: ApiConnections, host: Host, config: ApiConfig) -> None:
        self.connections, self._host, self._config = connections, host, config
        self._sweeper: asyncio.TimerHandle
        self._lines = Budget()
        self._logged: Counter[str] = Counter()

    @contextlib.asynccontextmanager
    async def serving(
        self, listening: list[socket.socket], make_protocol: MakeProtocol, tls: ssl.SSLContext | None
    ) -> AsyncIterator[None]:
        """Accept connections within the block. Connections that are open at its end belong to their protocols."""

        def accepted(sock: socket.socket, address: str, since_s: float) -> None:
            new, leaving = self.connections.enter(address, loop_time_s())
            if leaving is not None:
                leaving.abort()
            if new is None:
                with contextlib.suppress(OSError):
                    sock.send(UNAVAILABLE if tls is None else b"")
                sock.close()
            else:
                new.accepted = sock
                self._host.spawn(
                    self._open(sock, new, since_s, make_protocol, tls), name=f"connection of {address}", is_vital=False
                )
            if new is None or leaving is not None:
                self._log_crowd(address)

        acceptor = Acceptor(listening, accepted, on_exhausted=self._note_exhausted, came_s=self._host.came_s)
        self._sweep()
        try:
            yield
        finally:
            self._sweeper.cancel()
            acceptor.close()
            for connection in self.connections.all():
                if connection.accepted is not None:
                    connection.abort()

    async def _open(
        self,
        sock: socket.socket,
        connection: ApiConnection,
        since_s: float,
        make_protocol: MakeProtocol,
        tls: ssl.SSLContext | None,
    ) -> None:
        """Hand the socket to its protocol, after the TLS handshake if there is one. No command arrives before that."""
        behind_since_s = since_s if tls is None else None
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: PacedReading(
                    make_protocol(), self._host, self._config, self.connections, connection, behind_since_s
                ),
                sock,
                ssl=tls,
                ssl_handshake_timeout=None if tls is None else self.connections.request_timeout_s,
            )
        except OSError as error:  # of TLS too
            log.debug("client.broken", reason=printable(str(error)))
        finally:
            connection.accepted = None
            if connection.transport is None:
                self.connections.leave(connection)
                sock.close()

    def _sweep(self) -> None:
        self._sweeper = asyncio.get_running_loop().call_later(SWEEP_INTERVAL_S, self._sweep)
        for connection in self.connections.overdue(loop_time_s()):
            connection.abort()

    def _note_exhausted(self) -> None:
        self.connections.closed["no_descriptors"] += 1
        self._log_crowd("")

    def _log_crowd(self, address: str) -> None:
        """Log refused and closed connections, within the budget of repeated lines."""
        if self._lines.due("client.crowded", loop_time_s()):
            news = self.connections.closed - self._logged
            self._logged = self.connections.closed.copy()
            log.warning("client.crowded", peer=address, connections=len(self.connections), **news)


def reading_of(request: web.Request) -> PacedReading | None:
    """Return the protocol of a request's connection; None if the connection is closed."""
    protocol = None if request.transport is None else request.transport.get_protocol()
    return protocol if isinstance(protocol, PacedReading) else None
