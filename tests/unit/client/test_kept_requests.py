"""Requests that HostConnection sends again after a reconnection, without a network."""

import asyncio
from typing import Any, cast

import msgspec
import pytest

from hostlink.client.callers import Callers, boot_s
from hostlink.client.connection import HostConnection
from hostlink.client.http_client import HttpClient
from hostlink.errors import HostlinkError
from tests.support.virtual_loop import run_virtual, virtual


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


def shared(connection: HostConnection, type_name: str) -> Any:
    """Advertise one topic, as blocks of a program that share its key do."""
    request, withdrawal = {"op": "advertise", "topic": type_name}, {"op": "unadvertise"}
    return connection.keeping("publish /a", request, withdrawal)


class Http:
    url = "http://nowhere"
    callers = Callers(boot_s)

    def __init__(self) -> None:
        self.socket = Socket()

    async def open_socket(self, _group: str, _name: str) -> Socket:
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


@virtual
async def test_request_of_a_block_is_not_withdrawn_by_the_end_of_another_block() -> None:
    http = Http()
    connection = HostConnection(cast(HttpClient, http), reconnects=True)
    await connection.open()
    outer, inner = shared(connection, "outer"), shared(connection, "inner")
    await outer.__aenter__()
    await inner.__aenter__()
    await outer.__aexit__(None, None, None)
    assert http.socket.sent[1:] == ["advertise outer", "advertise inner"]
    await inner.__aexit__(None, None, None)
    assert http.socket.sent[3:] == ["unadvertise"]


@virtual
async def test_earlier_request_is_in_force_again_after_the_end_of_a_later_block() -> None:
    http = Http()
    connection = HostConnection(cast(HttpClient, http), reconnects=True)
    await connection.open()
    async with shared(connection, "outer"):
        async with shared(connection, "inner"):
            pass
        assert http.socket.sent[3:] == ["advertise outer"]
        http.socket = Socket()
        await connection.open()
        assert http.socket.sent == ["set_level", "advertise outer"]
    assert http.socket.sent[2:] == ["unadvertise"]


@virtual
async def test_request_that_waits_for_the_socket_is_not_withdrawn_by_the_end_of_another_block() -> None:
    http = Http()
    connection = HostConnection(cast(HttpClient, http), reconnects=True)
    await connection.open()
    async with asyncio.TaskGroup() as tasks:
        first, second = kept(connection, "/a"), kept(connection, "/a")
        http.socket.is_free.set()
        await first.__aenter__()
        http.socket.is_free.clear()
        tasks.create_task(second.__aenter__())
        await asyncio.sleep(0)  # the socket has taken the request, and its sender waits
        await first.__aexit__(None, None, None)
        http.socket.is_free.set()
    assert http.socket.sent == ["set_level", "subscribe /a", "subscribe /a"]
    await second.__aexit__(None, None, None)
    assert http.socket.sent[3:] == ["unsubscribe /a"]


@virtual
async def test_request_that_cannot_be_sent_is_not_sent_later() -> None:
    http = Http()
    connection = HostConnection(cast(HttpClient, http), reconnects=True)
    with pytest.raises(HostlinkError):
        await shared(connection, "never").__aenter__()
    await connection.open()
    assert http.socket.sent == ["set_level"]
