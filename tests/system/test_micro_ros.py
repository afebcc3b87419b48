"""`hostlink serve` as a process with micro-ROS boards: driving, stop, lock, loss, and restarts of either side."""

import asyncio
import contextlib
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from tests.support import xrce_board as board
from tests.support.process import Process, free_port, serve
from tests.support.pty_pair import pty_pair
from tests.support.waiting import expect
from tests.support.xrce_device import Device, serial_board, stock, udp_board

ROBOT = "linorobot_base_node"


@contextlib.asynccontextmanager
async def commanded(host: Process, speed: float = 0.2, *, robot: str = ROBOT) -> AsyncIterator[list[float]]:
    """A program that commands the robot twenty times a second, also while the daemon is not there.

    It sends a zero when its command is refused, as after a reconnection of the device. Yields the times of those that
    were accepted.
    """
    accepted: list[float] = []

    async def command() -> None:
        is_refused = False
        async with aiohttp.ClientSession() as session:
            while True:
                with contextlib.suppress(aiohttp.ClientError):
                    url = f"{host.url}/api/robots/{robot}/velocity"
                    wanted = 0.0 if is_refused else speed
                    async with session.put(url, json={"linear": wanted, "angular": 0}) as response:
                        is_refused = response.status == 409
                        await response.read()
                        if response.status == 200 and wanted:
                            accepted.append(time.monotonic())
                await asyncio.sleep(0.05)

    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(command())
        try:
            yield accepted
        finally:
            task.cancel()


async def takes(device: Device, is_so: Callable[[float], bool], since_s: float) -> float:
    """Wait until the board takes such a velocity. Return when."""

    def first() -> float | None:
        return next((at_s for at_s, speed in device.stock.taken if at_s > since_s and is_so(speed)), None)

    await expect(lambda: first() is not None)
    found = first()
    assert found is not None
    return found


def moves(speed: float) -> bool:
    return speed > 0.1


def stands(speed: float) -> bool:
    return speed == 0


def of(tmp_path: Path) -> dict[str, Any]:
    """The arguments that every start of the daemon has."""
    return {"environment": {"XDG_STATE_HOME": str(tmp_path)}}


async def test_board_drives_stops_and_is_locked(tmp_path: Path) -> None:
    port = free_port()
    async with serve("--micro-ros", f"udp://127.0.0.1:{port}", **of(tmp_path)) as host:
        began_s = time.monotonic()
        async with udp_board(("127.0.0.1", port)) as device:
            await host.logged("robot.appeared")
            appeared_s = time.monotonic() - began_s
            async with commanded(host):
                await takes(device, moves, began_s)
                stopped_s = time.monotonic()
                await host.post("/api/stop")
                stood_s = await takes(device, stands, stopped_s) - stopped_s
            await host.post(f"/api/robots/{ROBOT}/lock", {"reason": "test"})
            async with commanded(host):
                locked_s = time.monotonic()
                await asyncio.sleep(0.5)
                assert not any(moves(speed) for at_s, speed in device.stock.taken if at_s > locked_s)
            view = await host.get(f"/api/robots/{ROBOT}")
            assert view["odometry"]["pose"]["x_m"] == 0.5
    assert appeared_s < 0.5
    assert stood_s < 0.15


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("is_commanded", [True, False])
async def test_board_without_code_to_reconnect_drives_again_after_a_restart_of_the_daemon(
    tmp_path: Path, number: signal.Signals, is_commanded: bool
) -> None:
    port, api, tcp = free_port(), free_port(), free_port()
    arguments = ("--micro-ros", f"udp://127.0.0.1:{port}", "--api", f"127.0.0.1:{api}", "--listen", f"127.0.0.1:{tcp}")
    async with contextlib.AsyncExitStack() as stack:
        host = await stack.enter_async_context(serve(*arguments, **of(tmp_path)))
        device = await stack.enter_async_context(udp_board(("127.0.0.1", port), stock(gives_up=False)))
        await host.logged("robot.appeared")
        if is_commanded:
            await stack.enter_async_context(commanded(host))
            await takes(device, moves, 0.0)
        await asyncio.sleep(1.0)  # the board has been at work for a while
        ended_s = time.monotonic()
        await host.end(number)
        await asyncio.sleep(0.3)
        async with serve(*arguments, **of(tmp_path)) as again:
            began_s = time.monotonic()
            if not is_commanded:
                await stack.enter_async_context(commanded(again))
            driven_s = await takes(device, moves, began_s) - began_s
            await expect(lambda: any(each.is_done and each.at_s > began_s for each in device.stock.published))
            failed = sum(not each.is_done for each in device.stock.published)
            assert driven_s < 2.0
            assert failed <= 2 + began_s - ended_s
            assert (await again.get(f"/api/robots/{ROBOT}"))["connected"]


