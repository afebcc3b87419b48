"""The daemon with its guardian as processes: every end of the one, every mishap of the other."""

import asyncio
import contextlib
import fcntl
import os
import resource
import signal
import subprocess
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hostlink.core.robot.admission import LEASE_S
from tests.support.background import meanwhile
from tests.support.killing import LIMIT_S, Drive, driving, end_at, guarded_by, guardians_of, killer
from tests.support.process import HOSTLINK, Process, is_running
from tests.support.stopwatch import Stopwatch
from tests.support.unwatched_robot import ZERO, Reading, robot_on_tcp
from tests.support.waiting import TIMEOUT_S, expect

pytestmark = pytest.mark.quiet

WITHOUT = "guardian = false\n"
HANG_LIMIT_S = 1.5  # one second without a beat, and what a busy machine adds
IDLE = "[link]\nidle_timeout_s = 2.0\nsilence_timeout_s = 2.0\n"


def guardian_of(daemon: Process) -> int:
    """Return the pid of the guardian that was started last."""
    return guardians_of(daemon)[0]


def children_of(pid: int) -> str:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text()


async def wait_for_guardian(drive: Drive) -> None:
    """Until it holds both robots' connections."""
    await expect(lambda: guarded_by(guardian_of(drive.daemon)) == 2)


async def test_without_a_guardian_a_killed_daemons_robot_moves_on(tmp_path: Path) -> None:
    """So the robots of these tests do not stop by themselves."""
    file = tmp_path / "hostlink.toml"
    file.write_text(WITHOUT)
    async with driving(Reading(), "--config", str(file)) as drive:
        assert drive.daemon.lines("guardian.started") == []
        assert children_of(drive.daemon.pid) == ""
        assert await end_at(drive, 0.0, killer(signal.SIGKILL)) == float("inf")


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGSEGV,
        signal.SIGABRT,
        *(pytest.param(each, marks=pytest.mark.long) for each in (signal.SIGBUS, signal.SIGFPE)),
    ],
)
async def test_a_crash_in_c_code_stops_the_robots_and_writes_no_core_before(number: signal.Signals) -> None:
    async with driving(Reading()) as drive:
        assert resource.prlimit(drive.daemon.pid, resource.RLIMIT_CORE)[0] == 1
        assert await end_at(drive, 0.1, killer(number)) <= LIMIT_S
        assert not is_running(drive.daemon.pid)


@pytest.mark.alone
async def test_a_daemon_that_runs_out_of_address_space_leaves_no_robot_moving() -> None:
    """`ulimit -v`: whether the MemoryErrors end it, or the kernel does, as when memory runs out: the robots stand."""
    async with driving(Reading(with_blobs=True)) as drive:
        resource.prlimit(drive.daemon.pid, resource.RLIMIT_AS, (2**20, 2**20))
        with contextlib.suppress(AssertionError):
            await expect(lambda: not drive.daemon.is_running(), timeout_s=0.5)
        watch = Stopwatch(*guardians_of(drive.daemon))
        with contextlib.suppress(ProcessLookupError):
            os.kill(drive.daemon.pid, signal.SIGKILL)
        ended_s = time.monotonic()
        async with meanwhile(watch.sampling()):
            for robot in drive.robots:
                await robot.stood()
        assert drive.stood_after_s(ended_s) - watch.kept_s <= LIMIT_S


