"""Connection: asyncio protocol of one connection, with small reads and awaitable writes."""

import asyncio
from collections.abc import Callable

from hostlink.transport.base import READ_BYTES

_INTO = bytearray(READ_BYTES)  # shared by all connections: data is copied out before the next one reads
_VIEW = memoryview(_INTO)


class Connection(asyncio.BufferedProtocol):
    """Protocol of one connection.

    One turn of the loop reads at most READ_BYTES. Reading pauses until the data was consumed, so that the system slows
    the sender.
    """

    __slots__ = (
        "_error", "_is_paused", "_lost", "_on_made", "_received", "_writable", "is_ended", "is_writing_paused",
        "on_readable", "transport",
    )  # fmt: skip

    def __init__(self, on_made: Callable[["Connection"], None] | None = None) -> None:
        self.transport: asyncio.Transport
        self.is_writing_paused = False
        self.is_ended = False
        self.on_readable: Callable[[], None] = ignore
        self._on_made = on_made
        self._received = bytearray()
        self._is_paused = False
        self._error: Exception | None = None
        self._writable: asyncio.Future[None] | None = None
        self._lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    @property
    def is_lost(self) -> bool:
        """Whether the connection is lost."""
        return self._lost.done()

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return len(self._received)

    def read(self, limit_bytes: int) -> bytes:
        """Return received bytes; b"" when none are unread, and at the end.

        Raises:
            OSError: the connection broke, and every byte before was read.
        """
        received = self._received
        if not received and self._error is not None:
            raise self._error
        data = bytes(received[:limit_bytes])
        del received[:limit_bytes]
        if self._is_paused and not received:
            self._is_paused = False
            if not self.transport.is_closing():
                self.transport.resume_reading()
        return data

    async def drain(self) -> None:
        """Wait until the system has accepted the written data.

        Raises:
            OSError: the connection is lost.
        """
        if self._lost.done() or self.transport.is_closing():
            raise self._error or ConnectionResetError("connection lost")
        if self.is_writing_paused:
            self._writable = asyncio.get_running_loop().create_future()
            try:
                await self._writable
            finally:
                self._writable = None

    async def wait_closed(self) -> None:
        """Wait until the connection is lost."""
        await asyncio.shield(self._lost)

    # -- what asyncio calls -------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport  # type: ignore[assignment]  # pyserial-asyncio's derives from no class of asyncio's
        if self._on_made is not None:
            self._on_made(self)

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - asyncio's signature
        return _INTO

    def buffer_updated(self, nbytes: int) -> None:
        self.data_received(_VIEW[:nbytes])

    def data_received(self, data: bytes | memoryview) -> None:
        """Add received data. pyserial-asyncio calls it directly, because it has no buffered protocols."""
        self._received += data
        if len(self._received) >= READ_BYTES and not self._is_paused:
            self._is_paused = True
            self.transport.pause_reading()
        self.on_readable()

    def eof_received(self) -> bool:
        """Note that the peer sends no more. Data may still be sent to it."""
        self.is_ended = True
        self.on_readable()
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        self.is_ended = True
        self._error = exc
        self.on_readable()
        if self._writable is not None and not self._writable.done():
            self._writable.set_exception(exc or ConnectionResetError("connection lost"))
        if not self._lost.done():
            self._lost.set_result(None)

    def pause_writing(self) -> None:
        self.is_writing_paused = True

    def resume_writing(self) -> None:
        self.is_writing_paused = False
        if self._writable is not None and not self._writable.done():
            self._writable.set_result(None)


def ignore() -> None:
    """Do nothing: no reader is registered yet."""
