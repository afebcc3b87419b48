"""Findings about odometry do not appear for the project's own firmware, at rest, driven, turned and stopped."""

import asyncio

from hostlink.core.hub.robot import LocalRobot
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.bench import with_robot
from tests.support.gates import drive_gate
from tests.support.virtual_loop import virtual

COMMANDS = (PlanarVelocity(0.3), PlanarVelocity(0.0, yaw_rad_s=1.0), PlanarVelocity(-0.2, yaw_rad_s=0.4))


async def drive(robot: LocalRobot, velocity: PlanarVelocity, seconds: float) -> None:
    for _ in range(round(seconds * 10)):
        drive_gate(robot, velocity, owner="ann")
        await asyncio.sleep(0.1)


@virtual
async def test_firmware_that_drives_has_no_finding() -> None:
    async with with_robot() as (here, _):
        for velocity in COMMANDS:
            await drive(here.robot, velocity, 12.0)
            found = here.robot.state(asyncio.get_running_loop().time()).device_errors
            assert set(found) <= {"clock_trouble"}  # the virtual time is faster than the computer's clock
            await asyncio.sleep(2.0)
        assert here.robot.flawed_poses(asyncio.get_running_loop().time()) == ""
