"""micro-ROS boards on serial lines with a pace: a board, a daemon and its guardian at 115200 and 921600 baud."""

import asyncio
import contextlib
import json
import os
import random
import signal
import time
from collections.abc import AsyncIterator
from typing import NamedTuple

import pytest

from hostlink.core.messages.catalog import Catalog
from tests.support.background import meanwhile
from tests.support.killing import guardians_of
from tests.support.original_device import OriginalDevice
from tests.support.paced_port import PacedPort, paced_port
from tests.support.process import Process, run, serve
from tests.support.stopwatch import Stopwatch
from tests.support.uart import BITS_A_BYTE
from tests.support.waiting import TIMEOUT_S, expect, expect_never
from tests.support.xrce_board import TWIST
from tests.support.xrce_device import UartDevice, stock, uart_board
from tests.system.test_micro_ros import ROBOT, commanded, moves, stands, takes
from tests.system.test_micro_ros_guardian import (
    HANG_LIMIT_S,
    KILL_LIMIT_S,
    KILLS,
    WAITS_S,
    is_moving,
    moving,
    stood_after_s,
)

pytestmark = pytest.mark.quiet
TURN_BYTES = 1200  # of an Odometry in two fragments and an Imu, with their frames and what answers them
STOP_LIMIT_S = 0.15


class Line(NamedTuple):
    """A board's line, and how often the board publishes."""

    baud: int
    ring_bytes: int
    period_s: float

    @property
    def turn_s(self) -> float:
        """Time of the bytes of one turn of the board: a zero may wait for two, one that was begun and the next."""
        return TURN_BYTES * BITS_A_BYTE / self.baud


FAST = Line(921600, 128, 0.02)
SLOW = Line(115200, 128, 0.25)
NARROW = Line(115200, 64, 0.25)
LINES = pytest.mark.parametrize("line", [FAST, SLOW, NARROW], ids=["921600", "115200", "115200-ring-64"])


@contextlib.asynccontextmanager
async def plugged(port: PacedPort, line: Line) -> AsyncIterator[UartDevice]:
    """A board at the other end of the line."""
    program = stock(keeps=4, period_s=line.period_s)
    async with uart_board(port, program, baud=line.baud, ring_bytes=line.ring_bytes) as device:
        yield device


@contextlib.asynccontextmanager
async def driving(line: Line) -> AsyncIterator[tuple[Process, UartDevice]]:
    """A board that moves when the block begins."""
    async with (
        paced_port() as port,
        serve("--serial", f"{port.path}@{line.baud}") as daemon,
        plugged(port, line) as device,
        moving(daemon, [device]),
    ):
        yield daemon, device


@LINES
async def test_board_on_a_line_with_a_pace_is_a_robot_that_drives_and_stops(line: Line) -> None:
    async with (
        paced_port() as port,
        serve("--serial", f"{port.path}@{line.baud}") as host,
        plugged(port, line) as device,
    ):
        await device.is_at_work()
        await host.logged("robot.appeared")
        async with commanded(host):
            await takes(device, moves, 0.0)
            began_s, watch = time.monotonic(), Stopwatch(host.pid)
            await host.post("/api/stop")
            stood_s = await takes(device, stands, began_s) - began_s - watch.kept_s
        view = await host.get(f"/api/robots/{ROBOT}")
        assert view["odometry"]["pose"]["x_m"] == 0.5
        done = [each.took_s for each in device.stock.published if each.is_done]
        print(f"stood after {1000 * stood_s:.0f} ms, longest publish {1000 * max(done):.0f} ms")  # noqa: T201
        assert stood_s < STOP_LIMIT_S + 2 * line.turn_s
        assert min(done) > line.turn_s / 8  # an Imu: the line has a pace
        assert sum(not each.is_done for each in device.stock.published) == 0


@LINES
async def test_board_of_a_killed_daemon_takes_a_zero_on_a_line_with_a_pace(line: Line) -> None:
    dice, taken_s = random.Random(1), []
    for _ in range(KILLS):
        async with driving(line) as (daemon, device):
            await asyncio.sleep(dice.uniform(0.0, 0.3))
            began_s, watch = time.monotonic(), Stopwatch(*guardians_of(daemon), daemon.pid)
            async with meanwhile(watch.sampling()):
                os.kill(daemon.pid, signal.SIGKILL)
                with contextlib.suppress(AssertionError):
                    await expect(lambda: not is_moving(device), timeout_s=WAITS_S)
            taken_s.append(stood_after_s(device, began_s) - watch.kept_s)
            await expect_never(lambda: is_moving(device), for_s=0.5)
    print("taken after", [f"{1000 * each:.0f} ms" for each in taken_s])  # noqa: T201
    assert max(taken_s) <= KILL_LIMIT_S + 2 * line.turn_s, taken_s


