"""The API's port under connections that say nothing, say half of it, or take nothing."""

import asyncio
import contextlib
import socket
import ssl
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import aiohttp
import pytest

from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.waiting import TIMEOUT_S, expect

HALF = b"GET /api/robots HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "
BODY_MISSING = b"PUT /api/robots/robot_0/velocity HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 40\r\n\r\n{"
SMALL = Config().with_tables(api=ApiConfig(max_connections=24, max_connections_per_address=24))
IMPATIENT = Config().with_tables(api=ApiConfig(request_timeout_s=0.2))


SLOW_TURN_S = 0.02
QUEUED = 50  # connections that are accepted before; one a turn, so in twice a lease
VELOCITY = b'{"linear": %b, "angular": 0.0}'


def velocity_request(linear: bytes) -> bytes:
    body = VELOCITY % linear
    head = b"PUT /api/robots/robot_0/velocity HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n"
    return head + b"Content-Length: %d\r\n\r\n" % len(body) + body


@contextlib.contextmanager
def slow_turns() -> Iterator[None]:
    """Each turn of the loop takes a while, as on a machine that has too little time for it."""
    loop, is_over = asyncio.get_running_loop(), False

    def turn() -> None:
        time.sleep(SLOW_TURN_S)
        if not is_over:
            loop.call_soon(turn)

    loop.call_soon(turn)
    try:
        yield
    finally:
        is_over = True


def port_of(host: Daemon) -> int:
    return int(host.url.rpartition(":")[2])


@contextlib.asynccontextmanager
async def connections(host: Daemon, count: int, sent_bytes: bytes) -> AsyncIterator[list[asyncio.StreamReader]]:
    """So many connections to the API, each of which says this and then waits."""
    readers, writers = [], []
    try:
        for _ in range(count):
            reader, writer = await asyncio.open_connection("127.0.0.1", port_of(host))
            writer.write(sent_bytes)
            readers.append(reader)
            writers.append(writer)
        yield readers
    finally:
        for writer in writers:
            writer.close()


async def closed(reader: asyncio.StreamReader) -> bytes:
    """Read until the host closes the connection."""
    async with asyncio.timeout(TIMEOUT_S):
        with contextlib.suppress(ConnectionError):
            return await reader.read()
    return b""


async def stop(host: Daemon) -> int:
    async with asyncio.timeout(TIMEOUT_S):
        return (await host.rest("POST", "/api/stop"))[0]


async def metric(host: Daemon, name: str) -> float:
    async with host.session.get(host.url + "/metrics") as response:
        lines = (await response.text()).splitlines()
    return float(next(line.rpartition(" ")[2] for line in lines if line.startswith(name)))


@pytest.mark.parametrize("sent_bytes", [b"", BODY_MISSING], ids=["nothing", "body"])
async def test_a_stop_gets_through_beside_connections_that_never_finish(sent_bytes: bytes) -> None:
    async with daemon(SMALL) as host, fake_device(host.tcp, robot_topics()), connections(host, 60, sent_bytes):
        assert await stop(host) == 200
        assert await metric(host, 'hostlink_api_connections_closed_total{cause="evicted"}') >= 30
        assert await metric(host, "hostlink_api_connections ") <= 24


async def test_event_streams_leave_room_for_a_stop() -> None:
    async with daemon(SMALL) as host, contextlib.AsyncExitStack() as stack:
        session = await stack.enter_async_context(aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)))
        answers = []
        for _ in range(12):
            response = await stack.enter_async_context(session.get(host.url + "/api/events"))
            answers.append(response.status)
        assert answers == [200] * 8 + [503] * 4
        assert await stop(host) == 200


async def test_clients_that_read_no_answer_leave_room_for_a_stop() -> None:
    requests = b"GET /api/openapi.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 30
    async with daemon(SMALL) as host, connections(host, 40, requests):
        assert await stop(host) == 200


async def test_half_a_head_ends_with_its_time() -> None:
    async with daemon(IMPATIENT) as host, connections(host, 3, HALF) as readers:
        for reader in readers:
            assert await closed(reader) == b""
        assert await metric(host, 'hostlink_api_connections_closed_total{cause="timeout"}') == 3


async def test_handshakes_of_tls_that_never_end_give_way(tmp_path: Path) -> None:
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    make = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-out", certificate, "-keyout", key]
    await asyncio.to_thread(subprocess.run, [*make, *names], check=True, capture_output=True)
    trust = ssl.create_default_context(cafile=certificate)
    api = ApiConfig(certificate=certificate, key=key, max_connections=24, max_connections_per_address=24)
    async with (
        daemon(Config().with_tables(api=api)) as host,
        connections(host, 60, b"\x16"),
        asyncio.timeout(TIMEOUT_S),
    ):
        assert (await host.session.post(host.url + "/api/stop", ssl=trust)).status == 200


@pytest.mark.parametrize(
    ("linear", "queued", "status"),
    [(b"0.3", QUEUED, b"409"), (b"0.0", QUEUED, b"200"), (b"0.3", 0, b"200")],
    ids=["old", "zero", "new"],
)
async def test_velocity_that_waited_to_be_accepted_longer_than_its_lease_is_refused(
    linear: bytes, queued: int, status: bytes
) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        address = ("127.0.0.1", port_of(host))
        with contextlib.ExitStack() as stack, slow_turns():  # the kernel connects, also while the loop is busy
            for _ in range(queued):
                stack.enter_context(socket.create_connection(address))
            driver = stack.enter_context(socket.create_connection(address))
            driver.sendall(velocity_request(linear))
            answer = await asyncio.to_thread(driver.recv, 4096)
        assert answer.split()[1] == status, answer
        assert (b'"kind":"late"' in answer) == (status == b"409")
