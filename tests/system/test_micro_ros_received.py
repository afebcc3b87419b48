"""Table of what a micro-ROS board receives from `hostlink serve` through stops, a reboot and ends of the daemon.

A program commands 20 times a second, also while the daemon is not there; before a stop it becomes silent. After a
refusal it sends a zero, as one who lets go. The limits leave out the time in which the machine ran other programs.
"""

import asyncio
import contextlib
import os
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

import aiohttp
import pytest

from tests.support.background import meanwhile
from tests.support.killing import guarded_by, guardians_of
from tests.support.process import Process, free_port, serve
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect, expect_never
from tests.support.xrce_device import Device, stock, udp_board

pytestmark = [pytest.mark.quiet, pytest.mark.long]
ROBOT = "linorobot_base_node"
SPEED = 0.2
PERIOD_S = 0.05
SETTLED_S = 0.5
PAUSE_S = 2.2
LIMITS_S = {
    "the program is silent: its lease ends": 0.75,
    "stop": 0.15,
    "lock, then unlock": 0.15,
    "the daemon is ended (SIGTERM) and started again": 0.3,
    "the daemon is killed (kill -9) and started again": 0.3,
    "the daemon hangs for 2.2 s (SIGSTOP)": 1.5,
}
AGAIN_S = 2.0  # until the board is driven again after a restart of the daemon
HEAD = ("what happens", "zero after, ms", "zeros", "velocities after the zero", "driven again after, ms")


@dataclass
class Row:
    """Messages that the board received after an event. Times are in seconds; None: not asked for."""

    event: str
    zero_s: float | None
    zeros: int
    moved: int  # velocities other than zero behind the first zero, until the event is over
    again_s: float | None
    kept_s: float = 0.0  # how long other programs kept the daemon, its guardian and the board from running, of zero_s
    again_kept_s: float = 0.0  # of again_s

    def __str__(self) -> str:
        zero, again = ("-" if each is None else f"{1000 * each:.0f}" for each in (self.zero_s, self.again_s))
        return f"| {self.event} | {zero} | {self.zeros} | {self.moved} | {again} |"


@dataclass
class Scene:
    """A board at one port, the daemon at another, and the program that drives."""

    folder: Path
    stack: contextlib.AsyncExitStack
    board_port: int = field(default_factory=free_port)
    port: int = field(default_factory=free_port)
    api: int = field(default_factory=free_port)
    tcp: int = field(default_factory=free_port)
    is_silent: bool = False
    rows: list[Row] = field(default_factory=list)
    boots: int = 0
    device: Device = None  # type: ignore[assignment] - set by `boot`
    daemon: Process = None  # type: ignore[assignment] - set by `start`
    _power: contextlib.AsyncExitStack = field(default_factory=contextlib.AsyncExitStack)

    async def start(self) -> None:
        """Start the daemon on the ports that it had before."""
        arguments = ("--micro-ros", f"udp://127.0.0.1:{self.port}", "--api", f"127.0.0.1:{self.api}")
        self.daemon = await self.stack.enter_async_context(
            serve(*arguments, "--listen", f"127.0.0.1:{self.tcp}", environment={"XDG_STATE_HOME": str(self.folder)})
        )

    async def boot(self) -> None:
        """Switch the board off and on. Its key is drawn at each boot."""
        await self._power.aclose()
        self.boots += 1
        program = stock(key=self.boots.to_bytes(4), keeps=4, gives_up=False)
        at = udp_board(("127.0.0.1", self.port), program, local_port=self.board_port)
        self.device = await self._power.enter_async_context(at)

    async def drive(self) -> None:
        """Command the robot, also while the daemon is not there."""
        is_refused = False
        async with aiohttp.ClientSession() as session:
            while True:
                await asyncio.sleep(PERIOD_S)
                if self.is_silent:
                    continue
                with contextlib.suppress(aiohttp.ClientError, TimeoutError):
                    wanted = {"linear": 0.0 if is_refused else SPEED, "angular": 0.0}
                    url = f"http://127.0.0.1:{self.api}/api/robots/{ROBOT}/velocity"
                    async with asyncio.timeout(1.0), session.put(url, json=wanted) as response:
                        is_refused = response.status == 409
                        await response.read()

    def taken_since(self, since_s: float) -> list[tuple[float, float]]:
        return [each for each in self.device.stock.taken if each[0] > since_s]

    def is_moving(self) -> bool:
        taken = self.device.stock.taken
        return bool(taken) and taken[-1][1] > 0.0

    async def moves(self) -> None:
        """Wait until the board is driven, and the guardian has its connection."""
        await expect(self.is_moving)
        await expect(lambda: guarded_by(guardians_of(self.daemon)[0]) == 1)
        await asyncio.sleep(SETTLED_S)
        await expect(self.is_moving)

    async def event(
        self,
        name: str,
        begin: Callable[[], Awaitable[object]],
        end: Callable[[], Awaitable[object]],
        *,
        has_again: bool = False,
    ) -> None:
        """Let it happen while the board moves, and end it. Note what the board received until then."""
        await self.moves()
        began_s, watch = time.monotonic(), Stopwatch(self.daemon.pid, *guardians_of(self.daemon))
        async with meanwhile(watch.sampling()):
            await begin()
            with contextlib.suppress(AssertionError):
                await expect(lambda: not self.is_moving(), timeout_s=5.0)
        kept_s = watch.kept_s
        await expect_never(self.is_moving, for_s=SETTLED_S)
        taken = self.taken_since(began_s)
        stood_s = next((at_s for at_s, speed in taken if speed == 0.0), None)
        await end()
        ended_s, watch = time.monotonic(), Stopwatch(self.daemon.pid)
        again_s = None
        if has_again:
            await expect(self.is_moving)
            again_s = next(at_s for at_s, speed in self.taken_since(ended_s) if speed > 0.0) - ended_s
        self.rows.append(
            Row(
                name,
                None if stood_s is None else stood_s - began_s,
                sum(speed == 0.0 for _, speed in taken),
                sum(speed > 0.0 for at_s, speed in taken if stood_s is not None and at_s > stood_s),
                again_s,
                kept_s,
                watch.kept_s,
            )
        )

    async def reboot(self) -> None:
        """Reboot the board while it is driven: it is at rest, and takes no velocity of the time before."""
        await self.moves()
        began_s = time.monotonic()
        await self.boot()
        await expect(self.is_moving)
        taken = self.taken_since(began_s)
        place = next(place for place, (_, speed) in enumerate(taken) if speed > 0.0)
        self.rows.append(Row("the board reboots", None, place, int(place == 0), taken[place][0] - began_s))


