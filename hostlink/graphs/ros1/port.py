"""Port: a listening port of this node. It admits so many connections, from where it may, and counts the others.

| a connection comes                 | what happens                                                              |
|------------------------------------|---------------------------------------------------------------------------|
| from outside of the allowed        | it is closed                                                              |
| over the bound                     | the oldest that keeps a place without having sent anything is closed; if  |
|                                    | there is none, this one is                                                |
"""

import asyncio
import contextlib
import ipaddress
import socket
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hostlink.acceptor import Acceptor, bind
from hostlink.graphs.ros1.parts import Counts
from hostlink.hub.isolation import Spawn
from hostlink.listening import close_all


class Admitted(Protocol):
    """The protocol of a connection."""

    @property
    def is_replaceable(self) -> bool:
        """Whether another one may have its place."""


MakeProtocol = Callable[[], Admitted]


class Port:
    """Owns the listening sockets, and accepted ones until their protocols have them. First `bind`, then `accept`."""

    def __init__(self, counts: Counts, *, allow: Sequence[str], max_connections: int) -> None:
        """`allow`: networks from which somebody may connect; none named: all."""
        self._counts = counts
        self._networks = [ipaddress.ip_network(network) for network in allow]
        self._max_connections = max_connections
        self._opening = 0
        self._open: dict[asyncio.Transport, Admitted] = {}  # oldest first
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

        def accepted(connection: socket.socket, address: str, _since_s: float) -> None:
            if not self._admits(address):
                self._counts.refused_connections += 1
                connection.close()
                return
            self._opening += 1
            spawn(self._begin(connection, make_protocol), name=f"ROS 1 connection of {address}")

        self._acceptor = Acceptor(self._listening, accepted, on_exhausted=self._note_refused)

    def close(self) -> None:
        """End the connections, too."""
        if self._acceptor is not None:
            self._acceptor.close()
        close_all(self._listening)
        for transport in self._open:
            transport.close()

    def _admits(self, address: str) -> bool:
        if self._networks and not any(ipaddress.ip_address(address) in each for each in self._networks):
            return False
        self._open = {each: protocol for each, protocol in self._open.items() if not each.is_closing()}
        if len(self._open) + self._opening < self._max_connections:
            return True
        oldest = next((each for each, protocol in self._open.items() if protocol.is_replaceable), None)
        if oldest is None:
            return False
        self._note_refused()
        oldest.abort()
        del self._open[oldest]
        return True

    async def _begin(self, connection: socket.socket, make_protocol: MakeProtocol) -> None:
        is_open = False
        make: Any = make_protocol
        try:
            with contextlib.suppress(OSError):  # it has reset the connection already
                transport, protocol = await asyncio.get_running_loop().connect_accepted_socket(make, connection)
                self._open[transport] = protocol
                is_open = True
        finally:
            self._opening -= 1
            if not is_open:
                connection.close()

    def _note_refused(self) -> None:
        self._counts.refused_connections += 1
