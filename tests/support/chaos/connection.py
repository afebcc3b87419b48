"""Connection: one TCP connection of a hostile peer, and the ways to leave it."""

import asyncio
import contextlib
import random
import socket
import struct
from collections.abc import AsyncIterator, Callable, Iterator

from hostlink.core.runtime.cancellation import expire
from tests.support.background import meanwhile

DIAL_S = 3.0
WAYS = ("fin", "reset", "half_close", "silent")
RESET_AT_CLOSE = struct.pack("ii", 1, 0)
READ_BYTES = 256 * 1024
DATAGRAM_BYTES = 1452  # at most


class Room:
    """Bounds on what this generator itself uses, and those connections that stay until everybody leaves."""

    def __init__(self, **most: int) -> None:
        self._left = dict(most)
        self._staying: list[Connection] = []

    def reserve(self, kind: str, count: int) -> int:
        """Reserve up to `count` of a kind. Return how many there was room for."""
        granted = min(count, self._left[kind])
        self._left[kind] -= granted
        return granted

    def give_back(self, kind: str, count: int) -> None:
        self._left[kind] += count

    def keep(self, connection: "Connection") -> None:
        """Let it stay, silent."""
        self._staying.append(connection)

    def clear(self, dice: random.Random) -> None:
        """Everybody who stayed leaves."""
        for connection in self._staying:
            connection.close(dice.choice(("fin", "reset")))
            self.give_back(connection.kind, 1)
        self._staying.clear()


class Connection:
    """A socket that does not block."""

    def __init__(self, made: socket.socket, kind: str) -> None:
        self.kind = kind
        self._socket = made

    @classmethod
    async def dial(cls, to: tuple[str, int], source: str, kind: str, *, receive_bytes: int = 0) -> "Connection":
        """Connect from one of this machine's own addresses."""
        made = socket.socket()
        made.setblocking(False)
        if receive_bytes:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        try:
            made.bind((source, 0))
            async with asyncio.timeout(DIAL_S):
                await asyncio.get_running_loop().sock_connect(made, to)
        except BaseException:
            made.close()
            raise
        return cls(made, kind)

    async def send(self, data: bytes) -> None:
        await asyncio.get_running_loop().sock_sendall(self._socket, data)

    def offer(self, data: bytes) -> None:
        """Send what the system takes at once; the rest is lost."""
        with contextlib.suppress(OSError):
            self._socket.send(data)

    async def receive(self) -> bytes:
        """Return the received bytes; b"" at the end."""
        return await asyncio.get_running_loop().sock_recv(self._socket, READ_BYTES)

    async def receive_until(self, part: bytes, timeout_s: float) -> bytes:
        """All that came up to these bytes, or in that time, or to the end."""
        heard = b""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while part not in heard and (data := await self.receive()):
                    heard += data
        return heard

    async def read_away(self, hear: Callable[[bytes], None] = lambda _: None, *, pause_s: float = 0.0) -> None:
        """Read and forget, until the other end closes; `hear` is called with each piece."""
        with contextlib.suppress(OSError):
            while heard := await self.receive():
                hear(heard)
                await asyncio.sleep(pause_s)

    def half_close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def cut(self) -> None:
        """The other end is informed, and closes; then `receive` returns."""
        self.half_close()

    def close(self, way: str = "fin") -> None:
        """FIN, or RST."""
        with contextlib.suppress(OSError):
            if way == "reset":
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_CLOSE)
        self._socket.close()


class DatagramConnection(Connection):
    """Connected socket of datagrams. Its end is not announced to the peer; an ICMP error is an OSError."""

    def __init__(self, made: socket.socket, kind: str) -> None:
        super().__init__(made, kind)
        self._is_cut = False
        self._patience: asyncio.Timeout | None = None  # of who receives

    @classmethod
    async def dial(cls, to: tuple[str, int], source: str, kind: str, *, receive_bytes: int = 0) -> "Connection":  # noqa: ARG003 - of a connection
        """Create the connection. No datagram is sent yet, so the daemon does not know it."""
        made = socket.socket(type=socket.SOCK_DGRAM)
        made.setblocking(False)
        try:
            made.bind((source, 0))
            made.connect(to)
        except BaseException:
            made.close()
            raise
        return cls(made, kind)

    async def send(self, data: bytes) -> None:
        """In datagrams that pass a WiFi whole; the daemon's system drops what is too much."""
        for begin in range(0, len(data), DATAGRAM_BYTES):
            await super().send(data[begin : begin + DATAGRAM_BYTES])

    async def receive(self) -> bytes:
        """The next datagram; b"" once it is cut."""
        if self._is_cut:
            return b""
        try:
            async with asyncio.timeout(None) as self._patience:
                return await super().receive()
        except TimeoutError:
            return b""
        finally:
            self._patience = None

    def half_close(self) -> None:
        """There is no such thing; a socket that is shut down would be readable without end."""

    def cut(self) -> None:
        """End the connection without informing the peer; `receive` returns."""
        self._is_cut = True
        if self._patience is not None:
            expire(self._patience)


@contextlib.asynccontextmanager
async def reading(connection: Connection, pause_s: float = 0.0) -> AsyncIterator[None]:
    """Read it away for the length of the block."""
    async with meanwhile(connection.read_away(pause_s=pause_s)):
        yield


@contextlib.contextmanager
def leaving(connection: Connection, room: Room, way: str) -> Iterator[None]:
    """At the end of the block it leaves in its way."""
    try:
        yield
    finally:
        if way == "silent":
            room.keep(connection)
        else:
            if way == "half_close":
                connection.half_close()
            connection.close("reset" if way == "reset" else "fin")
            room.give_back(connection.kind, 1)
