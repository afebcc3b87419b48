"""ApiListener: the API's port. Accepts connections by the rules of `Connections` and aborts those that time out."""

import asyncio
import contextlib
import socket
import ssl
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from typing import cast

import structlog
from aiohttp import web

from hostlink.acceptor import Acceptor
from hostlink.api.connections import Connection, Connections
from hostlink.forwarding_protocol import ForwardingProtocol
from hostlink.hub.byte_budget import Share
from hostlink.hub.hub import Hub
from hostlink.link.fair_share import Turns
from hostlink.logs import printable
from hostlink.transport.base import READ_BYTES

REQUEST_BYTES = 2 * READ_BYTES  # in one read, while the connection speaks HTTP
SOCKET_BYTES = 64 * 1024  # in one read of a WebSocket: several seconds of velocity commands
CONTROL_FRAME_BYTES = 6  # of a client's ping or pong, without payload
LARGE_BYTES = SOCKET_BYTES  # a larger message needs room in the byte budget before it is read

_INTO = memoryview(bytearray(SOCKET_BYTES))  # receive buffer of all connections, copied before the next read


class PacedReading(ForwardingProtocol, asyncio.BufferedProtocol):
    """The protocol of one connection. Paces reading, and passes the bytes to the HTTP or WebSocket protocol inside.

    | protocol    | what is read                                                                                       |
    |-------------|----------------------------------------------------------------------------------------------------|
    | HTTP        | one piece in each turn (FairShare); not the rest of a body that no handler reads (`refuse_body`)   |
    | WebSocket   | everything available at once, because a newer command may be behind it. The rest of a large        |
    |             | message waits in the socket until the byte budget has room for it                                  |
    """

    def __init__(
        self,
        inner: asyncio.Protocol,
        turns: Turns,
        share: Share,
        came_s: Callable[[float], float],
        *,
        max_message_bytes: int,
        timeout_s: float,
        behind_since_s: float | None = None,
    ) -> None:
        """Wrap a protocol. `share`: budget of incomplete messages; `came_s`: earliest arrival of bytes read now.

        `behind_since_s`: time since when the connection, and its first bytes, may have waited to be accepted.
        """
        super().__init__(inner)
        self.came_s = behind_since_s or 0.0  # earliest arrival of the bytes read last
        self.request_came_s = 0.0  # of the request that is being answered
        self._turns, self._share, self._came = turns, share, came_s
        self._room_bytes = min(max_message_bytes, share.max_bytes)  # a larger message takes all
        self._timeout_s = timeout_s
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport
        self._held = b""  # read, but not passed on; reading is paused
        self._is_behind = behind_since_s is not None  # whether more bytes may wait behind those read last
        self._next_request_came_s: float | None = None
        self._is_web_socket = self._is_refusing = self._is_lost = self._has_room = False
        self._on_read = self._on_writable = _call_nothing  # callbacks of the WebSocket's owner
        self.is_writing_paused = False  # whether the transport's buffer is full
        self._unread_bytes = 0  # of an incomplete message
        self._deadline: asyncio.TimerHandle | None = None

    # -- what the API says --------------------------------------------------------------------------------------------

    def begin_request(self) -> None:
        """Note a complete head. A request that was read before its predecessor was answered is as old as that one."""
        if self._next_request_came_s is not None:
            self.request_came_s = self._next_request_came_s

    def end_request(self) -> None:
        """Note that the request is answered."""
        self._next_request_came_s = None

    def refuse_body(self) -> None:
        """Stop reading: the answer is decided. The connection is closed when the client had time to read it."""
        self._is_refusing = True

    def become_web_socket(self, *, on_read: Callable[[], None], on_writable: Callable[[], None]) -> None:
        """Switch to reading messages. `on_read` is called after each read, `on_writable` when writing may continue."""
        self._is_web_socket = True
        self._on_read, self._on_writable = on_read, on_writable

    def leave_web_socket(self) -> None:
        """Remove the callbacks of the WebSocket."""
        self._on_read = self._on_writable = _call_nothing

    def receive_message(self) -> None:
        """Note that a message is complete, and that a large one has been executed."""
        self._unread_bytes = 0
        if self._has_room:
            self._give_room()

    def receive_control(self, payload_bytes: int) -> None:
        """Subtract a ping or a pong, which belongs to no message: a client may send only those for days."""
        self._unread_bytes = max(0, self._unread_bytes - payload_bytes - CONTROL_FRAME_BYTES)

    # -- what asyncio calls -------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport  # type: ignore[assignment]  # uvloop's is not a subclass
        super().connection_made(transport)

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 - asyncio's signature
        return _INTO[: SOCKET_BYTES if self._is_web_socket else REQUEST_BYTES]

    def buffer_updated(self, nbytes: int) -> None:
        data = bytes(_INTO[:nbytes])
        if not self._is_behind:  # the bytes arrived after the previous turn of the event loop
            self.came_s = self._came(self._loop.time())
        self._is_behind = nbytes == (SOCKET_BYTES if self._is_web_socket else REQUEST_BYTES)
        if self._next_request_came_s is None:
            self._next_request_came_s = self.came_s
        if self._held or self._is_refusing:
            self._hold(data)
        elif self._is_web_socket:
            self._receive(data)
        elif nbytes < READ_BYTES and self._turns.share.is_free(is_flooding=False):
            self._pass_on(data)
        else:
            self._hold(data)
            self._turns.call(self._release, is_flooding=nbytes >= READ_BYTES)

    def connection_lost(self, exc: Exception | None) -> None:
        self._is_lost, self._held = True, b""
        self._give_room()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        self.is_writing_paused = True
        super().pause_writing()

    def resume_writing(self) -> None:
        self.is_writing_paused = False
        super().resume_writing()
        self._on_writable()

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _hold(self, data: bytes) -> None:
        self._held = b"" if self._is_refusing else self._held + data
        self._is_behind = True
        self._transport.pause_reading()

    def _release(self) -> None:
        """Pass on the bytes held back. Reading resumes before, because the inner protocol may pause it again."""
        data, self._held = self._held, b""
        if self._is_lost or self._is_refusing:
            return
        if not self._transport.is_closing():
            self._transport.resume_reading()
        self._pass_on(data)

    def _pass_on(self, data: bytes) -> None:
        began_s = self._loop.time()
        self._inner.data_received(data)
        self._turns.end(began_s)

    def _receive(self, data: bytes) -> None:
        """Pass on bytes of a WebSocket, unless they belong to a large message for which the budget has no room."""
        self._unread_bytes += len(data)
        if self._unread_bytes > LARGE_BYTES and not self._has_room:
            if not self._share.take(self._room_bytes):
                self._hold(data)
                self._share.wait(self._try_again)
                return
            self._has_room = True
            self._deadline = self._loop.call_later(self._timeout_s, self._transport.abort)
        self._inner.data_received(data)
        self._on_read()
        if not self._is_lost and not self._transport.is_reading():
            self._is_behind = True

    def _try_again(self) -> None:
        if self._is_lost:
            return
        data, self._held = self._held, b""
        self._unread_bytes -= len(data)
        if not self._transport.is_closing():
            self._transport.resume_reading()
        self._receive(data)

    def _give_room(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
        if self._has_room:
            self._has_room = False
            self._share.give(self._room_bytes)


def _call_nothing() -> None:
    """Replace the callbacks of a connection that is not a WebSocket."""


log = structlog.get_logger()

SWEEP_INTERVAL_S = 1.0  # a connection may exceed its timeout by this time
LOG_INTERVAL_S = 10.0
UNAVAILABLE = b"HTTP/1.1 503 Too many connections\r\nConnection: close\r\nRetry-After: 1\r\nContent-Length: 0\r\n\r\n"

MakeProtocol = Callable[[], asyncio.Protocol]


class ApiListener:
    """Owns accepted sockets until their protocols take over, and knows the state of each connection from then on."""

    def __init__(self, connections: Connections, hub: Hub) -> None:
        self._connections, self._hub = connections, hub
        self._sockets: dict[int, socket.socket] = {}  # in their handshake, by number of the connection
        self._transports: dict[int, asyncio.Transport] = {}
        self._by_transport: dict[asyncio.BaseTransport, tuple[Connection, PacedReading]] = {}
        self._log_at_s = float("-inf")
        self._logged: Counter[str] = Counter()

    @contextlib.asynccontextmanager
    async def serving(
        self, listening: list[socket.socket], make_protocol: MakeProtocol, tls: ssl.SSLContext | None
    ) -> AsyncIterator[None]:
        """Accept connections within the block. Connections that are open at its end belong to their protocols."""

        def accepted(sock: socket.socket, address: str, since_s: float) -> None:
            new, leaving = self._connections.enter(address, _now_s())
            if leaving is not None:
                self._cut(leaving)
            if new is None:
                _refuse(sock, UNAVAILABLE if tls is None else b"")
            else:
                self._sockets[new.number] = sock
                self._hub.spawn(self._open(sock, new, since_s, make_protocol, tls), name=f"connection of {address}")
            if new is None or leaving is not None:
                self._log_crowd(address)

        acceptor = Acceptor(listening, accepted, on_exhausted=self._note_exhausted, came_s=self._hub.gates.came_s)
        sweeper = _Every(SWEEP_INTERVAL_S, self._sweep)
        try:
            yield
        finally:
            sweeper.cancel()
            acceptor.close()
            for opening in self._sockets.values():
                _shut(opening)

    @contextlib.contextmanager
    def answering(self, transport: asyncio.BaseTransport | None) -> Iterator[None]:
        """Suspend the timeout of a connection within the block: the head of a request is complete."""
        found = None if transport is None else self._by_transport.get(transport)
        if found is None:
            yield
            return
        connection, reading = found
        self._connections.serve(connection)
        reading.begin_request()
        try:
            yield
        finally:
            reading.end_request()
            self._connections.wait(connection, _now_s())

    @contextlib.contextmanager
    def receiving(self, transport: asyncio.BaseTransport | None) -> Iterator[None]:
        """Restart the timeout of a connection within the block: the body of a request is incomplete."""
        found = None if transport is None else self._by_transport.get(transport)
        if found is None:
            yield
            return
        connection, _ = found
        self._connections.wait(connection, _now_s())
        try:
            yield
        finally:
            self._connections.serve(connection)

    # -- one connection -----------------------------------------------------------------------------------------------

    async def _open(
        self,
        sock: socket.socket,
        connection: Connection,
        since_s: float,
        make_protocol: MakeProtocol,
        tls: ssl.SSLContext | None,
    ) -> None:
        """Hand the socket to its protocol, after the TLS handshake if there is one. No command arrives before that."""
        behind_since_s = since_s if tls is None else None
        timeout_s = None if tls is None else self._connections.request_timeout_s
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: _Watched(make_protocol(), self, connection, self._hub, behind_since_s),
                sock,
                ssl=tls,
                ssl_handshake_timeout=timeout_s,
            )
        except OSError as error:  # of TLS too
            log.debug("client.broken", reason=printable(str(error)))
        finally:
            self._sockets.pop(connection.number, None)
            if connection.number not in self._transports:
                self._connections.leave(connection)
                sock.close()

    def opened(self, connection: Connection, reading: PacedReading, transport: asyncio.Transport) -> None:
        """Register an open connection."""
        self._transports[connection.number] = transport
        self._by_transport[transport] = connection, reading

    def reading(self, request: web.Request) -> PacedReading | None:
        """Return the protocol of a request's connection; None if the connection is closed."""
        transport = request.transport
        return None if transport is None or transport not in self._by_transport else self._by_transport[transport][1]

    def lost(self, connection: Connection) -> None:
        """Remove a closed connection."""
        transport = self._transports.pop(connection.number, None)
        if transport is not None:
            del self._by_transport[transport]
        self._connections.leave(connection)

    def _cut(self, connection: Connection) -> None:
        transport = self._transports.get(connection.number)
        if transport is not None:
            transport.abort()
        elif connection.number in self._sockets:
            _shut(self._sockets[connection.number])

    # -- all of them --------------------------------------------------------------------------------------------------

    def _sweep(self) -> None:
        for connection in self._connections.overdue(_now_s()):
            self._cut(connection)

    def _note_exhausted(self) -> None:
        self._connections.closed["no_descriptors"] += 1
        self._log_crowd("")

    def _log_crowd(self, address: str) -> None:
        """Log refused and closed connections: the first at once, the others at most once in LOG_INTERVAL_S."""
        now_s = _now_s()
        if now_s >= self._log_at_s:
            self._log_at_s = now_s + LOG_INTERVAL_S
            news = self._connections.closed - self._logged
            self._logged = self._connections.closed.copy()
            log.warning("client.crowded", peer=address, connections=len(self._connections), **news)


