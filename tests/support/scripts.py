"""Programs that drive a robot with the blocking client, each in a process of its own."""

import asyncio
import contextlib
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

from hostlink.workbench.sim.robot import SimulatedRobot
from tests.support.daemon import Daemon, daemon
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect, is_true_within

STOPPED_M_S = 0.005
ENDLESS_S = 60.0
MOVES_M_S = 0.02
TRY_S = 1.0  # a robot that is driven moves within this time
TRIES = 20
BEGINS_S = 0.1  # the time in which the first of a program's lines begins

DRIVE = """
import contextlib, os, signal, sys, threading, time
import hostlink.client
host = hostlink.client.connect_blocking({url!r})
robot = host.robot("robot_0")
while sys.stdin.readline() == "drive\\n":
    with contextlib.suppress(hostlink.client.HostlinkError):
        robot.drive(0.2, 0.0)
    print("drives", flush=True)
print("goes on", flush=True)
"""


@dataclass
class DrivenRobot:
    """A robot of a daemon: as the daemon has it, and in truth."""

    host: Daemon
    body: SimulatedRobot

    @property
    def is_held(self) -> bool:
        """Whether a source drives it and has not let go, in the daemon's view."""
        robot = self.host.hub.robots.find_here("robot_0")
        return (robot.gate.owner is not None and not robot.gate.target.is_zero) or not robot.gate.current.is_zero

    async def moves(self, again: Callable[[], Awaitable[object]]) -> None:
        """Wait until it moves. `again` lets the program drive once more: a pause of the machine ends what it drives."""
        for _ in range(TRIES):
            if await is_true_within(self._is_moving, TRY_S):
                return
            await again()
        await expect(self._is_moving)

    def _is_moving(self) -> bool:
        self.host.hub.gates.pauses(asyncio.get_running_loop().time())  # one that has just ended stops the robot first
        return self.is_held and self.body.speed_m_s > MOVES_M_S

    async def stands(self) -> None:
        await expect(lambda: not self.is_held)
        await expect(lambda: abs(self.body.speed_m_s) < STOPPED_M_S)


@contextlib.asynccontextmanager
async def robot_to_drive(*, lease_s: float = ENDLESS_S) -> AsyncIterator[DrivenRobot]:
    """Run a robot with a lease so long that only a stop, or the connection's end, stops it in time."""
    async with daemon() as host, simulated_robot(host.tcp) as body:
        await expect(lambda: host.hub.robots.find("robot_0").link is not None)
        host.hub.robots.find_here("robot_0").gate.admission.lease_s = lease_s
        yield DrivenRobot(host, body)


@contextlib.asynccontextmanager
async def script(robot: DrivenRobot, *lines: str, host: str = "127.0.0.1") -> AsyncIterator[Process]:
    """A program that moves the robot and then does these lines; killed at the end of the block if it still runs.

    `host`: the name by which it connects to the daemon.
    """
    code = "\n".join([DRIVE.format(url=robot.host.url.replace("127.0.0.1", host)), *lines])
    child = await asyncio.create_subprocess_exec(sys.executable, "-c", code, stdin=PIPE, stdout=PIPE, stderr=PIPE)
    assert child.stdin is not None
    assert child.stdout is not None
    write, read = child.stdin.write, child.stdout.readline

    async def drive() -> None:
        write(b"drive\n")
        assert await read() == b"drives\n"

    try:
        await drive()
        await robot.moves(drive)
        write(b"go on\n")
        assert await read() == b"goes on\n"
        await asyncio.sleep(BEGINS_S)
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.communicate()
