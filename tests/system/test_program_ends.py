"""Every end of a program that drives with the blocking client stops the robot."""

import asyncio
import signal
import sys
import time
from collections.abc import Awaitable, Callable

import pytest

from hostlink.core.robot.admission import LEASE_S
from tests.support.screen import screen
from tests.support.scripts import DrivenRobot, robot_to_drive, script
from tests.support.waiting import TIMEOUT_S, expect_never

pytestmark = pytest.mark.quiet

PAUSE_S = 0.6


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("pass", 0),
        pytest.param("sys.exit(3)", 3, marks=pytest.mark.long),
        ("1 / 0", 1),
        pytest.param("raise KeyboardInterrupt", 130, marks=pytest.mark.long),
        ("os._exit(4)", 4),
        ("os.kill(os.getpid(), signal.SIGTERM)", -signal.SIGTERM),
        pytest.param("del robot, host; time.sleep(1)", 0, marks=pytest.mark.long),
        pytest.param("threading.Thread(target=time.sleep, args=(0.3,)).start()", 0, marks=pytest.mark.long),
    ],
)
async def test_the_end_of_a_program_stops_what_it_drives(line: str, status: int) -> None:
    async with robot_to_drive() as robot:
        async with script(robot, "time.sleep(0.5)", line, host="localhost") as child:
            async with asyncio.timeout(TIMEOUT_S):
                _, errors = await child.communicate()
            found = child.returncode
        await robot.stands()
    assert found in (status, -signal.SIGINT if status == 130 else status)
    assert (errors != b"") is (status in (1, 130)), errors.decode()
    assert b"Exception in thread" not in errors


@pytest.mark.parametrize(
    ("number", "line"),
    [
        (signal.SIGINT, "time.sleep(60)"),
        pytest.param(signal.SIGINT, "for pose in robot.odometry(): pass", marks=pytest.mark.long),
        (signal.SIGKILL, "time.sleep(60)"),
        (signal.SIGHUP, "threading.Thread(target=lambda: (robot.drive(0.2, 0.0), time.sleep(60))).start()"),
    ],
)
async def test_a_signal_that_ends_a_program_stops_what_it_drives(number: signal.Signals, line: str) -> None:
    async with robot_to_drive() as robot:
        async with script(robot, line) as child:
            child.send_signal(number)
            async with asyncio.timeout(TIMEOUT_S):
                await child.communicate()
        await robot.stands()


@pytest.mark.parametrize("line", ["1 / 0", pytest.param("sys.exit()", marks=pytest.mark.long)])
async def test_an_error_in_a_thread_stops_what_is_driven_though_the_program_lives_on(line: str) -> None:
    thread = f"def control():\n    time.sleep(0.5)\n    {line}\nthreading.Thread(target=control).start()"
    async with robot_to_drive() as robot, script(robot, thread, "time.sleep(60)") as child:
        await robot.stands()
        assert child.returncode is None


async def test_the_end_of_the_main_thread_stops_what_it_drives_though_another_thread_lives() -> None:
    ended = "thread = threading.Thread(target=robot.drive, args=(0.1, 0.0))\nthread.start()\nthread.join()"
    hangs = "threading.Thread(target=time.sleep, args=(60,)).start()"
    async with robot_to_drive() as robot:
        for lines in ([], [ended]):
            async with script(robot, *lines, hangs, "time.sleep(0.5)") as child:
                await robot.stands()
                assert child.returncode is None


async def test_robot_that_another_thread_drives_is_driven_after_the_end_of_the_main_thread() -> None:
    control = "def control():\n    robot.drive(0.1, 0.0)\n    print(threading.main_thread().join(), flush=True)"
    lives = "    time.sleep(60)\nthread = threading.Thread(target=control)\nthread.start()"
    async with robot_to_drive() as robot, script(robot, control, lives) as child:
        assert child.stdout is not None
        assert await child.stdout.readline() == b"None\n"
        await expect_never(lambda: not robot.is_held, for_s=0.5)


async def test_program_that_is_stopped_by_a_signal_drives_for_a_lease_and_not_after_it_continues() -> None:
    async with robot_to_drive(lease_s=LEASE_S) as robot, script(robot, "time.sleep(60)") as child:
        child.send_signal(signal.SIGSTOP)
        await robot.stands()
        await asyncio.sleep(LEASE_S)  # also since the last answer, by the program's own clock
        child.send_signal(signal.SIGCONT)
        await expect_never(lambda: robot.is_held, for_s=0.5)


async def test_script_drives_again_after_a_pause_of_the_daemon() -> None:
    class Paused(DrivenRobot):
        async def moves(self, again: Callable[[], Awaitable[object]]) -> None:
            time.sleep(PAUSE_S)  # noqa: ASYNC251 - the machine does not run
            await super().moves(again)

    async with robot_to_drive() as robot, script(Paused(robot.host, robot.body), "time.sleep(60)"):
        assert robot.is_held


async def test_an_error_and_ctrl_c_at_pythons_prompt_stop_what_is_driven_and_the_connection_stays() -> None:
    async with robot_to_drive() as robot, screen() as terminal:
        await terminal.keys(f"{sys.executable} -i -q", "Enter")
        await terminal.keys("import hostlink.client, time", "Enter")

        async def drive() -> None:
            await terminal.keys("robot.drive(0.2, 0.0)", "Enter")

        await terminal.keys(
            f"host = hostlink.client.connect_blocking('{robot.host.url}'); robot = host.robot('robot_0')", "Enter"
        )
        for mistake, shown in (("1 / 0", "ZeroDivisionError"), ("time.sleep(60)", "KeyboardInterrupt")):
            await drive()
            await robot.moves(drive)
            await terminal.shows("Driven(linear_m_s=0.2")
            await terminal.keys(mistake, "Enter")
            if "sleep" in mistake:
                await asyncio.sleep(0.5)
                await terminal.keys("C-c")
            await terminal.shows(shown)
            await robot.stands()
            await terminal.keys("clear = host.is_connected, robot.is_driven; clear", "Enter")
            await terminal.shows("(True, False)")
            await terminal.keys("C-l")
        await drive()
        await robot.moves(drive)
        await terminal.keys("C-d")
        await robot.stands()
