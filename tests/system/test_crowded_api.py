"""`hostlink serve` with the usual 1024 descriptors, and a program that opens more connections than that."""

import asyncio
import contextlib
import resource
import socket
from collections.abc import AsyncIterator, Iterator

import aiohttp
import pytest

from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import Process, serve
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S, expect_never

pytestmark = pytest.mark.quiet

ATTACKERS = 1300
DESCRIPTORS = 1024
HALF = b"GET /api/robots HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "
LONGEST_S = 2.0  # on a machine with other work; without a bound it is a minute


@pytest.fixture(autouse=True)
def enough_descriptors() -> Iterator[None]:
    """Raise the limit of this process, which has the other ends; the daemon inherits the usual one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 4 * ATTACKERS), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@contextlib.asynccontextmanager
async def limited() -> AsyncIterator[Process]:
    async with serve() as host:
        _, hard = resource.prlimit(host.child.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(host.child.pid, resource.RLIMIT_NOFILE, (DESCRIPTORS, hard))
        yield host


async def attack(host: Process, stack: contextlib.ExitStack, count: int) -> None:
    """Half a request on so many connections."""
    loop = asyncio.get_running_loop()
    for _ in range(count):
        raw = stack.enter_context(socket.socket())
        raw.setblocking(False)
        await loop.sock_connect(raw, ("127.0.0.1", int(host.url.rpartition(":")[2])))
        with contextlib.suppress(ConnectionError):  # some give way already
            await loop.sock_sendall(raw, HALF)


async def log_of(host: Process) -> list[bytes]:
    """The lines, as soon as no more come."""
    lines: list[bytes] = []
    while True:
        await asyncio.sleep(0.3)
        before, lines = lines, host.log_file.read_bytes().splitlines()
        if len(before) == len(lines):
            return lines


async def test_a_stop_and_a_robot_get_through_beside_1300_half_requests() -> None:
    with contextlib.ExitStack() as stack:
        async with limited() as host, aiohttp.ClientSession() as session:
            await attack(host, stack, ATTACKERS)
            watch = Stopwatch(host.pid)
            async with fake_device(host.tcp, robot_topics()):
                robot_s, watch = watch.seconds, Stopwatch(host.pid)
                async with asyncio.timeout(TIMEOUT_S), session.post(host.url + "/api/stop") as response:
                    assert response.status == 200
                    robots = (await response.json())["robots"]
                stop_s = watch.seconds
            lines = await log_of(host)
    assert [robot["connected"] for robot in robots] == [True]
    assert max(robot_s, stop_s) < LONGEST_S, (robot_s, stop_s)
    assert sum(map(len, lines)) < 8_000, lines[:5]
    assert sum(b"client.crowded" in line for line in lines) == 1


async def test_no_descriptor_left_is_logged_once_and_ends_when_there_are_some() -> None:
    with contextlib.ExitStack() as stack:
        async with limited() as host, aiohttp.ClientSession() as session:
            resource.prlimit(host.child.pid, resource.RLIMIT_NOFILE, (3, DESCRIPTORS))
            await attack(host, stack, 20)
            for _ in range(20):
                device = stack.enter_context(socket.socket())
                device.connect(host.tcp)
            once = (b"descriptors.exhausted", b"client.crowded")
            await expect_never(lambda: any(host.log_file.read_bytes().count(word) > 1 for word in once), for_s=2.5)
            lines = await log_of(host)
            resource.prlimit(host.child.pid, resource.RLIMIT_NOFILE, (DESCRIPTORS, DESCRIPTORS))
            async with asyncio.timeout(TIMEOUT_S), fake_device(host.tcp, robot_topics()):
                response = await session.get(host.url + "/metrics")
                metrics = await response.text()
    assert [b"Traceback" in line for line in lines] == [False] * len(lines)
    assert sum(b"descriptors.exhausted" in line for line in lines) == 1
    assert sum(b"client.crowded" in line for line in lines) == 1
    assert 'hostlink_connections_refused_total{cause="no_descriptors"}' in metrics
    assert 'hostlink_api_connections_closed_total{cause="no_descriptors"}' in metrics
