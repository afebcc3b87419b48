"""Velocity that the device cannot receive: each entry point reports it to the sender, and the log stays small."""

import asyncio
import base64
import contextlib
import json
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.client import CommandRefused, Refused, connect
from hostlink.components.gateway.clients import ClientQueue
from hostlink.components.gateway.foxglove import FoxgloveClient, FoxgloveDirectory
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.core.config import Config
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import FrameTooLarge, HostlinkError
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics, topic
from tests.support.hosts import host_in
from tests.support.participants import Scene, play
from tests.support.process import run
from tests.support.rosbridge import Client
from tests.support.waiting import expect

REASON = "/robot_0/velocity_commands: frame of 56 bytes, the device takes 40"
TWIST = {"linear": {"x": 0.2}}
SMALL = [
    topic(EndpointKind.PUBLISHER, 125, "/robot_0/odometry", "geometry_msgs/Pose2D"),
    topic(EndpointKind.SUBSCRIBER, 100, "/robot_0/velocity_commands", "geometry_msgs/Twist", buffer_bytes=40),
]


@contextlib.asynccontextmanager
async def small_robot() -> AsyncIterator[Daemon]:
    async with daemon(Config()) as host, fake_device(host.tcp, SMALL):
        yield host


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("PUT", "velocity", b'{"linear": 0.1, "angular": 0}'),
        ("POST", "lock", None),
    ],
)
async def test_rest_gives_the_reason(method: str, path: str, body: bytes | None) -> None:
    async with small_robot() as host:
        status, answer = await host.rest(method, f"/api/robots/robot_0/{path}", body)
        assert (status, answer["error"]) == (413, {"kind": "FrameTooLarge", "reason": REASON})
        robot = await host.get("/api/robots/robot_0")
    assert robot["holder"] is None
    assert robot["unreachable"] == REASON
    assert robot["locked"] is (path == "lock")  # it is locked, though its device has not heard the zero


async def test_a_stop_of_all_reaches_the_others_first() -> None:
    async with small_robot() as host, fake_device(host.tcp, robot_topics("robot_1")) as other:
        await host.drive("robot_1", b'{"linear": 0.2, "angular": 0}')
        assert await other.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        status, answer = await host.rest("POST", "/api/stop")
        assert (status, answer["error"]["reason"]) == (413, REASON)
        assert await other.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)


async def test_rosbridge_gives_the_reason() -> None:
    async with small_robot() as host, host.session.ws_connect(host.url) as socket:
        client = Client(socket)
        await client.send(op="set_level", level="error")
        await client.send(op="publish", id="p", topic="/robot_0/cmd_vel", type="geometry_msgs/Twist", msg=TWIST)
        assert await client.receive() == {
            "op": "status", "level": "error", "msg": REASON, "kind": "FrameTooLarge", "id": "p",
        }  # fmt: skip


class Peer:
    """A client on a hub in virtual time; `statuses` is what it was told."""

    def __init__(self, made: Scene, kind: str) -> None:
        self.queue, self.kind, self.statuses = ClientQueue(), kind, list[dict[str, Any]]()
        self.client: Any
        if kind == "rosbridge":
            self.client = RosbridgeClient("client 1", host_in(made.hub), self.queue, spawn=made.tasks.create_task)
        else:
            host = host_in(made.hub)
            directory = FoxgloveDirectory(host)
            self.client = FoxgloveClient("client 1", host, directory, self.queue, spawn=made.tasks.create_task)
            channels = [
                {"id": number, "topic": name, "encoding": "ros1", "schemaName": type_name}
                for number, (name, type_name) in enumerate(NAMES.items())
            ]
            self.client.receive(json.dumps({"op": "advertise", "channels": channels}))

    def publish(self, name: str, payload: bytes) -> None:
        if self.kind == "rosbridge":
            raw = base64.b64encode(payload).decode()
            self.client.receive(json.dumps({"op": "publish", "topic": name, "type": NAMES[name], "raw": raw}))
        else:
            self.client.receive(struct.pack("<BI", 1, list(NAMES).index(name)) + payload)
        for waiting in iter(self.queue.pop, None):
            if not waiting.item.is_binary:
                operation = json.loads(waiting.item.data)
                self.statuses += [operation] if operation["op"] == "status" else []


NAMES = {
    "/robot_0/velocity_commands": "geometry_msgs/Twist",
    "/robot_0/cmd_vel": "geometry_msgs/Twist",
    "/chat": "std_msgs/String",
}


