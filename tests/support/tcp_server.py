"""A TCP server of a test, which leaves no connection behind: one that is collected later fails an innocent test."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Protocol

from aiohttp import web

ACCEPTING_TURNS = 5  # more than asyncio needs from the accepted socket to its handler
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Listening(Protocol):
    """A listening socket, or asyncio's view of one."""

    def fileno(self) -> int: ...


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


@contextlib.asynccontextmanager
async def http_server(app: web.Application, *, shutdown_timeout_s: float = 1.0) -> AsyncIterator[str]:
    """Serve an application of aiohttp within the block, and yield its URL without a path."""
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=shutdown_timeout_s)
    await runner.setup()
    listening = socket.create_server(("127.0.0.1", 0))
    await web.SockSite(runner, listening).start()
    try:
        yield "http://{}:{}".format(*listening.getsockname()[:2])
    finally:
        await stop_accepting(listening)
        await runner.cleanup()


async def end_accepting(server: asyncio.Server) -> None:
    """Stop accepting, and let each connection that is being accepted reach its handler, which closes it."""
    await stop_accepting(*server.sockets)
    server.close()


async def stop_accepting(*listening: Listening) -> None:
    """Accept no further connection, and return when those that are being accepted have reached their handlers.

    Python 3.11 loses a connection whose server is closed in the turn after it was accepted.
    """
    for each in listening:
        asyncio.get_running_loop().remove_reader(each.fileno())
    for _ in range(ACCEPTING_TURNS):
        await asyncio.sleep(0)


async def say_nothing(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Read until the other end closes, and answer nothing."""
    while await reader.read(4096):
        continue


def never() -> None:
    """Fail: the listener must find a free descriptor."""
    raise AssertionError("no descriptor is free")
