"""Drivers that go on after the machine stood still: the daemon refuses what it read late, and disarms its sources."""

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import aiohttp

from hostlink.client import Robot
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import CommandRefused, HostlinkError, RefusalKind
from tests.support.background import meanwhile

Value = TypeVar("Value")
REFUSED = 409
COMMAND_INTERVAL_S = 0.1


@dataclass
class Pause:
    """Whether a pause of the daemon is why a source is refused: from a late command until one is obeyed."""

    is_on: bool = False

    def explains(self, kind: str) -> bool:
        """Note a refusal of this kind, and return whether the pause is its cause."""
        self.is_on = self.is_on or kind == RefusalKind.LATE
        return self.is_on and kind in (RefusalKind.LATE, RefusalKind.DISARMED)


@dataclass
class Driver:
    """A participant that commands every COMMAND_INTERVAL_S."""

    longest_gap_s: float = 0.0  # between two commands

    @property
    def is_steady(self) -> bool:
        """Whether no command was so late that the machine may have stopped the robot."""
        return self.longest_gap_s < LEASE_S / 2


@contextlib.asynccontextmanager
async def driven(hub: Hub, name: str, linear: float) -> AsyncIterator[Driver]:
    """Drive a robot for the length of the block. After a pause of the daemon a zero arms the driver again.

    Any other refusal ends the block.
    """
    participant, driver = hub.join("driver"), Driver()

    async def repeat() -> None:
        now_s = asyncio.get_running_loop().time
        pause, wanted, sent_s = Pause(), PlanarVelocity(linear), now_s()
        while True:
            sent_s, before_s = now_s(), sent_s
            driver.longest_gap_s = max(driver.longest_gap_s, sent_s - before_s)
            try:
                participant.drive(hub.robots.find(name), wanted)
                if not wanted.is_zero:
                    pause = Pause()
                wanted = PlanarVelocity(linear)
            except CommandRefused as refused:
                if not pause.explains(refused.kind):
                    raise
                wanted = ZERO
            await asyncio.sleep(COMMAND_INTERVAL_S)

    try:
        async with meanwhile(repeat()):
            yield driver
    finally:
        participant.leave()


def obeyed(drive: Callable[[], Value]) -> Value:
    """Drive from a thread, until the daemon does not refuse the velocity because of a pause of this machine."""
    pause = Pause()
    while True:
        try:
            return drive()
        except CommandRefused as refused:
            if not pause.explains(refused.kind):
                raise
            time.sleep(LEASE_S)
        except HostlinkError as error:  # an earlier velocity was broken off
            if "this program did not run" not in str(error):
                raise


async def hold(robot: Robot, linear_m_s: float, angular_rad_s: float) -> None:
    """Let a program hold a velocity. After a pause of the daemon it lets go for as long as a lease, and tries again."""
    pause = Pause()
    while True:
        try:
            await robot.drive(linear_m_s, angular_rad_s)
        except CommandRefused as refused:
            if not pause.explains(refused.kind):
                raise
            await asyncio.sleep(LEASE_S)
        else:
            return


async def answered(send: Callable[[], Awaitable[tuple[int, Any]]]) -> tuple[int, Any]:
    """Send a velocity over REST until the daemon does not refuse it because of a pause.

    `send` returns the status and the JSON, and so does this. After a late command, a lease without one arms the source.
    """
    pause = Pause()
    while True:
        status, answer = await send()
        kind = answer["error"]["kind"] if status == REFUSED else ""
        if not pause.explains(kind):
            return status, answer
        if kind == RefusalKind.DISARMED:
            await asyncio.sleep(LEASE_S)


async def put_velocity(session: aiohttp.ClientSession, robot_url: str, body: bytes) -> None:
    """Send a velocity until the daemon obeys it.

    Raises:
        AssertionError: the daemon refused it for another reason than a pause.
    """

    async def send() -> tuple[int, Any]:
        async with session.put(f"{robot_url}/velocity", data=body) as response:
            return response.status, json.loads(await response.read())

    status, answer = await answered(send)
    assert status == 200, answer
