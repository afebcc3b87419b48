"""Velocity on a running daemon: every way in which a source of commands can vanish ends in zero."""

import asyncio

import pytest
from structlog.testing import capture_logs

from hostlink.config import Config, RobotConfig
from hostlink.errors import BadRequest, RobotHeld
from hostlink.protocol.frame import Id, encode
from hostlink.robot.velocity import Velocity
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.rosbridge import client
from tests.support.waiting import expect

ZERO = (0.0, 0.0)
CURVE = (0.2, 0.5)


def drive(host: Daemon, owner: str = "test", *, priority: int = 50, velocity: tuple[float, float] = CURVE) -> None:
    robot = host.hub.robots.find("robot_0")
    wanted = Velocity(linear_x_m_s=velocity[0], angular_z_rad_s=velocity[1])
    host.hub.gates.command(robot, wanted, owner=owner, priority=priority)


async def greeted(device: FakeDevice) -> None:
    """The zeros with which every session begins."""
    assert [await device.velocity() for _ in range(3)] == [ZERO, ZERO, ZERO]


async def test_the_first_velocity_of_a_session_is_zero() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        assert await device.velocity() == CURVE


async def test_a_command_is_repeated_until_its_lease_ends_and_then_zero_three_times() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host)
        sent = [await device.velocity()]
        while sent[-1] != ZERO:
            sent.append(await device.velocity())
        assert 3 <= sent.count(CURVE) <= 7  # 0.5 s at 10 Hz
        assert [await device.velocity() for _ in range(2)] == [ZERO, ZERO]
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await device.velocity()


async def test_a_client_that_leaves_stops_the_robot_at_once() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, "client 1")
        assert await device.velocity() == CURVE
        host.hub.gates.release("client 1")
        assert await device.velocity() == ZERO


async def test_anybody_may_stop() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, priority=100)
        assert await device.velocity() == CURVE
        status, _ = await host.rest("POST", "/api/robots/robot_0/stop")
        assert status == 200
        assert await device.velocity() == ZERO


async def test_a_lower_priority_is_refused_and_a_higher_one_replaces_the_owner() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, "program")
        with pytest.raises(RobotHeld, match="robot_0: program drives it with a higher priority"):
            drive(host, "demo", priority=0)
        drive(host, "teleop", priority=60, velocity=(0.1, 0.0))
        assert await device.velocity_other_than(CURVE) == (0.1, 0.0)


async def test_idle_zeros_of_another_source_do_not_stop_who_drives() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, "program")
        drive(host, "idle page", velocity=ZERO)
        assert await device.velocity() == CURVE
        assert host.hub.robots.find("robot_0").gate.owner_name == "program"


async def test_numbers_that_are_none_never_reach_a_robot() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        with pytest.raises(BadRequest, match="must be made of finite numbers"):
            drive(host, velocity=(float("nan"), 0.0))
        drive(host)
        assert await device.velocity() == CURVE


async def test_limits_scale_both_speeds_so_that_the_curve_stays() -> None:
    config = Config(robots={"robot_0": RobotConfig(wheel_separation_m=0.21, max_wheel_m_s=0.3436)})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, velocity=(-1.0, 2.0))
        linear, angular = await device.velocity()
    assert linear / angular == pytest.approx(-0.5)
    assert abs(linear) + angular * 0.105 == pytest.approx(0.3436)


async def test_a_device_cannot_drive_another_past_its_gate() -> None:
    """A message on a velocity topic is a command, whoever sends it: here one device drives the other."""
    remote = [robot_topics("robot_0")[1]._replace(kind=Id.PUBLISHER, topic_id=125)]
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        async with fake_device(host.tcp, remote) as sender:
            twist = host.hub.catalog.message("geometry_msgs/Twist")
            assert twist is not None
            await sender.send(encode(125, twist.encode({"linear": {"x": 5.0}})))
            assert await device.velocity() == (1.0, 0.0)  # the limit of a robot that nobody configured
        assert await device.velocity_other_than((1.0, 0.0)) == ZERO


async def test_a_robot_that_comes_back_is_not_sent_what_was_meant_before() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            await greeted(device)
            drive(host)
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        async with fake_device(host.tcp, robot_topics()) as device:
            await greeted(device)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.3):
                    await device.velocity()