async def test_board_of_a_stopped_daemon_takes_a_zero_and_is_driven_again_on_a_line_with_a_pace() -> None:
    async with driving(FAST) as (daemon, device):
        began_s, watch = time.monotonic(), Stopwatch(*guardians_of(daemon))
        os.kill(daemon.pid, signal.SIGSTOP)
        try:
            async with meanwhile(watch.sampling()):
                await expect(lambda: not is_moving(device), timeout_s=HANG_LIMIT_S + WAITS_S)
            taken_s = stood_after_s(device, began_s)
            await expect_never(lambda: is_moving(device), for_s=0.5)
        finally:
            os.kill(daemon.pid, signal.SIGCONT)
        print(f"taken after {1000 * taken_s:.0f} ms")  # noqa: T201
        assert taken_s - watch.kept_s <= HANG_LIMIT_S
        continued_s = time.monotonic()
        async with commanded(daemon):
            await takes(device, moves, continued_s)
        await expect(lambda: any(each.is_done and each.at_s > continued_s for each in device.stock.published))
        assert len(daemon.lines("link.closed")) == 1  # of rosserial, before the board was found


class RosserialBoard(OriginalDevice):
    """A board with an Odometry of rosserial and a velocity, whose loop runs at 30 Hz."""

    def __init__(self, baud: int) -> None:
        super().__init__(baud=baud)
        self.taken: list[float] = []
        twist = Catalog().message("geometry_msgs/Twist")
        assert twist is not None
        self.subscribe("/rover/cmd_vel", twist.name, twist.md5, lambda data: self.taken.append(TWIST.unpack(data)[0]))

    async def run(self) -> None:
        """Turn without end."""
        while True:
            wait_s = self.spin(time.monotonic())
            await asyncio.sleep(1 / 30 if wait_s is None else wait_s)


@pytest.mark.parametrize("baud", [115200, 921600])
async def test_rosserial_and_micro_ros_take_turns_at_a_port_with_a_pace(baud: int) -> None:
    async with paced_port() as port, serve("--serial", f"{port.path}@{baud}") as host:
        for _ in range(2):
            await check_micro_ros(host, port, baud)
            await check_rosserial(host, port, baud)
        found = [line["protocol"] for line in host.lines("serial.protocol_found")]
        assert found == ["micro-ROS", "rosserial"] * 2
        assert not host.lines("serial.waiting")


async def check_micro_ros(host: Process, port: PacedPort, baud: int) -> None:
    """Plug a board in, and drive and stop it."""
    async with plugged(port, Line(baud, 128, 0.25)) as device:
        await device.is_at_work()
        async with commanded(host):
            await expect(lambda: is_moving(device))
        await expect(lambda: not is_moving(device))


async def check_rosserial(host: Process, port: PacedPort, baud: int) -> None:
    """Plug a board of the other protocol in, and drive and stop it."""
    board = RosserialBoard(baud)
    with port.plugged(board):
        async with meanwhile(board.run()), commanded(host, robot="rover"):
            await expect(lambda: board.taken[-1] > 0)
        async with meanwhile(board.run()):
            await expect(lambda: board.taken[-1] == 0)


@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (115200, 921600), (115200, 57600)])
async def test_wrong_baud_rate_of_a_board_is_named_by_doctor(sent: int, read: int) -> None:
    """A rate that is too low is not always named: most whole bytes fall between two samples."""
    async with (
        paced_port() as port,
        serve("--serial", f"{port.path}@{read}") as host,
        plugged(port, Line(sent, 128, 0.25)) as device,
    ):
        found = {}
        async with asyncio.timeout(TIMEOUT_S):
            while not {"wrong_baud", "no_sync"} & found.keys():
                status, out, _ = await run("doctor", "--json", "--url", host.url)
                links = json.loads(out)["links"]
                found = {each["code"]: each["detail"] for link in links for each in link["diagnosis"]}
        assert status == 1
        if sent < read:
            assert f"read at {read} baud, most likely sent at {sent}" in found["wrong_baud"]
        assert not device.stock.is_running
        assert not host.lines("robot.appeared")


async def test_port_with_two_baud_rates_finds_the_one_of_a_board() -> None:
    async with (
        paced_port() as port,
        serve("--serial", f"{port.path}@921600,115200") as host,
        plugged(port, SLOW) as device,
    ):
        await device.is_at_work()
        assert (await host.logged("serial.baud_found"))["baud"] == 115200
