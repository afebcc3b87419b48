"""Server-sent events: what a page or `curl -N` gets without asking again."""

import asyncio
import contextlib
import json
import socket
import struct
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
import pytest
from structlog.testing import capture_logs

from hostlink.components.gateway.events import CHECK_S, TICK_S
from hostlink.core.config import Config, LinkConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG, fake_device, pose, robot_topics, topic
from tests.support.participants import publish
from tests.support.waiting import TIMEOUT_S, expect

ROBOTS, POSES, NARROW_BYTES = 6, 12, 2048
NO_LINGER = struct.pack("ii", 1, 0)  # the end of a connection is a reset


class Reader:
    """The events of one stream."""

    def __init__(self, response: aiohttp.ClientResponse) -> None:
        self._response = response

    async def next(self, wanted: str) -> Any:
        """The data of the next event of that name."""
        name = ""
        async with asyncio.timeout(TIMEOUT_S):
            async for line in self._response.content:
                key, _, value = line.decode().strip().partition(": ")
                if key == "event":
                    name = value
                elif key == "data" and name == wanted:
                    return json.loads(value)
        raise AssertionError("the stream ended")

    async def comment(self) -> str:
        """The next line that is part of no event."""
        async for line in self._response.content:
            if line.startswith(b":"):
                return line.decode().strip()
        raise AssertionError("the stream ended")


@contextlib.asynccontextmanager
async def stream(host: Daemon, path: str) -> AsyncIterator[Reader]:
    async with host.session.get(host.url + path) as response:
        assert (response.status, response.content_type) == (200, "text/event-stream")
        assert response.headers["Cache-Control"] == "no-store"
        yield Reader(response)


async def test_robots_and_links_are_events_when_they_connect_and_disconnect() -> None:
    async with daemon() as host, stream(host, "/api/events") as reader:
        assert (await reader.next("robots"))["robots"] == []
        await reader.next("clients")
        assert (await reader.comment()).startswith(": sent ")
        async with fake_device(host.tcp, robot_topics()):
            robots: list[Any] = []
            while not robots:
                robots = (await reader.next("robots"))["robots"]
            assert (robots[0]["name"], robots[0]["connected"]) == ("robot_0", True)
            assert (await reader.next("links"))["links"][0]["negotiations"] == 1
        while robots[0]["connected"]:
            robots = (await reader.next("robots"))["robots"]


