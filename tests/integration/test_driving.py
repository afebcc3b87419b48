"""PlanarVelocity on a running daemon: every way in which a source of commands can vanish ends in zero."""

import asyncio
import os

import aiohttp
import msgspec
import pytest
from structlog.testing import capture_logs

from hostlink.config import Config, RobotConfig
from hostlink.errors import CommandRefused
from hostlink.protocol.frame import Id, encode
from hostlink.robot.velocity import PlanarVelocity
from tests.support.api_loads import frame
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
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


async def test_the_first_velocity_of_a_session_is_zero() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        assert await device.velocity() == CURVE


async def test_a_device_cannot_drive_another_past_its_gate() -> None:
    """A message on a velocity topic is a command, also from a device: here one device drives the other."""
    remote = [robot_topics("robot_0")[1]._replace(kind=Id.PUBLISHER, topic_id=125)]
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        async with fake_device(host.tcp, remote) as sender:
            twist = host.hub.catalog.message("geometry_msgs/Twist")
            assert twist is not None
            await sender.send(encode(125, twist.encode({"linear": {"x": 5.0}})))
            assert await device.velocity() == (1.0, 0.0)  # the limit of a robot without configuration
        assert await device.velocity_other_than((1.0, 0.0)) == ZERO


async def test_robot_that_reconnects_while_its_old_link_seems_alive_replaces_it_at_once() -> None:
    with capture_logs() as lines:
        async with daemon() as host, fake_device(host.tcp, robot_topics()) as old:
            await greeted(old)
            async with fake_device(host.tcp, robot_topics()) as new:
                await old.closed()
                await greeted(new)  # until it is known who it is, and again then
                drive(host)
                assert await new.velocity_other_than(ZERO) == CURVE
                await new.send(pose(1.0))
                await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
    assert next(line["reason"] for line in lines if line["event"] == "link.closed") == "replaced"


async def test_a_robot_that_sends_no_more_but_still_reads_receives_a_zero_before_its_link_ends() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        assert await device.velocity() == CURVE
        device.end_sending()
        assert await device.velocity_other_than(CURVE) == ZERO
        await device.closed()


async def test_two_robots_behind_one_address_live_side_by_side() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("robot_0")) as first,
        fake_device(host.tcp, robot_topics("robot_1")) as second,
    ):
        await greeted(first)
        await greeted(second)
        drive(host)
        assert await first.velocity() == CURVE
        assert [robot["name"] for robot in (await host.get("/api/robots"))["robots"]] == ["robot_0", "robot_1"]
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await second.velocity()


async def test_another_address_that_announces_a_robots_name_has_a_number_and_a_hint_what_to_configure() -> None:
    with capture_logs() as lines:
        async with daemon() as host, fake_device(host.tcp, robot_topics()) as owner:
            await greeted(owner)
            async with fake_device(host.tcp, robot_topics(), local_host="127.0.0.2") as other:
                await greeted(other)
                drive(host)
                assert await owner.velocity() == CURVE
                names = [robot["name"] for robot in (await host.get("/api/robots"))["robots"]]
                assert names == ["robot_0", "robot_0_2"]
    numbered = next(line for line in lines if line["event"] == "robot.numbered")
    assert (numbered["robot"], numbered["own_name"]) == ("robot_0_2", "robot_0")
    assert '[robots.NAME] address = "127.0.0.2"' in numbered["advice"]


async def test_a_name_from_the_configuration() -> None:
    config = Config(robots={"mower": RobotConfig(address="127.0.0.3")})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics(), local_host="127.0.0.3") as device:
        await greeted(device)
        assert host.hub.robots.find("mower").topics.velocity == "/robot_0/velocity_commands"
        assert host.hub.robots.find("mower").shown.velocity == "/mower/velocity_commands"


async def test_the_daemon_stops_every_robot_and_then_silences_it() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        assert await device.velocity() == CURVE
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(host.hub.shutdown())
            frames = []
            while not frames or frames[-1].topic_id != Id.STOP:
                frames.append(await device.next())
            await device.closed()
    commands = [frame for frame in frames if frame.topic_id == 100]
    assert len(commands) >= 3
    assert all(frame.payload == bytes(48) for frame in commands[-3:])


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


async def test_a_lock_survives_a_reconnect() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            await greeted(device)
            drive(host)
            await locked(host)
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        assert (await host.get("/api/robots/robot_0"))["lock_reason"] == "emergency stop"
        async with fake_device(host.tcp, robot_topics()) as device:
            await greeted(device)
            with pytest.raises(CommandRefused):
                drive(host)
            assert await device.velocity() == ZERO


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


async def test_everything_stops_at_one_request() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("robot_0")) as first,
        fake_device(host.tcp, robot_topics("robot_1")) as second,
    ):
        for name, device in (("robot_0", first), ("robot_1", second)):
            await greeted(device)
            drive_gate(host.hub.robots.find(name), PlanarVelocity(0.2, yaw_rad_s=0.5), owner="test")
        status, body = await host.rest("POST", "/api/stop")
        assert (status, [robot["holder"] for robot in body["robots"]]) == (200, [None, None])
        assert await first.velocity_other_than(CURVE) == ZERO
        assert await second.velocity_other_than(CURVE) == ZERO


async def test_a_stop_brakes_as_gently_as_is_configured() -> None:
    config = Config(robots={"robot_0": RobotConfig(max_linear_deceleration_m_s2=1.0)})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, velocity=(0.3, 0.0))
        assert await device.velocity() == (0.3, 0.0)
        assert (await host.rest("POST", "/api/robots/robot_0/stop"))[0] == 200
        speeds = [0.3]
        while speeds[-1] != 0:
            speeds.append((await device.velocity())[0])
        assert len(speeds) > 3
        assert speeds == sorted(speeds, reverse=True)
        assert [await device.velocity() for _ in range(2)] == [ZERO, ZERO]


async def test_priorities_are_read_from_rest_and_shown() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await host.drive("robot_0", b'{"linear": 0.1, "angular": 0, "priority": 70}')
        assert (await host.get("/api/robots/robot_0"))["priority"] == 70
        with pytest.raises(CommandRefused):
            drive(host, "teleop", priority=60)


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
