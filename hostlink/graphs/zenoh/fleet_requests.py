"""FleetRequests: what is requested of other daemons: velocities, stops, locks; and their answers."""

import asyncio
import contextlib
import itertools
from collections.abc import Hashable
from dataclasses import dataclass, field

import structlog

from hostlink.errors import (
    BadPayload,
    BadRequest,
    CommandRefused,
    DeviceGone,
    HostlinkError,
    RefusalKind,
)
from hostlink.graphs.zenoh.fleet_messages import (
    Answer,
    Drive,
    Lock,
    Release,
    Request,
    Stop,
    StopRequest,
    Unlock,
    decode,
    encode,
)
from hostlink.graphs.zenoh.fleet_post import Post
from hostlink.graphs.zenoh.roster import Neighbour, Roster
from hostlink.graphs.zenoh.session import Sample
from hostlink.hub.robot import RemoteRobot
from hostlink.logs import printable
from hostlink.robot.velocity import PlanarVelocity, Twist

log = structlog.get_logger()

ANSWER_TIMEOUT_S = 0.5  # as long as a command lasts
MAX_WAITING = 4096  # commands without an answer; the oldest is forgotten
MAX_UNSETTLED = 64  # stops and locks
_TEXT = 200


@dataclass(slots=True, eq=False)
class _Command:
    """The newest command of an owner to a robot."""

    number: int
    neighbour: Neighbour
    robot: RemoteRobot
    sent_at_s: float
    answer: Answer | None = None
    is_answered: asyncio.Event = field(default_factory=asyncio.Event)

    def result(self) -> PlanarVelocity:
        """The velocity after the limits.

        Raises:
            HostlinkError: why not.
        """
        if self.answer is None:
            raise DeviceGone(self.robot.name, f"{self.neighbour.sender.name} does not answer")
        if self.answer.error:
            raise _refusal(self.robot.name, self.answer)
        return Twist(*(self.answer.velocity or ())).planar


@dataclass(slots=True, eq=False)
class _Unsettled:
    """A stop, a lock or an unlock that not everybody has answered."""

    payload: bytes
    key: str
    missing: dict[str, str]  # the names of daemons, by id
    since_s: float
    what: str
    refusal: str = ""
    is_settled: asyncio.Event = field(default_factory=asyncio.Event)


