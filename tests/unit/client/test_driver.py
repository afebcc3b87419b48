"""VelocitySender: what is repeated by a program that did not run for a while, or could not send."""

import asyncio
from collections import defaultdict
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, cast

import pytest

from hostlink.client.callers import Callers
from hostlink.client.connection import HostConnection
from hostlink.client.driver import VelocitySender
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.virtual_loop import run_virtual

ROBOT, OTHER, AHEAD = "robot_0", "robot_1", PlanarVelocity(0.2, 0.0, 0.0)
ANSWER = {
    "op": "drive_result",
    "result": True,
    "epoch": 7,
    "is_limited": False,
    "limited_by": None,
    "velocity": {"linear_m_s": 0.2, "linear_y_m_s": 0.0, "angular_rad_s": 0.0},
}


class _Daemon:
    """Connection to a daemon that accepts each drive. While an answer waits, the program sleeps, or runs.

    A repetition blocks for `send_s`.
    """

    def __init__(self) -> None:
        self.handlers: defaultdict[str, list[Callable[[dict[str, Any]], None]]] = defaultdict(list)
        self.asleep_s = self.slept_s = self.answer_s = self.send_s = 0.0
        self.repeated: list[str] = []  # names of robots

    def now_s(self) -> float:
        return asyncio.get_running_loop().time() + self.slept_s

    async def request(self, _: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
        assert timeout_s > self.answer_s
        self.slept_s += self.asleep_s
        await asyncio.sleep(self.answer_s)
        return dict(ANSWER)

    async def send(self, request: Mapping[str, Any]) -> None:
        self.repeated.append(str(request["robot"]))
        await asyncio.sleep(self.send_s)


def _drive(test: Callable[[_Daemon, VelocitySender], Coroutine[None, None, None]]) -> None:
    """Run a test whose program repeats its velocities, in virtual time."""

    async def run() -> None:
        daemon = _Daemon()
        driver = VelocitySender(cast(HostConnection, daemon), Callers(daemon.now_s))
        async with asyncio.TaskGroup() as tasks:
            repeating = tasks.create_task(driver.repeat())
            await asyncio.sleep(1.0)
            await test(daemon, driver)
            repeating.cancel()

    run_virtual(run())


@pytest.mark.parametrize("answer_s", [0.0, 0.3])  # the program reads the answer before it repeats, or afterwards
def test_drive_whose_answer_waited_for_a_sleeping_program_is_not_repeated(answer_s: float) -> None:
    async def test(daemon: _Daemon, driver: VelocitySender) -> None:
        daemon.asleep_s, daemon.answer_s = 0.6, answer_s
        await driver.drive(ROBOT, AHEAD, 50)
        await asyncio.sleep(1.0)
        assert (driver.robots, daemon.repeated) == ((), [])
        daemon.asleep_s = 0.0
        with pytest.raises(HostlinkError, match=r"this program did not run, or could not send, for 0\.\d s"):
            await driver.drive(ROBOT, AHEAD, 50)

    _drive(test)


def test_drive_with_a_slow_answer_is_repeated_by_a_program_that_ran() -> None:
    async def test(daemon: _Daemon, driver: VelocitySender) -> None:
        daemon.answer_s = 0.8
        await driver.drive(ROBOT, AHEAD, 50)
        await asyncio.sleep(1.0)
        assert driver.robots == (ROBOT,)
        assert len(daemon.repeated) >= 9

    _drive(test)


@pytest.mark.parametrize("is_watched", [False, True])  # by a motion of the program, which notes that the program runs
def test_velocities_are_broken_off_after_a_send_that_blocked_for_longer_than_a_lease(*, is_watched: bool) -> None:
    async def test(daemon: _Daemon, driver: VelocitySender) -> None:
        await driver.drive(ROBOT, AHEAD, 50)
        await driver.drive(OTHER, AHEAD, 50)
        daemon.send_s = 0.7
        for _ in range(8):
            await asyncio.sleep(0.1)
            if is_watched:
                driver.notice_sleep()
        await asyncio.sleep(0.1)
        assert (driver.robots, daemon.repeated) == ((), [ROBOT])
        for robot in (ROBOT, OTHER):
            with pytest.raises(HostlinkError, match=r"this program did not run, or could not send, for 0\.\d s"):
                await driver.drive(robot, AHEAD, 50)

    _drive(test)


@pytest.mark.parametrize("send_s", [0.3, 0.7])
def test_robot_that_is_stopped_while_a_send_to_another_blocks_is_not_driven_by_the_old_velocity(send_s: float) -> None:
    async def test(daemon: _Daemon, driver: VelocitySender) -> None:
        await driver.drive(ROBOT, AHEAD, 50)
        await driver.drive(OTHER, AHEAD, 50)
        daemon.send_s = send_s
        await asyncio.sleep(0.2)
        driver.stop_repeating(OTHER)
        await asyncio.sleep(1.0)
        assert OTHER not in daemon.repeated

    _drive(test)
