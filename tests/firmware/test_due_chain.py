"""The paper's chain on one PC: hostlink, the ESP8266's sketch, a 38400 baud line, the Due's firmware and its motors.

The firmware runs natively, and on a Cortex-M3 that QEMU emulates; with the ESP8266 between, and without.
"""

import asyncio
import contextlib
import re
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import aiohttp
import pytest

from tests.firmware import esp8266
from tests.firmware.boards import build_m3, build_native
from tests.support.process import Process, serve

pytestmark = pytest.mark.usefixtures("esp8266_built")

PATIENCE_S = 20.0
LINE = re.compile(r"left (-?[\d.]+) right (-?[\d.]+)")


class Board:
    """A running firmware; its reports tell how fast its wheels truly turn."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.speeds_ticks_s = (0.0, 0.0)

    async def listen(self) -> None:
        assert self.process.stdout is not None
        while line := await self.process.stdout.readline():
            if found := LINE.search(line.decode(errors="replace")):
                self.speeds_ticks_s = (float(found[1]), float(found[2]))

    async def expect_speed(self, least: float, most: float, within_s: float) -> None:
        async with asyncio.timeout(within_s):
            while True:
                if all(least <= speed <= most for speed in self.speeds_ticks_s):
                    return
                await asyncio.sleep(0.05)


def command(kind: str, port: int) -> list[str | Path]:
    if kind == "native":
        return [build_native() / "due_native", "127.0.0.1", str(port)]
    line = f"tcp:127.0.0.1:{port},nodelay=on"
    machine = ["qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none"]
    return [*machine, "-kernel", build_m3() / "due_m3.elf", "-serial", line, "-serial", "stdio"]


@contextlib.asynccontextmanager
async def board(kind: str, port: int) -> AsyncIterator[Board]:
    process = await asyncio.create_subprocess_exec(
        *command(kind, port), stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE
    )
    made = Board(process)
    try:
        async with asyncio.TaskGroup() as tasks:
            listening = tasks.create_task(made.listen())
            yield made
            listening.cancel()
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


@contextlib.asynccontextmanager
async def chain(kind: str, *, with_esp: bool) -> AsyncIterator[tuple[Process, Board]]:
    command(kind, 0)  # built before the clock of the daemon runs
    async with serve() as daemon:
        if with_esp:
            with esp8266.running("esp8266_native", daemon.tcp[1]) as sketch:
                async with board(kind, sketch.uart_port) as made:
                    yield daemon, made
        else:
            async with board(kind, daemon.tcp[1]) as made:
                yield daemon, made


async def drive(daemon: Process, made: Board, linear: float, *, until_ticks_s: float) -> None:
    """Command ten times a second until both wheels are so fast."""
    url = f"{daemon.url}/api/robots/robot_0/velocity"
    async with aiohttp.ClientSession() as session, asyncio.timeout(PATIENCE_S):
        while min(made.speeds_ticks_s) < until_ticks_s:
            async with session.put(url, json={"linear": linear, "angular": 0.0}) as response:
                assert response.status == 200, await response.text()
            await asyncio.sleep(0.1)


@pytest.mark.parametrize("with_esp", [False, True], ids=["direct", "esp8266"])
@pytest.mark.parametrize("kind", ["native", "cortex-m3"])
async def test_the_chain_negotiates_drives_reads_back_and_stops(kind: str, with_esp: bool) -> None:
    async with chain(kind, with_esp=with_esp) as (daemon, made):
        negotiated = await daemon.read_log("topics.negotiated")
        assert (negotiated["count"], negotiated["gap_at"]) == (6, None)
        await daemon.read_log("robot.appeared")
        await drive(daemon, made, 0.3, until_ticks_s=80.0)
        async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/api/robots/robot_0") as response:
            seen = await response.json()
        assert seen["odometry"]["pose"]["x_m"] > 0.05
        assert abs(seen["odometry"]["pose"]["y_m"]) < 0.05
        assert seen["odometry"]["rate_hz"] == pytest.approx(10.0, abs=2.5)
        await made.expect_speed(-2.0, 2.0, within_s=3.0)  # the lease is over: 0.5 s, the wheel, the report
        assert await daemon.end(signal.SIGTERM) == 0
    closed = [line for line in daemon.log if line["event"] == "link.trouble"]
    assert closed == []


@pytest.mark.parametrize("kind", ["native", "cortex-m3"])
async def test_a_killed_host_leaves_the_robot_standing(kind: str) -> None:
    async with chain(kind, with_esp=True) as (daemon, made):
        await daemon.read_log("robot.appeared")
        await drive(daemon, made, 0.3, until_ticks_s=80.0)
        daemon.child.kill()
        began_s = time.monotonic()
        await made.expect_speed(
            -2.0, 2.0, within_s=2.2
        )  # 0.5 s of the watchdog, the wheel rolls out, a report a second
        assert time.monotonic() - began_s < 2.2


async def test_a_host_that_comes_back_finds_the_robot_again() -> None:
    async with chain("native", with_esp=True) as (daemon, made):
        await daemon.read_log("robot.appeared")
        port = daemon.tcp[1]
        assert await daemon.end(signal.SIGTERM) == 0
        async with serve("--listen", f"127.0.0.1:{port}") as again:
            await again.read_log("robot.appeared")
            await drive(again, made, 0.3, until_ticks_s=50.0)
