"""Two participants of one name, as two programs behind one router are: each has leases of its own."""

import asyncio
import struct

import pytest

from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import CommandRefused
from tests.support.participants import ROBOT, Scene, play
from tests.support.virtual_loop import inside

VELOCITY = f"/{ROBOT}/velocity_commands"
TWIST = struct.Struct("<6d")


@inside(play)
async def test_one_that_leaves_does_not_end_the_others_lease(made: Scene) -> None:
    first, second = made.hub.join("program"), made.hub.join("program")
    robot = made.hub.robots.find(ROBOT)
    first.drive(robot, PlanarVelocity(0.2))
    second.leave()
    assert (robot.gate.owner_name, robot.gate.current.x_m_s) == ("program", 0.2)
    first.leave()
    assert (robot.gate.owner_name, robot.gate.current) == (None, ZERO)


@inside(play)
async def test_one_that_stays_does_not_keep_the_lease_of_the_one_that_left(made: Scene) -> None:
    first, second = made.hub.join("program", priority=60), made.hub.join("program")
    robot = made.hub.robots.find(ROBOT)
    first.drive(robot, PlanarVelocity(0.2))
    with pytest.raises(CommandRefused, match="program drives it with a higher priority"):
        second.drive(robot, PlanarVelocity(0.1))
    second.publish(VELOCITY, ZERO.encode())  # of a source that does not drive: it stops no robot
    await asyncio.sleep(0.1)
    assert made.speeds()[-1] == 0.2
    first.leave()
    await asyncio.sleep(0.1)
    assert made.speeds()[-1] == 0.0
    second.drive(robot, PlanarVelocity(0.1))
    assert robot.gate.priority == 50


@inside(play)
async def test_by_topic_too_each_is_an_owner(made: Scene) -> None:
    first, second = made.hub.join("program", priority=60), made.hub.join("program")
    first.publish(VELOCITY, TWIST.pack(0.2, 0, 0, 0, 0, 0))
    with pytest.raises(CommandRefused):
        second.publish(VELOCITY, TWIST.pack(0.1, 0, 0, 0, 0, 0))
    second.leave()
    await asyncio.sleep(0.1)
    assert made.speeds()[-1] == 0.2


@inside(play)
async def test_a_program_that_has_a_devices_name_does_not_end_its_lease(made: Scene) -> None:
    robot, driver = made.hub.robots.find(ROBOT), made.other.link
    made.hub.topics.find(VELOCITY).publish(TWIST.pack(0.2, 0, 0, 0, 0, 0), source=driver)
    made.hub.join(str(driver)).leave()
    assert (robot.gate.owner_name, robot.gate.current.x_m_s) == (str(driver), 0.2)
    made.hub.gates.release(driver)
    assert robot.gate.owner_name is None
