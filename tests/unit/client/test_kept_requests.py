"""Requests that HostConnection sends again after a reconnection, without a network."""

import asyncio
from typing import Any, cast

import msgspec

from hostlink.client.callers import Callers
from hostlink.client.connection import HostConnection
from hostlink.client.http_client import HttpClient
from tests.support.virtual_loop import run_virtual


class Socket:
    """Fake WebSocket that takes what is sent at once, and lets the sender of a `subscribe` wait until `is_free`."""

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.is_free = asyncio.Event()

    async def send_str(self, text: str) -> None:
        request: dict[str, Any] = msgspec.json.decode(text)
        self.sent.append(" ".join(map(str, (request["op"], *(request[key] for key in ("topic",) if key in request)))))
        if request["op"] == "subscribe":
            await self.is_free.wait()


class Http:
    url = "http://nowhere"
    callers = Callers()

    def __init__(self) -> None:
        self.socket = Socket()

    async def open_socket(self, _: str) -> Socket:
        return self.socket


def kept(connection: HostConnection, topic: str) -> Any:
    request, withdrawal = {"op": "subscribe", "topic": topic}, {"op": "unsubscribe", "topic": topic}
    return connection.keeping(f"subscribe {topic}", request, withdrawal)


def test_request_that_ends_during_a_reconnection_is_not_sent_again() -> None:
    async def test() -> None:
        http = Http()
        connection = HostConnection(cast(HttpClient, http), reconnects=True)
        http.socket.is_free.set()
        await connection.open()
        first, second = kept(connection, "/a"), kept(connection, "/b")
        async with first:
            await second.__aenter__()
            assert http.socket.sent == ["set_level", "subscribe /a", "subscribe /b"]
            http.socket = Socket()
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(connection.open())
                await asyncio.sleep(0)  # it waits for the socket, which has taken the first request
                tasks.create_task(second.__aexit__(None, None, None))
                await asyncio.sleep(0)
                http.socket.is_free.set()
            assert http.socket.sent == ["set_level", "subscribe /a", "unsubscribe /b"]

    run_virtual(test())
