"""Velocities that this client commands: those that one task repeats, and single ones.

What is broken off is never resumed. The program must let go of the robot, as every source of commands, or say that it
resumes.
"""

import asyncio
import contextlib
import itertools
import logging
import math
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hostlink.client.callers import Callers, calling_thread
from hostlink.client.connection import HostConnection, Message
from hostlink.client.http_client import CLOSE_TIMEOUT_S
from hostlink.client.views import Driven, MotionKind, Refusal
from hostlink.core.robot.admission import EARLIER_EPOCH, LEASE_S
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import CommandRefused, HostlinkError, RefusalKind, Refused

REPEAT_INTERVAL_S = 0.1  # a fifth of the lease that a command has
_COMMAND = "command:"
LET_GO = (
    f"this program drives again after stop(), a zero or {LEASE_S:g} s without drive(), or with drive(..., resume=True)"
)

ANSWER_TIMEOUT_S = 1.0
IDLE_TIMEOUT_S = 10.0  # a loop of a program calls more often, and a person notices a robot that does not stop

log = logging.getLogger("hostlink.client")  # Python prints its warnings, if the program has not set up logging


class Broken(NamedTuple):
    """Reason why a velocity is repeated no more."""

    kind: str
    reason: str
    by: str | None = None  # who drives or locked the robot, or what disarmed this program; None: unknown
    holder: str | None = None  # who drives the robot, for `held`


class _Ended(NamedTuple):
    """A velocity that was broken off, until the program lets go of the robot.

    It has let go when it made no call that drives for a lease after it was told: until then it knows nothing of it.
    """

    number: int
    broken: Broken
    told_s: float = math.inf  # the newest call that raised the reason, or the end of the motion that has it as a result

    def has_let_go(self, now_s: float) -> bool:
        return now_s >= self.told_s + LEASE_S


@dataclass(slots=True)
class _Stream:
    """Single commands that make one motion, and the epoch at which the daemon admitted the first one."""

    number: int
    epoch: int | None = None


class _Unlocked(NamedTuple):
    """The epoch of an unlock by this program, and until when the program needs it to drive again."""

    epoch: int
    until_s: float


@dataclass(slots=True)
class Repeated:
    """Velocity that is repeated, and who has called `drive` for it."""

    number: int
    request: Mapping[str, Any]
    sent_s: float
    epoch: int | None = None  # of the robot that accepted it; None: not answered yet
    thread: threading.Thread | None = field(default_factory=calling_thread.get)  # None: the connection's own
    is_kept: bool = False  # after the end of a notebook's cell, and without calls of the program
    is_motion: bool = False  # which ends by itself
    is_zero: bool = False
    task: asyncio.Task[Any] | None = field(default_factory=asyncio.current_task)  # that called `drive`

    def is_of_ended_thread(self) -> bool:
        return self.thread is not None and not self.thread.is_alive()

    def is_of_cell(self, thread: threading.Thread) -> bool:
        """Whether it ends with the notebook's cell that this thread runs."""
        return self.thread is thread and not self.is_kept

    def is_of_ended_task(self) -> bool:
        """Whether it ends with a notebook's cell, because its task has ended."""
        return not self.is_kept and (self.task is None or self.task.done())


