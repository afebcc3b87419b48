"""Port: a listening port of this node. It admits so many connections, from where it may, and counts the others."""

import asyncio
import contextlib
import ipaddress
import socket
from collections.abc import Callable, Sequence

from hostlink.acceptor import Acceptor, bind, close_all
from hostlink.graphs.ros1.counts import Counts

MakeProtocol = Callable[[], asyncio.BaseProtocol]
Spawn = Callable[..., object]


class Port:
    """Owns the listening sockets, and accepted ones until their protocols have them. First `bind`, then `accept`."""

    def __init__(self, counts: Counts, *, allow: Sequence[str], max_connections: int) -> None:
        """`allow`: networks from which somebody may connect; none named: all."""
        self._counts = counts
        self._networks = [ipaddress.ip_network(network) for network in allow]
        self._max_connections = max_connections
        self._opening = 0
        self._transports: list[asyncio.BaseTransport] = []
        self._listening: list[socket.socket] = []
        self._acceptor: Acceptor | None = None

    async def bind(self, host: str, port: int) -> int:
        """Listen; returns the number of the port.

        Raises:
            OSError: nobody can listen there.
        """
        self._listening = await bind(host, port)
        return int(self._listening[0].getsockname()[1])

    def accept(self, make_protocol: MakeProtocol, spawn: Spawn) -> None:
        """Serve connections from now on."""

        def accepted(connection: socket.socket, address: str) -> None:
            if not self._admits(address):
                self._counts.refused_connections += 1
                connection.close()
                return
            self._opening += 1
            spawn(self._open(connection, make_protocol), name=f"ROS 1 connection of {address}")

        self._acceptor = Acceptor(self._listening, accepted, on_exhausted=self._note_refused)

    def close(self) -> None:
        """End the connections, too."""
        if self._acceptor is not None:
            self._acceptor.close()
        close_all(self._listening)
        for transport in self._transports:
            transport.close()

    def _admits(self, address: str) -> bool:
        self._transports = [each for each in self._transports if not each.is_closing()]
        is_allowed = not self._networks or any(ipaddress.ip_address(address) in each for each in self._networks)
        return is_allowed and len(self._transports) + self._opening < self._max_connections

    async def _open(self, connection: socket.socket, make_protocol: MakeProtocol) -> None:
        is_open = False
        try:
            with contextlib.suppress(OSError):  # it has reset the connection already
                transport, _ = await asyncio.get_running_loop().connect_accepted_socket(make_protocol, connection)
                self._transports.append(transport)
                is_open = True
        finally:
            self._opening -= 1
            if not is_open:
                connection.close()

    def _note_refused(self) -> None:
        self._counts.refused_connections += 1
