"""Velocities, stops and locks between daemons: requests of this daemon to others, and of others to this one."""

import asyncio
import contextlib
import fnmatch
import functools
import itertools
import math
from collections.abc import Awaitable, Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, assert_never

import msgspec
import structlog
from structlog.contextvars import bound_contextvars

from hostlink.components.zenoh.fleet_messages import (
    ANSWER,
    GROUP,
    MAX_BOARD_TOPICS,
    MAX_ROBOTS,
    REQUEST,
    STOP_REQUEST,
    BoardTopic,
    FleetAnswer,
    FleetCommand,
    FleetTransport,
    Lock,
    Release,
    Request,
    RobotMessage,
    Stop,
    StopRequest,
    Unlock,
    is_shareable,
    message_of,
)
from hostlink.components.zenoh.fleet_orders import ANSWER_TIMEOUT_S, FleetOrders, Order
from hostlink.components.zenoh.roster import FleetRoster, Neighbour
from hostlink.components.zenoh.session import ZenohSample
from hostlink.core.host import Command, CommandEndpoint, Host, Participant, ProvidedRobot, RobotHere, RobotProvider
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.core.runtime.logs import of_peer, printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import BadRequest, CommandRefused, DeviceGone, HostlinkError, RefusalKind

MAX_DRIVERS = 64  # of one daemon; over it the driver leaves whose last command is the oldest
IDLE_S = 10.0  # a driver without a command for so long holds no lease
_PUBLISHER = 0  # the number of the one who publishes; drivers begin at 1

MAX_WAITING = 4096  # commands without an answer; the oldest is forgotten


@dataclass(slots=True, eq=False)
class _FleetDriver:
    participant: Participant
    commanded_at_s: float


