"""Teleop in a real terminal (tmux): it drives while a key is held, and on every way out the robot stops.

tests/unit/cli/test_driving.py has the rules of keys, tests/unit/cli/test_teleop_screen.py those of the screen.
"""

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from hostlink.cli.driving import GRACE_S, HOLD_S
from hostlink.client import connect
from hostlink.core.robot.events import LET_GO
from tests.support.fake_device import fake_device, pose, repeating, robot_topics
from tests.support.process import HOSTLINK, Process, serve, simulated
from tests.support.screen import PATIENCE_S, Screen, screen

TRIES = 5
MOVES_WITHIN_S = 3.0  # a robot whose key is held; otherwise the key is pressed again
RELEASED_S = 2 * HOLD_S  # time between two presses; a barred key is free HOLD_S after its last repeat


@contextlib.asynccontextmanager
async def driving(layout: str = "original") -> AsyncIterator[tuple[Process, Screen]]:
    """A daemon, a simulated robot, and teleop on its screen."""
    async with serve() as daemon, simulated(daemon.tcp, "--robot", "nimble"), screen() as terminal:
        await daemon.read_log("robot.appeared")
        await terminal.keys(f"{HOSTLINK} teleop --url {daemon.url} --layout {layout}", "Enter")
        await terminal.shows("hostlink teleop   robot_0   connected")
        yield daemon, terminal


async def expect(
    daemon: Process, is_so: Callable[[dict[str, Any]], bool], *, within_s: float = PATIENCE_S
) -> dict[str, Any]:
    """Return the first state of the robot of which this is true. The daemon sends the state when it changes.

    Raises:
        TimeoutError: no such state within `within_s` seconds.
    """
    async with asyncio.timeout(within_s), connect(daemon.url) as host:
        async for event in host.watch():
            if event.name == "robots" and is_so(state := dict(event.data["robots"][0])):
                return state
    raise AssertionError("the daemon ended the events")


async def last_drive_ended(daemon: Process) -> str:
    """Return why the newest drive ended."""
    return str((await daemon.get("/api/drives"))["drives"][0]["end"])


async def press_until_unlocked(terminal: Screen, daemon: Process) -> None:
    """Press the key as slowly as a person. A busy machine may end the question, which the next press asks again."""
    async with asyncio.timeout(PATIENCE_S):
        while (await daemon.get("/api/robots/robot_0"))["locked"]:
            await asyncio.sleep(2 * GRACE_S)
            await terminal.keys("r")


def is_driven(observed: dict[str, Any]) -> bool:
    return observed["odometry"] is not None and observed["odometry"]["twist"]["linear_m_s"] > 0.03


def is_stopped(observed: dict[str, Any]) -> bool:
    return observed["holder"] is None and abs(observed["odometry"]["twist"]["linear_m_s"]) < 0.01


@contextlib.asynccontextmanager
async def moving(terminal: Screen, daemon: Process, key: str = "w") -> AsyncIterator[None]:
    """Hold a key for the length of the block, which begins when the robot moves.

    A command that a busy machine delivers too late bars the key until it is released, so it is pressed again.
    """
    async with contextlib.AsyncExitStack() as held:
        async with asyncio.timeout(PATIENCE_S):
            await held.enter_async_context(terminal.holding(key))
            while not await _moves(daemon):
                await held.aclose()
                await asyncio.sleep(RELEASED_S)
                await held.enter_async_context(terminal.holding(key))
        yield


async def _moves(daemon: Process) -> bool:
    try:
        await expect(daemon, is_driven, within_s=MOVES_WITHIN_S)
    except TimeoutError:
        return False
    return True


@pytest.mark.parametrize(("layout", "key"), [("original", "w"), pytest.param("twist", "i", marks=pytest.mark.long)])
async def test_teleop_with_a_held_key_drives_and_lets_go_at_its_release(layout: str, key: str) -> None:
    async with driving(layout) as (daemon, terminal):
        async with moving(terminal, daemon, key):
            assert "driven by you" in await terminal.shows("command   +0.20 m/s")
        await expect(daemon, is_stopped)
        for _ in range(TRIES):  # a busy machine may deliver the zero after the end of the lease
            if await last_drive_ended(daemon) == LET_GO:
                break
            async with moving(terminal, daemon, key):
                pass
            await expect(daemon, is_stopped)
        else:
            raise AssertionError("every drive ended by its lease, and not by the released key")
        await terminal.shows("driven by nobody")


async def test_teleop_with_another_key_stops_the_robot_though_a_driving_key_is_held() -> None:
    """The epoch shows the stop. A key without a meaning only lets go."""
    async with driving() as (daemon, terminal):
        for key in ("Space", "p"):
            async with moving(terminal, daemon):
                epoch = (await daemon.get("/api/robots/robot_0"))["epoch"]
                await terminal.keys(key)
                if key != "p":
                    await expect(daemon, lambda observed, epoch=epoch: observed["epoch"] > epoch)  # type: ignore[misc]
                await expect(daemon, is_stopped)
            await asyncio.sleep(RELEASED_S)  # the stop barred the key that was held


