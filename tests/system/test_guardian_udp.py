"""A daemon that is killed or stuck while it drives a robot over UDP, where nothing shows that a sender is gone."""

import asyncio
import contextlib
import os
import random
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.background import meanwhile
from tests.support.killing import LIMIT_S, guardians_of, moving
from tests.support.process import Process, serve
from tests.support.stopwatch import Stopwatch
from tests.support.udp_device import GREETING
from tests.support.unwatched_robot import ZERO, UnwatchedRobot, robot_on_udp
from tests.support.waiting import expect_never

pytestmark = pytest.mark.quiet
KILLS = 6
SETTINGS = '[udp]\nhost = "127.0.0.1"\nport = 0\ntrusted = ["127.0.0.0/8"]\n'


@contextlib.asynccontextmanager
async def driving(folder: Path, settings: str = SETTINGS) -> AsyncIterator[tuple[Process, UnwatchedRobot]]:
    """The robot moves when the block begins, and commands come until the daemon is gone."""
    file = folder / "hostlink.toml"
    file.write_text(settings)
    async with serve("--config", str(file)) as daemon:
        host, _, port = daemon.lines("daemon.started")[0]["udp"].rpartition(":")
        async with robot_on_udp((host, int(port)), "on_udp") as robot, contextlib.AsyncExitStack() as greeting:
            await greeting.enter_async_context(meanwhile(_greet(robot)))
            async with moving(daemon, robot):
                await greeting.aclose()
                yield daemon, robot


async def _greet(robot: UnwatchedRobot) -> None:
    """Keep the session: some settings end it after half a second of silence."""
    while True:
        await asyncio.sleep(0.1)
        os.write(robot.descriptor, GREETING)


async def test_without_a_guardian_the_robot_moves_on(tmp_path: Path) -> None:
    """So it does not stop by itself."""
    async with driving(tmp_path, "guardian = false\n" + SETTINGS) as (daemon, robot):
        os.kill(daemon.pid, signal.SIGKILL)
        await expect_never(lambda: not robot.is_moving, for_s=1.0)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
async def test_a_killed_daemon_leaves_no_robot_moving(tmp_path: Path, number: signal.Signals) -> None:
    dice = random.Random(number)
    for kill in range(KILLS // 2):
        folder = tmp_path / f"{kill}"
        folder.mkdir()
        async with driving(folder) as (daemon, robot):
            await asyncio.sleep(dice.uniform(0.0, 0.2))
            began_s, watch = time.monotonic(), Stopwatch(*guardians_of(daemon))
            async with meanwhile(watch.sampling()):
                os.kill(daemon.pid, number)
                await robot.stood()
            assert robot.stood_after_s(began_s) - watch.kept_s <= LIMIT_S


async def test_a_daemon_that_ends_in_order_stops_it_and_then_says_so(tmp_path: Path) -> None:
    async with driving(tmp_path) as (daemon, robot):
        began_s, watch = time.monotonic(), Stopwatch(daemon.pid)
        async with meanwhile(watch.sampling()):
            os.kill(daemon.pid, signal.SIGTERM)
            await robot.stood()
        assert robot.stood_after_s(began_s) - watch.kept_s <= 1.0
        assert robot.velocities[-1][1] == ZERO


async def test_a_guardian_that_is_stuck_keeps_no_device_from_the_daemon(tmp_path: Path) -> None:
    """The guardian has a duplicate of the session's socket, which the kernel could give the device's datagrams."""
    settings = SETTINGS + "[link]\nidle_timeout_s = 0.5\nsilence_timeout_s = 0.5\n"
    async with driving(tmp_path, settings) as (daemon, robot):
        guardian = int(daemon.lines("guardian.started")[-1]["pid"])
        os.kill(guardian, signal.SIGSTOP)
        try:
            await daemon.logged("link.closed")  # the robot sends nothing by itself
            os.write(robot.descriptor, GREETING)
            await daemon.logged("robot.appeared", 2)
        finally:
            os.kill(guardian, signal.SIGCONT)
