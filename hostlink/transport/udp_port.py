"""UdpPort: shared UDP socket for datagrams without a session. It connects a socket for each session."""

import asyncio
import contextlib
import socket
import sys
from collections import Counter
from collections.abc import AsyncIterator, Callable
from typing import Any, NamedTuple

from hostlink.config import UdpConfig
from hostlink.errors import ConfigError
from hostlink.transport.base import READ_BYTES
from hostlink.transport.tcp import explain, spelled

RECEIVE_BUFFER_BYTES = 65536  # of one socket, in the kernel; datagrams above it are lost
DATAGRAMS_A_TURN = 16  # without a session; together they cost a tenth of a millisecond
_IP_PKTINFO = 8  # Linux value; Python has no constant for it
_ANCILLARY_BYTES = socket.CMSG_SPACE(20)  # size of in6_pktinfo, the longer one
_INTO = bytearray(READ_BYTES + 1)  # shared by all sockets: data is copied out before the next one reads
_VIEW = memoryview(_INTO)

Address = tuple[Any, ...]  # as in the socket module: host and port, for IPv6 also flow info and scope


class Datagram(NamedTuple):
    """Received datagram with its source and the local address that it was sent to; replies are sent from there."""

    data: bytes
    source: Address
    local: Address


def receive_from(from_socket: socket.socket, dropped: Counter[str]) -> tuple[bytes, Address] | None:
    """Receive the next datagram and its source; None if it is empty or larger than READ_BYTES.

    Raises:
        BlockingIOError: no datagram is waiting.
        OSError: an ICMP error was received.
    """
    size, source = from_socket.recvfrom_into(_INTO)
    if size > READ_BYTES:
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
        for _ in range(DATAGRAMS_A_TURN):
            try:
                size, ancillary, _, source = self._socket.recvmsg_into((_VIEW,), _ANCILLARY_BYTES)
            except BlockingIOError:
                return
            except OSError:
                self._dropped["unreachable"] += 1
                continue
            if size > READ_BYTES:
                self._dropped["too_large"] += 1
            elif size and self._on_datagram(self, Datagram(bytes(_VIEW[:size]), source, self._local(ancillary))):
                return

    def _local(self, ancillary: list[tuple[int, int, bytes]]) -> Address:
        """Return the local address that a datagram was sent to."""
        for level, kind, data in ancillary:
            if (level, kind) == (socket.IPPROTO_IP, _IP_PKTINFO):
                return socket.inet_ntop(socket.AF_INET, data[4:8]), self.address[1]
            if (level, kind) == (socket.IPPROTO_IPV6, socket.IPV6_PKTINFO):
                host = socket.inet_ntop(socket.AF_INET6, data[:16])
                scope = int.from_bytes(data[16:20], sys.byteorder) if host.startswith("fe80:") else 0
                return host, self.address[1], 0, scope
        return self.address


@contextlib.asynccontextmanager
async def serve_udp(
    config: UdpConfig, dropped: Counter[str], on_datagram: Callable[[UdpPort, Datagram], bool]
) -> AsyncIterator[list[UdpPort]]:
    """Receive until the block is left, on one port for each address of the host name.

    Raises:
        ConfigError: the address cannot be used.
    """
    ports: list[UdpPort] = []
    try:
        try:
            found = await asyncio.get_running_loop().getaddrinfo(
                config.host, config.port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
            )
            for family, _, _, _, address in dict.fromkeys(found):
                ports.append(UdpPort(_bind(family, address), dropped, on_datagram))
        except UnicodeError as error:
            raise ConfigError(f"UDP {spelled(config.host, config.port)}", "is not a valid host name") from error
        except (OSError, OverflowError) as error:
            raise ConfigError(f"UDP {spelled(config.host, config.port)}", explain(error, "--udp")) from error
        yield ports
    finally:
        for port in ports:
            port.close()


def _bind(family: int, address: Address) -> socket.socket:
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
