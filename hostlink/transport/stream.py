"""StreamTransport: a Connection as a Transport; TCP and serial ports differ only in how they open."""

import asyncio
import contextlib
from collections.abc import Callable

from hostlink.transport.base import CLOSE_TIMEOUT_S, READ_BYTES
from hostlink.transport.connection import Connection, ignore


class StreamTransport:
    """Owns the connection. Nothing waits in the process behind `send`: the write buffer's high-water mark is 0."""

    kind = "stream"

    def __init__(self, connection: Connection, *, peer: str, address: str) -> None:
        self.peer, self.address = peer, address
        self._connection = connection
        self._is_closed = False
        connection.transport.set_write_buffer_limits(high=0)

    def start(self, on_readable: Callable[[], None]) -> None:
        """From now on `on_readable` is called whenever bytes have come, and at the end."""
        self._connection.on_readable = on_readable
        if self.unread_bytes or self.is_ended:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """What has come and was not read."""
        return self._connection.unread_bytes

    @property
    def is_ended(self) -> bool:
        """Whether nothing more will come."""
        return self._connection.is_ended

    def read(self, limit_bytes: int) -> bytes:
        """What has come; b"" while there is nothing, and at the end."""
        return self._connection.read(limit_bytes)

    def write(self, data: bytes) -> bool:
        """One write, so one segment where it fits."""
        connection = self._connection
        if connection.transport.is_closing():
            return False
        connection.transport.write(data)
        return not connection.is_writing_paused

    async def drain(self) -> None:
        """Returns when the system has what was written."""
        await self._connection.drain()

    async def receive(self) -> bytes:
        """What has come; b"" at the end."""
        came = asyncio.Event()
        self.start(came.set)
        await came.wait()
        return self.read(2 * READ_BYTES)

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        self.write(data)
        await self.drain()

    def round_trip_s(self) -> float | None:
        """Nobody measures it."""
        return None

    def descriptor(self) -> int | None:
        """The socket's or the port's, until it is being closed."""
        return None if self._is_closed or self._connection.transport.is_closing() else self._open_descriptor()

    def _open_descriptor(self) -> int | None:
        """None where there is none."""
        return None

    async def aclose(self) -> None:
        """Let what was sent leave, but do not wait for a dead peer; whoever gives this up aborts."""
        if self._is_closed:  # a close that was given up cannot be waited for again
            return
        self._is_closed = True
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                with contextlib.suppress(OSError):  # a broken connection has nothing to leave
                    await self._leave()
                self._connection.transport.close()
                await self._connection.wait_closed()
        except TimeoutError:
            self._abort()
        except asyncio.CancelledError:
            self._abort()
            raise
        finally:
            self._connection.on_readable = ignore  # else link and connection keep each other until a collection

    async def _leave(self) -> None:
        """What must be waited for before the connection is closed: nothing, closing sends what was written."""

    def _abort(self) -> None:
        self._connection.transport.abort()
