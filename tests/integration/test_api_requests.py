"""Heads, bodies and frames that make no sense: refused, and neither an error of the daemon's nor a line for each."""

import asyncio
import contextlib
import gzip
import os
import random

import aiohttp
import pytest
from structlog.testing import capture_logs

from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.runtime.log_budget import LOG_INTERVAL_S
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.http_requests import UPGRADE, draw_request
from tests.support.rosbridge import Client

REQUESTS = 800
AT_ONCE = 20
QUIET_S = 0.1  # without a byte: there is no answer, or an endless one
ANSWER_TIMEOUT_S = 20.0  # where an answer must come
FEW_LINES = 12  # of warnings in LOG_INTERVAL_S, for thousands of wrong requests
OF_THE_ROBOT = {"robot.locked", "robot.unlocked", "link.diagnosed"}  # it sends nothing, which is diagnosed in time


async def exchange(host: Daemon, sent_bytes: bytes, *, quiet_s: float = QUIET_S) -> bytes:
    """Say it on a connection of its own; returns the beginning of what came."""
    reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
    heard = b""
    try:
        writer.write(sent_bytes)
        with contextlib.suppress(TimeoutError, ConnectionError):
            while len(heard) < 100_000:
                async with asyncio.timeout(quiet_s):
                    data = await reader.read(65536)
                heard += data
                if not data:
                    break
    finally:
        writer.close()
    return heard


async def open_connections(host: Daemon) -> float:
    async with host.session.get(host.url + "/metrics") as response:
        return float((await response.text()).partition("\nhostlink_api_connections ")[2].split()[0])


async def test_header_that_is_not_utf_8_is_refused() -> None:
    async with daemon() as host:
        for name in ("Host", "Origin", "Expect", "Connection", "Sec-WebSocket-Key", "Sec-WebSocket-Version"):
            host_line = b"" if name == "Host" else b"Host: 127.0.0.1\r\n"
            sent_bytes = (
                b"GET /api/robots HTTP/1.1\r\n" + host_line + name.encode() + b": \xff\r\nConnection: close\r\n\r\n"
            )
            heard = await exchange(host, sent_bytes, quiet_s=ANSWER_TIMEOUT_S)
            assert heard.startswith(b"HTTP/1.1 400 "), name
            assert heard.endswith(f"the header {name} is not UTF-8".encode() + b'"}}')


async def test_a_number_of_4400_digits_is_not_found() -> None:
    async with daemon() as host:
        for path in ("/api/links/{}/capture", "/api/links/1/capture/{}-0", "/api/links/1/capture/0-{}"):
            assert (await host.rest("GET", path.format("9" * 4400)))[0] == 404, path


async def test_program_whose_name_is_not_utf_8_is_listed() -> None:
    head = b"GET / HTTP/1.1\r\nHost: a\r\nUser-Agent: \xffa\r\n" + b"\r\n".join(UPGRADE) + b"\r\n\r\n"
    async with daemon() as host:
        reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
        writer.write(head.replace(b"Host: a", b"Host: 127.0.0.1"))
        await reader.readuntil(b"\r\n\r\n")
        assert [client["program"] for client in (await host.get("/api/clients"))["clients"]] == ["?a"]
        writer.close()


async def test_a_web_socket_for_another_protocol_is_refused() -> None:
    async with daemon() as host:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            await host.session.ws_connect(host.url, protocols=("other.websocket.v1",))
        headers = dict(line.decode().split(": ", 1) for line in UPGRADE) | {"Sec-WebSocket-Protocol": "odd.v1"}
        async with host.session.get(host.url + "/", headers=headers) as response:
            reason = (await response.json())["error"]["reason"]
        async with host.session.ws_connect(host.url) as socket:
            assert "topics" in await Client(socket).call("/rosapi/topics")
    assert refusal.value.status == 400
    assert (
        reason == "unknown subprotocol odd.v1; use foxglove.sdk.v1 or foxglove.websocket.v1, or none for rosbridge v2"
    )