@pytest.mark.parametrize(
    "reading",
    [Reading(), pytest.param(Reading(bytes_a_turn=2048, with_blobs=True), marks=pytest.mark.long)],
    ids=["", "long frames"],
)
async def test_robots_of_a_daemon_that_hangs_are_stopped_and_driven_again_afterwards(reading: Reading) -> None:
    """SIGSTOP: as a loop that is blocked, also inside a long frame. Its guardian sends zeros, and no id 11."""
    async with driving(reading) as drive:
        await wait_for_guardian(drive)
        began_s, watch = time.monotonic(), Stopwatch(*guardians_of(drive.daemon))
        os.kill(drive.daemon.pid, signal.SIGSTOP)
        for robot in drive.robots:
            await expect(lambda robot=robot: robot.velocities[-1][1] == ZERO)
        assert drive.stood_after_s(began_s) - watch.kept_s <= HANG_LIMIT_S
        ended_s = time.monotonic()
        drive.longest_gap_s = 0.0
        os.kill(drive.daemon.pid, signal.SIGCONT)
        await asyncio.sleep(0.5)
        if drive.longest_gap_s < LEASE_S:  # a pause interrupts, until its source pauses, too
            for robot in drive.robots:
                assert not robot.is_moving
                # The daemon may have stopped inside the system call that writes a velocity.
                assert len([at_s for at_s, velocity in robot.velocities if velocity != ZERO and at_s > ended_s]) <= 1
        await drive.let_go()
        await drive.moves()
        for robot in drive.robots:
            assert robot.stops == []
            assert robot.ended_at_s is None
        stopped = await drive.daemon.logged("guardian.stopped_robots")
        assert (stopped["level"], stopped["robots"]) == ("warning", 2)
        assert drive.daemon.lines("link.closed") == []
        assert await end_at(drive, 0.0, killer(signal.SIGKILL)) <= LIMIT_S


async def test_a_daemon_that_hangs_and_is_killed_then_has_its_robots_stopped_twice() -> None:
    """Systemd's watchdog does the same."""
    async with driving(Reading()) as drive:
        await wait_for_guardian(drive)
        os.kill(drive.daemon.pid, signal.SIGSTOP)
        for robot in drive.robots:
            await expect(lambda robot=robot: robot.velocities[-1][1] == ZERO)
            assert robot.stops == []
        os.kill(drive.daemon.pid, signal.SIGKILL)
        for robot in drive.robots:
            await robot.stood()
            assert len(robot.stops) == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_an_orderly_end_is_the_daemons_own_and_the_guardian_writes_nothing(number: signal.Signals) -> None:
    async with driving(Reading()) as drive:
        guardian = guardian_of(drive.daemon)
        os.kill(drive.daemon.pid, number)
        await drive.daemon.ended()
        ended_s = time.monotonic()
        await expect(lambda: not is_running(guardian))
        robot = drive.robots[1]
        assert len(robot.stops) == 1
        assert robot.velocities[-1][0] <= robot.stops[0] < ended_s


@contextlib.contextmanager
def serving_in_terminal(log: Path) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """(the terminal's other end, the daemon), which is the terminal's foreground process as in a shell."""
    terminal, theirs = os.openpty()
    with log.open("wb") as stderr:
        started = subprocess.Popen(
            [HOSTLINK, "serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0"],
            stdin=theirs, stdout=theirs, stderr=stderr, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 - nothing else takes a terminal
        )  # fmt: skip
    os.close(theirs)
    try:
        yield terminal, started
    finally:
        started.kill()
        started.wait()
        os.close(terminal)


async def test_ctrl_c_in_a_terminal_is_the_daemons_alone(tmp_path: Path) -> None:
    """The daemon stops the robot, and the guardian, which is of another session, has nothing to write."""
    with serving_in_terminal(tmp_path / "log") as (terminal, started):
        daemon = Process(started, tmp_path / "log")
        await daemon.has_started()
        async with robot_on_tcp(daemon.tcp, "robot_0") as robot:
            await expect(lambda: robot.velocities)
            os.write(terminal, b"\x03")
            assert await asyncio.to_thread(started.wait, TIMEOUT_S) == 0
            ended_s = time.monotonic()
            await robot.ended()
        assert len(robot.stops) == 1
        assert robot.stops[0] <= ended_s
        assert robot.velocities[-1][0] <= robot.stops[0]
        assert not is_running(guardian_of(daemon))


async def test_a_daemon_without_stdin_has_a_guardian_too(tmp_path: Path) -> None:
    log = tmp_path / "log"
    script = f"exec {HOSTLINK} serve --listen 127.0.0.1:0 --api 127.0.0.1:0 <&- 2>{log}"
    child = await asyncio.create_subprocess_exec("sh", "-c", script)
    daemon = Process(child, log)
    try:
        await daemon.has_started()
        async with robot_on_tcp(daemon.tcp, "robot_0") as robot:
            await daemon.logged("robot.appeared")
            child.kill()
            await robot.stood()
            assert robot.stops
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()
