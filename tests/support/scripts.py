"""Programs that drive a robot with the blocking client, each in a process of its own."""

import asyncio
import contextlib
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from dataclasses import dataclass

from hostlink.sim.robot import SimulatedRobot
from tests.support.daemon import Daemon, daemon
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

STOPPED_M_S = 0.005
ENDLESS_S = 60.0

DRIVE = """
import os, signal, sys, threading, time
import hostlink.client
host = hostlink.client.connect_blocking({url!r})
robot = host.robot("robot_0")
robot.drive(0.2, 0.0)
print("drives", flush=True)
"""


@contextlib.asynccontextmanager
async def script(url: str, *lines: str) -> AsyncIterator[Process]:
    """A program that drives robot_0 and then does these lines; killed at the end of the block if it still runs."""
    code = "\n".join([DRIVE.format(url=url), *lines])
    child = await asyncio.create_subprocess_exec(sys.executable, "-c", code, stdout=PIPE, stderr=PIPE)
    try:
        assert child.stdout is not None
        assert await child.stdout.readline() == b"drives\n"
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.communicate()


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

    async def moves(self) -> None:
        await expect(lambda: self.is_held and self.body.speed_m_s > 0.02)

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
