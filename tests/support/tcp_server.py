"""A TCP server of a test, which leaves no connection behind: one that is collected later fails an innocent test."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

ACCEPTING_TURNS = 5  # more than asyncio needs from the accepted socket to its handler
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@contextlib.asynccontextmanager
async def tcp_server(serve: Serve) -> AsyncIterator[tuple[str, int]]:
    """Run a server within the block and yield its address. Its connections are closed at the end."""
    serving: set[asyncio.Task[None]] = set()

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        serving.add(task)
        try:
            await serve(reader, writer)
        finally:
            writer.close()
            serving.discard(task)

    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[:2]
    finally:
        await end_accepting(server)
        for task in list(serving):
            task.cancel()
            await asyncio.wait([task])


async def end_accepting(server: asyncio.Server) -> None:
    """Stop accepting, and let each connection that is being accepted reach its handler, which closes it."""
    server.close()
    for _ in range(ACCEPTING_TURNS):
        await asyncio.sleep(0)


async def say_nothing(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Read until the other end closes, and answer nothing."""
    while await reader.read(4096):
        continue


def never() -> None:
    """Fail: the listener must find a free descriptor."""
    raise AssertionError("no descriptor is free")
