"""PlanarVelocity on a running daemon: every way in which a source of commands can vanish ends in zero."""

import asyncio
import os

import aiohttp
import msgspec
import pytest

from hostlink.config import Config, RobotConfig
from hostlink.errors import CommandRefused
from hostlink.robot.velocity import PlanarVelocity
from tests.support.api_loads import frame
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, robot_topics
from tests.support.gates import drive_gate
from tests.support.rosbridge import client
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect

ZERO = (0.0, 0.0)
CURVE = (0.2, 0.5)


def drive(host: Daemon, owner: str = "test", *, priority: int = 50, velocity: tuple[float, float] = CURVE) -> None:
    robot = host.hub.robots.find("robot_0")
    wanted = PlanarVelocity(x_m_s=velocity[0], yaw_rad_s=velocity[1])
    drive_gate(robot, wanted, owner=owner, priority=priority)


async def greeted(device: FakeDevice) -> None:
    """The zeros with which every session begins."""
    assert [await device.velocity() for _ in range(3)] == [ZERO, ZERO, ZERO]


async def test_a_robot_that_sends_no_more_but_still_reads_receives_a_zero_before_its_link_ends() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        assert await device.velocity() == CURVE
        device.end_sending()
        assert await device.velocity_other_than(CURVE) == ZERO
        await device.closed()


async def locked(host: Daemon, body: bytes | None = None) -> None:
    status, robot = await host.rest("POST", "/api/robots/robot_0/lock", body)
    assert (status, robot["locked"], robot["holder"], robot["priority"]) == (200, True, None, None)


async def test_a_lock_is_zero_past_every_ramp_and_refuses_everybody_until_it_is_opened() -> None:
    config = Config(robots={"robot_0": RobotConfig(max_linear_deceleration_m_s2=0.1)})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, "teleop", priority=100)
        assert await device.velocity() == CURVE
        await locked(host, b'{"reason": "a hand in the wheel"}')
        assert await device.velocity_other_than(CURVE) == ZERO
        with pytest.raises(CommandRefused, match="a hand in the wheel; to drive it again: hostlink unlock robot_0"):
            drive(host, "teleop", priority=100)
        body = b'{"linear": 0.1, "angular": 0, "priority": 100}'
        status, error = await host.rest("PUT", "/api/robots/robot_0/velocity", body)
        assert (status, error["error"]["kind"]) == (409, "locked")
        assert [await device.velocity() for _ in range(4)] == [ZERO] * 4  # one of them half a second later
        status, robot = await host.rest("POST", "/api/robots/robot_0/unlock")
        assert (status, robot["locked"], robot["lock_reason"]) == (200, False, None)
        drive(host)  # this source commanded nothing while the robot was locked
        assert await device.velocity_other_than(ZERO) == CURVE


@pytest.mark.parametrize("announced_bytes", [20, 10**9])
async def test_a_lock_waits_for_no_body_and_holds_without_it(announced_bytes: int) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        assert await device.velocity() == CURVE
        reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
        head = "POST /api/robots/robot_0/lock HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: "
        writer.write(f'{head}{announced_bytes}\r\n\r\n{{"reason": '.encode())
        assert await device.velocity_other_than(CURVE) == ZERO
        assert host.hub.robots.find("robot_0").gate.lock_reason == "emergency stop"
        writer.transport.abort()
        await reader.read()
        with pytest.raises(CommandRefused):
            drive(host)


async def test_lock_request_with_a_late_body_has_its_reason() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
        head = b"POST /api/robots/robot_0/lock HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 20\r\n\r\n"
        writer.write(head)
        gate = host.hub.robots.find("robot_0").gate
        await expect(lambda: gate.lock_reason == "emergency stop")
        writer.write(b'{"reason": "a hand"}')
        assert (await reader.readline()).startswith(b"HTTP/1.1 200 ")
        assert gate.lock_reason == "a hand"
        writer.close()


async def test_a_robot_that_is_away_can_be_locked() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            await greeted(device)
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        await locked(host)
        async with fake_device(host.tcp, robot_topics()) as device:
            await greeted(device)
            with pytest.raises(CommandRefused):
                drive(host)


async def test_the_lock_is_a_service_for_programs() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await greeted(device)
        drive(host)
        answer = await program.call("/robot_0/lock")
        assert answer["success"] is True
        assert "robot_0 is locked until robot_0/unlock is called" in answer["message"]
        assert "it is not known whether it is stopped: it sends no odometry" in answer["message"]
        assert await device.velocity_other_than(CURVE) == ZERO
        assert host.hub.robots.find("robot_0").gate.lock_reason == "emergency stop"
        assert (await program.call("/robot_0/unlock"))["success"] is True
        drive(host, "another")
        assert await device.velocity_other_than(ZERO) == CURVE


@pytest.mark.parametrize(("way", "within_s"), [("close", 0.3), ("cut", 0.3), ("silence", 0.8)])
async def test_a_program_on_the_websocket_that_vanishes_leaves_a_standing_robot(way: str, within_s: float) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await greeted(device)
        twist = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg=twist)
        assert await device.velocity() == CURVE
        watch = Stopwatch()
        if way == "close":
            await program.socket.close()
        elif way == "cut":
            connection = program.socket._response.connection
            assert connection is not None
            assert connection.transport is not None
            connection.transport.abort()
        assert await device.velocity_other_than(CURVE) == ZERO
        assert watch.seconds < within_s
        assert [await device.velocity() for _ in range(2)] == [ZERO, ZERO]


async def test_velocities_of_one_client_that_wait_are_one_and_each_drive_is_answered() -> None:
    """All come in one piece: the newest is obeyed, and a zero between them is not skipped."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        async with aiohttp.ClientSession() as session, session.ws_connect(host.url) as socket:
            speeds = [0.1, 0.2, 0.0, 0.3, 0.4]
            frames = [
                frame(msgspec.json.encode({"op": "drive", "id": n, "robot": "robot_0", "linear": v, "angular": 0}))
                for n, v in enumerate(speeds)
            ]
            descriptor = socket.get_extra_info("socket").fileno()
            os.write(descriptor, b"".join(frames))
            answers = {(answer := await socket.receive_json(timeout=5))["id"]: answer for _ in speeds}
        assert [answers[number]["result"] for number in range(len(speeds))] == [True] * len(speeds)
        assert [answers[number].get("is_replaced", False) for number in range(5)] == [True, True, False, True, False]
        assert [answers[number]["velocity"]["linear_m_s"] for number in range(5)] == [0.0, 0.0, 0.0, 0.4, 0.4]
        assert await device.velocity_other_than(ZERO) == (0.4, 0.0)
        assert host.hub.robots.find("robot_0").gate.counts.commands == 2
        metrics = await (await host.session.get(host.url + "/metrics")).text()
        assert 'hostlink_velocities_replaced_total{kind="rosbridge"} 3.0' in metrics
