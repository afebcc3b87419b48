"""Acceptor: accepts connections of listening sockets, one a turn of the loop, and reports when descriptors run out.

asyncio's own does neither: without descriptors it logs a traceback at each try.
"""

import asyncio
import errno
import os
import socket
from collections.abc import Callable

BACKLOG = 1024  # connections that may wait in the kernel
RETRY_S = 0.25  # a descriptor may be free again by then
EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})

OnAccepted = Callable[[socket.socket, str], None]


async def bind(host: str, port: int) -> list[socket.socket]:
    """Listen on each address that the name has here.

    Raises:
        OSError: nobody can listen there; a name that has no address is one, too.
        OverflowError: the port is no port.
        UnicodeError: the host is no name.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
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


def why(error: OSError | OverflowError | UnicodeError) -> str:
    """Why `bind` failed, for people."""
    if isinstance(error, OverflowError):
        return "no such port; they go from 0 (any free one) to 65535"
    if isinstance(error, UnicodeError):
        return "no such name"
    if isinstance(error, socket.gaierror) or error.errno is None:  # its numbers are not the system's
        return error.strerror or str(error)
    return os.strerror(error.errno)


def close_all(listening: list[socket.socket]) -> None:
    """Nobody can connect any more."""
    for each in listening:
        each.close()


class Acceptor:
    """Owns the listening sockets."""

    def __init__(
        self, listening: list[socket.socket], on_accepted: OnAccepted, *, on_exhausted: Callable[[], None]
    ) -> None:
        """`on_accepted` owns the connection that it receives, with the address of its peer."""
        self._listening = listening
        self._on_accepted, self._on_exhausted = on_accepted, on_exhausted
        self._retries: dict[int, asyncio.TimerHandle] = {}
        for each in listening:
            self._watch(each)

    def close(self) -> None:
        """Nobody can connect any more; connections that were accepted stay."""
        for retry in self._retries.values():
            retry.cancel()
        for each in self._listening:
            asyncio.get_running_loop().remove_reader(each.fileno())
        close_all(self._listening)

    def _watch(self, listening: socket.socket) -> None:
        self._retries.pop(listening.fileno(), None)
        asyncio.get_running_loop().add_reader(listening.fileno(), self._accept, listening)

    def _accept(self, listening: socket.socket) -> None:
        """Accept one; the loop comes back for the next, and others have their turn in between."""
        try:
            connection, address = listening.accept()
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:  # another is of the connection, which was reset before it was accepted: accept(2)
            if error.errno in EXHAUSTED:
                self._pause(listening)
            return
        connection.setblocking(False)
        self._on_accepted(connection, str(address[0]))

    def _pause(self, listening: socket.socket) -> None:
        """The socket stays readable: without a pause each turn of the loop would try again."""
        loop = asyncio.get_running_loop()
        loop.remove_reader(listening.fileno())
        self._retries[listening.fileno()] = loop.call_later(RETRY_S, self._watch, listening)
        self._on_exhausted()
