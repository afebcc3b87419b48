"""Bodies of requests: bounded for each route and together, and refused before they are read where the head suffices."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config
from tests.support.api_loads import head
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.waiting import TIMEOUT_S

READ, DRIVE = "reader-of-the-tests-0000", "driver-of-the-tests-0000"
CONFIG = Config().with_tables(
    api=ApiConfig(
        tokens=(
            TokenConfig(name="reader", role="read", token=READ),
            TokenConfig(name="driver", role="drive", token=DRIVE),
        )
    )
)
HUGE = "Content-Length: 100000000"
KERNEL_BYTES = 40_000_000  # two sockets of this computer hold less


@contextlib.asynccontextmanager
async def connection(host: Daemon) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
    try:
        yield reader, writer
    finally:
        writer.transport.abort()


async def sent_bytes(writer: asyncio.StreamWriter) -> int:
    """Send an endless body. Return how many bytes the daemon reads until it closes the connection."""
    count = 0
    with contextlib.suppress(ConnectionError):
        while count < KERNEL_BYTES:
            writer.write(bytes(65536))
            await writer.drain()
            count += 65536
    return count


@pytest.mark.parametrize(
    ("method", "path", "token", "status"),
    [
        ("PUT", "/api/robots/robot_0/velocity", "", 401),
        ("POST", "/api/recordings", DRIVE, 413),
        ("POST", "/api/stop", READ, 200),
    ],
)
async def test_a_body_that_the_head_refuses_is_not_read(method: str, path: str, token: str, status: int) -> None:
    async with daemon(CONFIG) as host, fake_device(host.tcp, robot_topics()), connection(host) as (reader, writer):
        writer.write(head(method, path, token, HUGE))
        async with asyncio.timeout(TIMEOUT_S):
            assert (await reader.readline()).split()[1] == str(status).encode()
        assert await sent_bytes(writer) < KERNEL_BYTES


async def test_a_large_body_does_not_stop_the_next_request_of_its_connection() -> None:
    """A small body over the limit is read to its end, because a program expects to keep its connection."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()), connection(host) as (reader, writer):
        for status in (b"413", b"200"):
            body = b" " * (2048 if status == b"413" else 0) + b'{"linear": 0, "angular": 0}'
            writer.write(head("PUT", "/api/robots/robot_0/velocity", "", f"Content-Length: {len(body)}") + body)
            answer = await reader.readuntil(b"\r\n\r\n")
            assert status in answer.partition(b"\r\n")[0]
            length = next(line for line in answer.lower().split(b"\r\n") if line.startswith(b"content-length"))
            await reader.readexactly(int(length.partition(b":")[2]))
