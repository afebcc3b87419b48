"""A simulated robot in the test's own process, so that a test can read its true speed."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from hostlink.messages.catalog import Catalog
from hostlink.sim.robot import SimulatedRobot
from hostlink.sim.run import run_over_tcp

CATALOG = Catalog()


@contextlib.asynccontextmanager
async def simulated_robot(address: tuple[str, int], name: str = "robot_0") -> AsyncIterator[SimulatedRobot]:
    """Runs for the length of the block, and connects again whenever its host is gone."""
    robot = SimulatedRobot(name, CATALOG)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(run_over_tcp(robot, *address))
        try:
            yield robot
        finally:
            running.cancel()
