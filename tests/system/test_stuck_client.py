"""A hundred clients, of which one never reads and one never stops talking: what the others and the daemon notice."""

import asyncio
import contextlib
import json
import socket
import statistics
import struct
import time
from collections.abc import AsyncIterator, Awaitable
from typing import TypeVar

import aiohttp
import pytest

from hostlink.protocol.frame import Id, encode
from tests.support.api_loads import operation, websocket_head
from tests.support.background import meanwhile
from tests.support.fake_device import FakeDevice, fake_device, pose, topic
from tests.support.process import Process, serve
from tests.support.resources import open_descriptors, resident_mib
from tests.support.waiting import expect

pytestmark = pytest.mark.quiet

GOOD = 98
ENOUGH = 1000  # ages of poses
TICK_S = 0.05
IMAGES = 50  # a tick: a thousand a second
TOPICS = [
    topic(Id.PUBLISHER, 125, "/pose", "geometry_msgs/Pose2D"),
    topic(Id.PUBLISHER, 126, "/image", "std_msgs/UInt8MultiArray"),
]
IMAGE = encode(126, bytes(8) + struct.pack("<I", 400) + bytes(400))
RECEIVE_BUFFER_BYTES = 4096
TALK_S = 0.001  # twice as much as one address may say, and this process has others to listen with
WORST_S = 0.5  # on a machine with other work; a daemon that waits for the stuck one waits for seconds

Result = TypeVar("Result")


class Crowd:
    """Clients that keep up: each measures how old a pose is at its arrival."""

    def __init__(self) -> None:
        self.ages_s: list[float] = []

    async def listen(self, web_socket: aiohttp.ClientWebSocketResponse) -> None:
        async for message in web_socket:
            self.ages_s.append(time.perf_counter() - json.loads(message.data)["msg"]["x"])

    async def p99_s(self, during: Awaitable[Result]) -> tuple[float, Result]:
        """Return the 99th percentile of the ages while this is awaited and until there are enough, and its result."""
        self.ages_s.clear()
        result = await during
        await expect(lambda: len(self.ages_s) > ENOUGH)
        return statistics.quantiles(self.ages_s, n=100)[98], result


@contextlib.asynccontextmanager
async def crowd(daemon: Process) -> AsyncIterator[Crowd]:
    everybody = Crowd()
    async with contextlib.AsyncExitStack() as stack, asyncio.TaskGroup() as tasks:
        session = await stack.enter_async_context(aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)))
        sockets = [await session.ws_connect(daemon.url) for _ in range(GOOD)]
        for each in sockets:
            await each.send_json({"op": "subscribe", "topic": "/pose"})
            tasks.create_task(everybody.listen(each))
        yield everybody
        for each in sockets:
            await each.close()


@contextlib.asynccontextmanager
async def raw_client(daemon: Process) -> AsyncIterator[socket.socket]:
    """A socket from which nothing is taken once it is a WebSocket."""
    loop = asyncio.get_running_loop()
    with socket.socket() as raw:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        raw.setblocking(False)
        await loop.sock_connect(raw, ("127.0.0.1", int(daemon.url.rpartition(":")[2])))
        await loop.sock_sendall(raw, websocket_head(""))
        while b"\r\n\r\n" not in await loop.sock_recv(raw, RECEIVE_BUFFER_BYTES):
            continue
        yield raw


async def never_reads(raw: socket.socket) -> None:
    """A client that subscribes to everything."""
    for name in ("/pose", "/image", "/rosout"):
        await asyncio.get_running_loop().sock_sendall(raw, operation(op="subscribe", topic=name))


async def never_stops(raw: socket.socket) -> None:
    """A client that talks as fast as it can, and asks questions without reading the answers."""
    publish = operation(op="publish", topic="/chat", type="std_msgs/String", msg={"data": "x" * 100})
    call = operation(op="call_service", id="1", service="/rosapi/topics")
    with contextlib.suppress(ConnectionError):
        while True:
            await asyncio.get_running_loop().sock_sendall(raw, publish + call)
            await asyncio.sleep(TALK_S)


async def tick(device: FakeDevice) -> None:
    while True:
        await device.send(IMAGE * IMAGES + pose(time.perf_counter()))
        await asyncio.sleep(TICK_S)


async def until_closed(daemon: Process, clients: set[str]) -> int:
    """Return how many messages were dropped for these clients until the daemon closed them."""
    dropped = 0
    while clients:
        line = await daemon.read_log("client.closed")
        clients.discard(line["client"])
        dropped += line["dropped"]
    return dropped


async def test_one_stuck_client_among_a_hundred_costs_the_others_nothing_and_the_daemon_little() -> None:
    async with serve() as daemon, fake_device(daemon.tcp, TOPICS) as device, crowd(daemon) as others:
        async with meanwhile(tick(device)):
            p99_alone_s, _ = await others.p99_s(asyncio.sleep(2.0))
            files, before_mib = open_descriptors(daemon.pid), resident_mib(daemon.pid)
            async with raw_client(daemon) as stuck, raw_client(daemon) as loud, meanwhile(never_stops(loud)):
                await never_reads(stuck)
                clients = {f"client {GOOD + 1}", f"client {GOOD + 2}"}
                p99_beside_s, dropped = await others.p99_s(until_closed(daemon, clients))
        assert dropped > 100  # it was told nothing, it lost only its own
        assert p99_beside_s < max(5 * p99_alone_s, WORST_S), (p99_alone_s, p99_beside_s)
        assert resident_mib(daemon.pid) - before_mib < 32
        await expect(lambda: open_descriptors(daemon.pid) <= files)  # neither of them is left behind
