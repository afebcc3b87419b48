"""`hostlink calibrate` as a process: at every end the robot stops at once, and the next call continues."""

import asyncio
import signal
from asyncio.subprocess import PIPE
from pathlib import Path

import pytest

from tests.support.background import meanwhile
from tests.support.process import HOSTLINK, Process, serve, simulated
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S

STOP_S = 0.7  # the lease, and a turn of the gate
SMALL = ("--length", "1", "--side", "0.5", "--turns", "0", "--repeats", "1")


async def until(daemon: Process, *, driven: bool) -> None:
    """Wait until the robot's command is a motion, or none."""
    async with asyncio.timeout(TIMEOUT_S):
        while ((await daemon.get("/api/robots/robot_0"))["velocity"]["linear_m_s"] > 0) is not driven:  # noqa: ASYNC110 - the daemon is another process
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
    words = ("calibrate", *SMALL, "--state", str(state))  # of the only robot
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        program = await asyncio.create_subprocess_exec(
            HOSTLINK, *words, "--url", daemon.url, stdin=PIPE, stdout=PIPE, stderr=PIPE
        )
        assert program.stdin is not None
        program.stdin.write(b"\n")
        await until(daemon, driven=True)
        watch = Stopwatch(daemon.pid, program.pid)
        async with meanwhile(watch.sampling()):
            program.send_signal(number)
            await until(daemon, driven=False)
            assert watch.seconds < STOP_S
        _, errors = await program.communicate()
    assert program.returncode == status
    assert b"Traceback" not in errors
    if number is not signal.SIGKILL:
        assert b"the robot was sent a stop; 0 drives are kept in " in errors