class _Watched(PacedReading):
    """PacedReading that tells the listener when the connection opens and closes."""

    def __init__(
        self,
        inner: asyncio.Protocol,
        listener: ApiListener,
        connection: Connection,
        hub: Hub,
        behind_since_s: float | None,
    ) -> None:
        super().__init__(
            inner,
            hub.turns(),
            hub.budget["receiving"],
            hub.gates.came_s,
            max_message_bytes=hub.config.api.max_message_bytes,
            timeout_s=hub.config.api.request_timeout_s,
            behind_since_s=behind_since_s,
        )
        self._listener, self._connection = listener, connection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._listener.opened(self._connection, self, cast("asyncio.Transport", transport))  # for uvloop
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._listener.lost(self._connection)
        super().connection_lost(exc)


class _Every:
    """Calls a function at an interval until it is cancelled."""

    def __init__(self, interval_s: float, call: Callable[[], None]) -> None:
        self._interval_s, self._call = interval_s, call
        self._timer = asyncio.get_running_loop().call_later(interval_s, self._run)

    def cancel(self) -> None:
        self._timer.cancel()

    def _run(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._interval_s, self._run)
        self._call()


def _refuse(sock: socket.socket, answer: bytes) -> None:
    with contextlib.suppress(OSError):
        sock.send(answer)
    sock.close()


def _shut(sock: socket.socket) -> None:
    """Shut down both directions; the owner of the socket closes it."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
