"""Teleop in a real terminal (tmux): it drives while a key is held, and on every way out the robot stops."""

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator, Callable
from typing import Any

import aiohttp
import pytest

from hostlink.cli.driving import HOLD_S
from hostlink.client import connect
from hostlink.hub.robot_events import LET_GO
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.process import HOSTLINK, Process, serve, simulated
from tests.support.screen import PATIENCE_S, Screen, screen

TRIES = 5
POSE_S = 0.05  # of the device's odometry
OBSERVATIONS, OBSERVED_S = 40, 0.05  # of a robot whose key is held, before the key is pressed again


@contextlib.asynccontextmanager
async def driving(layout: str = "original") -> AsyncIterator[tuple[Process, Screen]]:
    """A daemon, a simulated robot, and teleop on its screen."""
    async with serve() as daemon, simulated(daemon.tcp, "--robot", "nimble"), screen() as terminal:
        await daemon.read_log("robot.appeared")
        await terminal.keys(f"{HOSTLINK} teleop --url {daemon.url} --layout {layout}", "Enter")
        await terminal.shows("hostlink teleop   robot_0   connected")
        yield daemon, terminal


async def robot(daemon: Process) -> dict[str, Any]:
    async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/api/robots/robot_0") as response:
        observed: dict[str, Any] = await response.json()
        return observed


async def expect(daemon: Process, is_so: Callable[[dict[str, Any]], bool]) -> None:
    """Wait for a state of the robot, as the daemon sends it when it changes."""
    async with asyncio.timeout(PATIENCE_S), connect(daemon.url) as host:
        async for event in host.watch():
            if event.name == "robots" and is_so(event.data["robots"][0]):
                return


async def last_drive_ended(daemon: Process) -> str:
    """Why the newest drive ended."""
    async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/api/drives") as response:
        return str((await response.json())["drives"][0]["end"])


def is_driven(observed: dict[str, Any]) -> bool:
    return observed["odometry"] is not None and observed["odometry"]["twist"]["linear_m_s"] > 0.03


def stands(observed: dict[str, Any]) -> bool:
    return observed["holder"] is None and abs(observed["odometry"]["twist"]["linear_m_s"]) < 0.01


@contextlib.asynccontextmanager
async def moving(terminal: Screen, daemon: Process, key: str = "w") -> AsyncIterator[None]:
    """Hold a key for the length of the block, which begins when the robot moves.

    A command that a busy machine delivers too late bars the key until it is released, so it is pressed again.
    """
    async with contextlib.AsyncExitStack() as held:
        async with asyncio.timeout(PATIENCE_S):
            await held.enter_async_context(terminal.holding(key))
            while not await _moves_within(daemon, OBSERVATIONS):
                await held.aclose()
                await asyncio.sleep(2 * HOLD_S)  # a bar ends HOLD_S after the last repeat
                await held.enter_async_context(terminal.holding(key))
        yield


async def _moves_within(daemon: Process, observations: int) -> bool:
    for _ in range(observations):
        if is_driven(await robot(daemon)):
            return True
        await asyncio.sleep(OBSERVED_S)
    return False


@pytest.mark.parametrize(("layout", "key"), [("original", "w"), ("original", "Up"), ("twist", "i")])
async def test_a_pressed_key_drives_and_a_released_one_stops(layout: str, key: str) -> None:
    async with driving(layout) as (daemon, terminal):
        async with moving(terminal, daemon, key):
            assert "driven by you" in await terminal.shows("command   +0.20 m/s")
        await expect(daemon, stands)
        for _ in range(TRIES):  # a busy machine may deliver the zero after the end of the lease
            if await last_drive_ended(daemon) == LET_GO:
                break
            async with moving(terminal, daemon, key):
                pass
            await expect(daemon, stands)
        else:
            raise AssertionError("every drive ended by its lease, and not by the released key")
        await terminal.shows("driven by nobody")


@pytest.mark.parametrize("key", ["Space", "k"])
async def test_stop_key_stops_the_robot_though_a_driving_key_is_still_held(key: str) -> None:
    """The epoch shows the stop. tests/unit/cli/test_driving.py: the held key moves nothing until it is released."""
    async with driving() as (daemon, terminal), moving(terminal, daemon):
        epoch = (await robot(daemon))["epoch"]
        await terminal.keys(key)
        await expect(daemon, lambda observed: observed["epoch"] > epoch)
        await expect(daemon, stands)


