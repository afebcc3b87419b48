"""Courses through a running daemon: driven within its rules, and stopped however they end."""

import asyncio
import math
from collections.abc import Sequence

import pytest

from hostlink.cli.calibration_session import Drives
from hostlink.client import connect
from hostlink.config import Config, RobotConfig
from hostlink.errors import HostlinkError
from hostlink.robot.calibration import WheelGeometry
from hostlink.robot.course import STUCK_S, Leg, Speed, square, straight
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry import OdometryCorrection
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.simulated import simulated_robot
from tests.support.waiting import TIMEOUT_S, expect


async def follow(host: Daemon, legs: Sequence[Leg], name: str = "robot_0") -> tuple[Pose, ...]:
    drives = Drives(host.url, None, name, Speed())
    return await drives.follow(legs, OdometryCorrection(), lambda *_: None)


def is_driven(host: Daemon) -> bool:
    gate = host.hub.robots.find("robot_0").gate
    return gate.owner_name is not None


async def test_a_course_ends_where_it_should_and_the_robot_stands() -> None:
    async with daemon() as host, simulated_robot(host.tcp) as robot:
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 0)
        path = await follow(host, straight(0.2))
        assert path[0] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert path[-1].x_m == pytest.approx(0.2, abs=0.02)
        await expect(lambda: not is_driven(host))
        assert abs(robot.speed_m_s) < 0.01


async def test_driver_of_higher_priority_ends_the_course() -> None:
    async with daemon() as host, simulated_robot(host.tcp):
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 0)
        async with asyncio.TaskGroup() as tasks:
            driving = tasks.create_task(_refused(host))
            await expect(lambda: is_driven(host))
            status, _ = await host.rest("POST", "/api/robots/robot_0/lock", b'{"reason": "a cat"}')
            assert status == 200
        assert "a command for robot_0 was refused" in driving.result()
        assert "a cat" in driving.result()


async def _refused(host: Daemon) -> str:
    with pytest.raises(HostlinkError) as caught:
        await follow(host, square(1.0, 1))
    return str(caught.value)


@pytest.mark.parametrize(("last_m", "reason"), [(0.0, "no odometry arrived for 0.4 s"), (5.0, "the odometry jumped")])
async def test_a_robot_that_falls_silent_or_jumps_is_stopped(last_m: float, reason: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: bool(host.hub.robots.all()))
        async with asyncio.TaskGroup() as tasks:
            driving = tasks.create_task(_refused(host))
            async with asyncio.timeout(TIMEOUT_S):
                while not is_driven(host):
                    await device.send(pose(0.0, 0.0, 0.0))
                    await asyncio.sleep(0.05)
            await device.send(pose(last_m, 0.0, 0.0))
        assert reason in driving.result()
        await expect(lambda: not is_driven(host))


async def test_a_robot_whose_odometry_stands_is_stopped() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: bool(host.hub.robots.all()))
        async with asyncio.TaskGroup() as tasks:
            driving = tasks.create_task(_refused(host))
            async with asyncio.timeout(STUCK_S + 5.0):
                while not driving.done():
                    await device.send(pose(1.0, 2.0, 0.5))
                    await asyncio.sleep(0.05)
        assert "did not change for 2 s" in driving.result()
        await expect(lambda: not is_driven(host))


async def test_driver_that_takes_the_robot_over_keeps_it() -> None:
    async with daemon() as host, simulated_robot(host.tcp), connect(host.url) as other:
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 0)
        person = other.robot("robot_0", priority=60)
        async with asyncio.TaskGroup() as tasks:
            driving = tasks.create_task(_refused(host))
            await expect(lambda: is_driven(host))
            await person.drive(0.05, 0.0)
            speeds_m_s = []
            for _ in range(50):
                speeds_m_s.append(host.hub.robots.find("robot_0").gate.current.x_m_s)
                await asyncio.sleep(0.01)
        assert "a command for robot_0 was refused" in driving.result()
        assert speeds_m_s == pytest.approx([0.05] * len(speeds_m_s))
        assert person.is_driven


async def test_a_robot_that_another_drives_is_left_to_him() -> None:
    """A driver of lower priority would drive on while a person measures."""
    async with daemon() as host, simulated_robot(host.tcp), connect(host.url) as other:
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 0)
        program = other.robot("robot_0", priority=10)
        await program.drive(0.05, 0.0)
        assert "; end that program first" in await _refused(host)
        assert program.is_driven
        assert (await program.state())["velocity"]["linear_m_s"] == pytest.approx(0.05)


async def test_a_robot_that_is_not_there_is_named() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: bool(host.hub.robots.all()))
        with pytest.raises(HostlinkError, match="robot_7"):
            await follow(host, straight(1.0), "robot_7")


async def test_the_numbers_of_the_robot_are_the_parameters_with_which_it_connected() -> None:
    parameters = {"/robot_0/wheel_radius": [0.03, 0.031], "robot_0/wheel_separation": 0.15}
    async with daemon(Config(parameters=parameters)) as host:
        drives = Drives(host.url, None, "robot_0", Speed())
        async with simulated_robot(host.tcp):
            await expect(lambda: len(answered(host)) == 3)
            assert await drives.nominal() == (0.03, 0.031, 0.15)
            assert await drives.requests_parameters()
            await drives.set_parameters({"/robot_0/wheel_radius": "[0.04, 0.041]"})
            with pytest.raises(HostlinkError, match=r"given 0\.03, 0\.031 as wheel_radius .* 0\.04, 0\.041 now; reset"):
                await drives.nominal()
        await expect(lambda: not host.hub.links.all())
        async with simulated_robot(host.tcp):
            await expect(lambda: len(answered(host)) == 3)
            assert await drives.nominal() == (0.04, 0.041, 0.15)


@pytest.mark.parametrize("value", ['"wide"', "[0.0]", "0.2"])
async def test_a_parameter_of_any_kind_that_came_after_the_connection_is_found(value: str) -> None:
    async with daemon() as host, simulated_robot(host.tcp):
        await expect(lambda: len(answered(host)) == 3)
        drives = Drives(host.url, None, "robot_0", Speed())
        assert await drives.nominal() == WheelGeometry()
        await drives.set_parameters({"/robot_0/wheel_separation": value})
        with pytest.raises(HostlinkError, match="given no number as wheel_separation"):
            await drives.nominal()


def answered(host: Daemon) -> list[str]:
    """The parameters that the robots have been answered."""
    return [name for device in host.hub.robots.devices.values() for name in device.parameters]


async def test_a_robot_with_a_setting_of_its_separation_believes_in_that() -> None:
    config = Config(robots={"robot_0": RobotConfig(wheel_separation_m=0.33)})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: bool(host.hub.robots.all()))
        assert (await Drives(host.url, None, "robot_0", Speed()).nominal()).separation_m == 0.33


async def test_a_robot_without_parameters_has_the_paper_s_numbers_and_keeps_its_own() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: bool(host.hub.robots.all()))
        drives = Drives(host.url, None, "robot_0", Speed())
        assert await drives.nominal() == WheelGeometry()
        assert not await drives.requests_parameters()
    assert math.isclose(WheelGeometry().separation_m, 0.21)
