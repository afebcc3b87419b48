"""A command that its sender sent long ago moves no robot, also none that the sender has not driven before."""

import asyncio

import pytest

from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.fake_device import robot_topics
from tests.support.memory_hub import SETTLED_S, MemoryHub, in_hub, velocities

AHEAD = PlanarVelocity(0.2)


@pytest.mark.parametrize("late_s", [0.6, 8.0])
def test_command_from_before_a_stall_moves_no_second_robot(late_s: float) -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(robot_topics("first"), address="10.0.0.1")
        device = await made.connect(robot_topics("second"), address="10.0.0.2")
        program, clock_s = made.hub.join("program"), 1000.0
        program.drive(made.robot("first"), AHEAD, sent_s=made.now_s + clock_s)
        sent_s = made.now_s + clock_s  # of the command that the network holds
        await asyncio.sleep(late_s)
        with pytest.raises(CommandRefused) as refused:
            program.drive(made.robot("second"), AHEAD, sent_s=sent_s)
        assert refused.value.kind is RefusalKind.LATE
        await asyncio.sleep(SETTLED_S)
        assert all(velocity == (0.0, 0.0) for velocity in velocities(device))
        program.drive(made.robot("second"), AHEAD, sent_s=made.now_s + clock_s)  # a new one

    in_hub(test)


def test_clock_of_another_program_says_nothing() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(robot_topics("first"), address="10.0.0.1")
        await made.connect(robot_topics("second"), address="10.0.0.2")
        one, two = made.hub.join("one"), made.hub.join("two")
        assert one.drive(made.robot("first"), AHEAD, sent_s=made.now_s + 1000.0) == AHEAD
        assert two.drive(made.robot("second"), AHEAD, sent_s=made.now_s - 1000.0) == AHEAD

    in_hub(test)


@pytest.mark.parametrize("is_locked", [True, False])
def test_command_that_waited_while_the_robot_was_locked_or_away_moves_nothing(*, is_locked: bool) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(robot_topics("robot_0"), address="10.0.0.1")
        if is_locked:
            made.robot("robot_0").lock()
        else:
            await device.aclose()
        came_s = made.now_s
        await asyncio.sleep(0.2)
        if is_locked:
            made.robot("robot_0").unlock()
        else:
            await made.connect(robot_topics("robot_0"), address="10.0.0.1")
        program = made.hub.join("program")
        with pytest.raises(CommandRefused) as refused:
            program.drive(made.robot("robot_0"), AHEAD, received_s=came_s)
        assert refused.value.kind is RefusalKind.DISARMED
        assert program.drive(made.robot("robot_0"), PlanarVelocity()) == PlanarVelocity()
        assert program.drive(made.robot("robot_0"), AHEAD) == AHEAD

    in_hub(test)