class VelocitySender:
    """Velocities that this client commands.

    A repeated command ends by the next `drive` or `stop`; it is broken off by a refusal, by the loss of the connection,
    by a new connection of the robot's device, when this program did not run, or could not send, for longer than a
    command holds, and when the program made no call for `idle_timeout_s`. Then the robot stops.

    | state   | event                                                        | next    | the call                   |
    |---------|--------------------------------------------------------------|---------|----------------------------|
    | driving | the velocity is broken off; `drive` is refused or unanswered | stopped | raises why                 |
    | stopped | `drive` with a velocity                                      | stopped | raises why, sends nothing  |
    | stopped | `drive` of a zero, or with `resume`; `stop`, own `unlock`    | free    | as without an interruption |
    | stopped | a lease without a `drive` after one that raised              | free    |                            |
    | free    | `drive` with a velocity                                      | driving | returns, or raises         |

    A zero that is refused because another source drives breaks nothing off.
    """

    def __init__(self, connection: HostConnection, callers: Callers, *, idle_timeout_s: float = IDLE_TIMEOUT_S) -> None:
        """`callers`: the calls of the program, and the clock."""
        self.refusals: dict[str, Refusal | None] = {}  # by robot: of the newest answered `command`
        self.client_name: str | None = None  # as the daemon's newest answer calls this connection
        self._connection = connection
        self._callers = callers
        self._now_s, self._idle_timeout_s = self._callers.now_s, idle_timeout_s
        self._numbers = itertools.count(1)
        self._repeated: dict[str, Repeated] = {}
        self._ended: dict[str, _Ended] = {}  # by robot: of which the program has not let go since
        self._newest: dict[str, int] = {}  # by robot: number of the newest call that drove or stopped it
        self._newest_of_all = 0  # number of the newest call that stopped all robots
        self._unlocked: dict[str, _Unlocked] = {}  # by robot
        self._streams: dict[str, _Stream] = {}
        self._sent_s: dict[str, float] = {}  # by robot: the newest command that was sent
        self._ran_s = -math.inf  # the newest time at which this program is known to have run
        connection.handlers["drive_result"].append(self._receive_answer)

    @property
    def robots(self) -> tuple[str, ...]:
        """The names of the robots that are driven."""
        return tuple(self._repeated)

    async def drive(
        self,
        robot: str,
        velocity: PlanarVelocity,
        priority: int,
        *,
        is_kept: bool = False,
        number: int | None = None,
        take_over: bool = False,
        resume: bool = False,
    ) -> Driven:
        """Command, and repeat it from now on; returns when the daemon has accepted it.

        `number`: of a motion, from `next_number`; it ends by itself. `take_over`: from another source of the same
        priority; repetitions do not. `resume`: also if the program has not let go since it was interrupted.

        Raises:
            HostlinkError: it was refused, and nothing is repeated; or what was repeated before was broken off, and the
                program has not let go since.
        """
        self._callers.note()
        before, is_motion = self._repeated.get(robot), number is not None
        number = self.next_number() if number is None else number
        self._newest[robot] = number
        try:
            request = _request(robot, velocity, priority)
        except BaseException:  # the earlier velocity is outdated, and the new one is invalid
            self.stop_repeating(robot)
            raise
        if resume and before is None:
            self._ended.pop(robot, None)
            await self._connection.send({**_request(robot, ZERO, priority), "id": f"zero:{robot}"})
        self._check_let_go(robot, velocity)
        repeated = Repeated(
            number, request, self._now_s(), is_kept=is_kept, is_motion=is_motion, is_zero=velocity.is_zero
        )
        self._repeated[robot] = repeated
        was_driving = before is not None and (is_motion or not before.is_zero)  # a motion continues after a zero
        try:
            answer = await self._command(repeated, before if was_driving else None, take_over=take_over)
            driven = _driven(answer)
            self.notice_sleep()  # the lease may have ended before the answer was read
            repeated.epoch, repeated.sent_s = int(answer["epoch"]), self._now_s()
        except KeyError as missing:
            self.stop_repeating(robot)
            raise HostlinkError(f"hostlink is of another version than this one: its answer has no {missing}") from None
        except BaseException as error:  # a cancellation too: an abandoned command is not repeated
            if self._repeated.get(robot, repeated) is repeated:  # or it was broken off, which is raised here
                self.stop_repeating(robot)
                if isinstance(error, HostlinkError):
                    if was_driving or not isinstance(error, CommandRefused | Refused):
                        self._ended[robot] = _Ended(number, _broken_by_error(error), self._now_s())
                elif not isinstance(error, GeneratorExit):  # it may be on its way, and hold for a lease
                    await self.send_zero(robot, priority)
            raise
        return driven

    def _check_let_go(self, robot: str, velocity: PlanarVelocity) -> None:
        """Raise why a velocity was broken off, unless the program has let go since, or does now."""
        ended, now_s = self._ended.pop(robot, None), self._now_s()
        if ended is None or velocity.is_zero or ended.has_let_go(now_s):
            return
        self._ended[robot] = ended._replace(told_s=now_s)
        kind, reason, by, holder = ended.broken
        text = f"{robot} was stopped: {reason}; {LET_GO}"
        if kind in set(RefusalKind):
            raise CommandRefused(robot, RefusalKind(kind), text, holder=holder, by=by)
        raise HostlinkError(text)

    def number_of(self, robot: str) -> int | None:
        """Number of the velocity that is repeated; another call of `drive` gives another one. None: none is."""
        repeated = self._repeated.get(robot)
        return None if repeated is None else repeated.number

    def next_number(self) -> int:
        """Return the number of a call of `drive` that is about to be made."""
        return next(self._numbers)

    def newest(self, robot: str) -> int:
        """Number of the newest call of this program that drove or stopped a robot; 0: none did."""
        return max(self._newest.get(robot, 0), self._newest_of_all)

    def pop_end(self, robot: str, number: int) -> Broken:
        """Return why the velocity of this number is repeated no more. The program is told, and must let go."""
        ended = self._ended.get(robot)
        if ended is None or ended.number != number:  # the notice of a newer velocity is for the newer call
            return Broken(MotionKind.PROGRAM, f"this program stopped {robot} or drove it otherwise")
        self._ended[robot] = ended._replace(told_s=self._now_s())
        return ended.broken

    async def _command(self, repeated: Repeated, before: Repeated | None, *, take_over: bool) -> Message:
        """Command with the epoch of the motion before: what was interrupted since must not go on without notice.

        After an unlock by this program, the epoch is that of the unlock.
        """
        robot = str(repeated.request["robot"])
        self._sent_s[robot] = repeated.sent_s
        unlocked = self._unlocked.pop(robot, None)
        epoch = unlocked.epoch if unlocked is not None and repeated.sent_s < unlocked.until_s else None
        epoch = epoch if before is None else before.epoch
        request = {**repeated.request, "sent_s": repeated.sent_s, "epoch": epoch}
        if take_over:
            request["take_over"] = True
        answer = await self._connection.request(request, timeout_s=ANSWER_TIMEOUT_S)
        if not answer["result"]:
            raise refused(robot, answer)
        self._remember_name(answer)
        return answer

    def note_own_unlock(self, robot: str, answer: Message) -> None:
        """The program has seen the interruption that it ends: when it drives again, it means it.

        After a lease it has let go, and drives without the epoch.
        """
        self._ended.pop(robot, None)
        if (epoch := answer.get("epoch")) is not None:
            self._unlocked[robot] = _Unlocked(int(epoch), self._now_s() + LEASE_S)

    async def command(
        self,
        robot: str,
        velocity: PlanarVelocity,
        priority: int,
        *,
        epoch: int | None = None,
        is_planar: bool = True,
        take_over: bool = False,
    ) -> None:
        """Send one command, which is not repeated; its answer is not waited for, and is in `refusals` if it is one.

        Commands less than a lease apart are one stream, and carry the epoch of its beginning. A command with an epoch
        of its own begins another one.

        Raises:
            HostlinkError: the numbers are not finite, or there is no connection.
        """
        now_s = self._now_s()
        stream = self._streams.get(robot)
        is_over = now_s > self._sent_s.get(robot, -math.inf) + LEASE_S or (velocity.is_zero and is_planar)
        if stream is None or is_over or epoch is not None:
            stream = self._streams[robot] = _Stream(next(self._numbers))
        self._sent_s[robot] = now_s
        epoch = stream.epoch if epoch is None else epoch
        request: dict[str, Any] = {"id": f"{_COMMAND}{stream.number}:{robot}", "sent_s": now_s, "epoch": epoch}
        if not is_planar:
            request["is_planar"] = False
        if take_over:
            request["take_over"] = True
        await self._connection.send(_request(robot, velocity, priority) | request)

    def give_up(self, is_meant: Callable[[Repeated], bool] | None = None) -> tuple[str, ...]:
        """Repeat no more what is meant; None: everything, and end motions that have not commanded yet.

        Notices of velocities that were broken off stay. Returns the names of the robots that were driven so.
        """
        if is_meant is None:
            self._newest_of_all = self.next_number()
        names = tuple(robot for robot, each in self._repeated.items() if is_meant is None or is_meant(each))
        for robot in names:
            self.stop_repeating(robot)
        return names

    def stop_repeating_all(self) -> tuple[str, ...]:
        """Repeat nothing more, and end motions that have not commanded yet; returns the robots that were driven."""
        self._ended.clear()
        return self.give_up()

    def stop_repeating(self, robot: str) -> None:
        """Repeat it no more, and end a motion that has not commanded yet; the caller knows of the end."""
        self._newest[robot] = self.next_number()
        self._repeated.pop(robot, None)
        self._ended.pop(robot, None)

    async def send_zero(self, robot: str, priority: int) -> None:
        """Send a zero after commands that may still be in transit: a stop by REST overtakes them.

        It is never too late, and not repeated; without a connection nothing is on its way.
        """
        if self._now_s() <= self._sent_s.pop(robot, float("-inf")) + LEASE_S:
            with contextlib.suppress(HostlinkError):
                await self._connection.send({**_request(robot, ZERO, priority), "id": f"zero:{robot}"})

    async def let_go(self, robots: Iterable[str], priority: int) -> None:
        """Send zeros, for a second at most; the lease stops what they do not reach."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                for robot in robots:
                    await self.send_zero(robot, priority)

    def break_all(self, reason: str) -> tuple[str, ...]:
        """The connection is lost; returns the robots that were driven."""
        for stream in self._streams.values():
            stream.epoch = EARLIER_EPOCH  # to the daemon the next connection is another source
        driven = self.robots
        for robot in driven:
            self._break(robot, Broken(MotionKind.CONNECTION, reason))
        return driven

    async def repeat(self) -> None:
        """Keep the commands alive, until cancelled."""
        while True:
            await asyncio.sleep(REPEAT_INTERVAL_S)
            self.notice_sleep()
            await self._end_idle()
            for robot, repeated in list(self._repeated.items()):
                if repeated.epoch is not None and self._repeated.get(robot) is repeated:
                    await self._repeat(robot, repeated)
                    self.notice_sleep()  # it may have blocked

    def notice_sleep(self) -> None:
        """Break off what was commanded before this program did not run, or could not send, for longer than a lease."""
        now_s = self._now_s()
        for robot, repeated in list(self._repeated.items()):
            is_answered = repeated.epoch is not None  # or the program may be waiting for a slow answer
            quiet_s = now_s - (repeated.sent_s if is_answered else max(self._ran_s, repeated.sent_s))
            if quiet_s > LEASE_S:
                reason = f"this program did not run, or could not send, for {quiet_s:.1f} s"
                self._break(robot, Broken(MotionKind.ASLEEP, reason))
        self._ran_s = now_s

    async def _end_idle(self) -> None:
        """Break off what a thread or task of the program drives that makes no call: it may hang."""
        for robot, repeated in list(self._repeated.items()):
            if repeated.epoch is None or repeated.is_kept or repeated.is_motion:
                continue
            idle_s = self._now_s() - self._callers.called_s(repeated.thread, repeated.task)
            if idle_s > self._idle_timeout_s and self._repeated.get(robot) is repeated:
                reason = f"the program made no call for {idle_s:.1f} s"
                advice = "drive(..., keep=True) drives on without calls, connect(idle_timeout_s=...) sets the time"
                self._break(robot, Broken(MotionKind.ASLEEP, f"{reason}; {advice}"))
                log.warning("%s stopped: %s; %s", robot, reason, advice)
                zero = {"linear": 0.0, "angular": 0.0, "linear_y": 0.0, "id": f"zero:{robot}", "reason": reason}
                with contextlib.suppress(HostlinkError):  # without a connection the daemon stops it
                    await self._connection.send({**repeated.request, **zero})

    async def _repeat(self, robot: str, repeated: Repeated) -> None:
        now_s = repeated.sent_s = self._sent_s[robot] = self._now_s()
        request = {"id": f"repeat:{repeated.number}", "sent_s": now_s, "epoch": repeated.epoch}
        with contextlib.suppress(HostlinkError):  # the connection reports its loss to everybody
            await self._connection.send({**repeated.request, **request})

    def _receive_answer(self, answer: dict[str, Any]) -> None:
        """Handle the answer to a single command or to a repetition."""
        self._remember_name(answer)
        key = str(answer["id"])
        broken = None if answer["result"] else _broken_by(answer)
        if key.startswith(_COMMAND):
            number, _, robot = key.removeprefix(_COMMAND).partition(":")
            self.refusals[robot] = None if broken is None else Refusal(broken.kind, broken.reason)
            stream = self._streams.get(robot)
            if broken is None and stream is not None and stream.epoch is None and number == str(stream.number):
                stream.epoch = int(answer["epoch"])
        elif broken is not None:
            for robot, repeated in list(self._repeated.items()):
                is_at_rest = repeated.is_zero and not repeated.is_motion
                is_harmless = is_at_rest and broken.kind == RefusalKind.HELD  # nothing was interrupted
                if key == f"repeat:{repeated.number}" and not is_harmless:
                    self._break(robot, broken)

    def _remember_name(self, answer: Message) -> None:
        self.client_name = answer.get("client", self.client_name)  # a refusal has none, an older daemon neither

    def _break(self, robot: str, broken: Broken) -> None:
        self._ended[robot] = _Ended(self._repeated.pop(robot).number, broken)


def refused(robot: str, answer: Message) -> HostlinkError:
    """The error of an answer that refuses a command."""
    kind, reason, by, holder = _broken_by(answer)
    if kind not in set(RefusalKind):
        return Refused(kind, reason)
    return CommandRefused(robot, RefusalKind(kind), reason, holder=holder, by=by)


def _broken_by(answer: Message) -> Broken:
    by = answer.get("by") or answer.get("holder")  # an older daemon sends only the holder, or none of both
    return Broken(str(answer["kind"]), str(answer["reason"]), by, answer.get("holder"))


def _broken_by_error(error: HostlinkError) -> Broken:
    if isinstance(error, CommandRefused):
        return Broken(error.kind, error.reason, error.by, None if error.holder is None else str(error.holder))
    return Broken(MotionKind.CONNECTION, str(error))


def _request(robot: str, velocity: PlanarVelocity, priority: int) -> dict[str, Any]:
    if not velocity.is_finite:
        raise CommandRefused(robot, RefusalKind.NOT_FINITE, f"{robot}: a velocity must be made of finite numbers")
    names = ("linear", "linear_y", "angular")
    numbers = dict(zip(names, map(float, velocity), strict=True))
    return {"op": "drive", "robot": robot, **numbers, "priority": priority}


def _driven(answer: Message) -> Driven:
    velocity = answer["velocity"]
    return Driven(
        velocity["linear_m_s"],
        velocity["angular_rad_s"],
        answer["is_limited"],
        answer.get("limited_by"),
        velocity.get("linear_y_m_s", 0.0),  # an older daemon knows none
    )
