"""Devices on a running daemon: what they are told, what is heard of them, what others notice of their trouble."""

import asyncio
import socket
import struct
import tracemalloc

import pytest

from hostlink.core.hub.message import Message
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.participants import subscribe
from tests.support.waiting import expect


async def test_a_message_of_a_device_reaches_a_subscriber() -> None:
    heard: asyncio.Queue[Message] = asyncio.Queue()
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        subscribe(host.hub, "robot_0/odometry", heard.put_nowait)
        await device.send(pose(1.0, 2.0, 0.5))
        message = await heard.get()
    assert message.decoded == {"x": 1.0, "y": 2.0, "theta": 0.5}
    assert message.decoded == {"x": 1.0, "y": 2.0, "theta": 0.5}
    assert message.type_name == "geometry_msgs/Pose2D"


async def test_message_of_an_undefined_type_passes_as_bytes() -> None:
    uncommon = topic(EndpointKind.PUBLISHER, 125, "/odd", "std_msgs/Bool")._replace(type="my_msgs/Odd", md5="1" * 32)
    heard: asyncio.Queue[Message] = asyncio.Queue()
    async with daemon() as host, fake_device(host.tcp, [uncommon]) as device:
        subscribe(host.hub, "/odd", heard.put_nowait)
        await device.send(encode(125, b"raw"))
        message = await heard.get()
    assert (message.type_name, message.payload) == ("my_msgs/Odd", b"raw")


STRING_OF_4_GB = struct.pack("<H", 125) + b"\xff\xff\xff\xff"


@pytest.mark.parametrize(
    "bad",
    [
        bytes(range(256)) * 40,
        b"\xff\xfe\xff\x7f\x81" + b"\x00" * 100,  # a header that claims 32767 bytes
        encode(Id.PUBLISHER, STRING_OF_4_GB),
        encode(99, b"") + encode(4711, b"x") + encode(100, b"to the host?"),
    ],
    ids=["any bytes", "32767", "4 GB string", "odd ids"],
)
async def test_bad_bytes_cost_neither_their_device_nor_another(bad: bytes) -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("bad")) as device,
        fake_device(host.tcp, robot_topics("good")) as other,
    ):
        tracemalloc.start()
        for _ in range(20):
            await device.send(bad)
        await other.send(pose(3.0))
        await expect(lambda: host.hub.topics.find("/good/odometry").messages == 1)
        peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        # Whatever false header the junk ends with, the next good frames are found inside what it claims.
        await device.send(encode(Id.TIME, bytes(8)) + pose(4.0))
        await expect(lambda: host.hub.topics.find("/bad/odometry").messages == 1)
        assert not host.hub.isolation.crashes
    assert peak_bytes < 5_000_000


async def test_a_device_that_publishes_before_a_request_gets_one_request_and_is_then_understood() -> None:
    async with daemon() as host, fake_device(host.tcp) as device:
        for _ in range(30):
            await device.send(pose(0.0))
        await device.announce(robot_topics())
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        assert (await host.get("/api/links"))["links"][0]["topic_requests"] == 1


async def test_connections_that_are_reset_at_once_disturb_no_robot() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        for _ in range(50):
            with socket.create_connection(host.tcp) as visitor:
                visitor.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        await expect(lambda: len(host.hub.links.all()) == 1)
        assert not host.hub.isolation.crashes
