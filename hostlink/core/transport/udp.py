"""UDP: one connected socket for each device, and the shared port for datagrams without a session.

The kernel gives a connected socket only the datagrams and ICMP errors of its peer, in a separate buffer. A flood from
other addresses therefore takes nothing from the device, an ICMP error ends no other link, and another process can get a
duplicate.
"""

import asyncio
import contextlib
import errno
import socket
import sys
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any, NamedTuple

from hostlink.core.config import UdpConfig
from hostlink.core.runtime.listening import bind_all, spelled
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.transport.base import READ_BYTES
from hostlink.core.transport.connection import ignore
from hostlink.core.transport.tcp import explain
from hostlink.errors import ConfigError

FREE_S = 1.5  # the guardian of a daemon that was killed has its port for half a second, to stop the robots
RETRY_S = 0.05

# -- allowance --------------------------------------------------------------------------------------------------------

HEADER_BYTES = 28  # IPv4 and UDP header of each datagram

RECEIVE_BUFFER_BYTES = 65536  # of one socket, in the kernel; datagrams above it are lost
NEW_DATAGRAMS_A_TURN = 16  # without a session; together they cost a tenth of a millisecond

LONGEST_BYTES = 65507  # payload of a datagram

MAX_DATAGRAM_BYTES = 1452  # to a device: passes Ethernet and WiFi unfragmented, also over IPv6 (1500 - 40 - 8)
DATAGRAMS_A_TURN = 4  # per device and turn of the loop: a robot sends tens a second
PATIENCE_S = 1.0  # wait for room in the kernel: a command that waited longer is expired

# A protocol that answers each datagram with two short ones, while its device introduces itself, needs some bytes more
# than it gets. With OPENED_A_SECOND of the acceptor it is 20 kB/s to forged addresses.
CREDIT_BYTES = 1024


class Allowance:
    """Byte allowance of an unverified address: no more is sent to it than came from it, with and without headers.

    The limit prevents that a forged source address is used to flood a third host.
    """

    def __init__(self, *, is_limited: bool, credit_bytes: int = 0) -> None:
        """`credit_bytes` may be sent beyond what came."""
        self.is_limited = is_limited
        self._payload_bytes = self._wire_bytes = credit_bytes

    def earn(self, size_bytes: int) -> None:
        """Add a received datagram to the allowance."""
        self._payload_bytes += size_bytes
        self._wire_bytes += size_bytes + HEADER_BYTES

    def allows(self, datagrams: Sequence[bytes]) -> bool:
        """Whether all of these datagrams may be sent."""
        if not self.is_limited:
            return True
        payload_bytes = sum(map(len, datagrams))
        wire_bytes = payload_bytes + HEADER_BYTES * len(datagrams)
        return payload_bytes <= self._payload_bytes and wire_bytes <= self._wire_bytes

    def spend(self, size_bytes: int) -> None:
        """Subtract a sent datagram from the allowance."""
        self._payload_bytes -= size_bytes
        self._wire_bytes -= size_bytes + HEADER_BYTES


# -- port -------------------------------------------------------------------------------------------------------------

_IP_PKTINFO = 8  # Linux value; Python has no constant for it
_ANCILLARY_BYTES = socket.CMSG_SPACE(20)  # size of in6_pktinfo, the longer one
_INTO = bytearray(LONGEST_BYTES + 1)  # shared by all sockets: data is copied out before the next one reads
_VIEW = memoryview(_INTO)

Address = tuple[Any, ...]  # as in the socket module: host and port, for IPv6 also flow info and scope


class Datagram(NamedTuple):
    """Received datagram with its source and the local address that it was sent to; replies are sent from there."""

    data: bytes
    source: Address
    local: Address


def receive_from(
    from_socket: socket.socket, dropped: Counter[str], limit_bytes: int = READ_BYTES
) -> tuple[bytes, Address] | None:
    """Receive the next datagram and its source; None if it is empty or larger than the limit.

    Raises:
        BlockingIOError: no datagram is waiting.
        OSError: an ICMP error was received.
    """
    size, source = from_socket.recvfrom_into(_INTO)
    if size > limit_bytes:
        dropped["too_large"] += 1
        return None
    return (bytes(_VIEW[:size]), source) if size else None