class FleetDrivers:
    """Drivers at other daemons: each is a participant here, where the gates and their leases are."""

    def __init__(self, host: Host, transport: FleetTransport, roster: FleetRoster) -> None:
        self._host, self._here, self._transport, self._roster = host, host.here, transport, roster
        self._drivers: dict[str, dict[int, _FleetDriver]] = {}  # by daemon, and by their numbers there

    # -- requests -----------------------------------------------------------------------------------------------------

    def receive(self, sample: ZenohSample) -> None:
        """Answer a request to this daemon alone."""
        self._receive(sample, REQUEST)

    def receive_stop(self, sample: ZenohSample) -> None:
        """Answer a request to all daemons. Reading is enough to stop."""
        self._receive(sample, STOP_REQUEST)

    def _receive(self, sample: ZenohSample, decoder: "msgspec.json.Decoder[Any]") -> None:
        neighbour = self._roster.announced(self._transport.keys.sender(sample.key))
        request = None if neighbour is None else self._transport.decode(sample.payload, decoder)
        if neighbour is None or request is None:
            return
        if isinstance(request, Stop | Lock) and request.to and self._transport.me.zid not in request.to:
            return
        with bound_contextvars(**of_peer(f"fleet {neighbour.sender.name}")):
            answered = self._answer(neighbour, request)
        self._transport.put("answer", answered, to=neighbour.sender.zid)

    def publish(self, neighbour: Neighbour, topic: str, payload: bytes) -> None:
        """Publish a message of another daemon's program to a device here.

        Raises:
            HostlinkError: the daemon may not publish, or the message does not fit the device.
        """
        self._check_role(neighbour, topic)
        self._participant(neighbour, _PUBLISHER, "programs").publish(topic, payload)

    # -- whose --------------------------------------------------------------------------------------------------------

    def leave(self, zid: str) -> None:
        """Follow the loss of a daemon: what its drivers drive stops."""
        for driver in self._drivers.pop(zid, {}).values():
            driver.participant.leave()

    def leave_all(self) -> None:
        """Let the drivers of all daemons leave: what they drive stops."""
        for zid in list(self._drivers):
            self.leave(zid)

    def tick(self, now_s: float) -> None:
        """Let drivers leave after IDLE_S without a command."""
        for zid, drivers in list(self._drivers.items()):
            for number, driver in list(drivers.items()):
                if now_s > driver.commanded_at_s + IDLE_S:
                    del drivers[number]
                    driver.participant.leave()
            if not drivers:
                del self._drivers[zid]

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _answer(self, neighbour: Neighbour, request: Request | StopRequest) -> FleetAnswer:
        robot = ""
        try:
            match request:
                case FleetCommand():
                    if not request.wanted.is_zero:
                        self._check_role(neighbour, request.robot)
                    source = functools.partial(self._participant, neighbour, request.owner, request.owner_name)
                    self._here.require(request.robot, driver=None if request.wanted.is_zero else source)
                    robot = request.robot
                    return self._drive(neighbour, request)
                case Release():
                    driver = self._drivers.get(neighbour.sender.zid, {}).pop(request.owner, None)
                    if driver is not None:
                        driver.participant.leave()
                    return FleetAnswer(number=request.number)
                case Unlock():
                    self._check_role(neighbour, request.robot or "every board")
                    self._here.unlock(request.robot, by=str(printable(neighbour.sender.name)))
                    robots = () if request.robot is None else (self._message(request.robot),)
                    return FleetAnswer(number=request.number, robots=robots)
                case Stop() | Lock():
                    return self._stop(neighbour, request)
                case _:
                    assert_never(request)
        except HostlinkError as error:
            self._transport.counts["refused"] += 1
            known = self._here.get(robot)
            return _refusal(request.number, error, None if known is None else known.epoch)

    def _drive(self, neighbour: Neighbour, request: FleetCommand) -> FleetAnswer:
        if neighbour.is_silent:  # it has sent nothing by which its clock is known
            raise DeviceGone(request.robot, "the daemons have just met; try again")
        received_s = loop_time_s() - neighbour.freshness.late_s(request.sent_s, loop_time_s())
        limited = self._here.drive(
            self._participant(neighbour, request.owner, request.owner_name),
            request.robot,
            request.wanted,
            priority=request.priority,
            received_s=received_s,
            epoch=request.epoch,
            take_over=request.take_over,
        )
        known = self._here.get(request.robot)
        epoch = None if known is None else known.epoch
        return FleetAnswer(number=request.number, velocity=limited.twist, epoch=epoch)

    def _message(self, robot: str) -> RobotMessage:
        return message_of(self._here.state(robot))

    def _stop(self, neighbour: Neighbour, request: StopRequest) -> FleetAnswer:
        name, by = request.robot, printable(neighbour.sender.name)
        robots = [robot for robot in self._here.all() if name in (None, robot.name)]
        is_repeated = request.number in neighbour.stops
        if is_repeated:  # its answer was lost; obeying again could end what began since
            return self._stopped(request, robots)
        if robots or name is None:  # a robot that is not here yet is stopped or locked once it is
            neighbour.stops.append(request.number)
            if isinstance(request, Lock):
                self._here.lock(name, f"{request.reason} ({neighbour.sender.name})", by=by)
            else:
                self._here.stop(name, by=by)
        return self._stopped(request, robots)

    def _stopped(self, request: StopRequest, robots: list[RobotHere]) -> FleetAnswer:
        """Return the answer to a stop or a lock that was obeyed."""
        found = self._here.endpoints(request.robot) if robots or request.robot is None else []
        found.sort(key=lambda each: not each.reason)  # those first that could not be sent a zero
        boards = tuple(map(BoardTopic.of, found[:MAX_BOARD_TOPICS]))
        shared = [robot.name for robot in robots if is_shareable(robot.name)][:MAX_ROBOTS]
        return FleetAnswer(number=request.number, robots=tuple(map(self._message, shared)), boards=boards)

    def _check_role(self, neighbour: Neighbour, what: str) -> None:
        name = neighbour.sender.name
        if not any(fnmatch.fnmatchcase(name, pattern) for pattern in self._transport.may_drive):
            raise BadRequest(
                f"{what}: {printable(name)} may only read at {self._transport.me.name} (zenoh.drivers there)"
            )

    def _participant(self, neighbour: Neighbour, number: int, name: str) -> Participant:
        drivers = self._drivers.setdefault(neighbour.sender.zid, {})
        driver = drivers.pop(number, None)
        if driver is None or driver.participant.has_left:
            who = f"{printable(name)} at {printable(neighbour.sender.name)}"
            driver = _FleetDriver(self._host.join(who, group=GROUP), 0.0)
        driver.commanded_at_s = loop_time_s()
        drivers[number] = driver
        if len(drivers) > MAX_DRIVERS:
            self._transport.counts["excess_drivers"] += 1
            drivers.pop(next(iter(drivers))).participant.leave()
        return driver.participant


