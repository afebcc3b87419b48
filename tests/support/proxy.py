"""A TCP proxy between a client and a server, whose line a test cuts: as a radio, a cable, a tunnel would."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from enum import Enum

from tests.support.tcp_server import tcp_server

READ_BYTES = 65536
GATHER_S = 0.2


def address_of(url: str) -> tuple[str, int]:
    """Host and port of a URL."""
    host, _, port = url.removeprefix("http://").partition(":")
    return host, int(port)


class Line(Enum):
    """State of the line."""

    WORKS = "works"
    SWALLOWS = "swallows"  # as a radio out of reach: what is sent is gone
    STALLS = "stalls"  # as a full tunnel: what is sent arrives when it works again
    GATHERS = "gathers"  # as a busy machine's: what a server sends within a moment is read in one piece
    STALLS_SOCKETS = "stalls_sockets"  # as where a segment of theirs is lost: requests overtake what WebSockets send


class Proxy:
    """Every connection through it shares one line."""

    def __init__(self, target: tuple[str, int]) -> None:
        self.target = target
        self.url = ""
        self.is_refusing = False
        self._line = Line.WORKS
        self._works = asyncio.Event()
        self._works.set()
        self._writers: set[asyncio.StreamWriter] = set()

    def set_line(self, line: Line) -> None:
        self._line = line
        if line in (Line.WORKS, Line.GATHERS):
            self._works.set()
        else:
            self._works.clear()

    def break_off(self) -> None:
        """Reset every connection."""
        for writer in self._writers:
            writer.transport.abort()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            if self.is_refusing:
                return
            with contextlib.suppress(OSError):
                there_reader, there_writer = await asyncio.open_connection(*self.target)
                self._writers.add(there_writer)
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(self._carry(reader, there_writer))
                    tasks.create_task(self._carry(there_reader, writer, is_answer=True))
        finally:
            self._writers.discard(writer)
            writer.transport.abort()

    async def _carry(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, is_answer: bool = False
    ) -> None:
        try:
            with contextlib.suppress(OSError):
                is_socket = False
                while data := await reader.read(READ_BYTES):
                    is_socket |= b"upgrade: websocket" in data.lower()
                    if self._line is Line.STALLS or (is_socket and self._line is Line.STALLS_SOCKETS):
                        await self._works.wait()
                    if self._line is Line.GATHERS and is_answer:
                        data += await _gather(reader)
                    if self._line in (Line.WORKS, Line.STALLS_SOCKETS, Line.GATHERS):
                        writer.write(data)
                        await writer.drain()
            await self._works.wait()  # the end of one side is not passed on either
        finally:
            self._writers.discard(writer)
            writer.close()


async def _gather(reader: asyncio.StreamReader) -> bytes:
    """Return the bytes that arrive within GATHER_S."""
    gathered = b""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(GATHER_S):
            while data := await reader.read(READ_BYTES):
                gathered += data
    return gathered


@contextlib.asynccontextmanager
async def proxy(target: tuple[str, int] | str) -> AsyncIterator[Proxy]:
    """A proxy to an address or a URL, on a port of its own."""
    new = Proxy(address_of(target) if isinstance(target, str) else target)
    async with tcp_server(new.serve) as address:
        new.url = "http://{}:{}".format(*address)
        try:
            yield new
        finally:
            new.set_line(Line.WORKS)
            new.break_off()
