"""A simulated robot in the test's own process, so that a test can read its true speed and disturb it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from hostlink.protocol.frame import Frame, encode
from hostlink.sim.firmware_world import RobotKind
from hostlink.sim.robot import Fault, SimulatedRobot
from hostlink.sim.run import run_over_tcp

PLOT_ID = 126


class DisturbedRobot(SimulatedRobot):
    """A simulated robot whose messages a test can hold back or add to."""

    def __init__(self, name: str, kind: RobotKind) -> None:
        super().__init__(name, kind=kind)
        self.is_plot_silent = False  # plot_data is advertised, but not published
        self.added = b""  # frames that go to the host with the next one of its own

    def transform(self, frame: Frame) -> bytes:
        """Return the bytes that the host receives for a frame."""
        added, self.added = self.added, b""
        if frame.topic_id == PLOT_ID and self.is_plot_silent:
            return added
        return added + encode(*frame)

    def skip(self, seconds: float) -> None:
        """Let so much time pass for the firmware at once."""
        assert self._began_s is not None
        self._began_s -= seconds


@contextlib.asynccontextmanager
async def simulated_robot(
    address: tuple[str, int], name: str = "robot_0", kind: RobotKind = RobotKind.PAPER
) -> AsyncIterator[DisturbedRobot]:
    """Runs for the length of the block, and connects again whenever its host is gone."""
    robot = DisturbedRobot(name, kind)
    async with asyncio.TaskGroup() as tasks:
        fault = Fault(transform=robot.transform)
        running = tasks.create_task(run_over_tcp(robot, *address, fault=fault))
        try:
            yield robot
        finally:
            running.cancel()