class UdpPort:
    """One bound and unconnected socket.

    `on_datagram` returns whether it opened a session. Then the turn of the loop ends, because that is expensive.
    """

    def __init__(
        self, bound: socket.socket, dropped: Counter[str], on_datagram: Callable[["UdpPort", Datagram], bool]
    ) -> None:
        self.family = bound.family
        self.address: Address = bound.getsockname()
        self._socket, self._dropped, self._on_datagram = bound, dropped, on_datagram
        asyncio.get_running_loop().add_reader(bound, self._receive)

    def connect(self, datagram: Datagram) -> socket.socket:
        """Open a socket that receives the datagrams of this source from now on.

        Raises:
            OSError: no descriptor is left, or the source cannot be reached.
        """
        connection = socket.socket(self.family, socket.SOCK_DGRAM)
        try:
            _set_options(connection)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            connection.bind(datagram.local)
            connection.connect(datagram.source)
        except BaseException:
            connection.close()
            raise
        return connection

    def send(self, data: bytes, to: Address) -> None:
        """Send to an address without a session. An unreachable address is counted and is not an error."""
        try:
            self._socket.sendto(data, to)
        except OSError:
            self._dropped["unreachable"] += 1

    def close(self) -> None:
        """Stop receiving."""
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def _receive(self) -> None:
        for _ in range(NEW_DATAGRAMS_A_TURN):
            try:
                size, ancillary, _, source = self._socket.recvmsg_into((_VIEW,), _ANCILLARY_BYTES)
            except BlockingIOError:
                return
            except OSError:
                self._dropped["unreachable"] += 1
                continue
            if size > READ_BYTES:
                self._dropped["too_large"] += 1
            elif size and self._on_datagram(
                self, Datagram(bytes(_VIEW[:size]), source, local_address(ancillary, self.address))
            ):
                return


def local_address(ancillary: list[tuple[int, int, bytes]], bound: Address) -> Address:
    """Return the local address that a datagram was sent to; the bound address if the system does not tell."""
    for level, kind, data in ancillary:
        if (level, kind) == (socket.IPPROTO_IP, _IP_PKTINFO):
            return socket.inet_ntop(socket.AF_INET, data[4:8]), bound[1]
        if (level, kind) == (socket.IPPROTO_IPV6, socket.IPV6_PKTINFO):
            host = socket.inet_ntop(socket.AF_INET6, data[:16])
            scope = int.from_bytes(data[16:20], sys.byteorder) if host.startswith("fe80:") else 0
            return host, bound[1], 0, scope
    return bound


@contextlib.asynccontextmanager
async def serve_udp(
    config: UdpConfig, dropped: Counter[str], on_datagram: Callable[[UdpPort, Datagram], bool], option: str = "--udp"
) -> AsyncIterator[list[UdpPort]]:
    """Receive until the block is left, on one port for each address of the host name. `option`: as in `explain`.

    Raises:
        ConfigError: the address cannot be used.
    """
    ports: list[UdpPort] = []
    try:
        try:
            found = await asyncio.get_running_loop().getaddrinfo(
                config.host, config.port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
            )
            bound = await _bind_soon(config, found)
            ports += [UdpPort(each, dropped, on_datagram) for each in bound]
        except UnicodeError as error:
            raise ConfigError(f"UDP {spelled(config.host, config.port)}", "is not a valid host name") from error
        except (OSError, OverflowError) as error:
            raise ConfigError(f"UDP {spelled(config.host, config.port)}", explain(error, option)) from error
        yield ports
    finally:
        for port in ports:
            port.close()


async def _bind_soon(config: UdpConfig, found: Sequence[tuple[Any, ...]]) -> list[socket.socket]:
    """Bind as soon as the port is free, within FREE_S.

    Raises:
        OSError: it is not free until then.
    """
    until_s = loop_time_s() + FREE_S
    while True:
        try:
            return bind_all(config.host, config.port, found, _bind)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or loop_time_s() >= until_s:
                raise
        await asyncio.sleep(RETRY_S)


def _bind(family: int, _protocol: int, address: Address) -> socket.socket:
    """Bind before SO_REUSEPORT is set.

    The bind therefore fails if another program uses the port, and afterwards only sockets of this user can share it.
    """
    bound = socket.socket(family, socket.SOCK_DGRAM)
    try:
        _set_options(bound)
        bound.bind(address)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        if sys.platform == "linux" and family == socket.AF_INET6:
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_RECVPKTINFO, 1)
        elif sys.platform == "linux":
            bound.setsockopt(socket.IPPROTO_IP, _IP_PKTINFO, 1)
    except BaseException:
        bound.close()
        raise
    return bound


