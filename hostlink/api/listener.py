"""ApiListener: the API's port. It admits connections by the rules of Connections, and cuts those that wait too long."""

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
from hostlink.api.paced_reading import PacedReading
from hostlink.hub.hub import Hub
from hostlink.logs import printable

log = structlog.get_logger()

SWEEP_INTERVAL_S = 1.0  # how much longer than its time a connection may wait
LOG_INTERVAL_S = 10.0
UNAVAILABLE = b"HTTP/1.1 503 Too many connections\r\nConnection: close\r\nRetry-After: 1\r\nContent-Length: 0\r\n\r\n"

MakeProtocol = Callable[[], asyncio.Protocol]


class ApiListener:
    """Owns accepted sockets until their protocols have them, and knows the state of each connection from then on."""

    def __init__(self, connections: Connections, hub: Hub) -> None:
        self._connections, self._hub = connections, hub
        self._sockets: dict[int, socket.socket] = {}  # that are being opened, by the connection's number
        self._transports: dict[int, asyncio.Transport] = {}
        self._by_transport: dict[asyncio.BaseTransport, tuple[Connection, PacedReading]] = {}
        self._log_at_s = float("-inf")
        self._logged: Counter[str] = Counter()

    @contextlib.asynccontextmanager
    async def serving(
        self, listening: list[socket.socket], make_protocol: MakeProtocol, tls: ssl.SSLContext | None
    ) -> AsyncIterator[None]:
        """Accept connections for the length of the block; those that are open at its end belong to their protocols."""

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
        """The head of a request is whole: its connection does not wait during the block."""
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
        """The body of a request that is answered is missing: its connection waits during the block."""
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
        """Give it to its protocol, after the handshake of TLS if there is one: before that nobody sends a command."""
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
        """It has its protocol."""
        self._transports[connection.number] = transport
        self._by_transport[transport] = connection, reading

    def reading(self, request: web.Request) -> PacedReading | None:
        """How the connection of a request is read; None: it is closed."""
        transport = request.transport
        return None if transport is None or transport not in self._by_transport else self._by_transport[transport][1]

    def lost(self, connection: Connection) -> None:
        """It is closed."""
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
        """The first, then what came since, at most once in LOG_INTERVAL_S."""
        now_s = _now_s()
        if now_s >= self._log_at_s:
            self._log_at_s = now_s + LOG_INTERVAL_S
            news = self._connections.closed - self._logged
            self._logged = self._connections.closed.copy()
            log.warning("client.crowded", peer=address, connections=len(self._connections), **news)


class _Watched(PacedReading):
    """The protocol of one connection; the listener knows when it begins and ends."""

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
        self._listener.opened(self._connection, self, cast("asyncio.Transport", transport))  # uvloop's is no subclass
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._listener.lost(self._connection)
        super().connection_lost(exc)


class _Every:
    """Calls something at an interval, until it is cancelled."""

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
    """End both directions; the owner of the socket closes it."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
