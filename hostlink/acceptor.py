"""Acceptor: accepts connections of listening sockets, one a turn of the loop, and reports when descriptors run out.

asyncio's own does neither: without descriptors it logs a traceback at each try.
"""

import asyncio
import errno
import os
import select
import socket
from collections.abc import Callable

from hostlink.listening import close_all, listen_on

RETRY_S = 0.25  # a descriptor may be free again by then
EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})

OnAccepted = Callable[[socket.socket, str, float], None]


async def bind(host: str, port: int) -> list[socket.socket]:
    """Listen on each address that the name has here.

    Raises:
        OSError: nobody can listen there; a name that has no address is one, too.
        OverflowError: the port is no port.
        UnicodeError: the host is no name.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    return listen_on(host, port, found)


def why(error: OSError | OverflowError | UnicodeError) -> str:
    """Why `bind` failed, for people."""
    if isinstance(error, OverflowError):
        return "invalid port; choose 0 (any free port) to 65535"
    if isinstance(error, UnicodeError):
        return "no such name"
    if isinstance(error, socket.gaierror) or error.errno is None:  # its numbers are not the system's
        return error.strerror or str(error)
    return os.strerror(error.errno)


class Acceptor:
    """Owns the listening sockets."""

    def __init__(
        self,
        listening: list[socket.socket],
        on_accepted: OnAccepted,
        *,
        on_exhausted: Callable[[], None],
        came_s: Callable[[float], float] = lambda now_s: now_s,
    ) -> None:
        """`on_accepted` owns the connection that it receives, with the address of its peer, and since when it may wait.

        `came_s`: since when something may have waited that is noticed now.
        """
        self._listening, self._came_s = listening, came_s
        self._since_s: dict[int, float] = {}  # since when connections have waited at a socket, without a moment of none
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
        since_s = self._since_s.setdefault(listening.fileno(), self._came_s(asyncio.get_running_loop().time()))
        try:
            connection, address = listening.accept()
        except (BlockingIOError, InterruptedError):
            del self._since_s[listening.fileno()]
            return
        except OSError as error:  # another is of the connection, which was reset before it was accepted: accept(2)
            if error.errno in EXHAUSTED:
                self._pause(listening)
            return
        if not _is_readable(listening):
            del self._since_s[listening.fileno()]
        connection.setblocking(False)
        self._on_accepted(connection, str(address[0]), since_s)

    def _pause(self, listening: socket.socket) -> None:
        """The socket stays readable: without a pause each turn of the loop would try again."""
        loop = asyncio.get_running_loop()
        loop.remove_reader(listening.fileno())
        self._retries[listening.fileno()] = loop.call_later(RETRY_S, self._watch, listening)
        self._on_exhausted()


def _is_readable(listening: socket.socket) -> bool:
    """Whether another connection waits."""
    poll = select.poll()
    poll.register(listening, select.POLLIN)
    return bool(poll.poll(0))