class Listener(board.Stock):
    """A board that only takes a velocity: it says nothing unless it is asked."""

    def objects(self) -> list[tuple[int, bytes, int]]:
        return [each for each in super().objects() if each[0] not in {self.ODOMETRY, self.IMU}]

    def once(self) -> board.Program:
        client = self.client
        assert (yield from client.connect())
        for id_, content, parent in self.objects():
            assert (yield from client.create(id_, content, parent)) in {0, 1}
        client.read_data(self.COMMAND)
        while True:
            yield from client.listen(1.0)


@pytest.mark.parametrize("is_serial", [False, True])
async def test_board_that_only_listens_drives_again_after_a_restart_of_the_daemon(
    tmp_path: Path, *, is_serial: bool
) -> None:
    port, tcp = free_port(), free_port()
    with pty_pair() as (descriptor, path):
        os.set_blocking(descriptor, False)
        way = ("--serial", f"{path}@115200") if is_serial else ("--micro-ros", f"udp://127.0.0.1:{port}")
        arguments = (*way, "--listen", f"127.0.0.1:{tcp}")
        program = Listener(board.Client(key=b"only"), b"", b"", keeps=0)
        at = serial_board(descriptor, program) if is_serial else udp_board(("127.0.0.1", port), program)
        async with contextlib.AsyncExitStack() as stack:
            host = await stack.enter_async_context(serve(*arguments, **of(tmp_path)))
            device = await stack.enter_async_context(at)
            await host.logged("robot.appeared")
            await asyncio.sleep(0.5)
            await host.end(signal.SIGKILL)
            async with serve(*arguments, **of(tmp_path)) as again:
                began_s = time.monotonic()
                async with commanded(again):
                    assert await takes(device, moves, began_s) < began_s + 2.0


async def test_board_that_begins_anew_is_the_same_robot(tmp_path: Path) -> None:
    port = free_port()
    async with serve("--micro-ros", f"udp://127.0.0.1:{port}", **of(tmp_path)) as host:
        for key in (b"one!", b"two!", b"two!"):
            async with udp_board(("127.0.0.1", port), stock(key=key), local_port=free_port()) as device:
                await device.is_at_work()
                async with commanded(host):
                    await takes(device, moves, 0.0)
                    assert [each["name"] for each in (await host.get("/api/robots"))["robots"]] == [ROBOT]


async def test_loss_of_five_in_a_hundred_each_way_blocks_no_publication_and_delays_no_command(tmp_path: Path) -> None:
    port = free_port()
    program = stock(gives_up=False)
    async with (
        serve("--micro-ros", f"udp://127.0.0.1:{port}", **of(tmp_path)) as host,
        udp_board(("127.0.0.1", port), program, loss=0.05) as device,
    ):
        await device.is_at_work()
        async with commanded(host) as accepted:
            await expect(lambda: len(accepted) > 100)
        taken = [at_s for at_s, speed in program.taken if moves(speed)]
        assert len(taken) > 0.7 * len(accepted)  # on a busy machine a newer one replaces one that waits
        assert not [each for each in program.published if not each.is_done]
        slowest_s = max(each.took_s for each in program.published)
        assert slowest_s < 0.3
