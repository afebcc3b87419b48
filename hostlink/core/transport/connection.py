"""BufferedConnection: asyncio protocol of one connection, with small reads and awaitable writes.

StreamTransport is that of a device, for TCP and serial ports. `set_options` sets the options of a socket.
"""

import asyncio
import contextlib
import socket
from collections.abc import Callable

from hostlink.core.transport.base import CLOSE_TIMEOUT_S, READ_BYTES

_INTO = bytearray(READ_BYTES)  # shared by all connections: data is copied out before the next one reads
_VIEW = memoryview(_INTO)

# Seconds, seconds, probes: a dead peer is detected within 11 s.
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class BufferedConnection(asyncio.BufferedProtocol):
    """Protocol of one connection.

    One turn of the loop reads at most READ_BYTES. Reading pauses until the data was consumed, so that the system slows
    the sender.
    """

    __slots__ = (
        "_error", "_is_paused", "_lost", "_received", "_writable", "is_behind", "is_ended", "is_writing_paused",
        "on_readable", "transport",
    )  # fmt: skip

    full_read_bytes = READ_BYTES  # a read of fewer bytes has left none in the system

    def __init__(self) -> None:
        self.transport: asyncio.Transport
        self.is_behind = False  # whether the system may have more bytes behind those that were received
        self.is_writing_paused = False
        self.is_ended = False
        self.on_readable: Callable[[], None] = ignore
        self._received = bytearray()
        self._is_paused = False
        self._error: Exception | None = None
        self._writable: asyncio.Future[None] | None = None
        self._lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return len(self._received)

    def read(self, limit_bytes: int) -> bytes:
        """Return received bytes; b"" when none are unread, and at the end.

        Raises:
            OSError: the connection broke, and every byte before was read.
        """
        received = self._received
        if not received and self._error is not None:
            raise self._error
        data = bytes(received[:limit_bytes])
        del received[:limit_bytes]
        if self._is_paused and not received:
            self._is_paused = False
            if not self.transport.is_closing():
                self.transport.resume_reading()
        return data

    async def drain(self) -> None:
        """Wait until the system has accepted the written data.

        Raises:
            OSError: the connection is lost.
        """
        if self._lost.done() or self.transport.is_closing():
            raise self._error or ConnectionResetError("connection lost")
        if self.is_writing_paused:
            self._writable = asyncio.get_running_loop().create_future()
            try:
                await self._writable
            finally:
                self._writable = None

    async def wait_closed(self) -> None:
        """Wait until the connection is lost."""
        await asyncio.shield(self._lost)

    # -- what asyncio calls -------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport  # type: ignore[assignment]  # pyserial-asyncio's derives from no class of asyncio's

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - asyncio's signature
        return _INTO

    def buffer_updated(self, nbytes: int) -> None:
        received = self._received
        received += _VIEW[:nbytes]
        if len(received) >= READ_BYTES and not self._is_paused:
            self._is_paused = True
            self.transport.pause_reading()
        self.is_behind = self._is_paused or nbytes >= self.full_read_bytes
        self.on_readable()

    def data_received(self, data: bytes) -> None:
        """Add received data. pyserial-asyncio has no buffered protocols; it reads at most READ_BYTES."""
        _INTO[: len(data)] = data
        self.buffer_updated(len(data))

    def eof_received(self) -> bool:
        """Note that the peer sends no more. Data may still be sent to it."""
        self.is_ended = True
        self.on_readable()
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        self.is_ended = True
        self._error = exc
        self.on_readable()
        if self._writable is not None and not self._writable.done():
            self._writable.set_exception(exc or ConnectionResetError("connection lost"))
        if not self._lost.done():
            self._lost.set_result(None)

    def pause_writing(self) -> None:
        self.is_writing_paused = True

    def resume_writing(self) -> None:
        self.is_writing_paused = False
        if self._writable is not None and not self._writable.done():
            self._writable.set_result(None)


def ignore() -> None:
    """Do nothing: no reader is registered yet."""


class StreamTransport(BufferedConnection):
    """Transport over a stream, for TCP and serial ports. The write buffer's high-water mark is 0."""

    __slots__ = ("_is_closed", "address", "peer")

    kind = "stream"

    def __init__(self, *, peer: str = "", address: str = "") -> None:
        super().__init__()
        self.peer, self.address = peer, address
        self._is_closed = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.transport.set_write_buffer_limits(high=0)

    def start(self, on_readable: Callable[[], None]) -> None:
        """Call `on_readable` from now on whenever bytes arrived, and at the end."""
        self.on_readable = on_readable
        if self.unread_bytes or self.is_ended:
            on_readable()

    def write(self, data: bytes) -> bool:
        """Write the data in one call, so that it is one segment where possible."""
        if self.transport.is_closing():
            return False
        self.transport.write(data)
        return not self.is_writing_paused

    async def receive(self) -> bytes:
        """Wait for bytes; b"" at the end."""
        came = asyncio.Event()
        self.start(came.set)
        await came.wait()
        return self.read(2 * READ_BYTES)

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        self.write(data)
        await self.drain()

    def round_trip_s(self) -> float | None:
        """Return None: a stream has no measurement of its round trip."""
        return None

    def descriptor(self) -> int | None:
        """File descriptor of the socket or port, until it is being closed."""
        return None if self._is_closed or self.transport.is_closing() else self._open_descriptor()

    def _open_descriptor(self) -> int | None:
        """Return the descriptor of the open socket or port; None if there is none."""
        return None

    async def aclose(self) -> None:
        """Send what was written, then close. Abort after CLOSE_TIMEOUT_S or when cancelled."""
        if self._is_closed:  # a cancelled close cannot be awaited again
            return
        self._is_closed = True
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                with contextlib.suppress(OSError):  # a broken connection has nothing left to send
                    await self._leave()
                self.transport.close()
                await self.wait_closed()
        except TimeoutError:
            self._abort()
        except asyncio.CancelledError:
            self._abort()
            raise
        finally:
            self.on_readable = ignore  # otherwise link and connection form a reference cycle
            if self._error is not None:
                self._error.__traceback__ = None  # another one: its frames have the connection

    async def _leave(self) -> None:
        """Wait before closing. A stream needs nothing: closing sends what was written."""

    def _abort(self) -> None:
        self.transport.abort()


def set_options(connection: socket.socket, *, send_bytes: int, receive_bytes: int, user_timeout_ms: int) -> None:
    """Set the options of a connected socket.

    `send_bytes` and `receive_bytes` bound the kernel's buffers. `user_timeout_ms` bounds how long sent data may stay
    unacknowledged.

    Raises:
        OSError: the connection is lost.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_bytes)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    for name, value in {**KEEPALIVE, "TCP_USER_TIMEOUT": user_timeout_ms}.items():
        option = getattr(socket, name, None)  # some systems lack some of them
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
