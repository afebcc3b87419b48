"""Driver: the velocities that this client commands: held ones, which one task repeats, and single ones.

A hold that is broken is never resumed.
"""

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hostlink.client.connection import Connection
from hostlink.client.views import Refusal
from hostlink.errors import HostlinkError

REPEAT_INTERVAL_S = 0.1  # a fifth of the lease that a command has
_COMMAND = "command:"
LEASE_S = 0.5  # after it without a command the daemon has stopped the robot
ANSWER_TIMEOUT_S = 1.0
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # goes on while the computer sleeps, where there is one


@dataclass(slots=True)
class _Hold:
    number: int
    request: Mapping[str, Any]
    sent_s: float
    link: int | None = None  # of the device that accepted it; None: not answered yet


class Driver:
    """Who is driven how.

    A hold ends by the next `drive` or `stop`; it is broken by a refusal, by the loss of the connection, by a new
    connection of the robot's device, and when this program did not run for longer than a command holds. Then the
    robot stands, and the next `drive` raises why, once, instead of driving.
    """

    def __init__(self, connection: Connection) -> None:
        self.refusals: dict[str, Refusal | None] = {}  # by robot: of the newest answered `command`
        self._connection = connection
        self._numbers = itertools.count(1)
        self._holds: dict[str, _Hold] = {}
        self._broken: dict[str, str] = {}
        connection.handlers["drive_result"] = self._receive_answer

    @property
    def robots(self) -> tuple[str, ...]:
        """The names of the robots that are driven."""
        return tuple(self._holds)

    async def drive(self, robot: str, linear_m_s: float, angular_rad_s: float, priority: int) -> None:
        """Command, and hold from now on; returns when the daemon has accepted it.

        Raises:
            HostlinkError: it was refused, and nothing is held; or what was held before is broken.
        """
        request = _request(robot, linear_m_s, angular_rad_s, priority)
        if (reason := self._broken.pop(robot, None)) is not None:
            raise HostlinkError(f"{robot} was stopped, drive again if it is still meant: {reason}")
        before = self._holds.get(robot)
        hold = self._holds[robot] = _Hold(next(self._numbers), request, _now_s())
        try:
            hold.link = await self._command(hold, None if before is None else before.link)
            hold.sent_s = _now_s()
        except BaseException:  # a cancellation too: what nobody waits for is not held
            if self._holds.get(robot) is hold:
                self.let_go(robot)
            raise

    async def _command(self, hold: _Hold, link: int | None) -> int:
        """For the device of the hold before, if there was one: else a new one would be driven on without a word."""
        request = {**hold.request, "sent_s": hold.sent_s, "link": link}
        answer = await self._connection.request(request, timeout_s=ANSWER_TIMEOUT_S)
        if not answer["result"]:
            raise HostlinkError(str(answer["reason"]))
        return int(answer["link"])

    async def command(
        self, robot: str, velocity: tuple[float, float], priority: int, *, link: int | None = None
    ) -> None:
        """Send one command, which is not held; its answer is not waited for, and is in `refusals` if it is one.

        Raises:
            HostlinkError: the numbers are not finite, or there is no connection.
        """
        request = {"id": f"{_COMMAND}{robot}", "sent_s": _now_s(), "link": link}
        await self._connection.send(_request(robot, *velocity, priority) | request)

    def let_go(self, robot: str) -> None:
        """Repeat it no more; the end of it is known to the caller."""
        self._holds.pop(robot, None)
        self._broken.pop(robot, None)

    def break_all(self, reason: str) -> tuple[str, ...]:
        """The connection is lost; returns the robots that were driven."""
        driven = self.robots
        for robot in driven:
            self._break(robot, reason)
        return driven

    async def repeat(self) -> None:
        """Keep the commands alive, until cancelled."""
        while True:
            await asyncio.sleep(REPEAT_INTERVAL_S)
            for robot, hold in list(self._holds.items()):
                if hold.link is not None:
                    await self._repeat(robot, hold)

    async def _repeat(self, robot: str, hold: _Hold) -> None:
        now_s = _now_s()
        if now_s > hold.sent_s + LEASE_S:
            self._break(robot, f"this program did not run for {now_s - hold.sent_s:.1f} s")
            return
        hold.sent_s = now_s
        request = {"id": f"hold:{hold.number}", "sent_s": now_s, "link": hold.link}
        with contextlib.suppress(HostlinkError):  # the connection tells everybody of its loss
            await self._connection.send({**hold.request, **request})

    def _receive_answer(self, answer: dict[str, Any]) -> None:
        """Of a command that nobody waits for."""
        key = str(answer["id"])
        refusal = None if answer["result"] else Refusal(str(answer["kind"]), str(answer["reason"]))
        if key.startswith(_COMMAND):
            self.refusals[key.removeprefix(_COMMAND)] = refusal
        elif refusal is not None:
            for robot, hold in list(self._holds.items()):
                if key == f"hold:{hold.number}":
                    self._break(robot, refusal.reason)

    def _break(self, robot: str, reason: str) -> None:
        del self._holds[robot]
        self._broken[robot] = reason


def _request(robot: str, linear_m_s: float, angular_rad_s: float, priority: int) -> dict[str, Any]:
    if not (math.isfinite(linear_m_s) and math.isfinite(angular_rad_s)):
        raise HostlinkError(f"{robot}: a velocity must be made of finite numbers")
    velocity = {"linear": float(linear_m_s), "angular": float(angular_rad_s)}
    return {"op": "drive", "robot": robot, **velocity, "priority": priority}


def _now_s() -> float:
    return time.clock_gettime(_CLOCK)