async def test_a_slow_reader_is_sent_the_newest_and_not_what_was_true_in_between() -> None:
    """No event waits in the kernel: it would arrive long after it was true."""
    names = [f"robot_{number}" for number in range(ROBOTS)]
    async with daemon() as host, contextlib.AsyncExitStack() as stack:
        devices = [await stack.enter_async_context(fake_device(host.tcp, robot_topics(name))) for name in names]
        with socket.socket() as narrow:
            narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, NARROW_BYTES)
            address, port = host.url.removeprefix("http://").split(":")
            narrow.connect((address, int(port)))
            reader, writer = await asyncio.open_connection(sock=narrow, limit=NARROW_BYTES)
            writer.write(b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
            for number in range(1, POSES + 1):
                for device in devices:
                    await device.send(pose(float(number)))
                await asyncio.sleep(TICK_S)
            received = b""
            async with asyncio.timeout(TIMEOUT_S):
                while b'"x_m":%.1f' % POSES not in received:
                    received += await reader.read(NARROW_BYTES)
            assert received.count(b"event: robots") < POSES / 2
            writer.close()


async def test_slow_reader_that_disconnects_causes_no_error() -> None:
    names = [f"robot_{number}" for number in range(ROBOTS)]
    with capture_logs() as lines:
        async with daemon() as host, contextlib.AsyncExitStack() as stack:
            devices = [await stack.enter_async_context(fake_device(host.tcp, robot_topics(name))) for name in names]
            with socket.socket() as narrow:
                narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, NARROW_BYTES)
                narrow.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)
                narrow.connect(("127.0.0.1", int(host.url.rpartition(":")[2])))
                narrow.sendall(b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
                for number in range(1, POSES + 1):
                    for device in devices:
                        await device.send(pose(float(number)))
                    await asyncio.sleep(TICK_S)
            async with asyncio.timeout(TIMEOUT_S):
                while (await host.get("/api/clients"))["clients"]:  # noqa: ASYNC110 - there is no event
                    await asyncio.sleep(CHECK_S)
    assert [line for line in lines if line["event"] in ("library.complained", "loop.error")] == []


async def test_each_new_pose_is_an_event() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        async with stream(host, "/api/robots/robot_0/odometry/events") as reader:
            for number in range(3):
                await device.send(pose(float(number), 0.0, 0.0))
                assert (await reader.next("odometry"))["pose"]["x_m"] == number
            assert (await host.get("/api/clients"))["clients"][0]["kind"] == "events"
        while (await host.get("/api/clients"))["clients"]:  # that a reader is gone shows when it is written to
            await device.send(pose(0.0, 0.0, 0.0))
        assert len(host.hub.topics.find("/robot_0/odometry").subscribers) == 1
        assert len(host.hub.robots.find("robot_0").followers) == 1  # what publishes its odometry as ROS has it


async def x_of_the_next(reader: Reader, x_m: float) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while (await reader.next("odometry"))["pose"]["x_m"] != x_m:
            pass


async def test_event_stream_follows_a_robot_that_reconnects_with_another_topic_and_type() -> None:
    other_type = CATALOG.message("nav_msgs/Odometry")
    assert other_type is not None
    other = [
        topic(EndpointKind.PUBLISHER, 126, "/robot_0/odom", "nav_msgs/Odometry"),
        topic(EndpointKind.SUBSCRIBER, 100, "/robot_0/velocity_commands", "geometry_msgs/Twist"),
    ]
    frame = encode(126, other_type.encode({"pose": {"pose": {"position": {"x": 1.0}, "orientation": {"w": 1.0}}}}))
    async with daemon() as host, contextlib.AsyncExitStack() as devices:
        device = await devices.enter_async_context(fake_device(host.tcp, robot_topics()))
        async with stream(host, "/api/robots/robot_0/odometry/events") as reader:
            await device.send(pose(1.0))
            await x_of_the_next(reader, 1.0)
            await devices.aclose()
            device = await devices.enter_async_context(fake_device(host.tcp, other))
            await expect(lambda: host.hub.robots.find("robot_0").shown.odometry == "/robot_0/odom")
            count = host.hub.robots.find("robot_0").odometry.count
            await device.send(frame)
            async with asyncio.timeout(TIMEOUT_S):
                while (await reader.next("odometry"))["count"] != count + 1:
                    pass


async def test_pose_of_another_publisher_is_not_an_event() -> None:
    path = "/api/robots/robot_0/odometry/events"
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, stream(host, path) as reader:
        await device.send(pose(1.0))
        await x_of_the_next(reader, 1.0)
        publish(host.hub, "/robot_0/odometry", {"x": 9.0})
        await device.send(pose(2.0))
        assert (await reader.next("odometry"))["pose"]["x_m"] == 2.0


async def test_the_stream_of_a_robot_that_is_forgotten_ends() -> None:
    config = Config(link=LinkConfig(forget_robot_after_s=0.2))
    async with daemon(config) as host, contextlib.AsyncExitStack() as devices:
        device = await devices.enter_async_context(fake_device(host.tcp, robot_topics()))
        async with stream(host, "/api/robots/robot_0/odometry/events") as reader:
            await device.send(pose(1.0))
            await x_of_the_next(reader, 1.0)
            await devices.aclose()
            with pytest.raises(AssertionError, match="the stream ended"):
                await reader.next("odometry")


async def test_event_stream_of_an_unknown_robot_is_not_found() -> None:
    async with daemon() as host:
        status, error = await host.rest("GET", "/api/robots/nobody/odometry/events")
        assert (status, error["error"]["kind"]) == (404, "UnknownTopic")
        assert (await host.get("/api/clients"))["clients"] == []