class FleetRequests:
    """Implements RobotHosts. A command goes to the one daemon that has the robot, a stop or a lock to all."""

    def __init__(self, post: Post, roster: Roster) -> None:
        self._post, self._roster = post, roster
        self._numbers = itertools.count(1)
        self._owner_numbers = itertools.count(1)
        self._owners: dict[Hashable, int] = {}
        self._newest: dict[tuple[Hashable, str], _Command] = {}
        self._waiting: dict[int, _Command] = {}
        self._unsettled: dict[int, _Unsettled] = {}

    # -- RobotHosts ---------------------------------------------------------------------------------------------------

    def drive(
        self, robot: RemoteRobot, velocity: PlanarVelocity, *, owner: Hashable, priority: int, epoch: int | None
    ) -> None:
        """Send a command of an owner.

        Raises:
            HostlinkError: why the command before this one was refused, if nobody has learned it yet.
        """
        neighbour, now_s = self._neighbour(robot), _now_s()
        before = self._newest.pop((owner, robot.name), None)
        if before is not None and not velocity.is_zero:
            self._raise_refusal(before, now_s)
        if owner not in self._owners:
            self._owners[owner] = next(self._owner_numbers)
        command = _Command(next(self._numbers), neighbour, robot, now_s)
        self._newest[owner, robot.name] = command
        self._waiting[command.number] = command
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]
        request = Drive(
            number=command.number,
            sent_s=now_s,
            robot=robot.name,
            owner=self._owners[owner],
            owner_name=printable(str(owner)),
            velocity=velocity.twist,
            priority=priority,
            epoch=epoch,
        )
        self._request(neighbour, request)

    async def answer(self, robot: RemoteRobot, owner: Hashable) -> PlanarVelocity:
        """The answer to the newest command of an owner: the velocity after the limits.

        Raises:
            HostlinkError: it was refused, or nobody has answered.
        """
        command = self._newest.get((owner, robot.name))
        if command is None:
            raise DeviceGone(robot.name, "the command was withdrawn")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(command.sent_at_s + ANSWER_TIMEOUT_S):
                await command.is_answered.wait()
        if self._newest.get((owner, robot.name)) is command and (command.answer is None or command.answer.error):
            del self._newest[owner, robot.name]  # its owner learns of it here
        return command.result()

    def release(self, owner: Hashable) -> None:
        """A source of commands is gone: what it drives elsewhere stops."""
        number = self._owners.pop(owner, None)
        if number is None:
            return
        commands = [self._newest.pop(key) for key in list(self._newest) if key[0] == owner]
        for neighbour in {id(each.neighbour): each.neighbour for each in commands}.values():
            self._request(neighbour, Release(number=next(self._numbers), owner=number))

    def stop(self, name: str | None) -> None:
        """Stop whatever has this name, wherever it is; None: every robot."""
        number = next(self._numbers)
        self._send_to_all(number, Stop(number=number, robot=name), name, "stop")

    def lock(self, name: str, reason: str) -> None:
        """Lock whatever has this name, wherever it is."""
        number = next(self._numbers)
        self._send_to_all(number, Lock(number=number, robot=name, reason=reason), name, "lock")

    def unlock(self, robot: RemoteRobot) -> None:
        """Let it be driven again.

        Raises:
            DeviceGone: the daemon that has it is gone.
        """
        neighbour, number = self._neighbour(robot), next(self._numbers)
        payload = encode(Unlock(number=number, robot=robot.name))
        key = self._post.keys.key("drive", self._post.me, to=neighbour.sender.zid)
        self._expect(number, _Unsettled(payload, key, {neighbour.sender.zid: robot.host}, _now_s(), "unlock"))
        self._post.session.put(key, payload, is_urgent=True)

    async def settled(self) -> None:
        """Wait until every daemon has answered the stops, locks and unlocks so far.

        Raises:
            DeviceGone: one of them has not answered in time, or has refused.
        """
        waited_for = list(self._unsettled.items())
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                for _, each in waited_for:
                    await each.is_settled.wait()
        for number, each in waited_for:
            self._unsettled.pop(number, None)
            if each.missing:
                self._log_unanswered(each)
        for _, each in waited_for:
            if each.missing or each.refusal:
                hosts = ", ".join(each.missing.values())
                raise DeviceGone(
                    hosts or each.what, each.refusal or f"has not answered the {each.what}; what is here has"
                )

    # -- what comes back ----------------------------------------------------------------------------------------------

    def receive(self, sample: Sample) -> Answer | None:
        """An answer of another daemon; returned if it is one to a stop, a lock or an unlock."""
        sender = self._post.keys.sender(sample.key, is_addressed=True)
        try:
            answer = decode(sample.payload, Answer)
        except BadPayload:
            self._post.counts["malformed"] += 1
            return None
        command = self._waiting.get(answer.number)
        if command is not None and sender == command.neighbour.sender:
            del self._waiting[answer.number]
            command.answer = answer
            command.robot.note_epoch(answer.epoch, lock_reason=command.robot.admission.lock_reason)
            command.is_answered.set()
            return None
        unsettled = self._unsettled.get(answer.number)
        if unsettled is None or sender is None:
            return None
        if unsettled.missing.pop(sender.zid, None) is not None and answer.error:
            unsettled.refusal = printable(answer.reason, _TEXT)
        if not unsettled.missing:
            unsettled.is_settled.set()
        return answer

    def tick(self) -> None:
        """Repeat what was not answered, and forget what nobody waits for any more."""
        now_s = _now_s()
        for number, each in list(self._unsettled.items()):
            if now_s > each.since_s + 2 * ANSWER_TIMEOUT_S:
                del self._unsettled[number]
                if each.missing:
                    self._log_unanswered(each)
            elif each.missing:
                self._post.session.put(each.key, each.payload, is_urgent=True)
        for number, command in list(self._waiting.items()):
            if now_s < command.sent_at_s + 2 * ANSWER_TIMEOUT_S:
                break
            del self._waiting[number]

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _neighbour(self, robot: RemoteRobot) -> Neighbour:
        place = self._roster.place(robot.name)
        if place is None or place.neighbour.sender.zid != robot.place:
            raise DeviceGone(robot.name, f"{robot.host} is gone")
        return place.neighbour

    def _raise_refusal(self, before: _Command, now_s: float) -> None:
        """What nobody has waited for: the command before was refused, or not answered in a whole lease."""
        is_late = before.answer is None and now_s > before.sent_at_s + ANSWER_TIMEOUT_S
        is_refused = before.answer is not None and before.answer.error
        if is_refused or (is_late and now_s < before.sent_at_s + 2 * ANSWER_TIMEOUT_S):
            before.result()

    def _request(self, neighbour: Neighbour, request: Request) -> None:
        self._post.session.put(
            self._post.keys.key("drive", self._post.me, to=neighbour.sender.zid), encode(request), is_urgent=True
        )

    def _send_to_all(self, number: int, request: StopRequest, name: str | None, what: str) -> None:
        payload, key = encode(request), self._post.keys.key("stop", self._post.me)
        missing = {
            each.sender.zid: each.sender.name
            for each in self._roster.all()
            if any(each.is_connected(robot) for robot in each.robots if name in (None, robot))
        }
        if missing:
            self._expect(number, _Unsettled(payload, key, missing, _now_s(), what))
        self._post.session.put(key, payload, is_urgent=True)

    def _expect(self, number: int, unsettled: _Unsettled) -> None:
        self._unsettled[number] = unsettled
        if len(self._unsettled) > MAX_UNSETTLED:
            del self._unsettled[next(iter(self._unsettled))]

    def _log_unanswered(self, unsettled: _Unsettled) -> None:
        self._post.counts["unanswered"] += 1
        hosts = [printable(host) for host in unsettled.missing.values()]
        log.warning("fleet.unanswered", what=unsettled.what, hosts=hosts)


def _refusal(robot: str, answer: Answer) -> HostlinkError:
    """The error that was raised there."""
    reason = printable(answer.reason, _TEXT)
    if answer.error in set(RefusalKind):
        return CommandRefused(robot, RefusalKind(answer.error), reason, holder=answer.owner)
    if answer.error == DeviceGone.__name__:
        return DeviceGone(robot, reason.removeprefix(f"{robot}: "))
    return BadRequest(reason)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