def _refusal(number: int, error: HostlinkError, epoch: int | None) -> FleetAnswer:
    holder = error.holder if isinstance(error, CommandRefused) else None
    owner = None if holder is None else str(holder)
    return FleetAnswer(number=number, error=error.kind, reason=str(error)[:512], owner=owner, epoch=epoch)


log = structlog.get_logger()

_TEXT = 200


@dataclass(slots=True, eq=False)
class _Command:
    """The newest command of an owner to a robot."""

    number: int
    neighbour: Neighbour
    robot: ProvidedRobot
    owner: Hashable
    sent_at_s: float
    answer: FleetAnswer | None = None
    is_answered: asyncio.Event = field(default_factory=asyncio.Event)

    def result(self) -> PlanarVelocity:
        """The velocity after the limits.

        Raises:
            HostlinkError: why not.
        """
        if self.answer is None:
            raise DeviceGone(self.robot.name, f"{self.neighbour.sender.name} does not answer")
        if self.answer.error:
            raise _error_of(self.robot.name, self.answer)
        return Twist(*(self.answer.velocity or ())).planar


class FleetRequests(RobotProvider):
    """Robots of other daemons. A command is sent to the daemon of the robot, a stop or a lock to all."""

    def __init__(
        self, transport: FleetTransport, roster: FleetRoster, orders: FleetOrders, numbers: "itertools.count[int]"
    ) -> None:
        """`orders` may have some of an earlier run; their `numbers` are not used again."""
        self._transport, self._roster, self._orders, self._numbers = transport, roster, orders, numbers
        self._owner_numbers = itertools.count(1)
        self._owners: dict[Hashable, int] = {}
        self._newest: dict[tuple[Hashable, str], _Command] = {}
        self._waiting: dict[int, _Command] = {}
        self.show: Callable[[Iterable[str]], None] = lambda _: None  # called with the robots whose lock has changed

    # -- RobotProvider ------------------------------------------------------------------------------------------------

    def drive(self, robot: ProvidedRobot, command: Command[PlanarVelocity]) -> None:
        """Send a command. It is as old there as here, and older by its way.

        Raises:
            HostlinkError: the previous command was refused, and its sender does not know it yet.
        """
        neighbour, now_s, owner = self._neighbour(robot), loop_time_s(), command.source
        before = self._newest.pop((owner, robot.name), None)
        if before is not None and not command.velocity.is_zero:
            self._raise_refusal(before, now_s)
        if not command.velocity.is_zero and not neighbour.answers(now_s, ANSWER_TIMEOUT_S):
            raise DeviceGone(robot.name, f"{robot.host} does not answer; its robots stop there by themselves")
        neighbour.unanswered_since_s = min(neighbour.unanswered_since_s, now_s)
        if owner not in self._owners:
            self._owners[owner] = next(self._owner_numbers)
        sent = _Command(next(self._numbers), neighbour, robot, owner, now_s)
        self._newest[owner, robot.name] = self._waiting[sent.number] = sent
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]
        request = FleetCommand(
            number=sent.number,
            sent_s=self._transport.clock_s(command.received_s),
            robot=robot.name,
            owner=self._owners[owner],
            owner_name=printable(str(owner)),
            velocity=command.velocity.twist,
            priority=command.priority,
            epoch=command.epoch,
            take_over=command.take_over,
        )
        self._transport.put("drive", request, to=neighbour.sender.zid)

    def answer(self, robot: ProvidedRobot, owner: Hashable) -> Awaitable[PlanarVelocity]:
        """Return the later answer to the newest command of an owner until now: the velocity after the limits.

        Raises (when it is awaited):
            HostlinkError: it was refused, or not answered.
        """
        return self._answer(robot, owner, self._newest.get((owner, robot.name)))

    async def _answer(self, robot: ProvidedRobot, owner: Hashable, command: _Command | None) -> PlanarVelocity:
        if command is None:
            raise DeviceGone(robot.name, "the command was withdrawn")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(command.sent_at_s + ANSWER_TIMEOUT_S):
                await command.is_answered.wait()
        if self._newest.get((owner, robot.name)) is command and (command.answer is None or command.answer.error):
            del self._newest[owner, robot.name]  # its owner learns of it here
        return command.result()

    def release(self, owner: Hashable) -> None:
        """Release what a source drives at other daemons: it stops."""
        number = self._owners.pop(owner, None)
        if number is None:
            return
        commands = [self._newest.pop(key) for key in list(self._newest) if key[0] == owner]
        for neighbour in {id(each.neighbour): each.neighbour for each in commands}.values():
            request = Release(number=next(self._numbers), owner=number)
            self._transport.put("drive", request, to=neighbour.sender.zid)

    def stop(self, name: str | None) -> None:
        """Stop all robots of this name at all daemons, also at those out of sight; None: every robot."""
        self._send_to_all(Stop(number=next(self._numbers), robot=name), "stop")

    def lock(self, name: str | None, reason: str) -> None:
        """Lock all robots of this name at all daemons, also at those out of sight; None: every robot and board."""
        self._send_to_all(Lock(number=next(self._numbers), robot=name, reason=reason), "lock")
        if name is not None:
            self.show((name,))

    def lock_reason(self, name: str) -> str | None:
        """Return the reason of a lock that a daemon has not obeyed yet, as it will show it."""
        reason = self._orders.lock_reason(name)
        return None if reason is None else f"{reason} ({self._transport.me.name})"

    def unlock(self, robot: ProvidedRobot) -> None:
        """Let it be driven again.

        Raises:
            DeviceGone: the daemon that has it is gone.
        """
        zid = self._neighbour(robot).sender.zid
        request = Unlock(number=next(self._numbers), robot=robot.name)
        self._orders.withdraw_locks(robot.name)
        self._orders.add(request, "unlock", {zid: robot.host}, loop_time_s())
        self._transport.put("drive", request, to=zid)
        self.show((robot.name,))

    def unlock_all(self) -> None:
        """Unlock the boards of each daemon at which they are locked, and its robots that are not known here."""
        self._orders.withdraw_locks(None)
        for neighbour in self._roster.all():
            if neighbour.boards_locked is not None:
                neighbour.boards_locked = None
                zid, name = neighbour.sender.zid, neighbour.sender.name
                request = Unlock(number=next(self._numbers), robot=None)
                self._orders.add(request, "unlock", {zid: name}, loop_time_s())
                self._transport.put("drive", request, to=zid)

    async def settled(self) -> list[CommandEndpoint]:
        """Wait until every daemon has answered the stops, locks and unlocks so far.

        Return the topics of their boards that are not a robot's.

        Raises:
            DeviceGone: one of them has not answered in time, or has refused.
        """
        waited_for = self._orders.fresh()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                for each in waited_for:
                    await each.is_settled.wait()
        for each in waited_for:
            if each.missing and not each.is_overdue:
                each.is_overdue = True
                self._log_unanswered(each)
        for each in waited_for:
            if each.missing or each.refusal:
                hosts = ", ".join(sorted(set(each.missing.values())))
                raise DeviceGone(hosts or each.what, each.refusal or _unanswered(each))
        boards = (board for each in waited_for for board in each.boards)
        return list({(board.host, board.link, board.topic): board for board in boards}.values())

    # -- answers ------------------------------------------------------------------------------------------------------

    def receive(self, sample: ZenohSample) -> FleetAnswer | None:
        """An answer of another daemon; returned if it is one to a stop, a lock or an unlock.

        The robots in it are noted; the caller shows them.
        """
        sender, answer = self._transport.keys.sender(sample.key), self._transport.decode(sample.payload, ANSWER)
        neighbour = self._roster.find(sender)
        if answer is None or neighbour is None:
            return None
        neighbour.unanswered_since_s = math.inf
        command = self._waiting.get(answer.number)
        if command is not None and sender == command.neighbour.sender:
            del self._waiting[answer.number]
            command.answer = answer
            command.robot.note_answer(command.owner, answer.epoch, is_refused=bool(answer.error))
            command.is_answered.set()
            return None
        order = self._orders.receive(neighbour.sender, answer)
        if order is None:
            return None
        if isinstance(order.request, Lock) and order.robot is None and not answer.error:
            neighbour.boards_locked = order.request.reason  # its next state says so, too
        for state in answer.robots:
            if state.name in neighbour.robots:
                neighbour.robots[state.name] = state
        return answer

    def greet(self) -> None:
        """A daemon has appeared: it may have missed stops and locks."""
        self._orders.greet(loop_time_s())

    def tick(self) -> None:
        """Repeat stops and locks without an answer, and forget commands that are too old."""
        now_s = loop_time_s()
        overdue, repeated = self._orders.tick(now_s)
        for each in overdue:
            self._log_unanswered(each)
        for request in repeated:
            self._transport.put("stop", request)
        for number, command in list(self._waiting.items()):
            if now_s < command.sent_at_s + 2 * ANSWER_TIMEOUT_S:
                break
            del self._waiting[number]

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _neighbour(self, robot: ProvidedRobot) -> Neighbour:
        place = self._roster.place(robot.name)
        if place is None or place.neighbour.sender.zid != robot.place:
            raise DeviceGone(robot.name, f"{robot.host} is gone")
        return place.neighbour

    def _raise_refusal(self, before: _Command, now_s: float) -> None:
        """Raise the refusal of the previous command, or that it was not answered within a lease."""
        is_late = before.answer is None and now_s > before.sent_at_s + ANSWER_TIMEOUT_S
        is_refused = before.answer is not None and before.answer.error
        if is_refused or (is_late and now_s < before.sent_at_s + 2 * ANSWER_TIMEOUT_S):
            before.result()

    def _send_to_all(self, request: StopRequest, what: str) -> None:
        self._orders.add(request, what, self._orders.receivers(request), loop_time_s())
        self._transport.put("stop", request)

    def _log_unanswered(self, order: Order) -> None:
        self._transport.counts["unanswered"] += 1
        hosts = [printable(host) for host in order.missing.values()]
        log.warning("fleet.unanswered", what=order.what, hosts=hosts)


def _unanswered(order: Order) -> str:
    text = f"has not answered the {order.what}; what is here has"
    return text if isinstance(order.request, Unlock) else f"{text}. It is in force there when the host is seen again"


def _error_of(robot: str, answer: FleetAnswer) -> HostlinkError:
    """Return the error that the other daemon raised."""
    reason = printable(answer.reason, _TEXT)
    if answer.error in set(RefusalKind):
        return CommandRefused(robot, RefusalKind(answer.error), reason, holder=answer.owner)
    if answer.error == DeviceGone.__name__:
        return DeviceGone(robot, reason.removeprefix(f"{robot}: "))
    return BadRequest(reason)