async def test_key_without_a_meaning_lets_go_though_a_driving_key_is_still_held() -> None:
    async with driving() as (daemon, terminal), moving(terminal, daemon):
        await terminal.keys("p")
        await expect(daemon, stands)


@pytest.mark.parametrize("way", ["C-c", "TERM", "HUP", "KILL", "close"])
async def test_every_way_out_stops_the_robot(way: str) -> None:
    async with driving() as (daemon, terminal):
        process = await terminal.process("hostlink teleop")
        async with moving(terminal, daemon):
            if way == "close":
                await terminal.tmux("kill-session", "-t", "main")
            elif way == "C-c":
                await terminal.keys("C-c")
            else:
                os.kill(process, getattr(signal, f"SIG{way}"))
            await expect(daemon, stands)


@pytest.mark.parametrize("way", ["C-c", "TERM"])
async def test_the_terminal_is_as_it_was(way: str) -> None:
    async with driving() as (daemon, terminal):
        process = await terminal.process("hostlink teleop")
        async with moving(terminal, daemon):
            pass
        if way == "C-c":
            await terminal.keys("C-c")
        else:
            os.kill(process, signal.SIGTERM)
        await terminal.shows("bash-")  # the prompt is back
        await terminal.keys("stty -a | tr ' ;' '\\n\\n' | grep -cx -e icanon -e echo", "Enter")
        assert "\n2\n" in await terminal.shows("\n2\n")


async def test_suspending_stops_the_robot_and_coming_back_drives_again() -> None:
    async with driving() as (daemon, terminal):
        async with moving(terminal, daemon):
            pass
        await terminal.keys("C-z")
        await terminal.shows("Stopped")
        await expect(daemon, stands)
        await terminal.keys("clear", "Enter", "fg", "Enter")
        await terminal.shows("speeds")
        assert stands(await robot(daemon))
        async with moving(terminal, daemon):
            pass


async def test_a_daemon_that_goes_away_is_reported_and_an_earlier_key_does_not_move_the_robot_later() -> None:
    async with driving() as (daemon, terminal):
        async with moving(terminal, daemon):
            daemon.child.kill()
            assert "Ctrl-C ends" in await terminal.shows("the robot stops by itself; trying again")
        await terminal.keys("C-c")
        await terminal.shows("bash-")


async def post(daemon: Process, path: str) -> None:
    async with aiohttp.ClientSession() as session, session.post(daemon.url + path) as response:
        assert response.status == 200


async def test_a_locked_robot_is_unlocked_by_a_key_and_moves_only_by_the_next() -> None:
    async with driving() as (daemon, terminal):
        async with moving(terminal, daemon):
            await post(daemon, "/api/robots/robot_0/lock")
            assert "r unlocks it" in await terminal.shows("LOCKED: ")
        await terminal.keys("w", "r")
        await expect(daemon, lambda observed: not observed["locked"])
        await expect(daemon, stands)
        async with moving(terminal, daemon):
            pass


async def test_forty_columns_show_all_of_it() -> None:
    async with driving() as (daemon, terminal):
        await terminal.tmux("resize-window", "-t", "main", "-x", "40", "-y", "24")
        shown = await terminal.shows("forward speed up/down")
        assert "heading" in shown
        assert "Ctrl-C" in shown
        async with moving(terminal, daemon):
            pass


async def test_a_robot_whose_odometry_stands_still_is_warned_of_in_colour() -> None:
    async with serve() as daemon, fake_device(daemon.tcp, robot_topics()) as device, screen() as terminal:
        await device.send(pose(0.0))
        await terminal.keys(f"{HOSTLINK} teleop --url {daemon.url}", "Enter")
        await terminal.shows("hostlink teleop   robot_0   connected")
        async with asyncio.timeout(PATIENCE_S), terminal.holding("w"):
            while "its odometry stands still" not in await terminal.text():
                await device.send(pose(0.0))
                await asyncio.sleep(POSE_S)
        coloured = await terminal.tmux("capture-pane", "-p", "-e", "-t", "main")
        line = next(line for line in coloured.splitlines() if "stands still" in line)
        assert "\x1b[1m\x1b[33m" in line or "\x1b[33;1m" in line or "\x1b[1;33m" in line


async def test_without_a_terminal_it_is_refused() -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        child = await asyncio.create_subprocess_exec(
            HOSTLINK, "teleop", "--url", daemon.url, stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        _, err = await child.communicate()
    assert child.returncode == 2
    assert err.decode().startswith("hostlink: teleop: standard input or output is not a terminal")
