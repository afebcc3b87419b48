"""Acceptor: accepts connections of listening sockets, one per turn of the loop, and reports a lack of descriptors.

asyncio's own server does neither: without descriptors it logs a traceback at each try.
"""

import asyncio
import errno
import select
import socket
from collections.abc import Callable

from hostlink.core.runtime.listening import close_all, listen_on
from hostlink.errors import system_text

RETRY_S = 0.25  # a descriptor may be free by then
EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})

OnAccepted = Callable[[socket.socket, str, float], None]


async def bind(host: str, port: int) -> list[socket.socket]:
    """Listen on each local address of the host name.

    Raises:
        OSError: an address cannot be listened on, or the name has no address.
        OverflowError: the port is out of range.
        UnicodeError: the host name is invalid.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    return listen_on(host, port, found)


def why(error: OSError | OverflowError | UnicodeError) -> str:
    """Explain for people why `bind` failed."""
    if isinstance(error, OverflowError):
        return "invalid port; choose 0 (any free port) to 65535"
    if isinstance(error, UnicodeError):
        return "invalid host name"
    return system_text(error)


class Acceptor:
    """Owner of listening sockets."""

    def __init__(
        self,
        listening: list[socket.socket],
        on_accepted: OnAccepted,
        *,
        on_exhausted: Callable[[], None],
        came_s: Callable[[float], float] = lambda now_s: now_s,
    ) -> None:
        """`on_accepted` gets the connection, its peer's address, and the time since when it may have waited.

        `came_s` returns the time since when an event noticed now may have waited.
        """
        self._listening, self._came_s = listening, came_s
        self._since_s: dict[int, float] = {}  # time since when each socket always had a waiting connection
        self._on_accepted, self._on_exhausted = on_accepted, on_exhausted
        self._retries: dict[int, asyncio.TimerHandle] = {}
        for each in listening:
            self._watch(each)

    def close(self) -> None:
        """Stop listening. Accepted connections are not affected."""
        for retry in self._retries.values():
            retry.cancel()
        for each in self._listening:
            asyncio.get_running_loop().remove_reader(each.fileno())
        close_all(self._listening)

    def _watch(self, listening: socket.socket) -> None:
        self._retries.pop(listening.fileno(), None)
        asyncio.get_running_loop().add_reader(listening.fileno(), self._accept, listening)

    def _accept(self, listening: socket.socket) -> None:
        """Accept one connection. The loop calls again for the next, so that others have their turn in between."""
        since_s = self._since_s.setdefault(listening.fileno(), self._came_s(asyncio.get_running_loop().time()))
        try:
            connection, address = listening.accept()
        except (BlockingIOError, InterruptedError):
            del self._since_s[listening.fileno()]
            return
        except OSError as error:  # other errors belong to a connection that was reset before it was accepted: accept(2)
            if error.errno in EXHAUSTED:
                self._pause(listening)
            return
        if not _is_readable(listening):
            del self._since_s[listening.fileno()]
        connection.setblocking(False)
        self._on_accepted(connection, str(address[0]), since_s)

    def _pause(self, listening: socket.socket) -> None:
        """Stop accepting for RETRY_S. The socket stays readable, so each turn of the loop would try again."""
        loop = asyncio.get_running_loop()
        loop.remove_reader(listening.fileno())
        self._retries[listening.fileno()] = loop.call_later(RETRY_S, self._watch, listening)
        self._on_exhausted()


def _is_readable(listening: socket.socket) -> bool:
    """Whether another connection waits."""
    poll = select.poll()
    poll.register(listening, select.POLLIN)
    return bool(poll.poll(0))
