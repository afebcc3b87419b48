"""What remains of clients that are gone, in `hostlink serve` as it runs: nothing that grows."""

import asyncio
import gc
import json
import re
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from tests.support.daemon import daemon
from tests.support.process import Process, serve
from tests.support.resources import in_use

CLIENTS = 900
AT_ONCE = 20
MOST_KIB = 1024  # that the third 900 may add; without a collection they add 19,000
UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: c3R1Y2sgc3R1Y2sgc3R1Yw==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
CLOSE = bytes([0x88, 0x82, 0, 0, 0, 0, 0x03, 0xE8])

Visit = Callable[[int], Awaitable[None]]


def frame(**request: object) -> bytes:
    """A WebSocket frame of a client, masked with zeros."""
    body = json.dumps(request).encode()
    return bytes([0x81, 0xFE]) + struct.pack(">H", len(body)) + bytes(4) + body


async def web_socket(port: int) -> None:
    """A client that subscribes, asks, hears the answer and says goodbye."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(UPGRADE + frame(op="subscribe", topic="/a"))
    writer.write(frame(op="call_service", service="/rosapi/get_time", args={}))
    await reader.readuntil(b"service_response")
    writer.write(CLOSE)
    await reader.read()
    writer.close()


async def web_socket_that_breaks_off(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(UPGRADE + frame(op="call_service", service="/rosapi/get_time", args={}))
    await reader.readuntil(b"service_response")
    writer.transport.abort()


async def request(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
    await reader.read()
    writer.close()


async def visits(visit: Visit, port: int, count: int) -> None:
    async def some() -> None:
        for _ in range(count // AT_ONCE):
            await visit(port)

    async with asyncio.TaskGroup() as tasks:
        for _ in range(AT_ONCE):
            tasks.create_task(some())


def resident_kib(host: Process) -> int:
    status = Path(f"/proc/{host.child.pid}/status").read_text()
    return int(re.findall(r"VmRSS:\s+(\d+)", status)[0])


@pytest.mark.parametrize("visit", [web_socket, web_socket_that_breaks_off, request])
async def test_nothing_is_kept_of_a_client_that_is_gone(visit: Visit) -> None:
    async with daemon() as host:
        port = int(host.url.rpartition(":")[2])
        await visits(visit, port, 100)
        await asyncio.sleep(0.2)
        gc.collect()
        objects, before = len(gc.get_objects()), in_use()
        await visits(visit, port, 300)
        await asyncio.sleep(0.2)
        gc.collect()
        assert len(gc.get_objects()) - objects < 300  # less than one a client
        assert in_use() == before


async def test_a_daemon_that_has_served_2700_clients_is_no_larger_than_after_1800() -> None:
    sizes = []
    async with serve() as host:
        for _ in range(3):
            await visits(web_socket, int(host.url.rpartition(":")[2]), CLIENTS)
            await asyncio.sleep(1.5)  # nobody drives: it collects
            sizes.append(resident_kib(host))
    assert sizes[2] - sizes[1] < MOST_KIB, sizes
