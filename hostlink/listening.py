"""Listening sockets, with few imports: a program listens first, and imports the server afterwards.

Connections wait in the kernel until they are accepted.
"""

import errno
import socket
from collections.abc import Iterable
from typing import Any

BACKLOG = 1024  # connections that may wait in the kernel
MAX_PORT = 0xFFFF


def listen(host: str, port: int) -> list[socket.socket]:
    """Listen on each local address of the host name.

    Raises:
        OSError: an address cannot be listened on, or the name has no address.
        OverflowError: the port is out of range.
        UnicodeError: the host name is invalid.
    """
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    return listen_on(host, port, found)


def listen_on(host: str, port: int, found: Iterable[tuple[Any, ...]]) -> list[socket.socket]:
    """Listen on each of the addresses that `getaddrinfo` found for a host and a port.

    Raises:
        OSError: one of them cannot be listened on, or none is an address of this computer.
        OverflowError: the port is out of range; `getaddrinfo` would turn 65536 into 0.
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
            if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):  # such as ::1 without IPv6
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
    """Close the sockets."""
    for each in listening:
        each.close()


def spelled(host: str, port: int) -> str:
    """Format an address for people; IPv6 in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def own_address() -> str | None:
    """Return this computer's address in its network; None without one. Connecting a UDP socket sends no packet."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # RFC 5737: for documentation, assigned to no host
        except OSError:
            return None
        return str(probe.getsockname()[0])
