"""One daemon drives two robots without a watchdog, over TCP and on a serial port, and ends at a chosen moment."""

import asyncio
import base64
import contextlib
import itertools
import os
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field

import aiohttp

from tests.support.process import Process, serve
from tests.support.unwatched_robot import BLOB_BUFFER_BYTES, Reading, UnwatchedRobot, robot_on_pty, robot_on_tcp

LIMIT_S = 0.2
COMMAND_INTERVAL_S = 0.005
BLOB_INTERVAL_S = 0.02
BAUD = 921600
BLOB = base64.b64encode(bytes(BLOB_BUFFER_BYTES - 100)).decode()


@dataclass
class Drive:
    """A daemon and its two robots, both moving."""

    daemon: Process
    robots: list[UnwatchedRobot] = field(default_factory=list)
    is_let_go: bool = False  # while it is, the program commands nothing

    def stood_after_s(self, since_s: float) -> float:
        """From then until the last of them stood."""
        return max(robot.stood_after_s(since_s) for robot in self.robots)


@contextlib.asynccontextmanager
async def driving(reading: Reading, *arguments: str) -> AsyncIterator[Drive]:
    """Both robots move when the block begins, and commands come 200 times a second until the daemon is gone."""
    async with (
        robot_on_pty("on_wire") as (on_wire, port),
        serve("--serial", f"{port}@{BAUD}", *arguments) as daemon,
        robot_on_tcp(daemon.tcp, "on_air", reading) as on_air,
        aiohttp.ClientSession() as session,
    ):
        await daemon.logged("robot.appeared", 2)
        async with session.ws_connect(daemon.url) as client, asyncio.TaskGroup() as tasks:
            drive = Drive(daemon, [on_wire, on_air])
            sources = [tasks.create_task(_command(client, drive))]
            if reading.with_blobs:
                sources.append(tasks.create_task(_send_blobs(client)))
            try:
                for robot in drive.robots:
                    await robot.driven()
                yield drive
            finally:
                for source in sources:
                    source.cancel()


async def end_at(drive: Drive, after_s: float, end: Callable[[int], None]) -> float:
    """End the daemon after a time; returns how long the robots moved on, infinite for one that still does."""
    await asyncio.sleep(after_s)
    began_s = time.monotonic()
    end(drive.daemon.pid)
    for robot in drive.robots:
        with contextlib.suppress(AssertionError):  # its time is infinite
            await robot.stood(1.0)
    return drive.stood_after_s(began_s)


def killer(number: int) -> Callable[[int], None]:
    """Ends a process by this signal."""
    return lambda pid: os.kill(pid, number)


async def _command(client: aiohttp.ClientWebSocketResponse, drive: Drive) -> None:
    with contextlib.suppress(ConnectionError):  # the daemon has ended
        for turn in itertools.count():
            for name in () if drive.is_let_go else ("on_wire", "on_air"):
                speed = 0.1 + turn % 7 / 100
                twist = {"linear": {"x": speed, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0.5}}
                await client.send_json({"op": "publish", "topic": f"/{name}/velocity_commands", "msg": twist})
            await asyncio.sleep(COMMAND_INTERVAL_S)


async def _send_blobs(client: aiohttp.ClientWebSocketResponse) -> None:
    message = {"layout": {"dim": [], "data_offset": 0}, "data": BLOB}
    with contextlib.suppress(ConnectionError):
        while True:
            await client.send_json({"op": "publish", "topic": "/on_air/blob", "msg": message})
            await asyncio.sleep(BLOB_INTERVAL_S)
