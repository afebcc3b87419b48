"""Foxglove's own protocol on the API's port: who may, what a driving client leaves behind, what a slow one costs."""

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

from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.events import OWNER_LEFT
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.daemon import Daemon, daemon, stops_of
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.waiting import TIMEOUT_S, expect

FOXGLOVE = "foxglove.sdk.v1"
SCAN_BYTES = 30_000  # the buffers of the kernel take many small messages before the daemon must drop one
DRIVE, READ = "a-token-of-a-driver", "a-token-of-a-watcher"
TOKENS = (TokenConfig(name="ann", token=DRIVE, role="drive"), TokenConfig(name="tv", token=READ, role="read"))
CURVE, ZERO = (0.2, 0.5), (0.0, 0.0)
MESSAGE = 1  # opcode


class Player:
    """A program at the other end of the WebSocket."""

    def __init__(self, web_socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = web_socket
        self.channels: dict[str, int] = {}

    async def send(self, **request: Any) -> None:
        await self.socket.send_str(json.dumps(request))

    async def until(self, op: str) -> dict[str, Any]:
        """The next JSON message of this op."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                message = await self.socket.receive()
                assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
                if message.type is aiohttp.WSMsgType.TEXT:
                    found: dict[str, Any] = json.loads(message.data)
                    if found["op"] == "advertise":
                        self.channels |= {each["topic"]: each["id"] for each in found["channels"]}
                    if found["op"] == op:
                        return found

    async def message(self) -> tuple[int, bytes]:
        """(subscription, payload) of the next message."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                message = await self.socket.receive()
                if message.type is aiohttp.WSMsgType.BINARY and message.data[0] == MESSAGE:
                    break
        return struct.unpack_from("<I", message.data, 1)[0], message.data[13:]

    async def channel(self, topic: str) -> int:
        while topic not in self.channels:
            await self.until("advertise")
        return self.channels[topic]

    async def subscribe(self, topic: str) -> None:
        await self.send(op="subscribe", subscriptions=[{"id": 7, "channelId": await self.channel(topic)}])

    async def begin_to_drive(self, topic: str) -> None:
        channel = {"id": 1, "topic": topic, "encoding": "ros1", "schemaName": "geometry_msgs/Twist"}
        await self.send(op="advertise", channels=[channel])

    async def drive(self) -> None:
        velocity = PlanarVelocity(x_m_s=CURVE[0], yaw_rad_s=CURVE[1])
        await self.socket.send_bytes(struct.pack("<BI", 1, 1) + velocity.encode())


@contextlib.asynccontextmanager
async def player(host: Daemon, query: str = "", **options: Any) -> AsyncIterator[Player]:
    async with host.session.ws_connect(f"{host.url}/{query}", protocols=(FOXGLOVE,), **options) as web_socket:
        assert web_socket.protocol == FOXGLOVE
        yield Player(web_socket)


def velocity_topic(host: Daemon) -> str:
    return host.hub.robots.find("robot_0").shown.velocity


async def test_messages_of_a_robot_arrive_as_the_device_sent_them() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, player(host) as one:
        await one.subscribe("/robot_0/odometry")
        await expect(lambda: "client 1" in map(str, keys(host, "/robot_0/odometry")))
        await device.send(pose(1.0, 2.0, 3.0))
        assert await one.message() == (7, struct.pack("<3d", 1.0, 2.0, 3.0))
        (view,) = (await host.get("/api/clients"))["clients"]
        assert (view["kind"], view["role"]) == ("foxglove", "drive")
        device.hang_up()
        assert (await one.until("unadvertise"))["channelIds"]


def keys(host: Daemon, topic: str) -> list[object]:
    found = host.hub.topics.find_or_none(topic)
    return [] if found is None else [subscriber.key for subscriber in found.subscribers]


@pytest.mark.parametrize("subprotocols", [("foxglove.websocket.v1",), ("other.v1", "foxglove.sdk.v1")])
async def test_the_first_subprotocol_that_is_known_is_spoken(subprotocols: tuple[str, ...]) -> None:
    async with daemon() as host, host.session.ws_connect(host.url, protocols=subprotocols) as web_socket:
        assert web_socket.protocol == subprotocols[-1]
        assert (await Player(web_socket).until("serverInfo"))["name"] == "hostlink"


async def test_tokens_and_their_roles_hold_in_the_url_and_in_the_header() -> None:
    async with daemon(Config().with_tables(api=ApiConfig(tokens=TOKENS))) as host:
        for query, status in (("", 401), ("?token=guessed-and-wrong", 401)):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
                await host.session.ws_connect(f"{host.url}/{query}", protocols=(FOXGLOVE,))
            assert refusal.value.status == status
        async with (
            player(host, f"?token={DRIVE}") as one,
            player(host, headers={"Authorization": f"Bearer {READ}"}) as two,
        ):
            assert "clientPublish" in (await one.until("serverInfo"))["capabilities"]
            assert "clientPublish" not in (await two.until("serverInfo"))["capabilities"]
            await two.begin_to_drive("/robot_0/cmd_vel")
            refused = "advertise: the token may only read; use one with the role drive"
            assert (await two.until("status"))["message"] == refused
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            await host.session.ws_connect(
                f"{host.url}/?token={DRIVE}", protocols=(FOXGLOVE,), headers={"Origin": "https://app.foxglove.dev"}
            )
        assert refusal.value.status == 403


@pytest.mark.parametrize("end", ["closes", "vanishes"])
async def test_a_robot_stands_when_the_client_that_drove_it(end: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, player(host) as one:
        await expect(lambda: bool(host.hub.robots.all()))
        await one.begin_to_drive(velocity_topic(host))
        await one.drive()
        assert await device.velocity_other_than(ZERO) == CURVE
        reasons = stops_of(host, "robot_0")
        if end == "closes":
            await one.socket.close()
        else:
            one.socket._response.connection.transport.abort()  # type: ignore[union-attr]
        assert await device.velocity_other_than(CURVE) == ZERO
        assert reasons == [OWNER_LEFT] or host.was_paused


async def test_a_locked_robot_refuses_and_the_reason_is_a_status() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, player(host) as one:
        await expect(lambda: bool(host.hub.robots.all()))
        assert (await host.rest("POST", "/api/robots/robot_0/lock"))[0] == 200
        await one.begin_to_drive(velocity_topic(host))
        await one.drive()
        status = await one.until("status")
        assert (status["level"], status["id"]) == (2, velocity_topic(host))
        assert "locked" in status["message"]
        assert [await device.velocity() for _ in range(3)] == [ZERO] * 3


async def test_a_client_that_never_reads_loses_only_its_own_messages_and_the_robot_nothing() -> None:
    with capture_logs() as lines:
        scan = topic(EndpointKind.PUBLISHER, 126, "/scan", "std_msgs/String", buffer_bytes=SCAN_BYTES + 4)
        frame = encode(scan.id, struct.pack("<I", SCAN_BYTES) + bytes(SCAN_BYTES))
        async with daemon() as host, fake_device(host.tcp, [*robot_topics(), scan]) as device:
            async with player(host) as stuck:
                await stuck.subscribe("/scan")
                await expect(lambda: "client 1" in map(str, keys(host, "/scan")))
                transport = stuck.socket._response.connection.transport  # type: ignore[union-attr]
                transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                transport.pause_reading()
                async with asyncio.timeout(TIMEOUT_S):
                    while not dropped(await host.get("/api/clients")):
                        await device.send(frame * 10 + pose(1.0))
                assert (await host.get("/api/robots/robot_0"))["connected"] is True
                transport.abort()
            await expect(lambda: any(line["event"] == "client.closed" for line in lines))


def dropped(view: Any) -> int:
    return sum(each["dropped"] for each in view["clients"])


@pytest.mark.parametrize("data", ["no JSON", b""])
async def test_invalid_request_has_one_status_and_the_client_stays(data: str | bytes) -> None:
    async with daemon() as host, player(host) as one:
        await (one.socket.send_str(data) if isinstance(data, str) else one.socket.send_bytes(data))
        assert (await one.until("status"))["level"] == 2
        await one.send(op="getParameters", parameterNames=[], id="alive")
        assert (await one.until("parameterValues"))["id"] == "alive"
