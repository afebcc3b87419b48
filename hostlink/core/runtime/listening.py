"""Listening sockets, with few imports: a program listens first, and imports the server afterwards.

Connections wait in the kernel until they are accepted.
"""

import errno
import socket
from collections.abc import Callable, Iterable
from typing import Any

BACKLOG = 1024  # connections that may wait in the kernel
MAX_PORT = 0xFFFF
FREE_PORT_TRIES = 5  # a port that is free for IPv6 may be in use for IPv4

Bind = Callable[[int, int, tuple[Any, ...]], socket.socket]  # family, protocol, address


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
        OverflowError: the port is out of range.
    """
    return bind_all(host, port, found, _listen)


def bind_all(host: str, port: int, found: Iterable[tuple[Any, ...]], bind: Bind) -> list[socket.socket]:
    """Bind a socket to each of the addresses that `getaddrinfo` found for a host and a port.

    "::" is every address, also of IPv4, which gets a socket of its own: peers keep their usual addresses. With port 0
    all sockets get the same free port.

    Raises:
        OSError: one of them cannot be bound, or none is an address of this computer.
        OverflowError: the port is out of range; `getaddrinfo` would turn 65536 into 0.
    """
    if not 0 <= port <= MAX_PORT:
        raise OverflowError(f"port {port}")
    addresses = list(dict.fromkeys((family, protocol, address) for family, _, protocol, _, address in found))
    if any(address[0] == "::" for _, _, address in addresses):
        addresses.append((socket.AF_INET, addresses[0][1], ("0.0.0.0", port)))  # noqa: S104 - what "::" means
        addresses = list(dict.fromkeys(addresses))
    for _ in range(0 if port else FREE_PORT_TRIES - 1):
        try:
            return _bind_all(host, addresses, bind)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
    return _bind_all(host, addresses, bind)


def _bind_all(host: str, addresses: list[tuple[int, int, Any]], bind: Bind) -> list[socket.socket]:
    bound: list[socket.socket] = []
    refusal = OSError(f"{host} has no address")
    for family, protocol, address in addresses:
        port = bound[0].getsockname()[1] if bound else address[1]
        try:
            bound.append(bind(family, protocol, (address[0], port, *address[2:])))
        except OSError as error:
            refusal = error
            if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):  # such as ::1 without IPv6
                close_all(bound)
                raise
    if not bound:
        raise refusal
    return bound


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
    """Return this computer's address in its network; None without one."""
    try:
        return address_towards(socket.AF_INET, ("192.0.2.1", 9))  # RFC 5737: for documentation, assigned to no host
    except OSError:
        return None


def address_towards(family: int, address: tuple[Any, ...]) -> str:
    """Return this computer's address on the route to another. Connecting a UDP socket sends no packet.

    Raises:
        OSError: there is no route.
    """
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)
        return str(probe.getsockname()[0])
