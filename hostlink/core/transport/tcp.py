"""TcpTransport, and the listener for TCP devices."""

import asyncio
import contextlib
import errno
import fcntl
import socket
import struct
import sys
import termios
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass

from hostlink.core.config import TcpConfig
from hostlink.core.runtime.acceptor import Acceptor, bind, why
from hostlink.core.runtime.listening import spelled
from hostlink.core.transport.base import Transport
from hostlink.core.transport.connection import StreamTransport, set_options
from hostlink.errors import ConfigError

# -- stall ------------------------------------------------------------------------------------------------------------

STALL_S = 0.4  # longer than a peer may delay an acknowledgement (lwIP on an ESP8266: 0.25 s)

SEND_BUFFER_BYTES = 8192  # bounds old commands in the kernel, where they cannot be replaced
RECEIVE_BUFFER_BYTES = 65536  # bounds how late a device's data may be during a flood
STALL_POLL_S = 0.01
CHECK_S = 0.05  # between looks for unacknowledged bytes: STALL_S is eight of them
USER_TIMEOUT_MS = 5000  # the peer is gone when sent data stays unacknowledged for longer


class Stall:
    """Detector of a stalled peer, from the number of sent and of unacknowledged bytes."""

    __slots__ = ("_acknowledged_bytes", "_is_waiting", "_since_s")

    def __init__(self) -> None:
        self._is_waiting = False
        self._acknowledged_bytes = 0
        self._since_s = 0.0  # time of the last progress, or of the first unacknowledged byte

    def is_stalled(self, *, sent_bytes: int, unacknowledged_bytes: int, now_s: float) -> bool:
        """Whether bytes are unacknowledged and none was acknowledged for STALL_S."""
        acknowledged_bytes = sent_bytes - unacknowledged_bytes
        if not self._is_waiting or acknowledged_bytes > self._acknowledged_bytes:
            self._acknowledged_bytes, self._since_s = acknowledged_bytes, now_s
        self._is_waiting = unacknowledged_bytes > 0
        return self._is_waiting and now_s >= self._since_s + STALL_S


# -- tcp --------------------------------------------------------------------------------------------------------------

_I32 = struct.Struct("=i")
_RTT_AT = 68  # offset of tcpi_rtt, in microseconds, in Linux's struct tcp_info


@dataclass(frozen=True, slots=True)
class Listener:
    """Address of the listening socket."""

    address: tuple[str, int]


class StallChecks:
    """Asks the kernel what peers have not acknowledged: once in CHECK_S, of all connections that were written to."""

    def __init__(self) -> None:
        self._written: dict[TcpTransport, None] = {}

    def add(self, transport: "TcpTransport") -> None:
        """Note a connection that was written to."""
        if not self._written:
            asyncio.get_running_loop().call_later(CHECK_S, self._check)
        self._written[transport] = None

    def _check(self) -> None:
        written, self._written = self._written, {}
        for transport in written:
            transport.check_stall()


class TcpTransport(StreamTransport):
    """TCP connection with a measured round trip. Nothing more is sent to it while the network stalls."""

    __slots__ = ("_checks", "_is_acknowledged", "_on_made", "_sent_bytes", "_socket", "_stall")

    kind = "tcp"

    def __init__(self, on_made: Callable[["TcpTransport"], None], checks: StallChecks) -> None:
        """`on_made` is called when the connection has its peer and its options. `checks` is that of all connections."""
        super().__init__()
        self._on_made, self._checks = on_made, checks
        self._is_acknowledged = True  # at the newest look; until the next one, nothing stalls
        self._socket: socket.socket | None = None
        self._sent_bytes = 0
        self._stall = Stall()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        made: socket.socket = transport.get_extra_info("socket")
        peername = transport.get_extra_info("peername")
        try:
            set_options(
                made,
                send_bytes=SEND_BUFFER_BYTES,
                receive_bytes=RECEIVE_BUFFER_BYTES,
                user_timeout_ms=USER_TIMEOUT_MS,
            )
        except OSError:
            peername = None
        if peername is None:  # the peer has already reset the connection
            self.transport.abort()
            return
        self._socket, self.address, self.peer = made, peername[0], spelled(*peername[:2])
        self._on_made(self)

    def write(self, data: bytes) -> bool:
        """Write, and report False during a stall, so that the next frame is chosen as late as possible."""
        if self.transport.is_closing():
            return False
        self.transport.write(data)
        self._sent_bytes += len(data)
        self._checks.add(self)
        return not self.is_writing_paused and (self._is_acknowledged or not self._is_stalled())

    def check_stall(self) -> None:
        """Look for unacknowledged bytes, which may be the beginning of a stall."""
        self._is_stalled()

    async def drain(self) -> None:
        """Wait until the peer acknowledges what was sent."""
        await super().drain()
        while self._is_stalled():  # noqa: ASYNC110 - the kernel sends no event
            await asyncio.sleep(STALL_POLL_S)

    def _is_stalled(self) -> bool:
        """Whether the peer acknowledges nothing; False where the system does not tell, or the connection is lost."""
        unacknowledged_bytes = self._unacknowledged()
        self._is_acknowledged = not unacknowledged_bytes
        return self._stall.is_stalled(
            sent_bytes=self._sent_bytes,
            unacknowledged_bytes=unacknowledged_bytes,
            now_s=asyncio.get_running_loop().time(),
        )

    def _unacknowledged(self) -> int:
        """Ask the kernel how many bytes the peer has not acknowledged."""
        connection = self._socket
        if connection is None or sys.platform != "linux" or self._lost.done():
            return 0
        number = connection.fileno()
        return 0 if number < 0 else int(_I32.unpack(fcntl.ioctl(number, termios.TIOCOUTQ, bytes(4)))[0])

    async def _leave(self) -> None:
        await super().drain()
        self._shut_down()

    def _abort(self) -> None:
        self._shut_down()
        super()._abort()

    def _shut_down(self) -> None:
        """Shut the connection down. Closing alone would not end it while another process holds a duplicate."""
        number = None if self.transport.is_closing() else self._open_descriptor()
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
        return None if found is None or self._lost.done() or found.fileno() < 0 else found


