"""StreamTransport and TcpTransport, and the listener for TCP devices."""

import asyncio
import contextlib
import errno
import fcntl
import os
import socket
import struct
import sys
import termios
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass

from hostlink.acceptor import bind
from hostlink.config import TcpConfig
from hostlink.errors import ConfigError
from hostlink.listening import BACKLOG
from hostlink.transport.base import CLOSE_TIMEOUT_S, READ_BYTES, Stall, Transport
from hostlink.transport.connection import Connection, ignore
from hostlink.transport.socket_options import set_options

# -- stream -----------------------------------------------------------------------------------------------------------


class StreamTransport:
    """Transport over a Connection, for TCP and serial ports. The write buffer's high-water mark is 0."""

    kind = "stream"

    def __init__(self, connection: Connection, *, peer: str, address: str) -> None:
        self.peer, self.address = peer, address
        self._connection = connection
        self._is_closed = False
        connection.transport.set_write_buffer_limits(high=0)

    def start(self, on_readable: Callable[[], None]) -> None:
        """Call `on_readable` from now on whenever bytes arrived, and at the end."""
        self._connection.on_readable = on_readable
        if self.unread_bytes or self.is_ended:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return self._connection.unread_bytes

    @property
    def is_ended(self) -> bool:
        """Whether the connection ended, so that no more bytes arrive."""
        return self._connection.is_ended

    def read(self, limit_bytes: int) -> bytes:
        """Return received bytes; b"" when none are unread, and at the end."""
        return self._connection.read(limit_bytes)

    def write(self, data: bytes) -> bool:
        """Write the data in one call, so that it is one segment where possible."""
        connection = self._connection
        if connection.transport.is_closing():
            return False
        connection.transport.write(data)
        return not connection.is_writing_paused

    async def drain(self) -> None:
        """Wait until the system has accepted the written data."""
        await self._connection.drain()

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
        return None if self._is_closed or self._connection.transport.is_closing() else self._open_descriptor()

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
                self._connection.transport.close()
                await self._connection.wait_closed()
        except TimeoutError:
            self._abort()
        except asyncio.CancelledError:
            self._abort()
            raise
        finally:
            self._connection.on_readable = ignore  # otherwise link and connection form a reference cycle

    async def _leave(self) -> None:
        """Wait before closing. A stream needs nothing: closing sends what was written."""

    def _abort(self) -> None:
        self._connection.transport.abort()


# -- tcp --------------------------------------------------------------------------------------------------------------

_RTT_AT = 68  # offset of tcpi_rtt, in microseconds, in Linux's struct tcp_info
SEND_BUFFER_BYTES = 8192  # bounds old commands in the kernel, where they cannot be replaced
RECEIVE_BUFFER_BYTES = 65536  # bounds how late a device's data may be during a flood
ACCEPTED_AT_ONCE = 1  # per turn of the loop, because each connection costs about a millisecond
STALL_POLL_S = 0.01
USER_TIMEOUT_MS = 5000  # the peer is gone when sent data stays unacknowledged for longer


@dataclass(frozen=True, slots=True)
class Listener:
    """Address of the listening socket."""

    address: tuple[str, int]


