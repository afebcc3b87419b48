"""Memory of `hostlink serve` after clients have disconnected: nothing grows."""

import asyncio
import gc
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from tests.support.api_loads import frame, operation, websocket_head
from tests.support.daemon import daemon
from tests.support.process import HOSTLINK, serve
from tests.support.resources import in_use, resident_mib
from tests.support.waiting import expect

CLIENTS, AT_ONCE = 900, 20
MOST_MIB = 1.0  # that 900 clients may add; without a collection they add 19
MOST_ROUNDS = 6  # a busy machine collects later
CLOSE = frame((1000).to_bytes(2, "big"), 8)
ASK = operation(op="call_service", service="/rosapi/get_time", args={})

Visit = Callable[[int], Awaitable[None]]


async def web_socket(port: int) -> None:
    """A client that subscribes, asks, hears the answer and says goodbye."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(websocket_head("") + operation(op="subscribe", topic="/a") + ASK)
    await reader.readuntil(b"service_response")
    writer.write(CLOSE)
    await reader.read()
    writer.close()


async def web_socket_that_breaks_off(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(websocket_head("") + ASK)
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


@pytest.mark.parametrize(
    "visit", [web_socket, pytest.param(web_socket_that_breaks_off, marks=pytest.mark.long), request]
)
async def test_daemon_keeps_nothing_of_a_disconnected_client(visit: Visit) -> None:
    async with daemon() as host:
        port, tasks = int(host.url.rpartition(":")[2]), len(asyncio.all_tasks())
        await visits(visit, port, 100)
        await expect(lambda: len(asyncio.all_tasks()) <= tasks)  # all clients are gone, but perhaps for a socket
        gc.collect()
        objects, before = len(gc.get_objects()), in_use()
        await visits(visit, port, 300)
        await expect(lambda: all(now <= then for now, then in zip(in_use(), before, strict=True)))
        gc.collect()
        assert len(gc.get_objects()) - objects < 300  # less than one a client


@pytest.mark.long
async def test_daemon_grows_no_more_after_some_rounds_of_900_clients() -> None:
    """A daemon that keeps something of each client grows in every round."""
    sizes_mib = []
    async with serve() as host:
        for _ in range(MOST_ROUNDS):
            await visits(web_socket, int(host.url.rpartition(":")[2]), CLIENTS)
            await asyncio.sleep(1.5)  # without a driver, the daemon collects garbage
            sizes_mib.append(resident_mib(host.pid))
            if len(sizes_mib) > 2 and sizes_mib[-1] - sizes_mib[-2] < MOST_MIB:
                return
    raise AssertionError(sizes_mib)


LATCHING, LATCHED_TOPICS, LATCHED_BYTES, ROUNDS = 30, 4, 900_000, 2
LEFT_MIB = 24  # 10 are left; 40 and more where glibc keeps the blocks


async def latching(port: int) -> None:
    """A client with large latched messages, each published twice, that leaves once all were read."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(websocket_head(""))
    await reader.readuntil(b"\r\n\r\n")
    name = f"/latched_{writer.get_extra_info('sockname')[1]}"
    for number in range(ROUNDS * LATCHED_TOPICS):
        topic, message = f"{name}_{number % LATCHED_TOPICS}", {"data": "x" * LATCHED_BYTES}
        writer.write(operation(op="publish", topic=topic, type="std_msgs/String", latch=True, msg=message))
        await writer.drain()
    writer.write(ASK)
    await reader.readuntil(b"service_response")
    writer.write(CLOSE)
    await reader.read()
    writer.close()


@pytest.mark.long
async def test_daemon_whose_clients_latched_large_messages_gives_their_memory_back(tmp_path: Path) -> None:
    config = tmp_path / "hostlink.toml"
    config.write_text("[black_box]\nmax_memory_mb = 2\n")  # it keeps what was published last
    async with serve("--config", str(config), program=(HOSTLINK,)) as host:  # a forked one has its parent's heap, too
        port = int(host.url.rpartition(":")[2])
        await request(port)
        before_mib = resident_mib(host.pid)
        for _ in range(ROUNDS):
            async with asyncio.TaskGroup() as tasks:
                for _ in range(LATCHING):
                    tasks.create_task(latching(port))
        await expect(lambda: resident_mib(host.pid) < before_mib + LEFT_MIB)