async def test_a_body_that_breaks_off_or_is_damaged_is_refused() -> None:
    head = b"PUT /api/robots/robot_0/velocity HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    with capture_logs() as lines:
        async with (
            daemon(Config().with_tables(api=ApiConfig(request_timeout_s=0.5))) as host,
            fake_device(host.tcp, robot_topics()),
        ):
            reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
            writer.write(head + b"Transfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n")
            await asyncio.sleep(0.05)
            writer.write(b"zz\r\n")
            assert (await reader.readline()).startswith(b"HTTP/1.1 4")
            writer.close()
            _, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
            writer.write(head + b"Content-Length: 40\r\n\r\n{")
            await asyncio.sleep(0.05)
            writer.transport.abort()
            await asyncio.sleep(0.05)
    assert [line for line in lines if line["event"] in ("library.complained", "loop.error")] == []


async def test_a_compressed_body_is_not_unpacked() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        url = f"{host.url}/api/robots/robot_0/velocity"
        body = gzip.compress(b'{"linear": 0, "angular": 0}' + b" " * 10**5)  # to a hundred and fifty bytes
        async with host.session.put(url, data=body, headers={"Content-Encoding": "gzip"}) as response:
            assert response.status == 400


@pytest.mark.slow
async def test_no_request_is_an_error_of_the_daemon() -> None:
    seed = int(os.environ.get("HOSTLINK_SEED", "1"))
    draw = random.Random(seed)
    config = Config().with_tables(api=ApiConfig(request_timeout_s=0.3, max_requests_s=1e6))
    wrong: list[tuple[bytes, bytes]] = []
    began_s = asyncio.get_running_loop().time()
    with capture_logs() as lines:
        async with daemon(config) as host, fake_device(host.tcp, robot_topics()):

            async def some() -> None:
                for _ in range(REQUESTS // AT_ONCE):
                    sent_bytes = draw_request(draw)
                    heard = await exchange(host, sent_bytes)
                    if b"HTTP/1.1 5" in heard and b"HTTP/1.1 503" not in heard:
                        wrong.append((sent_bytes[:500], heard[:500]))

            async with asyncio.TaskGroup() as tasks:
                for _ in range(AT_ONCE):
                    tasks.create_task(some())
            assert (await host.rest("POST", "/api/stop"))[0] == 200
            assert (await host.rest("GET", "/api/clients"))[0] == 200
            assert await open_connections(host) < AT_ONCE
    assert wrong == [], f"HOSTLINK_SEED={seed}"
    assert [line for line in lines if "exc_info" in line] == [], f"HOSTLINK_SEED={seed}"
    loud = [line for line in lines if line["log_level"] in ("warning", "error") and line["event"] not in OF_THE_ROBOT]
    intervals = 1 + (asyncio.get_running_loop().time() - began_s) // LOG_INTERVAL_S
    assert len(loud) < FEW_LINES * intervals, f"HOSTLINK_SEED={seed}"


async def test_no_frame_of_a_web_socket_is_an_error_of_the_daemon() -> None:
    seed = int(os.environ.get("HOSTLINK_SEED", "1"))
    draw = random.Random(seed)
    head = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + b"\r\n".join(UPGRADE) + b"\r\n\r\n"
    with capture_logs() as lines:
        async with daemon() as host:
            async with asyncio.TaskGroup() as tasks:
                for _ in range(100):
                    first = draw.choice((0x81, 0x82, 0x89, 0x88, draw.randrange(256)))
                    frame = bytes((first, draw.randrange(256))) + draw.randbytes(draw.randrange(64))
                    tasks.create_task(exchange(host, head + frame * draw.choice((1, 3))))
            assert (await host.rest("GET", "/api/clients"))[0] == 200
    assert [line for line in lines if "exc_info" in line] == [], f"HOSTLINK_SEED={seed}"