@contextlib.asynccontextmanager
async def scene(folder: Path) -> AsyncIterator[Scene]:
    async with contextlib.AsyncExitStack() as stack:
        made = Scene(folder, stack)
        await made.start()
        stack.push_async_callback(made._power.aclose)
        await made.boot()
        await stack.enter_async_context(meanwhile(made.drive()))
        yield made


async def nothing() -> None:
    """End an event that is over."""


def signalled(made: Scene, number: signal.Signals) -> Callable[[], Awaitable[object]]:
    async def send() -> None:
        os.kill(made.daemon.pid, number)

    return send


async def test_board_receives_zeros_after_each_event_and_no_velocity_behind_them(tmp_path: Path) -> None:
    async with scene(tmp_path) as made:

        async def silence() -> None:
            made.is_silent = True

        async def speak() -> None:
            made.is_silent = False

        async def stop() -> None:
            made.is_silent = True  # a program that continues drives again after it let go
            await made.daemon.post(f"/api/robots/{ROBOT}/stop")

        async def restart() -> None:
            await made.daemon.ended()
            await made.start()

        async def resume() -> None:
            os.kill(made.daemon.pid, signal.SIGCONT)

        async def hang() -> None:
            os.kill(made.daemon.pid, signal.SIGSTOP)
            await asyncio.sleep(PAUSE_S)

        silent, stopped, locked, ended, killed, hung = LIMITS_S
        await made.event(silent, silence, speak, has_again=True)
        await made.event(stopped, stop, speak, has_again=True)
        await made.event(
            locked,
            lambda: made.daemon.post(f"/api/robots/{ROBOT}/lock", {"reason": "test"}),
            lambda: made.daemon.post(f"/api/robots/{ROBOT}/unlock"),
            has_again=True,
        )
        await made.reboot()
        await made.event(ended, signalled(made, signal.SIGTERM), restart, has_again=True)
        await made.event(killed, signalled(made, signal.SIGKILL), restart, has_again=True)
        await made.event(hung, hang, resume, has_again=True)
    print("\n".join((f"| {' | '.join(HEAD)} |", *map(str, made.rows))))  # noqa: T201
    assert [each.event for each in made.rows if each.moved] == []
    for row in made.rows:
        if row.event in LIMITS_S:
            assert row.zeros > 0, row
            assert row.zero_s is not None, row
            assert row.zero_s - row.kept_s <= LIMITS_S[row.event], row
        assert row.again_s is not None, row
        if row.event in {ended, killed}:
            assert row.again_s - row.again_kept_s <= AGAIN_S, row
