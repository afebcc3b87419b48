"""Number of written bytes of a connection that have not arrived."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

import pytest

from hostlink.components.gateway.events import MOST_BYTES, unread_bytes, until_read

SENT_BYTES = 1 << 20


@contextlib.asynccontextmanager
async def connection() -> AsyncIterator[tuple[asyncio.Transport, asyncio.StreamReader]]:
    """One that writes, and one that reads only what a test reads."""
    accepted: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
    server = await asyncio.start_server(lambda _, writer: accepted.put_nowait(writer), "127.0.0.1", 0)
    with socket.socket() as narrow:
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        narrow.connect(server.sockets[0].getsockname())
        reader, writer = await asyncio.open_connection(sock=narrow, limit=2048)
        other = await accepted.get()
        try:
            yield other.transport, reader
        finally:
            for each in (writer, other):
                each.transport.abort()
            server.close()
            await asyncio.sleep(0)  # the ends are closed in the next turn


async def test_unread_bytes_are_counted_until_they_are_read() -> None:
    async with connection() as (transport, reader):
        assert unread_bytes(transport) == 0
        transport.write(bytes(SENT_BYTES))
        assert unread_bytes(transport) > SENT_BYTES / 2
        with pytest.raises(TimeoutError):
            await until_read(transport, 0.1)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(until_read(transport, 1.0))
            await reader.readexactly(SENT_BYTES)
        assert unread_bytes(transport) <= MOST_BYTES


async def test_wait_for_a_closed_connection_returns_at_once() -> None:
    async with connection() as (transport, _):
        transport.write(bytes(SENT_BYTES))
        transport.abort()
        with pytest.raises(OSError):  # noqa: PT011 - any: it is the end of a reader
            await until_read(transport, 1.0)
        with pytest.raises(OSError):  # noqa: PT011
            await until_read(None, 1.0)


async def test_wait_returns_when_the_connection_closes() -> None:
    async with connection() as (transport, _):
        transport.write(bytes(SENT_BYTES))
        asyncio.get_running_loop().call_soon(transport.abort)
        with pytest.raises(ConnectionResetError):
            await until_read(transport, 1.0)