@pytest.mark.parametrize(
    "way",
    [
        "C-c",
        "q",
        pytest.param("TERM", marks=pytest.mark.long),
        pytest.param("HUP", marks=pytest.mark.long),
        "KILL",
        "close",
    ],
)
async def test_teleop_that_ends_in_any_way_stops_the_robot(way: str) -> None:
    """After an end in order, the terminal is as it was before."""
    async with driving() as (daemon, terminal):
        process = await terminal.process("hostlink teleop")
        async with moving(terminal, daemon):
            if way == "close":
                await terminal.tmux("kill-session", "-t", "main")
            elif way in ("C-c", "q"):
                await terminal.keys(way)
            else:
                os.kill(process, getattr(signal, f"SIG{way}"))
            await expect(daemon, is_stopped)
        if way in ("C-c", "q", "TERM"):
            await terminal.shows("bash-")  # the prompt is back
            await terminal.keys("C-u", "stty -a | tr ' ;' '\\n\\n' | grep -cx -e icanon -e echo", "Enter")
            await terminal.shows("\n2\n")


async def test_teleop_that_is_suspended_stops_the_robot_and_drives_again_after_its_return() -> None:
    async with driving() as (daemon, terminal):
        async with moving(terminal, daemon):
            pass
        await terminal.keys("C-z")
        await terminal.shows("Stopped")
        await expect(daemon, is_stopped)
        await terminal.keys("clear", "Enter", "fg", "Enter")
        await terminal.shows("speeds")
        assert is_stopped(await daemon.get("/api/robots/robot_0"))
        async with moving(terminal, daemon):
            pass


async def test_teleop_whose_daemon_is_killed_shows_that_the_robot_stops_by_itself() -> None:
    """tests/unit/cli/test_driving.py: the held key moves nothing until it is released."""
    async with driving() as (daemon, terminal):
        async with moving(terminal, daemon):
            daemon.child.kill()
            assert "q or Ctrl-C ends" in await terminal.shows("the robot stops by itself; trying again")
        await terminal.keys("C-c")
        await terminal.shows("bash-")


async def test_teleop_of_a_locked_robot_unlocks_it_by_a_key_twice_and_drives_by_the_next() -> None:
    async with driving() as (daemon, terminal):
        async with moving(terminal, daemon):
            await daemon.post("/api/robots/robot_0/lock")
            assert "r twice unlocks it" in await terminal.shows("LOCKED: ")
        await terminal.keys("w", "r")
        await terminal.shows("REALLY UNLOCK? r again does it")
        assert (await daemon.get("/api/robots/robot_0"))["locked"]
        await press_until_unlocked(terminal, daemon)
        await expect(daemon, is_stopped)
        async with moving(terminal, daemon):
            pass


async def test_teleop_of_a_robot_whose_odometry_stands_still_shows_a_warning_in_colour() -> None:
    async with (
        serve() as daemon,
        fake_device(daemon.tcp, robot_topics()) as device,
        repeating(device, pose(0.0), interval_s=0.05),
        screen() as terminal,
    ):
        await terminal.keys(f"{HOSTLINK} teleop --url {daemon.url}", "Enter")
        await terminal.shows("hostlink teleop   robot_0   connected")
        async with terminal.holding("w"):
            await terminal.shows("its odometry does not change")
            coloured = await terminal.tmux("capture-pane", "-p", "-e", "-t", "main")
        line = next(line for line in coloured.splitlines() if "does not change" in line)
        assert "\x1b[1m\x1b[33m" in line or "\x1b[33;1m" in line or "\x1b[1;33m" in line


async def test_teleop_without_a_terminal_is_refused() -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        child = await asyncio.create_subprocess_exec(
            HOSTLINK, "teleop", "--url", daemon.url, stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        _, err = await child.communicate()
    assert child.returncode == 2
    assert err.decode().startswith("hostlink: teleop: standard input or output is not a terminal")


async def test_teleop_of_a_device_that_cannot_take_a_velocity_shows_why_it_neither_drives_nor_stops() -> None:
    small = [info._replace(buffer_bytes=40) if info.id == 100 else info for info in robot_topics()]
    reason = "/robot_0/velocity_commands: frame of 56 bytes, the device takes 40"
    async with serve() as daemon, fake_device(daemon.tcp, small), screen() as terminal:
        await terminal.keys(f"{HOSTLINK} teleop robot_0 --url {daemon.url}", "Enter")
        await terminal.shows("hostlink teleop   robot_0   connected")
        await terminal.keys("Space")
        await terminal.shows(reason)
        await terminal.keys("w")
        assert "hostlink teleop   robot_0   connected" in await terminal.shows(reason)
        await terminal.keys("C-c")
        await terminal.shows("bash-")