class TcpTransport(StreamTransport):
    """TCP connection with a measured round trip. Nothing more is sent to it while the network stalls."""

    kind = "tcp"

    def __init__(self, connection: Connection, *, peer: str, address: str) -> None:
        super().__init__(connection, peer=peer, address=address)
        self._socket: socket.socket | None = connection.transport.get_extra_info("socket")
        self._sent_bytes = 0
        self._stall = Stall()

    def write(self, data: bytes) -> bool:
        """Write, and report False during a stall, so that the next frame is chosen as late as possible."""
        is_through = super().write(data)
        self._sent_bytes += len(data)
        return is_through and not self._is_stalled()

    async def drain(self) -> None:
        """Wait until the peer acknowledges what was sent."""
        await super().drain()
        while self._is_stalled():  # noqa: ASYNC110 - the kernel sends no event
            await asyncio.sleep(STALL_POLL_S)

    def _is_stalled(self) -> bool:
        now_s = asyncio.get_running_loop().time()
        waiting = self._unacknowledged_bytes()
        return self._stall.is_stalled(sent_bytes=self._sent_bytes, unacknowledged_bytes=waiting, now_s=now_s)

    def _unacknowledged_bytes(self) -> int:
        """Number of unacknowledged bytes; 0 where the system has no such figure, or the connection is lost."""
        connection = self._open_socket()
        if connection is None or sys.platform != "linux":
            return 0
        return int(struct.unpack("=i", fcntl.ioctl(connection.fileno(), termios.TIOCOUTQ, bytes(4)))[0])

    async def _leave(self) -> None:
        await self._connection.drain()
        self._shut_down()

    def _abort(self) -> None:
        self._shut_down()
        super()._abort()

    def _shut_down(self) -> None:
        """Shut the connection down. Closing alone would not end it while another process holds a duplicate."""
        number = None if self._connection.transport.is_closing() else self._open_descriptor()
        if number is None:
            return
        connection = socket.socket(fileno=number)
        with contextlib.suppress(OSError):  # the peer has closed already
            connection.shutdown(socket.SHUT_RDWR)
        connection.detach()

    def round_trip_s(self) -> float | None:
        """Round trip time from the kernel; None where it has no TCP_INFO, or the connection is lost."""
        connection = self._open_socket()
        if connection is None or not hasattr(socket, "TCP_INFO"):
            return None
        try:
            info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RTT_AT + 4)
        except OSError:
            return None
        rtt_us: int = struct.unpack_from("=I", info, _RTT_AT)[0]
        return rtt_us / 1e6

    def _open_descriptor(self) -> int | None:
        found = self._open_socket()
        return None if found is None else found.fileno()

    def _open_socket(self) -> socket.socket | None:
        """Return the open socket. None when it is closed: uvloop's closed sockets raise on any call."""
        found = self._socket
        return None if found is None or self._connection.is_lost or found.fileno() < 0 else found


@contextlib.asynccontextmanager
async def serve_tcp(
    config: TcpConfig, on_connection: Callable[[Transport], None], *, listening: Sequence[socket.socket] = ()
) -> AsyncIterator[Listener]:
    """Accept devices until the block is left. `listening`: sockets from `hostlink.listening` that listen already.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    def accept(connection: Connection) -> None:
        peername = connection.transport.get_extra_info("peername")
        try:
            set_options(
                connection.transport.get_extra_info("socket"),
                send_bytes=SEND_BUFFER_BYTES,
                receive_bytes=RECEIVE_BUFFER_BYTES,
                user_timeout_ms=USER_TIMEOUT_MS,
            )
        except OSError:
            peername = None
        if peername is None:  # the peer has already reset the connection
            connection.transport.abort()
            return
        host, port = peername[:2]
        on_connection(TcpTransport(connection, peer=spelled(host, port), address=host))

    loop = asyncio.get_running_loop()
    try:
        sockets = listening or await bind(config.host, config.port)
    except (OSError, OverflowError) as error:
        raise ConfigError(f"TCP {spelled(config.host, config.port)}", explain(error, "--listen")) from error
    address = sockets[0].getsockname()[:2]
    servers = [
        await loop.create_server(lambda: Connection(accept), sock=each, backlog=ACCEPTED_AT_ONCE) for each in sockets
    ]
    for server in servers:
        for each in server.sockets:
            with socket.socket(fileno=os.dup(each.fileno())) as same:
                same.listen(BACKLOG)  # kernel backlog; asyncio uses one number for both
    try:
        yield Listener(address)
    finally:
        for server in servers:
            server.close()  # wait_closed would wait for the links, which end after the listener


def spelled(host: str, port: int) -> str:
    """Format an address for people; IPv6 in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def explain(error: OSError | OverflowError, option: str) -> str:
    """Explain why an address cannot be listened on. `option` is the flag that chooses another."""
    if isinstance(error, OverflowError):
        return "invalid port; choose 0 (any free port) to 65535"
    if error.errno == errno.EADDRINUSE:
        return f"is in use, probably by another rosserial host; stop it, or choose another port with {option} HOST:PORT"
    is_lookup = isinstance(error, socket.gaierror)  # getaddrinfo has its own error numbers
    reason = error.strerror if is_lookup or error.errno is None else os.strerror(error.errno)
    return f"cannot be listened on: {reason or error}"  # Python 3.13 has only a text for an address of no interface
