"""VelocitySender: what a program that did not run for a while repeats."""

import asyncio
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, cast

import pytest

from hostlink.client.connection import HostConnection
from hostlink.client.driver import VelocitySender
from hostlink.errors import HostlinkError
from hostlink.robot.velocity import PlanarVelocity
from tests.support.virtual_loop import run_virtual

ROBOT, AHEAD = "robot_0", PlanarVelocity(0.2, 0.0, 0.0)
ANSWER = {
    "op": "drive_result",
    "result": True,
    "epoch": 7,
    "is_limited": False,
    "limited_by": None,
    "velocity": {"linear_m_s": 0.2, "linear_y_m_s": 0.0, "angular_rad_s": 0.0},
}


class _Daemon:
    """Connection to a daemon that accepts each drive. While an answer waits, the program sleeps, or runs."""

    def __init__(self) -> None:
        self.handlers: defaultdict[str, list[Callable[[dict[str, Any]], None]]] = defaultdict(list)
        self.asleep_s = self.slept_s = self.answer_s = 0.0
        self.repetitions = 0

    def now_s(self) -> float:
        return asyncio.get_running_loop().time() + self.slept_s

    async def request(self, _: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
        assert timeout_s > self.answer_s
        self.slept_s += self.asleep_s
        await asyncio.sleep(self.answer_s)
        return dict(ANSWER)

    async def send(self, _: Mapping[str, Any]) -> None:
        self.repetitions += 1


async def _driver(daemon: _Daemon, tasks: asyncio.TaskGroup) -> tuple[VelocitySender, asyncio.Task[None]]:
    driver = VelocitySender(cast(HostConnection, daemon), daemon.now_s)
    repeating = tasks.create_task(driver.repeat())
    await asyncio.sleep(1.0)
    return driver, repeating


@pytest.mark.parametrize("answer_s", [0.0, 0.3])  # the program reads the answer before it repeats, or afterwards
def test_drive_whose_answer_waited_for_a_sleeping_program_is_not_repeated(answer_s: float) -> None:
    async def run() -> None:
        daemon = _Daemon()
        async with asyncio.TaskGroup() as tasks:
            driver, repeating = await _driver(daemon, tasks)
            daemon.asleep_s, daemon.answer_s = 0.6, answer_s
            await driver.drive(ROBOT, AHEAD, 50)
            await asyncio.sleep(1.0)
            assert (driver.robots, daemon.repetitions) == ((), 0)
            daemon.asleep_s = 0.0
            with pytest.raises(HostlinkError, match=r"this program did not run for 0\.\d s"):
                await driver.drive(ROBOT, AHEAD, 50)
            repeating.cancel()

    run_virtual(run())


def test_drive_with_a_slow_answer_is_repeated_by_a_program_that_ran() -> None:
    async def run() -> None:
        daemon = _Daemon()
        async with asyncio.TaskGroup() as tasks:
            driver, repeating = await _driver(daemon, tasks)
            daemon.answer_s = 0.8
            await driver.drive(ROBOT, AHEAD, 50)
            await asyncio.sleep(1.0)
            assert driver.robots == (ROBOT,)
            assert daemon.repetitions >= 9
            repeating.cancel()

    run_virtual(run())