@pytest.mark.parametrize("kind", ["rosbridge", "foxglove"])
def test_a_client_that_asked_for_nothing_is_told_of_a_refused_velocity_once_a_second_and_topic(kind: str) -> None:
    async def test(made: Scene) -> None:
        peer, robot = Peer(made, kind), made.hub.robots.find("robot_0")
        topics = ["/robot_0/velocity_commands", "/robot_0/cmd_vel"]
        for number in range(48):  # in 6 s; each reason is another
            robot.lock(f"reason {number}")
            for name in topics:
                peer.publish(name, PlanarVelocity(0.2).encode())
            await asyncio.sleep(0.125)
        assert len(peer.statuses) == 2 * 6
        assert all("locked: reason" in str(status) for status in peer.statuses)
        assert {status["level"] for status in peer.statuses} == {"error" if kind == "rosbridge" else 2}
        peer.publish(topics[0], PlanarVelocity().encode())  # a zero is accepted
        assert len(peer.statuses) == 2 * 6

    play(test)


async def test_the_drive_operation_gives_the_reason() -> None:
    async with small_robot() as host, host.session.ws_connect(host.url) as socket:
        client = Client(socket)
        await client.send(op="drive", id="d", robot="robot_0", linear=0.1, angular=0.0)
        assert await client.receive() == {
            "op": "drive_result", "id": "d", "result": False, "kind": "FrameTooLarge", "reason": REASON,
        }  # fmt: skip


async def test_the_python_client_gives_the_reason() -> None:
    async with small_robot() as host, connect(host.url) as program:
        with pytest.raises(HostlinkError, match=REASON):
            await program.robot("robot_0").drive(0.1, 0.0)
        with pytest.raises(HostlinkError, match=REASON):
            await program.robot("robot_0").stop()
        await program.publish("/robot_0/cmd_vel", TWIST)
        with pytest.raises(HostlinkError, match=REASON):
            await program.settle()
        assert not program.robot("robot_0").is_driven


async def test_errors_of_the_python_client_have_the_kind() -> None:
    async with daemon(Config()) as host, fake_device(host.tcp, robot_topics()), connect(host.url) as program:
        robot = program.robot("robot_0")
        await expect(lambda: host.hub.robots.find("robot_0").link)
        await robot.lock("smoke")
        with pytest.raises(CommandRefused) as command:
            await robot.drive(0.1, 0.0)
        await program.publish("/robot_0/cmd_vel", TWIST)
        with pytest.raises(Refused) as published:
            await program.settle()
        with pytest.raises(Refused) as unknown:
            await program.get("/api/robots/robot_9")
    assert [each.value.kind for each in (command, published, unknown)] == ["locked", "locked", "UnknownTopic"]


async def test_a_command_gives_the_reason() -> None:
    async with small_robot() as host:
        status, _, error = await run("pub", "/robot_0/cmd_vel", '{"linear": {"x": 0.1}}', "--url", host.url)
    next_step = "send less in one message; `hostlink doctor` shows which buffer of the board is too small"
    assert (status, error) == (1, f"hostlink: {REASON}; {next_step}\n")


async def test_the_log_has_one_line_of_it() -> None:
    with capture_logs() as lines:
        async with small_robot() as host:
            for _ in range(40):
                await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.1, "angular": 0}')
            robot = host.hub.robots.find("robot_0")
            await expect(lambda: not robot.gate.is_active)
            assert robot.refusals.count > 40
    assert [line["cause"] for line in lines if line["event"] == "robot.unreachable"] == [REASON]


async def test_a_robot_that_accepts_its_velocity_again_is_reachable() -> None:
    async with small_robot() as host:
        robot = host.hub.robots.find("robot_0")
        with pytest.raises(FrameTooLarge):
            robot.stop()
        async with fake_device(host.tcp, robot_topics()) as better:  # the same address replaces it
            await expect(lambda: robot.refusals.cause is None)
            await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
            assert await better.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)


@pytest.mark.parametrize(
    ("program", "answers"),
    [("AutobahnPython/26.10.2", ["service_response"]), ("", ["status", "service_response"])],
    ids=["roslibpy", "another program"],
)
async def test_status_that_no_client_asked_for_is_not_sent_to_roslibpy(program: str, answers: list[str]) -> None:
    """roslibpy 2.1.0 logs a traceback for each. Others, such as ros-mcp, learn of the refusal by it."""
    async with (
        small_robot() as host,
        host.session.ws_connect(host.url, headers={"User-Agent": program}) as socket,
    ):
        peer = Client(socket)
        await peer.send(op="publish", topic="/robot_0/velocity_commands", msg=TWIST)
        await peer.send(op="call_service", service="/rosapi/get_time", args={})
        assert [(await peer.receive())["op"] for _ in answers] == answers
