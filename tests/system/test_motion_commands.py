"""`hostlink move` and `turn` as processes: the robot is stopped however they end."""

import asyncio
import signal
from asyncio.subprocess import PIPE

import pytest

from tests.support.background import meanwhile
from tests.support.process import HOSTLINK, Process, run, serve, simulated
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S

STOP_S = 0.7  # the lease, and a turn of the gate


async def until(daemon: Process, *, driven: bool) -> None:
    """Wait until the robot's command is a motion, or none."""
    async with asyncio.timeout(TIMEOUT_S):
        while ((await daemon.get("/api/robots/robot_0"))["velocity"]["linear_m_s"] > 0) is not driven:  # noqa: ASYNC110 - the daemon is another process
            await asyncio.sleep(0.02)


async def moving(url: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        HOSTLINK, "move", "robot_0", "20", "--url", url, stdin=PIPE, stdout=PIPE, stderr=PIPE
    )


async def test_move_and_turn_drive_the_only_robot_and_say_how_far() -> None:
    async with serve() as daemon, simulated(daemon.tcp, "--robot", "nimble"):
        await daemon.read_log("robot.appeared")
        at = ("--url", daemon.url)
        for words, wanted in (
            (("move", "-20cm"), "robot_0 moved -0."),
            (("turn", "robot_0", "-90deg", "--speed", "2"), "robot_0 turned -"),
        ):
            status, out, err = await run(*words, *at)
            assert (status, err) == (0, "")
            assert out.startswith(wanted)
        await run("lock", "robot_0", "--reason", "a foot", *at)
        status, out, err = await run("move", "robot_0", "1", *at)
        assert (status, out) == (1, "")
        assert err == "hostlink: robot_0: locked: a foot; to drive it again: hostlink unlock robot_0\n"


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 130, marks=pytest.mark.long),
        pytest.param(signal.SIGHUP, 130, marks=pytest.mark.long),
        (signal.SIGKILL, -signal.SIGKILL),
    ],
)
async def test_a_signal_stops_the_robot(number: signal.Signals, status: int) -> None:
    async with serve() as daemon, simulated(daemon.tcp, "--robot", "nimble"):
        await daemon.read_log("robot.appeared")
        program = await moving(daemon.url)
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
        assert b"robot_0 was sent a stop, +" in errors


async def test_a_move_that_is_locked_says_by_whom_and_how_to_continue() -> None:
    async with serve() as daemon, simulated(daemon.tcp, "--robot", "nimble"):
        await daemon.read_log("robot.appeared")
        program = await moving(daemon.url)
        await until(daemon, driven=True)
        await daemon.post("/api/robots/robot_0/lock")
        out, errors = await program.communicate()
    assert program.returncode == 1
    assert out.startswith(b"robot_0 moved +")
    assert b"stopped before +20.000 m: " in errors
    assert b"to drive it again: hostlink unlock robot_0" in errors


async def test_a_move_whose_daemon_is_killed_ends_with_the_reason() -> None:
    """tests/system/test_guardian.py: the guardian stops the robot."""
    async with serve() as daemon, simulated(daemon.tcp, "--robot", "nimble"):
        await daemon.read_log("robot.appeared")
        program = await moving(daemon.url)
        await until(daemon, driven=True)
        daemon.child.kill()
        _, errors = await program.communicate()
    assert program.returncode == 1
    assert b"Traceback" not in errors
    assert len(errors.splitlines()) == 1
