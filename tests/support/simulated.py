"""A simulated robot in the test's own process, so that a test can read its true speed and disturb it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import cast

from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.rosserial.frame import Frame, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.workbench.sim.firmware_world import RobotKind
from hostlink.workbench.sim.robot import Fault, SimulatedRobot
from hostlink.workbench.sim.run import run_over_streams, run_over_tcp
from tests.support.memory_transport import MemoryTransport, memory_pair

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


class _Writer:
    """StreamWriter of a transport in memory."""

    def __init__(self, end: MemoryTransport) -> None:
        self.transport, self.write, self._end = self, end.write, end

    def get_write_buffer_size(self) -> int:
        return 0

    def close(self) -> None:
        self._end.break_off()

    async def wait_closed(self) -> None:
        """Return at once, because the end is closed."""


@contextlib.asynccontextmanager
async def simulated_in_memory(
    hub: Hub, name: str = "robot_0", kind: RobotKind = RobotKind.PAPER
) -> AsyncIterator[DisturbedRobot]:
    """Runs for the length of the block, in the loop that runs the hub."""
    robot, reader = DisturbedRobot(name, kind), asyncio.StreamReader()
    host_end, end = memory_pair(address=f"{name}.local")
    hub.spawn(hub.links.serve(hub.links.open(host_end, ROSSERIAL)), name=f"link of {name}")

    async def read() -> None:
        while data := await end.receive():
            reader.feed_data(data)
        reader.feed_eof()

    async with asyncio.TaskGroup() as tasks:
        writer = cast(asyncio.StreamWriter, _Writer(end))
        fault = Fault(transform=robot.transform)
        running = [tasks.create_task(read()), tasks.create_task(run_over_streams(robot, reader, writer, fault=fault))]
        try:
            yield robot
        finally:
            for task in running:
                task.cancel()
