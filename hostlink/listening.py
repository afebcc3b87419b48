"""Sockets that listen. Imports next to nothing: a program listens first, and imports what serves the connections then.

Until somebody accepts them, connections wait in the kernel.
"""

import errno
import socket
from collections.abc import Iterable
from typing import Any

BACKLOG = 1024  # connections that may wait in the kernel
MAX_PORT = 0xFFFF


def listen(host: str, port: int) -> list[socket.socket]:
    """Listen on each address that the name has here.

    Raises:
        OSError: nobody can listen there; a name that has no address is one, too.
        OverflowError: the port is no port.
        UnicodeError: the host is no name.
    """
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    return listen_on(host, port, found)


def listen_on(host: str, port: int, found: Iterable[tuple[Any, ...]]) -> list[socket.socket]:
    """Listen on each of the addresses that `getaddrinfo` has found for a host and a port.

    Raises:
        OSError: nobody can listen on one of them, or on none of those that are of this computer.
        OverflowError: the port is no port; `getaddrinfo` makes 0 of 65536.
    """
    if not 0 <= port <= MAX_PORT:
        raise OverflowError(f"port {port}")
    listening: list[socket.socket] = []
    refusal = OSError(f"{host} has no address")
    for family, _, protocol, _, address in dict.fromkeys(found):
        try:
            listening.append(_listen(family, protocol, address))
        except OSError as error:
            refusal = error
            if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):  # as ::1 where there is no IPv6
                close_all(listening)
                raise
    if not listening:
        raise refusal
    return listening


def _listen(family: int, protocol: int, address: tuple[object, ...]) -> socket.socket:
    listening = socket.socket(family, socket.SOCK_STREAM, protocol)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listening.bind(address)
        listening.listen(BACKLOG)
        listening.setblocking(False)
    except BaseException:
        listening.close()
        raise
    return listening


def close_all(listening: Iterable[socket.socket]) -> None:
    """Nobody can connect any more."""
    for each in listening:
        each.close()
