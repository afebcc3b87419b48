"""A daemon that is killed or stopped while it drives a micro-ROS board, which blocks in each of its publishes."""

import asyncio
import contextlib
import itertools
import os
import random
import signal
import time
from collections.abc import AsyncIterator, Callable

import aiohttp
import pytest

from tests.support import xrce_board as board
from tests.support.background import meanwhile
from tests.support.killing import guarded_by, guardians_of
from tests.support.process import Process, serve
from tests.support.pty_pair import pty_pair
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect, expect_never
from tests.support.xrce_device import Device, serial_board, stock, tcp_board, udp_board

pytestmark = pytest.mark.quiet
KILLS = 4
KILL_LIMIT_S = 0.15
HANG_LIMIT_S = 1.5  # one second without a beat, and what a busy machine adds
COMMAND_S = 0.02
WAITS_S = 3.0  # a board that has taken no zero by then moves on

Drive = Callable[[], contextlib.AbstractAsyncContextManager[tuple[Process, list[Device]]]]


@contextlib.asynccontextmanager
async def driving(*boards: board.Stock, loss: float = 0.0) -> AsyncIterator[tuple[Process, list[Device]]]:
    """Boards that all move when the block begins, at addresses of their own. Commands come until the daemon is gone."""
    async with serve("--micro-ros", "udp://127.0.0.1:0") as daemon, contextlib.AsyncExitStack() as stack:
        (url,) = daemon.lines("daemon.started")[0]["micro_ros"]
        host, _, port = url.removeprefix("udp://").rpartition(":")
        devices = [
            await stack.enter_async_context(
                udp_board((host, int(port)), each, loss=loss, local=f"127.0.0.{2 + number}")
            )
            for number, each in enumerate(boards)
        ]
        async with moving(daemon, devices):
            yield daemon, devices


@contextlib.asynccontextmanager
async def moving(daemon: Process, devices: list[Device]) -> AsyncIterator[None]:
    """The boards move when the block begins, and the guardian has their connections."""
    await daemon.logged("robot.appeared", len(devices))
    names = [str(line["robot"]) for line in daemon.lines("robot.appeared")]
    assert len(set(names)) == len(devices), names
    async with (
        aiohttp.ClientSession() as client,
        client.ws_connect(daemon.url) as socket,
        meanwhile(_command(socket, names)),
    ):
        await expect(lambda: all(is_moving(each) for each in devices))
        await expect(lambda: guarded_by(guardians_of(daemon)[0]) == len(devices))
        yield


@contextlib.asynccontextmanager
async def driving_on_wire() -> AsyncIterator[tuple[Process, list[Device]]]:
    """A board on a pseudo-terminal that moves when the block begins."""
    with pty_pair() as (descriptor, path):
        os.set_blocking(descriptor, False)
        async with (
            serve("--serial", f"{path}@921600") as daemon,
            serial_board(descriptor, stock(keeps=4)) as device,
            moving(daemon, [device]),
        ):
            yield daemon, [device]


@contextlib.asynccontextmanager
async def driving_over_tcp() -> AsyncIterator[tuple[Process, list[Device]]]:
    """A board with a TCP connection that moves when the block begins."""
    async with serve("--micro-ros", "tcp://127.0.0.1:0") as daemon:
        (url,) = daemon.lines("daemon.started")[0]["micro_ros"]
        host, _, port = url.removeprefix("tcp://").rpartition(":")
        async with tcp_board((host, int(port)), stock(keeps=4)) as device, moving(daemon, [device]):
            yield daemon, [device]


async def _command(socket: aiohttp.ClientWebSocketResponse, names: list[str]) -> None:
    with contextlib.suppress(ConnectionError):  # the daemon has ended
        for name in itertools.cycle(names):
            await socket.send_json({"op": "drive", "robot": name, "linear": 0.2, "angular": 0.5})
            await asyncio.sleep(COMMAND_S)
    await asyncio.Future()


def is_moving(device: Device) -> bool:
    taken = device.stock.taken
    return bool(taken) and taken[-1][1] > 0.0


def stood_after_s(device: Device, since_s: float) -> float:
    """Return when the board took the zero after which it did not move again; infinite if it moves."""
    taken = device.stock.taken
    moving = max(number for number, (_, speed) in enumerate(taken) if speed > 0.0)
    return taken[moving + 1][0] - since_s if moving + 1 < len(taken) else float("inf")


async def test_boards_of_a_killed_daemon_take_a_zero_while_they_publish() -> None:
    """The boards and their keys are equal: they are two robots at two addresses."""
    await check_kills(lambda: driving(stock(keeps=4), stock(keeps=4)))


async def test_board_on_a_serial_port_of_a_killed_daemon_takes_a_zero_while_it_publishes() -> None:
    await check_kills(driving_on_wire)


async def check_kills(drive: Drive) -> None:
    """Kill daemons at drawn times. Check when the boards take a zero, and that they stand afterwards."""
    dice, taken_s = random.Random(1), []
    for _ in range(KILLS):
        async with drive() as (daemon, devices):
            await asyncio.sleep(dice.uniform(0.0, 0.1))
            began_s, watch = time.monotonic(), Stopwatch(*guardians_of(daemon))
            async with meanwhile(watch.sampling()):
                os.kill(daemon.pid, signal.SIGKILL)
                with contextlib.suppress(AssertionError):
                    await expect(lambda: not any(map(is_moving, devices)), timeout_s=WAITS_S)
            taken_s += [stood_after_s(each, began_s) - watch.kept_s for each in devices]
            await expect_never(lambda: any(map(is_moving, devices)), for_s=0.5)
    print("taken after", [f"{1000 * each:.0f} ms" for each in taken_s])  # noqa: T201
    assert max(taken_s) <= KILL_LIMIT_S, taken_s


@pytest.mark.long
async def test_board_with_a_bad_radio_of_a_killed_daemon_stands() -> None:
    for _ in range(KILLS):
        async with driving(stock(keeps=4), loss=0.05) as (daemon, (device,)):
            os.kill(daemon.pid, signal.SIGKILL)
            await expect(lambda: not is_moving(device), timeout_s=WAITS_S)
            await expect_never(lambda: is_moving(device), for_s=0.5)


@pytest.mark.parametrize("drive", [lambda: driving(stock(keeps=4)), driving_over_tcp, driving_on_wire])
async def test_board_of_a_stopped_daemon_stands_while_it_publishes(drive: Drive) -> None:
    async with drive() as (daemon, (device,)):
        began_s = time.monotonic()
        os.kill(daemon.pid, signal.SIGSTOP)
        try:
            await expect(lambda: not is_moving(device), timeout_s=WAITS_S + HANG_LIMIT_S)
            taken_s = stood_after_s(device, began_s)
            await expect_never(lambda: is_moving(device), for_s=0.5)
        finally:
            os.kill(daemon.pid, signal.SIGCONT)
        print(f"taken after {1000 * taken_s:.0f} ms")  # noqa: T201
        assert taken_s <= HANG_LIMIT_S
