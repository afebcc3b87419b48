"""Courses of the calibration: driven within the daemon's rules, and stopped however they end. In virtual time."""

import asyncio
from collections.abc import Iterator, Sequence

import pytest

from hostlink.cli import calibration_session
from hostlink.cli.calibration_session import SILENCE_S, Drives
from hostlink.client.course import STUCK_S, Leg, Speed, square, straight
from hostlink.core.config import Config, ParameterValue, RobotConfig
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.errors import HostlinkError
from hostlink.workbench.calibration import WheelGeometry
from tests.support.background import meanwhile
from tests.support.bench import Bench, bench, refused, with_robot
from tests.support.fake_device import robot_topics
from tests.support.participants import ODOMETRY_ID, POSE
from tests.support.scripted_device import ScriptedDevice
from tests.support.simulated import simulated_in_memory
from tests.support.virtual_loop import virtual
from tests.support.waiting import expect

PERIOD_S = 0.05
COURSE = square(1.0, 1)


@pytest.fixture
def patch() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        yield patch


def drives_of(here: Bench, patch: pytest.MonkeyPatch, name: str = "robot_0") -> Drives:
    """Return the drives of a robot of this bench."""
    patch.setattr(calibration_session, "connected", here.program)
    return Drives("memory", None, name, Speed())


async def follow(drives: Drives, legs: Sequence[Leg] = COURSE) -> tuple[Pose, ...]:
    return await drives.follow(legs, OdometryCorrection(), lambda *_: None)


async def is_driven(here: Bench) -> None:
    await expect(lambda: here.robot.gate.owner_name is not None)


async def send_pose(device: ScriptedDevice, x_m: float) -> None:
    await device.send(ODOMETRY_ID, POSE.pack(x_m, 0.0, 0.0))


@virtual
async def test_course_ends_where_it_should_and_the_robot_stands(patch: pytest.MonkeyPatch) -> None:
    async with with_robot() as (here, robot):
        path = await follow(drives_of(here, patch), straight(0.2))
        assert path[0] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert path[-1].x_m == pytest.approx(0.2, abs=0.02)
        assert here.robot.gate.owner_name is None
        assert abs(robot.speed_m_s) < 0.01


@virtual
async def test_lock_ends_the_course(patch: pytest.MonkeyPatch) -> None:
    async with with_robot() as (here, _):
        driving = here.tasks.create_task(refused(follow(drives_of(here, patch))))
        await is_driven(here)
        await here.other.robot("robot_0").lock("a cat", wait_s=0)
        reason = await driving
        assert "a command for robot_0 was refused" in reason
        assert "a cat" in reason


@pytest.mark.parametrize(("last_m", "reason"), [(0.0, "no odometry arrived for 0.4 s"), (5.0, "the odometry jumped")])
@virtual
async def test_robot_that_falls_silent_or_jumps_is_stopped(
    last_m: float, reason: str, patch: pytest.MonkeyPatch
) -> None:
    async with bench() as here:
        device = await here.device(robot_topics())
        driving = here.tasks.create_task(refused(follow(drives_of(here, patch))))
        while here.robot.gate.owner_name is None:
            await send_pose(device, 0.0)
            await asyncio.sleep(PERIOD_S)
        await send_pose(device, last_m)
        await asyncio.sleep(SILENCE_S + PERIOD_S)
        assert here.robot.gate.owner_name is None
        assert reason in await driving


@virtual
async def test_robot_whose_odometry_stands_is_stopped(patch: pytest.MonkeyPatch) -> None:
    async with bench() as here:
        device = await here.device(robot_topics())

        async def stand() -> None:
            while True:
                await send_pose(device, 1.0)
                await asyncio.sleep(PERIOD_S)

        async with meanwhile(stand()), asyncio.timeout(STUCK_S + 1.0):
            assert "did not change for 2 s" in await refused(follow(drives_of(here, patch)))
        assert here.robot.gate.owner_name is None


@virtual
async def test_driver_that_takes_the_robot_over_keeps_it(patch: pytest.MonkeyPatch) -> None:
    async with with_robot() as (here, _):
        person = here.other.robot("robot_0", priority=60)
        driving = here.tasks.create_task(refused(follow(drives_of(here, patch))))
        await is_driven(here)
        await person.drive(0.05, 0.0)
        for _ in range(50):
            assert here.robot.gate.current.x_m_s == pytest.approx(0.05)
            await asyncio.sleep(0.01)
        assert "a command for robot_0 was refused" in await driving
        assert person.is_driven


@virtual
async def test_robot_that_another_drives_or_that_is_not_there_is_not_driven(patch: pytest.MonkeyPatch) -> None:
    """A driver of lower priority would drive on while a person measures."""
    async with with_robot() as (here, _):
        program = here.other.robot("robot_0", priority=10)
        await program.drive(0.05, 0.0)
        assert "; end that program first" in await refused(follow(drives_of(here, patch)))
        assert program.is_driven
        assert here.robot.gate.current.x_m_s == pytest.approx(0.05)
        assert "robot_7" in await refused(follow(drives_of(here, patch, "robot_7")))


def answered(here: Bench) -> list[str]:
    """The parameters that the robots have been answered."""
    return [name for device in here.hub.robots.devices.values() for name in device.parameters]


@virtual
async def test_numbers_of_the_robot_are_the_parameters_with_which_it_connected(patch: pytest.MonkeyPatch) -> None:
    parameters: dict[str, ParameterValue] = {
        "/robot_0/wheel_radius": [0.03, 0.031],
        "robot_0/wheel_separation": 0.15,
    }
    async with bench(Config(parameters=parameters)) as here:
        drives = drives_of(here, patch)
        async with simulated_in_memory(here.hub):
            await expect(lambda: len(answered(here)) == 3)
            assert await drives.nominal() == (0.03, 0.031, 0.15)
            assert await drives.requests_parameters()
            await drives.set_parameters({"/robot_0/wheel_radius": "[0.04, 0.041]"})
            with pytest.raises(HostlinkError, match=r"given 0\.03, 0\.031 as wheel_radius .* 0\.04, 0\.041 now; reset"):
                await drives.nominal()
        await expect(lambda: not here.hub.links.all())
        async with simulated_in_memory(here.hub):
            await expect(lambda: len(answered(here)) == 3)
            assert await drives.nominal() == (0.04, 0.041, 0.15)


@pytest.mark.parametrize("value", ['"wide"', "[0.0]", "0.2"])
@virtual
async def test_parameter_of_any_kind_that_came_after_the_connection_is_found(
    value: str, patch: pytest.MonkeyPatch
) -> None:
    async with with_robot() as (here, _):
        drives = drives_of(here, patch)
        assert await drives.nominal() == WheelGeometry()
        await drives.set_parameters({"/robot_0/wheel_separation": value})
        with pytest.raises(HostlinkError, match="given no number as wheel_separation"):
            await drives.nominal()


@pytest.mark.parametrize("setting_m", [0.33, None])
@virtual
async def test_robot_without_parameters_has_its_setting_else_the_papers_numbers(
    setting_m: float | None, patch: pytest.MonkeyPatch
) -> None:
    async with bench(Config(robots={"robot_0": RobotConfig(wheel_separation_m=setting_m)})) as here:
        await here.device(robot_topics())
        drives = drives_of(here, patch)
        assert (await drives.nominal()).separation_m == (setting_m or 0.21)
        assert not await drives.requests_parameters()