def _set_options(made: socket.socket) -> None:
    made.setblocking(False)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    if made.family == socket.AF_INET6:
        made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)


# -- transport --------------------------------------------------------------------------------------------------------

_RESERVE = bytes(56)  # size of a velocity: the next frame is chosen when this much may be sent
_ANSWER = bytes(16)  # the same of a protocol whose devices wait for an answer, which is shorter than what they ask


class UdpTransport:
    """Transport over the socket of one session. It ends by silence, or when the peer's system refuses the port.

    A device with an unverified address is behind while it has not sent enough to allow the next velocity.
    """

    kind = "udp"

    def __init__(
        self,
        connection: socket.socket,
        first: Datagram,
        *,
        is_verified: bool,
        dropped: Counter[str],
        on_other: Callable[[Datagram], object],
        on_limited: Callable[[], None] = lambda: None,
        keeps_datagrams: bool = False,
    ) -> None:
        """`first` is the datagram that began the session. `keeps_datagrams`: each `read` returns one, whole.

        `on_other` gets datagrams of other sources that arrived before the socket was connected.

        `on_limited` is called when data cannot be sent because the device is not verified.
        """
        self.peer = spelled(*first.source[:2])
        self.address: str = first.source[0]
        self._socket, self._first = connection, first
        self._allowance = Allowance(is_limited=not is_verified, credit_bytes=CREDIT_BYTES if keeps_datagrams else 0)
        self._dropped, self._on_other, self._on_limited = dropped, on_other, on_limited
        self._on_readable: Callable[[], None] = ignore
        self._received = bytearray()
        self._lengths: deque[int] | None = deque() if keeps_datagrams else None  # of the datagrams in `_received`
        self._limit_bytes = LONGEST_BYTES if keeps_datagrams else READ_BYTES
        self._reserve = _ANSWER if keeps_datagrams else _RESERVE
        self._unsent: list[bytes] = []
        self.is_behind = False  # whether the kernel may have more datagrams
        self._is_reading = self._is_closed = False
        self._error: OSError | None = None
        self._progress = asyncio.Event()
        self.feed(first.data)

    @property
    def is_verified(self) -> bool:
        """Whether the device has proven that it receives at its source address."""
        return not self._allowance.is_limited

    def verify(self) -> None:
        """Note that the device has proven that it receives at its source address."""
        self._allowance.is_limited = False
        self._progress.set()

    # -- from the device ----------------------------------------------------------------------------------------------

    def start(self, on_readable: Callable[[], None]) -> None:
        """Call `on_readable` from now on whenever bytes arrived, and at the end."""
        self._on_readable = on_readable
        self._read_on()
        if self.unread_bytes or self.is_ended:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return len(self._received)

    @property
    def is_ended(self) -> bool:
        """Whether the connection ended, so that no more bytes arrive."""
        return self._is_closed or self._error is not None

    def read(self, limit_bytes: int) -> bytes:
        """Return received bytes, or the next datagram; b"" when none are unread, and after `aclose`.

        Raises:
            OSError: the device's port is closed, and every byte before was read.
        """
        if not self._received and self._error is not None:
            raise self._error
        if self._lengths:
            limit_bytes = self._lengths.popleft()
        data = bytes(self._received[:limit_bytes])
        del self._received[:limit_bytes]
        self._read_on()
        return data

    def feed(self, data: bytes) -> None:
        """Add a datagram of this device that arrived at the shared port."""
        if self.is_ended or self._is_full:
            self._dropped["unread"] += 1
            return
        self._add(data)
        self._on_readable()

    async def receive(self) -> bytes:
        """Wait for bytes; b"" at the end."""
        came = asyncio.Event()
        self.start(came.set)
        await came.wait()
        return self.read(2 * READ_BYTES)

    @property
    def _is_full(self) -> bool:
        return len(self._received) >= READ_BYTES

    def _read_on(self) -> None:
        """Read the socket while there is room. Otherwise the kernel keeps the data, up to its bound."""
        if not self._is_reading and not self._is_full and not self.is_ended:
            self._is_reading = True
            asyncio.get_running_loop().add_reader(self._socket, self._receive)

    def _stop_reading(self) -> None:
        if self._is_reading:
            self._is_reading = False
            asyncio.get_running_loop().remove_reader(self._socket)

    def _receive(self) -> None:
        self.is_behind = True
        for _ in range(DATAGRAMS_A_TURN):
            try:
                found = receive_from(self._socket, self._dropped, self._limit_bytes)
            except BlockingIOError:
                self.is_behind = False
                break
            except ConnectionRefusedError:
                self._break()
                return
            except OSError:  # no route at the moment; the silence timeout decides
                self._dropped["unreachable"] += 1
                continue
            if found is None:
                continue
            data, source = found
            if source[:2] != self._first.source[:2]:
                self._on_other(Datagram(data, source, self._first.local))
                continue
            self._add(data)
            if self._is_full:
                self._stop_reading()
                break
        if self._received:
            self._on_readable()

    def _add(self, data: bytes) -> None:
        self._received += data
        if self._lengths is not None and data:
            self._lengths.append(len(data))
        self._allowance.earn(len(data))
        self._progress.set()

    def _break(self) -> None:
        """End the transport: the device's port is closed (ICMP). Report a reset, as TCP does."""
        if not self.is_ended:
            self._error = ConnectionResetError(errno.ECONNRESET, "the device's port is closed")
            self._stop_reading()
            self._progress.set()
            asyncio.get_running_loop().call_soon(self._on_readable)

    # -- to the device ------------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> bool:
        """Send a frame as one datagram, or as several if it exceeds MAX_DATAGRAM_BYTES and is part of a stream.

        A frame that may not be sent is dropped. If it were kept, it could move the robot after a later stop.
        """
        if self.is_ended:
            return False
        datagrams = [data]
        if self._lengths is None:
            datagrams = [data[at : at + MAX_DATAGRAM_BYTES] for at in range(0, len(data), MAX_DATAGRAM_BYTES)]
        if self._allowance.allows(datagrams):
            self._unsent = datagrams
        else:
            self._give_up()
        return self._flush() and self._has_reserve

    async def drain(self) -> None:
        """Wait until the written data was sent and the allowance permits a velocity.

        Raises:
            OSError: the connection broke, or was closed.
        """
        await self._leave()
        while not self._has_reserve:
            if not await self._is_progress():
                self._on_limited()
            self._check()

    async def send(self, data: bytes) -> None:
        """Write, and wait until the data was sent."""
        self.write(data)
        await self._leave()
        await asyncio.sleep(0)  # a datagram sender never blocks, so yield to other tasks

    @property
    def _has_reserve(self) -> bool:
        return self._allowance.allows((self._reserve,))

    def _give_up(self) -> None:
        self._unsent.clear()
        self._dropped["unsent"] += 1
        self._on_limited()

    async def _leave(self) -> None:
        """Wait until the written data was sent. Drop it after PATIENCE_S without room in the kernel."""
        self._check()
        loop = asyncio.get_running_loop()
        while not self._flush():
            loop.add_writer(self._socket, self._progress.set)
            try:
                if not await self._is_progress():
                    self._unsent.clear()
                    self._dropped["unsent"] += 1
            finally:
                if not self._is_closed:
                    loop.remove_writer(self._socket)
            self._check()

    async def _is_progress(self) -> bool:
        """Wait until a datagram arrived or may be sent, at most PATIENCE_S. Return whether one did."""
        self._progress.clear()
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._progress.wait()
        except TimeoutError:
            return False
        return True

    def _check(self) -> None:
        if self.is_ended:
            raise self._error or ConnectionResetError("connection lost")

    def _flush(self) -> bool:
        """Send as much as the kernel accepts. Return whether everything was sent."""
        while self._unsent:
            try:
                self._socket.send(self._unsent[0])
            except BlockingIOError:
                return False
            except ConnectionRefusedError:
                self._break()
                return False
            except OSError:  # no route at the moment; the silence timeout decides
                self._dropped["unreachable"] += 1
            self._allowance.spend(len(self._unsent.pop(0)))
        return True

    # -- its end ------------------------------------------------------------------------------------------------------

    def round_trip_s(self) -> float | None:
        """Return None: UDP has no measurement of its round trip."""
        return None

    def descriptor(self) -> int | None:
        """File descriptor of the socket, until it is closed."""
        return None if self._is_closed else self._socket.fileno()

    async def aclose(self) -> None:
        """Close at once. Everything that was sent has left the process."""
        if self._is_closed:
            return
        self._stop_reading()
        asyncio.get_running_loop().remove_writer(self._socket)
        self._is_closed = True
        self._progress.set()
        with contextlib.suppress(OSError):  # a duplicate in another process receives no more datagrams of the device
            self._socket.connect(self._socket.getsockname())
        self._socket.close()
        on_readable, self._on_readable = self._on_readable, ignore
        on_readable()