class PromptTcpTransport(TcpTransport):
    """TCP connection that acknowledges each segment at once.

    A device that writes one message with two calls, and leaves Nagle's algorithm on, keeps the second part until the
    first is acknowledged. Linux delays that acknowledgement by 40 ms.
    """

    __slots__ = ()

    def buffer_updated(self, nbytes: int) -> None:
        connection = self._open_socket()
        if connection is not None and hasattr(socket, "TCP_QUICKACK"):
            with contextlib.suppress(OSError):  # the connection is lost
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)  # the kernel forgets it soon
        super().buffer_updated(nbytes)


@contextlib.asynccontextmanager
async def serve_tcp(
    config: TcpConfig,
    on_connection: Callable[[Transport], None],
    *,
    on_exhausted: Callable[[], None],
    listening: Sequence[socket.socket] = (),
    option: str = "--listen",
    is_prompt: bool = False,
) -> AsyncIterator[Listener]:
    """Accept devices until the block is left. Links end after the listener.

    `on_exhausted` is called at each try to accept without a free descriptor. `listening`: sockets from
    `hostlink.core.runtime.listening` that listen already. `option`: as in `explain`. `is_prompt`: connections are
    `PromptTcpTransport`s.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    async def open_transport(connection: socket.socket) -> None:
        try:
            await loop.connect_accepted_socket(lambda: kind(on_connection, checks), connection)
        except OSError:  # the peer has reset the connection
            connection.close()
        except Exception as error:  # noqa: BLE001 - a defect in opening one connection ends neither listener nor daemon
            connection.close()
            loop.call_exception_handler({"message": "a connection could not be opened", "exception": error})

    def accepted(connection: socket.socket, peer: str, _: float) -> None:
        tasks.create_task(open_transport(connection), name=f"opening of {peer}")

    loop, checks, kind = asyncio.get_running_loop(), StallChecks(), PromptTcpTransport if is_prompt else TcpTransport
    try:
        sockets = list(listening) or await bind(config.host, config.port)
    except (OSError, OverflowError, UnicodeError) as error:
        raise ConfigError(f"TCP {spelled(config.host, config.port)}", explain(error, option)) from error
    address = sockets[0].getsockname()[:2]
    async with asyncio.TaskGroup() as tasks:
        acceptor = Acceptor(sockets, accepted, on_exhausted=on_exhausted)
        try:
            yield Listener(address)
        finally:
            acceptor.close()


def explain(error: OSError | OverflowError | UnicodeError, option: str) -> str:
    """Explain why an address cannot be listened on. `option` is the flag that chooses another, `--micro-ros udp://`."""
    other = f"{option}HOST:PORT" if option.endswith("/") else f"{option} HOST:PORT"
    if isinstance(error, UnicodeError):
        return f"{why(error)}; choose another with {other}"
    if isinstance(error, OverflowError):
        return why(error)
    if error.errno == errno.EADDRINUSE:
        owner = "a micro-ROS agent" if option.startswith("--micro-ros") else "another rosserial host"
        return f"is in use, probably by {owner}; stop it, or choose another port with {other}"
    return f"cannot be listened on: {why(error)}"


# -- mDNS -------------------------------------------------------------------------------------------------------------