async def test_a_robot_that_comes_back_while_its_old_link_seems_alive_replaces_it_at_once() -> None:
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
        with pytest.raises(RobotHeld, match="a hand in the wheel; to drive it again: hostlink unlock robot_0"):
            drive(host, "teleop", priority=100)
        body = b'{"linear": 0.1, "angular": 0, "priority": 100}'
        status, error = await host.rest("PUT", "/api/robots/robot_0/velocity", body)
        assert (status, error["error"]["kind"]) == (409, "RobotHeld")
        assert [await device.velocity() for _ in range(4)] == [ZERO] * 4  # one of them half a second later
        status, robot = await host.rest("POST", "/api/robots/robot_0/unlock")
        assert (status, robot["locked"], robot["lock_reason"]) == (200, False, None)
        drive(host)
        assert await device.velocity_other_than(ZERO) == CURVE


@pytest.mark.parametrize("topic", ["/robot_0/cmd_vel", "/robot_0/velocity_commands", "/robot_0/cmd_vel_stamped"])
async def test_a_stream_that_went_on_through_a_lock_drives_after_a_zero_and_not_before(topic: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        stream = host.hub.join("navigation")
        forward, still = Velocity(0.2).encode(), Velocity().encode()
        header = bytes(16) if topic.endswith("stamped") else b""  # without a stamp and a frame
        stream.publish(topic, header + forward)
        assert await device.velocity() == (0.2, 0.0)
        await locked(host)
        with pytest.raises(RobotHeld, match="locked: emergency stop"):
            stream.publish(topic, header + forward)
        assert (await host.rest("POST", "/api/robots/robot_0/unlock"))[0] == 200
        for _ in range(8):
            with pytest.raises(BadRequest, match=r"drives again after a zero, or 0\.5 s without velocities"):
                stream.publish(topic, header + forward)
            await asyncio.sleep(0.1)
        assert host.hub.robots.find("robot_0").gate.owner_name is None
        stream.publish(topic, header + still)
        stream.publish(topic, header + forward)
        assert await device.velocity_other_than(ZERO) == (0.2, 0.0)


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
        await expect(reader.at_eof)
        with pytest.raises(RobotHeld):
            drive(host)


async def test_a_lock_whose_reason_comes_late_has_it() -> None:
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
            with pytest.raises(RobotHeld):
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
            with pytest.raises(RobotHeld):
                drive(host)


async def test_the_lock_is_a_service_for_programs() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await greeted(device)
        drive(host)
        answer = await program.call("/robot_0/lock")
        assert answer == {"success": True, "message": "robot_0 is locked until robot_0/unlock is called"}
        assert await device.velocity_other_than(CURVE) == ZERO
        assert host.hub.robots.find("robot_0").gate.lock_reason == "emergency stop"
        assert (await program.call("/robot_0/unlock"))["success"] is True
        drive(host)
        assert await device.velocity_other_than(ZERO) == CURVE


async def test_everything_stops_at_one_request() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("robot_0")) as first,
        fake_device(host.tcp, robot_topics("robot_1")) as second,
    ):
        for name, device in (("robot_0", first), ("robot_1", second)):
            await greeted(device)
            host.hub.gates.command(host.hub.robots.find(name), Velocity(0.2, angular_z_rad_s=0.5), owner="test")
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
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.1, "angular": 0, "priority": 70}')
        assert (await host.get("/api/robots/robot_0"))["priority"] == 70
        with pytest.raises(RobotHeld):
            drive(host, "teleop", priority=60)


@pytest.mark.parametrize(("way", "within_s"), [("close", 0.3), ("cut", 0.3), ("silence", 0.8)])
async def test_a_program_on_the_websocket_that_vanishes_leaves_a_standing_robot(way: str, within_s: float) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await greeted(device)
        twist = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg=twist)
        assert await device.velocity() == CURVE
        if way == "close":
            await program.socket.close()
        elif way == "cut":
            connection = program.socket._response.connection
            assert connection is not None
            assert connection.transport is not None
            connection.transport.abort()
        async with asyncio.timeout(within_s):
            assert await device.velocity_other_than(CURVE) == ZERO
        assert [await device.velocity() for _ in range(2)] == [ZERO, ZERO]


async def test_a_script_that_stops_calling_rest_leaves_a_standing_robot() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0.5}')
        assert await device.velocity() == CURVE
        async with asyncio.timeout(0.8):
            assert await device.velocity_other_than(CURVE) == ZERO


async def test_when_who_was_more_important_vanishes_the_robot_stops_and_another_may_drive() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await greeted(device)
        drive(host, "person", priority=60, velocity=(0.1, 0.0))
        with pytest.raises(RobotHeld):
            drive(host, "script")
        assert await device.velocity() == (0.1, 0.0)
        host.hub.gates.release("person")
        assert await device.velocity_other_than((0.1, 0.0)) == ZERO
        drive(host, "script")
        assert await device.velocity_other_than(ZERO) == CURVE
