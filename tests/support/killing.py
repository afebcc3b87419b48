"""One daemon drives two robots without a watchdog, over TCP and on a serial port, and ends at a chosen moment."""

import asyncio
import base64
import contextlib
import itertools
import os
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path

import aiohttp

from hostlink.core.robot.admission import LEASE_S
from tests.support.background import meanwhile
from tests.support.process import Process, serve
from tests.support.stopwatch import Stopwatch
from tests.support.unwatched_robot import BLOB_BUFFER_BYTES, Reading, UnwatchedRobot, robot_on_pty, robot_on_tcp
from tests.support.waiting import TIMEOUT_S, is_true_within

LIMIT_S = 0.2
TRY_S = 2.0  # until the program lets go and commands again
LET_GO_S = 1.2 * LEASE_S
STANDS_S = 2.0  # a robot that moves for longer moves on
COMMAND_INTERVAL_S = 0.005
BLOB_INTERVAL_S = 0.02
BAUD = 921600
BLOB = base64.b64encode(bytes(BLOB_BUFFER_BYTES - 100)).decode()


@dataclass
class Drive:
    """A daemon and its robots, all moving."""

    daemon: Process
    robots: list[UnwatchedRobot] = field(default_factory=list)
    is_let_go: bool = False  # while it is, the program commands nothing
    longest_gap_s: float = 0.0  # between two commands: a starved program pauses, too

    def stood_after_s(self, since_s: float) -> float:
        """Return the time from then until the last of the robots stood."""
        return max(robot.stood_after_s(since_s) for robot in self.robots)

    async def moves(self) -> None:
        """Wait until all robots move.

        A command that a busy machine delivers late is refused, and its source must let go before it drives again.
        """
        async with asyncio.timeout(TIMEOUT_S):
            while not await is_true_within(lambda: all(robot.is_moving for robot in self.robots), TRY_S):
                await self.let_go()

    async def let_go(self) -> None:
        """Command nothing for longer than a lease."""
        self.is_let_go = True
        await asyncio.sleep(LET_GO_S)
        self.is_let_go = False


@contextlib.asynccontextmanager
async def driving(reading: Reading, *arguments: str) -> AsyncIterator[Drive]:
    """A robot on a serial port and one over TCP, both of which move (`moving`)."""
    async with (
        robot_on_pty("on_wire") as (on_wire, port),
        serve("--serial", f"{port}@{BAUD}", *arguments) as daemon,
        robot_on_tcp(daemon.tcp, "on_air", reading) as on_air,
        moving(daemon, on_wire, on_air) as drive,
    ):
        yield drive


@contextlib.asynccontextmanager
async def moving(daemon: Process, *robots: UnwatchedRobot) -> AsyncIterator[Drive]:
    """The robots move when the block begins, and commands come 200 times a second until the daemon is gone."""
    await daemon.logged("robot.appeared", len(robots))
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(daemon.url) as client,
        asyncio.TaskGroup() as tasks,
    ):
        drive = Drive(daemon, list(robots))
        sources = [tasks.create_task(_command(client, drive))]
        if any(robot.reading.with_blobs for robot in robots):
            sources.append(tasks.create_task(_send_blobs(client)))
        try:
            await drive.moves()
            yield drive
        finally:
            for source in sources:
                source.cancel()


async def end_at(drive: Drive, after_s: float, end: Callable[[int], None]) -> float:
    """End the daemon after a time; return how long the robots moved on, infinite for one that still does.

    The time in which the test or the guardian waited for a core is left out.
    """
    await asyncio.sleep(after_s)
    began_s, watch = time.monotonic(), Stopwatch(*guardians_of(drive.daemon))
    async with meanwhile(watch.sampling()):
        end(drive.daemon.pid)
        for robot in drive.robots:
            with contextlib.suppress(AssertionError):  # its time is infinite
                await robot.stood(STANDS_S)
    return drive.stood_after_s(began_s) - watch.kept_s


def guardians_of(daemon: Process) -> list[int]:
    """Return the pid of the guardian that was started last, if there is one."""
    return [int(line["pid"]) for line in daemon.lines("guardian.started")[-1:]]


def guarded_by(guardian: int) -> int:
    """Return how many connections the guardian holds, apart from stdio and that to the daemon; -1 while it starts."""
    is_ready = Path(f"/proc/{guardian}/comm").read_text() == "guardian\n"
    return len(list(Path(f"/proc/{guardian}/fd").iterdir())) - 4 if is_ready else -1


def killer(number: int) -> Callable[[int], None]:
    """Ends a process by this signal."""
    return lambda pid: os.kill(pid, number)


async def _command(client: aiohttp.ClientWebSocketResponse, drive: Drive) -> None:
    sent_s = time.monotonic()
    with contextlib.suppress(ConnectionError):  # the daemon has ended
        for turn in itertools.count():
            now_s = time.monotonic()
            drive.longest_gap_s, sent_s = max(drive.longest_gap_s, now_s - sent_s), now_s
            for robot in () if drive.is_let_go else drive.robots:
                speed = 0.1 + turn % 7 / 100
                twist = {"linear": {"x": speed, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0.5}}
                await client.send_json({"op": "publish", "topic": f"/{robot.name}/velocity_commands", "msg": twist})
            await asyncio.sleep(COMMAND_INTERVAL_S)


async def _send_blobs(client: aiohttp.ClientWebSocketResponse) -> None:
    message = {"layout": {"dim": [], "data_offset": 0}, "data": BLOB}
    with contextlib.suppress(ConnectionError):
        while True:
            await client.send_json({"op": "publish", "topic": "/on_air/blob", "msg": message})
            await asyncio.sleep(BLOB_INTERVAL_S)
