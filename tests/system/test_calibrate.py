"""`hostlink calibrate` as a process: at every end the robot stops at once, and the next call continues."""

import asyncio
import signal
import time
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from tests.support.process import HOSTLINK, Process, serve, simulated

STOP_S = 0.7  # the lease, and a busy machine
PATIENCE_S = 20.0
SMALL = ("--length", "1", "--side", "0.5", "--turns", "0", "--repeats", "1")


async def robot(daemon: Process) -> dict[str, Any]:
    async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/api/robots/robot_0") as response:
        state: dict[str, Any] = await response.json()
        return state


async def until(daemon: Process, *, driven: bool) -> float:
    """Returns how long it lasted."""
    start_s = time.monotonic()
    async with asyncio.timeout(PATIENCE_S):
        while True:
            if ((await robot(daemon))["velocity"]["linear_m_s"] > 0) is driven:
                return time.monotonic() - start_s
            await asyncio.sleep(0.02)


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 130, marks=pytest.mark.long),
        (signal.SIGKILL, -signal.SIGKILL),
    ],
)
async def test_a_signal_in_a_drive_stops_the_robot(number: signal.Signals, status: int, tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    words = ("calibrate", "robot_0", *SMALL, "--state", str(state))
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        program = await asyncio.create_subprocess_exec(
            HOSTLINK, *words, "--url", daemon.url, stdin=PIPE, stdout=PIPE, stderr=PIPE
        )
        assert program.stdin is not None
        program.stdin.write(b"\n")
        await until(daemon, driven=True)
        program.send_signal(number)
        assert await until(daemon, driven=False) < STOP_S
        _, errors = await program.communicate()
    assert program.returncode == status
    assert b"Traceback" not in errors
    if number is not signal.SIGKILL:
        assert b"the robot was sent a stop; 0 drives are kept in " in errors
