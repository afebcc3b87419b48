"""Robots that were flashed alike: each has a name, topics, poses and commands of its own."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest

from hostlink.core.config import Config, LinkConfig, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import decode_parameter
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.protocol.rosserial.topic_table import MAX_MISSED
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused, RefusalKind
from hostlink.workbench.sim.kinematic_robot import DRIVES
from hostlink.workbench.sim.run import run_fleet
from tests.support.daemon import Daemon, daemon
from tests.support.device_codec import encode_parameter_request
from tests.support.fake_device import (
    FakeDevice,
    fake_device,
    pose,
    repeating,
    robot_topics,
    service_client,
    service_server,
    topic,
)
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.participants import publish
from tests.support.rosbridge import client
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect

ONE, OTHER = "127.0.0.2", "127.0.0.3"
SLOW, FAST = PlanarVelocity(x_m_s=0.1), PlanarVelocity(x_m_s=0.4)
CONFIGURED = Config(robots={"a": RobotConfig(address=ONE), "b": RobotConfig(address=OTHER)})
MORE = [
    topic(EndpointKind.SUBSCRIBER, 102, "/robot_0/pid_tune_l", "geometry_msgs/Vector3"),
    topic(EndpointKind.SUBSCRIBER, 103, "/chatter_in", "std_msgs/Bool"),
    *service_server("/robot_0/reset", "std_srvs/SetBool", 126, 104),
    topic(EndpointKind.PUBLISHER, 127, "/chatter", "std_msgs/Bool"),
    *service_client("/robot_0/ask", "std_srvs/SetBool", 128, 105),
]


@contextlib.asynccontextmanager
async def two_alike(host: Daemon, first: str = ONE, second: str = ONE) -> AsyncIterator[tuple[FakeDevice, FakeDevice]]:
    """Two devices that tell the same, and talk; the first came first."""
    async with (
        fake_device(host.tcp, robot_topics() + MORE, local_host=first) as one,
        repeating(one, pose(1.0)),
        fake_device(host.tcp, robot_topics() + MORE, local_host=second) as other,
        repeating(other, pose(2.0)),
    ):
        await expect(lambda: len([robot for robot in host.hub.robots.all() if robot.link is not None]) == 2)
        yield one, other


async def test_robots_of_one_name_have_topics_under_their_names_and_share_global_topics() -> None:
    async with daemon(CONFIGURED) as host, two_alike(host, second=OTHER) as (one, other):
        names = {shown.name for shown in host.hub.topics.all()}
        assert {"/a/odometry", "/a/velocity_commands", "/a/pid_tune_l", "/b/odometry", "/b/pid_tune_l"} <= names
        assert not [name for name in names if name.startswith("/robot_0")]
        assert len(host.hub.topics.find("/chatter").publishers) == 2
        publish(host.hub, "/chatter_in", {"data": True}, source="test")
        assert [await device.frame(103) for device in (one, other)] == [b"\x01", b"\x01"]
        links = (await host.get("/api/links"))["links"]
        shown = {(each["own_name"], each["name"]) for link in links for each in link["topics"]}
        assert {("/robot_0/pid_tune_l", f"/{name}/pid_tune_l") for name in "ab"} | {("/chatter", "/chatter")} <= shown
        robots = (await host.get("/api/robots"))["robots"]
        assert [robot["velocity_topic"] for robot in robots] == ["/a/velocity_commands", "/b/velocity_commands"]


async def test_a_service_of_the_one_is_not_answered_by_the_other() -> None:
    async def serve(device: FakeDevice, word: str) -> None:
        await device.frame(104)
        await device.send(encode(126, b"\x01" + struct.pack("<I", len(word)) + word.encode()))

    async with daemon(CONFIGURED) as host, two_alike(host, second=OTHER) as (one, other):
        for device, name in ((one, "a"), (other, "b"), (one, "a")):
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(serve(device, name))
                answer = await host.hub.services.call(f"/{name}/reset", {"data": True})
            assert answer["message"] == name


async def test_a_service_that_each_calls_is_that_of_its_name_else_that_of_all() -> None:
    async def call_empty(device: FakeDevice) -> bytes:
        await device.send(encode(128, b"\x01"))
        return (await device.frame(105))[5:]

    async def offer(program: Any, name: str) -> None:
        await program.send(op="advertise_service", service=name, type="std_srvs/SetBool")
        await expect(lambda: host.hub.services.provider(name))

    async def answered(program: Any, device: FakeDevice, word: str) -> None:
        async with asyncio.TaskGroup() as tasks:
            calling = tasks.create_task(call_empty(device))
            call = await program.receive()
            values = {"success": True, "message": word}
            await program.send(
                op="service_response", service=call["service"], id=call["id"], values=values, result=True
            )
        assert calling.result() == word.encode()

    async with daemon(CONFIGURED) as host, two_alike(host, second=OTHER) as (one, other), client(host) as program:
        await offer(program, "/robot_0/ask")
        await answered(program, one, "for all")
        async with client(host) as another:
            await offer(another, "/b/ask")
            await answered(another, other, "for b")
            await answered(program, one, "for all")


async def test_a_parameter_is_that_of_its_name_else_that_of_all() -> None:
    parameters = {"/robot_0/gain": 1, "/b/gain": 2}
    config = Config(robots=CONFIGURED.robots, parameters=parameters)
    async with daemon(config) as host, two_alike(host, second=OTHER) as devices:
        for device, gain in zip(devices, (1, 2), strict=True):
            await device.send(encode(Id.PARAMETER, encode_parameter_request("/robot_0/gain")))
            assert decode_parameter(await device.frame(Id.PARAMETER)) == ((gain,), (), ())


async def test_limits_apply_to_every_robot_that_announces_the_name() -> None:
    config = Config(robots={"robot_0": RobotConfig(max_linear_m_s=0.2, odom_topic="/odom")})
    async with daemon(config) as host, two_alike(host):
        for name in ("robot_0", "robot_0_2"):
            robot = host.hub.robots.find(name)
            assert drive_gate(robot, FAST, owner="test").x_m_s == 0.2
        assert host.hub.topics.find_or_none("/robot_0_2/odom") is not None


async def test_robot_that_reconnects_while_its_old_link_seems_alive_keeps_its_name_and_lock() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics(), local_host=ONE) as old,
        fake_device(host.tcp, robot_topics(), local_host=OTHER) as other,
        repeating(other, pose(2.0)),
    ):
        await expect(lambda: host.hub.robots.find("robot_0_2").link)
        host.hub.robots.find("robot_0").lock("a person is near")
        watch = Stopwatch()
        async with fake_device(host.tcp, robot_topics(), local_host=ONE):
            await old.closed()
            assert watch.seconds < 2.0 or host.was_paused
            await expect(lambda: host.hub.robots.find("robot_0").link)
            with pytest.raises(CommandRefused, match="a person is near"):
                drive_gate(host.hub.robots.find("robot_0"), SLOW, owner="test")
            drive_gate(host.hub.robots.find("robot_0_2"), SLOW, owner="test")
            assert await other.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)


def test_driver_of_the_old_link_does_not_drive_the_new_link() -> None:
    async def check(made: MemoryHub) -> None:
        old = await made.connect(peer="10.0.0.2:1")
        old.infos = []  # the device that reconnects no longer answers here
        robot = made.robot()
        first = robot.link

        async def drive() -> None:
            while robot.link is first:
                drive_gate(robot, SLOW, owner="test")
                await asyncio.sleep(0.02)

        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(drive())
            new = await made.connect(peer="10.0.0.2:2")
        await asyncio.sleep(1.0)
        assert robot.link is new.link
        assert (0.1, 0.0) in velocities(old)
        assert velocities(old)[-1] == (0.0, 0.0)
        assert set(velocities(new)) == {(0.0, 0.0)}

    in_hub(check)


async def test_robot_that_differs_from_the_locked_robot_is_not_locked() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics(), local_host=ONE) as one,
        repeating(one, pose(1.0)),
    ):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        host.hub.robots.find("robot_0").lock("a person is near")
        async with fake_device(host.tcp, robot_topics(), local_host=OTHER) as other:
            await expect(lambda: host.hub.robots.find("robot_0_2").link)
            drive_gate(host.hub.robots.find("robot_0_2"), SLOW, owner="test")
            assert await other.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)


async def test_a_robot_that_drives_and_announces_its_topics_without_its_velocity_again_and_again_is_stopped() -> None:
    """A device that takes no velocity is not a robot: a client could not stop it."""

    async def drive() -> None:
        robot = host.hub.robots.find("robot_0")
        while robot.link is not None:
            try:
                drive_gate(robot, SLOW, owner="test")
            except CommandRefused as error:
                if error.kind not in (RefusalKind.LATE, RefusalKind.DISARMED):  # this process was starved
                    raise
            await asyncio.sleep(0.02)

    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, asyncio.TaskGroup() as tasks:
        await expect(lambda: host.hub.robots.find("robot_0").link)
        driving = tasks.create_task(drive())
        link = host.hub.links.all()[0]
        link.session.probe()
        link.wake()
        for _ in range(MAX_MISSED):
            assert not driving.done()
            await device.announce([each for each in robot_topics() if each.id != 100])
        await driving
        last = (0.1, 0.0)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.2):
                while True:
                    last = await device.velocity()
        assert last == (0.0, 0.0)
        with pytest.raises(CommandRefused, match="its device is not connected"):
            drive_gate(host.hub.robots.find("robot_0"), SLOW, owner="test")


async def test_a_host_is_ready_again_when_a_robot_that_left_is_forgotten() -> None:
    config = Config(link=LinkConfig(forget_robot_after_s=0.3))
    async with daemon(config) as host, fake_device(host.tcp, robot_topics("robot_1")):
        async with fake_device(host.tcp, robot_topics("robot_0")):
            await expect(lambda: len(host.hub.robots.all()) == 2)
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        assert (await host.rest("GET", "/readyz"))[0] == 503
        await expect(lambda: host.hub.robots.forgotten == 1)
        assert (await host.rest("GET", "/readyz"))[0] == 200
        assert [robot["name"] for robot in (await host.get("/api/robots"))["robots"]] == ["robot_1"]


@pytest.mark.parametrize("kinematics", DRIVES)
async def test_simulated_robot_of_another_drive_moves_as_it_can_and_stops(kinematics: str) -> None:
    has_y = DRIVES[kinematics].has_y
    wanted = PlanarVelocity(0.2, 0.1 if has_y else 0.0, 0.2)
    config = Config(robots={"robot_0": RobotConfig(kinematics=kinematics)})  # type: ignore[arg-type]
    async with daemon(config) as host, asyncio.TaskGroup() as tasks:
        running = tasks.create_task(run_fleet(*host.tcp, robots=1, kinematics=kinematics))
        await expect(lambda: len(host.hub.robots.all()) == 1 and host.hub.robots.find("robot_0").odometry.count > 2)
        robot = host.hub.robots.find_here("robot_0")

        def measured() -> PlanarVelocity:
            return robot.odometry.snapshot(asyncio.get_running_loop().time()).twist

        def is_driven() -> bool:
            drive_gate(robot, wanted, owner="test")
            return measured() == pytest.approx(wanted, abs=1e-6)

        await expect(is_driven)
        await expect(lambda: measured().is_zero)  # the lease ends
        if not has_y:
            with pytest.raises(CommandRefused) as refused:
                drive_gate(robot, PlanarVelocity(0.2, 0.1), owner="test")
            assert refused.value.kind is RefusalKind.UNSUPPORTED
        running.cancel()


async def test_a_simulated_fleet_of_one_name_is_a_fleet() -> None:
    async with daemon() as host, asyncio.TaskGroup() as tasks:
        fleets = [tasks.create_task(run_fleet(*host.tcp, robots=1)) for _ in range(3)]
        await expect(lambda: len(host.hub.robots.all()) == 3)
        names = [robot.name for robot in host.hub.robots.all()]
        assert names == ["robot_0", "robot_0_2", "robot_0_3"]
        links = [robot.link for robot in host.hub.robots.all()]
        for name, velocity in zip(names, (SLOW, FAST), strict=False):
            drive_gate(host.hub.robots.find(name), velocity, owner="test")
        await expect(lambda: all(robot.odometry.count > 10 for robot in host.hub.robots.all()))
        assert [robot.link for robot in host.hub.robots.all()] == links

        def findings() -> set[str]:
            return {each.code for link in host.hub.links.all() for each in host.hub.diagnoses.of(link)}

        await expect(lambda: "flashed_alike" in findings())
        assert "reboots" not in findings()
        for fleet in fleets:
            fleet.cancel()
