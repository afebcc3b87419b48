"""Driver: the velocities that this client commands: those that one task repeats, and single ones.

What is broken off is never resumed.
"""

import asyncio
import contextlib
import contextvars
import itertools
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hostlink.client.connection import Connection, Message
from hostlink.client.views import Driven, Refusal
from hostlink.errors import HostlinkError

REPEAT_INTERVAL_S = 0.1  # a fifth of the lease that a command has
_COMMAND = "command:"
LEASE_S = 0.5  # after it without a command the daemon has stopped the robot
ANSWER_TIMEOUT_S = 1.0
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # goes on while the computer sleeps, where there is one
calling_thread: contextvars.ContextVar[threading.Thread | None] = contextvars.ContextVar("calling_thread", default=None)


@dataclass(slots=True)
class _Repeated:
    number: int
    request: Mapping[str, Any]
    sent_s: float
    is_yielding: bool
    link: int | None = None  # of the device that accepted it; None: not answered yet
    stops: int | None = None  # of the robot, as that answer counts them; None: it does not
    thread: threading.Thread | None = field(default_factory=calling_thread.get)  # None: the connection's own


class Driver:
    """Who is driven how.

    A repeated command ends by the next `drive` or `stop`; it is broken off by a refusal, by the loss of the connection,
    by a new connection of the robot's device, and when this program did not run for longer than a command holds. Then
    the robot stands, and the next `drive` raises why, once, instead of driving.
    """

    def __init__(self, connection: Connection) -> None:
        self.refusals: dict[str, Refusal | None] = {}  # by robot: of the newest answered `command`
        self.client_name: str | None = None  # as the daemon's newest answer calls this connection
        self._connection = connection
        self._numbers = itertools.count(1)
        self._repeated: dict[str, _Repeated] = {}
        self._broken: dict[str, str] = {}
        self._sent_s: dict[str, float] = {}  # by robot: the newest command that was sent
        connection.handlers["drive_result"].append(self._receive_answer)
        connection.handlers["status"].append(self._receive_status)

    @property
    def robots(self) -> tuple[str, ...]:
        """The names of the robots that are driven."""
        return tuple(self._repeated)

    @property
    def robots_of_ended_threads(self) -> tuple[str, ...]:
        """Those of them whose newest `drive` came from a thread that is over."""
        threads = {robot: repeated.thread for robot, repeated in self._repeated.items()}
        return tuple(robot for robot, thread in threads.items() if thread is not None and not thread.is_alive())

    async def drive(
        self, robot: str, linear_m_s: float, angular_rad_s: float, priority: int, *, is_yielding: bool = False
    ) -> Driven:
        """Command, and repeat it from now on; returns when the daemon has accepted it.

        `is_yielding`: a stop of anybody since the command before refuses it, and breaks off what is repeated.

        Raises:
            HostlinkError: it was refused, and nothing is repeated; or what was repeated before was broken off.
        """
        before = self._repeated.get(robot)
        try:
            request = _request(robot, linear_m_s, angular_rad_s, priority)
        except BaseException:  # what was held is not meant any more, and what is meant nobody knows
            self.stop_repeating(robot)
            raise
        if (reason := self._broken.pop(robot, None)) is not None:
            raise HostlinkError(f"{robot} was stopped, drive again if it is still meant: {reason}")
        repeated = self._repeated[robot] = _Repeated(next(self._numbers), request, _now_s(), is_yielding)
        try:
            answer = await self._command(repeated, before)
            driven = _driven(answer)
            repeated.link, repeated.stops, repeated.sent_s = int(answer["link"]), answer.get("stops"), _now_s()
        except KeyError as missing:
            self.stop_repeating(robot)
            raise HostlinkError(f"hostlink is of another version than this one: its answer has no {missing}") from None
        except BaseException as ended:  # a cancellation too: what nobody waits for is not repeated
            if self._repeated.get(robot, repeated) is repeated:  # or it was broken off, which is raised here
                self.stop_repeating(robot)
                if not isinstance(ended, HostlinkError | GeneratorExit):  # it may be on its way, and hold for a lease
                    await self.send_zero(robot, priority)
            raise
        return driven

    async def _command(self, repeated: _Repeated, before: _Repeated | None) -> Message:
        """For the device that was driven before, if one was: else a new one would be driven on without notice."""
        self._sent_s[str(repeated.request["robot"])] = repeated.sent_s
        link, stops = (None, None) if before is None else (before.link, before.stops)
        request = {**repeated.request, "sent_s": repeated.sent_s, "link": link}
        if repeated.is_yielding:
            request["stops"] = stops
        answer = await self._connection.request(request, timeout_s=ANSWER_TIMEOUT_S)
        if not answer["result"]:
            raise HostlinkError(str(answer["reason"]))
        self._remember_name(answer)
        return answer

    async def command(
        self, robot: str, velocity: tuple[float, float], priority: int, *, link: int | None = None
    ) -> None:
        """Send one command, which is not repeated; its answer is not waited for, and is in `refusals` if it is one.

        Raises:
            HostlinkError: the numbers are not finite, or there is no connection.
        """
        self._sent_s[robot] = _now_s()
        request = {"id": f"{_COMMAND}{robot}", "sent_s": self._sent_s[robot], "link": link, "is_stream": True}
        await self._connection.send(_request(robot, *velocity, priority) | request)

    def stop_repeating(self, robot: str) -> None:
        """Repeat it no more; the end of it is known to the caller."""
        self._repeated.pop(robot, None)
        self._broken.pop(robot, None)

    async def send_zero(self, robot: str, priority: int) -> None:
        """Follow the commands that may still be on their way with a zero: a stop goes another way, and overtakes them.

        It is never too late, and not repeated; without a connection nothing is on its way.
        """
        if _now_s() <= self._sent_s.pop(robot, float("-inf")) + LEASE_S:
            with contextlib.suppress(HostlinkError):
                await self._connection.send({**_request(robot, 0.0, 0.0, priority), "id": f"zero:{robot}"})

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
            for robot, repeated in list(self._repeated.items()):
                if repeated.link is not None:
                    await self._repeat(robot, repeated)

    async def _repeat(self, robot: str, repeated: _Repeated) -> None:
        now_s = _now_s()
        if now_s > repeated.sent_s + LEASE_S:
            self._break(robot, f"this program did not run for {now_s - repeated.sent_s:.1f} s")
            return
        repeated.sent_s = self._sent_s[robot] = now_s
        request = {"id": f"repeat:{repeated.number}", "sent_s": now_s, "link": repeated.link}
        if repeated.is_yielding:
            request["stops"] = repeated.stops
        with contextlib.suppress(HostlinkError):  # the connection reports its loss to everybody
            await self._connection.send({**repeated.request, **request})

    def _receive_answer(self, answer: dict[str, Any]) -> None:
        """Of a command that nobody waits for."""
        self._remember_name(answer)
        key = str(answer["id"])
        is_locked = bool(answer.get("is_locked"))
        refusal = None if answer["result"] else Refusal(str(answer["kind"]), str(answer["reason"]), is_locked)
        if key.startswith(_COMMAND):
            self.refusals[key.removeprefix(_COMMAND)] = refusal
        elif refusal is not None:
            for robot, repeated in list(self._repeated.items()):
                if key == f"repeat:{repeated.number}":
                    self._break(robot, refusal.reason)

    def _receive_status(self, status: dict[str, Any]) -> None:
        """A token that may only read gets no other answer."""
        key = str(status.get("id"))
        if key.startswith(_COMMAND):
            self.refusals[key.removeprefix(_COMMAND)] = Refusal("NoRole", str(status["msg"]))

    def _remember_name(self, answer: Message) -> None:
        self.client_name = answer.get("client", self.client_name)  # a refusal has none, an older daemon neither

    def _break(self, robot: str, reason: str) -> None:
        del self._repeated[robot]
        self._broken[robot] = reason


def _request(robot: str, linear_m_s: float, angular_rad_s: float, priority: int) -> dict[str, Any]:
    if not (math.isfinite(linear_m_s) and math.isfinite(angular_rad_s)):
        raise HostlinkError(f"{robot}: a velocity must be made of finite numbers")
    velocity = {"linear": float(linear_m_s), "angular": float(angular_rad_s)}
    return {"op": "drive", "robot": robot, **velocity, "priority": priority}


def _driven(answer: Message) -> Driven:
    velocity = answer["velocity"]
    return Driven(velocity["linear_m_s"], velocity["angular_rad_s"], answer["is_limited"], answer.get("limited_by"))


def _now_s() -> float:
    return time.clock_gettime(_CLOCK)
