"""StreamTransport: a Connection as a Transport; TCP and serial ports differ only in how they open."""

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
    """Owns the connection. Nothing waits in the process behind `send`: the write buffer's high-water mark is 0."""

    kind = "stream"

    def __init__(self, connection: Connection, *, peer: str, address: str) -> None:
        self.peer, self.address = peer, address
        self._connection = connection
        self._is_closed = False
        connection.transport.set_write_buffer_limits(high=0)

    def start(self, on_readable: Callable[[], None]) -> None:
        """From now on `on_readable` is called whenever bytes have come, and at the end."""
        self._connection.on_readable = on_readable
        if self.unread_bytes or self.is_ended:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """What has come and was not read."""
        return self._connection.unread_bytes

    @property
    def is_ended(self) -> bool:
        """Whether nothing more will come."""
        return self._connection.is_ended

    def read(self, limit_bytes: int) -> bytes:
        """What has come; b"" while there is nothing, and at the end."""
        return self._connection.read(limit_bytes)

    def write(self, data: bytes) -> bool:
        """One write, so one segment where it fits."""
        connection = self._connection
        if connection.transport.is_closing():
            return False
        connection.transport.write(data)
        return not connection.is_writing_paused

    async def drain(self) -> None:
        """Returns when the system has what was written."""
        await self._connection.drain()

    async def receive(self) -> bytes:
        """What has come; b"" at the end."""
        came = asyncio.Event()
        self.start(came.set)
        await came.wait()
        return self.read(2 * READ_BYTES)

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        self.write(data)
        await self.drain()

    def round_trip_s(self) -> float | None:
        """Nobody measures it."""
        return None

    def descriptor(self) -> int | None:
        """The socket's or the port's, until it is being closed."""
        return None if self._is_closed or self._connection.transport.is_closing() else self._open_descriptor()

    def _open_descriptor(self) -> int | None:
        """None where there is none."""
        return None

    async def aclose(self) -> None:
        """Let what was sent leave, but do not wait for a dead peer; whoever gives this up aborts."""
        if self._is_closed:  # a close that was given up cannot be waited for again
            return
        self._is_closed = True
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                with contextlib.suppress(OSError):  # a broken connection has nothing to leave
                    await self._leave()
                self._connection.transport.close()
                await self._connection.wait_closed()
        except TimeoutError:
            self._abort()
        except asyncio.CancelledError:
            self._abort()
            raise
        finally:
            self._connection.on_readable = ignore  # else link and connection keep each other until a collection

    async def _leave(self) -> None:
        """What must be waited for before the connection is closed: nothing, closing sends what was written."""

    def _abort(self) -> None:
        self._connection.transport.abort()


# -- tcp --------------------------------------------------------------------------------------------------------------

_RTT_AT = 68  # tcpi_rtt, microseconds, in Linux's struct tcp_info
SEND_BUFFER_BYTES = 8192  # stale commands must not pile up in the kernel, where nothing can replace them
RECEIVE_BUFFER_BYTES = 65536  # of a flood, in the kernel: by so much a device's news may be late
ACCEPTED_AT_ONCE = 1  # before others have their turn: each connection costs about a millisecond
STALL_POLL_S = 0.01
USER_TIMEOUT_MS = 5000  # sent and not acknowledged after that: the peer is gone


@dataclass(frozen=True, slots=True)
class Listener:
    """Where it really listens."""

    address: tuple[str, int]


class TcpTransport(StreamTransport):
    """A connection whose system measures the way, and is sent nothing more while the network stands still."""

    kind = "tcp"

    def __init__(self, connection: Connection, *, peer: str, address: str) -> None:
        super().__init__(connection, peer=peer, address=address)
        self._socket: socket.socket | None = connection.transport.get_extra_info("socket")
        self._sent_bytes = 0
        self._stall = Stall()

    def write(self, data: bytes) -> bool:
        """What is next is chosen as late as can be: when the peer keeps up with what was sent."""
        is_through = super().write(data)
        self._sent_bytes += len(data)
        return is_through and not self._is_stalled()

    async def drain(self) -> None:
        """Returns when the peer keeps up with what was sent."""
        await super().drain()
        while self._is_stalled():  # noqa: ASYNC110 - the kernel sends no event
            await asyncio.sleep(STALL_POLL_S)

    def _is_stalled(self) -> bool:
        now_s = asyncio.get_running_loop().time()
        waiting = self._unacknowledged_bytes()
        return self._stall.is_stalled(sent_bytes=self._sent_bytes, unacknowledged_bytes=waiting, now_s=now_s)

    def _unacknowledged_bytes(self) -> int:
        """0 where the system has no such figure, or the connection is gone."""
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
        """End the connection for the peer, also while another process holds a duplicate: closing this one would not."""
        number = None if self._connection.transport.is_closing() else self._open_descriptor()
        if number is None:
            return
        connection = socket.socket(fileno=number)
        with contextlib.suppress(OSError):  # the peer was first
            connection.shutdown(socket.SHUT_RDWR)
        connection.detach()

    def round_trip_s(self) -> float | None:
        """What the kernel makes of its acknowledgements; None where it has no TCP_INFO, or the connection is gone."""
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
        """None when it is closed: asyncio's own has no descriptor then, and uvloop's fails at any question."""
        found = self._socket
        return None if found is None or self._connection.is_lost or found.fileno() < 0 else found


@contextlib.asynccontextmanager
async def serve_tcp(
    config: TcpConfig, on_connection: Callable[[Transport], None], *, listening: Sequence[socket.socket] = ()
) -> AsyncIterator[Listener]:
    """Accept devices until the block is left. `listening`: sockets that listen already, from `hostlink.listening`.

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
        if peername is None:  # it has reset the connection already
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
                same.listen(BACKLOG)  # in the kernel, where asyncio means both by one number
    try:
        yield Listener(address)
    finally:
        for server in servers:
            server.close()  # wait_closed would wait for the links, which end after the listener


def spelled(host: str, port: int) -> str:
    """An address for people; IPv6 in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def explain(error: OSError | OverflowError, option: str) -> str:
    """Why an address cannot be listened on; `option` chooses another."""
    if isinstance(error, OverflowError):
        return "no such port; they go from 0 (any free one) to 65535"
    if error.errno == errno.EADDRINUSE:
        return f"is in use: another host for rosserial runs; stop it, or choose another port with {option} HOST:PORT"
    is_lookup = isinstance(error, socket.gaierror)  # its numbers are not the system's
    reason = error.strerror if is_lookup or error.errno is None else os.strerror(error.errno)
    return f"cannot be listened on: {reason or error}"  # Python 3.13 has a text alone for an address of no interface
