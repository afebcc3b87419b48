"""The client in a real Jupyter kernel: a robot is driven over cells; a cell that fails stops it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
from jupyter_client.manager import AsyncKernelManager

from tests.support.scripts import robot_to_drive

pytestmark = [pytest.mark.quiet, pytest.mark.filterwarnings("ignore::DeprecationWarning")]

PATIENCE_S = 20.0
TRIES = 3
STOPPED_AT_ITS_END = "robot_0 stopped at the end of the cell; drive(..., for_s=2)"


class Notebook:
    """One kernel and its cells."""

    def __init__(self, manager: AsyncKernelManager, client: Any) -> None:
        self.manager, self._client = manager, client

    def begin(self, cell: str) -> None:
        self._client.execute(cell)

    async def run(self, cell: str) -> str:
        """Return what the cell shows: its value, its output, or the name of its error."""
        self.begin(cell)
        return await self.shown()

    async def run_to_its_end(self, cell: str) -> str:
        """Run a cell that drives until its end stops the robot: a pause of the machine may have stopped it before."""
        shown = ""
        for _ in range(TRIES):
            shown = await self.run(cell)
            if shown.startswith(STOPPED_AT_ITS_END):
                break
        return shown

    async def shown(self) -> str:
        found = ""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                message = await self._client.get_iopub_msg()
                content = message["content"]
                match message["msg_type"]:
                    case "stream":
                        found += content["text"]
                    case "execute_result":
                        found += content["data"]["text/plain"]
                    case "error":
                        found += content["ename"]
                    case "status" if content["execution_state"] == "idle" and found is not None:
                        if message["parent_header"].get("msg_type") == "execute_request":
                            return found


@contextlib.asynccontextmanager
async def notebook() -> AsyncIterator[Notebook]:
    manager = AsyncKernelManager(kernel_name="python3")
    await manager.start_kernel()
    client = manager.client()
    client.start_channels()
    try:
        await client.wait_for_ready(timeout=PATIENCE_S)
        yield Notebook(manager, client)
    finally:
        client.stop_channels()
        await manager.shutdown_kernel(now=True)


async def test_a_cell_stops_its_robot_unless_it_is_kept_and_an_error_an_interrupt_or_the_kernels_death_stops_it() -> (
    None
):
    async with robot_to_drive() as robot, notebook() as cells:
        await cells.run("import time, hostlink.client")
        await cells.run(f"host = hostlink.client.connect_blocking({robot.host.url!r})")
        assert (
            await cells.run("robot = host.robot('robot_0'); robot")
            == f"<BlockingRobot robot_0 at {robot.host.url}, priority 50>"
        )

        shown = await cells.run_to_its_end("robot.drive(0.2, 0.0); time.sleep(0.5)")
        assert shown.startswith(STOPPED_AT_ITS_END)
        await robot.stands()
        assert await cells.run("robot.is_driven") == "False"

        async def drive() -> str:
            return await cells.run("robot.drive(0.2, 0.0, keep=True)")

        assert (await drive()).startswith("Driven(linear_m_s=0.2")
        await robot.moves(drive)
        assert float(await cells.run("print(next(robot.odometry())['pose']['x_m'])")) >= 0.0
        assert await cells.run("robot.is_driven") == "True"  # cells that end well change nothing about what is kept
        assert await cells.run("1 / 0") == "ZeroDivisionError"
        await robot.stands()

        await drive()
        await robot.moves(drive)
        cells.begin("for pose in robot.odometry(): pass")
        await asyncio.sleep(0.3)
        await cells.manager.interrupt_kernel()
        assert await cells.shown() == "KeyboardInterrupt"
        await robot.stands()

        await drive()
        await robot.moves(drive)
        assert await cells.run("await undefined") == "NameError"
        await robot.stands()

        await drive()
        await robot.moves(drive)
        await cells.run("import threading; threading.Thread(target=lambda: 1 / 0).start()")  # the cell itself ends well
        await robot.stands()

        await drive()
        await robot.moves(drive)
        await cells.manager.signal_kernel(9)
        await robot.stands()


@pytest.mark.long
async def test_a_cell_of_the_asyncio_client_stops_its_robot_unless_it_is_kept_or_a_task_drives_it() -> None:
    async with robot_to_drive() as robot, notebook() as cells:
        await cells.run("import asyncio, contextlib, hostlink.client")
        await cells.run("cells = contextlib.AsyncExitStack()")
        await cells.run(f"host = await cells.enter_async_context(hostlink.client.connect({robot.host.url!r}))")
        await cells.run("robot = host.robot('robot_0')")

        shown = await cells.run_to_its_end("driven = await robot.drive(0.2, 0.0)")
        assert shown.startswith(STOPPED_AT_ITS_END)
        await robot.stands()
        assert await cells.run("robot.is_driven") == "False"

        keep = "await robot.drive(0.2, 0.0, keep=True)"
        await cells.run(keep)
        await robot.moves(lambda: cells.run(keep))
        assert await cells.run("robot.is_driven") == "True"
        assert await cells.run("1 / 0") == "ZeroDivisionError"
        await robot.stands()

        begin = "driving = asyncio.get_running_loop().create_task(robot.drive(0.2, 0.0, for_s=60.0))"
        await cells.run(begin)
        await robot.moves(lambda: cells.run(begin))
        assert await cells.run("robot.is_driven") == "True"
        await cells.run("driving.cancel()")
        await robot.stands()
