"""FleetDrivers: the drivers of other daemons. Each is a participant here, where the gates and their leases are."""

import asyncio
import fnmatch
import functools
from dataclasses import dataclass, field
from typing import assert_never

from structlog.contextvars import bound_contextvars

from hostlink.errors import BadPayload, BadRequest, CommandRefused, DeviceGone, HostlinkError
from hostlink.graphs.zenoh.fleet_messages import (
    Answer,
    Drive,
    Lock,
    Release,
    Request,
    StopRequest,
    Unlock,
    decode_request,
    decode_stop,
    encode,
)
from hostlink.graphs.zenoh.fleet_post import GROUP, Post
from hostlink.graphs.zenoh.fleet_states import state_of
from hostlink.graphs.zenoh.roster import Neighbour, Roster
from hostlink.graphs.zenoh.session import Sample
from hostlink.hub.hub import Hub
from hostlink.hub.participant import Participant
from hostlink.hub.robot import LocalRobot
from hostlink.logs import of_peer, printable

MAX_DRIVERS = 64  # of one daemon; over it the one goes that commanded the longest ago
IDLE_S = 10.0  # a driver that has not commanded for so long has nothing to release
_PUBLISHER = 0  # the number of the one who publishes; drivers begin at 1


@dataclass(slots=True, eq=False)
class _Driver:
    participant: Participant
    commanded_at_s: float


@dataclass(slots=True, eq=False)
class _Drivers:
    """Of one daemon, by their numbers there."""

    of: dict[int, _Driver] = field(default_factory=dict)


class FleetDrivers:
    """Answers the requests of other daemons."""

    def __init__(self, hub: Hub, post: Post, roster: Roster) -> None:
        self._hub, self._post, self._roster = hub, post, roster
        self._drivers: dict[str, _Drivers] = {}

    # -- requests -----------------------------------------------------------------------------------------------------

    def receive(self, sample: Sample) -> None:
        """A request to this daemon alone."""
        neighbour = self._neighbour(sample, is_addressed=True)
        if neighbour is None:
            return
        try:
            request = decode_request(sample.payload)
        except BadPayload:
            self._post.counts["malformed"] += 1
            return
        with bound_contextvars(**of_peer(f"fleet {neighbour.sender.name}")):
            answer = self._answer(neighbour, request)
        self._send(neighbour, answer)

    def receive_stop(self, sample: Sample) -> None:
        """A request to all daemons. Whoever may read may stop."""
        neighbour = self._neighbour(sample)
        if neighbour is None:
            return
        try:
            request = decode_stop(sample.payload)
        except BadPayload:
            self._post.counts["malformed"] += 1
            return
        with bound_contextvars(**of_peer(f"fleet {neighbour.sender.name}")):
            answer = self._stop(neighbour, request)
        self._send(neighbour, answer)

    def publish(self, neighbour: Neighbour, topic: str, payload: bytes) -> None:
        """What a program of another daemon publishes to a device here.

        Raises:
            HostlinkError: it may not, or it does not fit the device.
        """
        self._check_role(neighbour, topic)
        self._participant(neighbour, _PUBLISHER, "programs").publish(topic, payload)

    # -- whose --------------------------------------------------------------------------------------------------------

    def leave(self, zid: str) -> None:
        """A daemon is gone, or cannot be reached: what its drivers drive stops."""
        for driver in self._drivers.pop(zid, _Drivers()).of.values():
            driver.participant.leave()

    def leave_all(self) -> None:
        """The fleet ends here."""
        for zid in list(self._drivers):
            self.leave(zid)

    def tick(self, now_s: float) -> None:
        """Let those leave who have long ceased to command."""
        for zid, drivers in list(self._drivers.items()):
            for number, driver in list(drivers.of.items()):
                if now_s > driver.commanded_at_s + IDLE_S:
                    del drivers.of[number]
                    driver.participant.leave()
            if not drivers.of:
                del self._drivers[zid]

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _neighbour(self, sample: Sample, *, is_addressed: bool = False) -> Neighbour | None:
        sender = self._post.keys.sender(sample.key, is_addressed=is_addressed)
        neighbour = None if sender is None else self._roster.find(sender)
        if neighbour is None:
            self._post.counts["unannounced"] += 1
        return neighbour

    def _answer(self, neighbour: Neighbour, request: Request) -> Answer:
        robot = None
        try:
            match request:
                case Drive():
                    source = functools.partial(self._participant, neighbour, request.owner, request.owner_name)
                    robot = self._hub.robots.find_here(request.robot, driver=None if request.wanted.is_zero else source)
                    return self._drive(neighbour, robot, request)
                case Release():
                    driver = self._drivers.get(neighbour.sender.zid, _Drivers()).of.pop(request.owner, None)
                    if driver is not None:
                        driver.participant.leave()
                    return Answer(number=request.number)
                case Unlock():
                    self._check_role(neighbour, request.robot)
                    robot = self._hub.robots.find_here(request.robot)
                    robot.unlock()
                    return Answer(number=request.number, robots=(state_of(robot),))
                case _:
                    assert_never(request)
        except HostlinkError as error:
            self._post.counts["refused"] += 1
            return _refusal(request.number, error, robot)

    def _drive(self, neighbour: Neighbour, robot: LocalRobot, request: Drive) -> Answer:
        velocity = request.wanted
        if not velocity.is_zero:
            self._check_role(neighbour, robot.name)
            if robot.also_at:
                raise DeviceGone(robot.name, f"several robots have this name, also at {', '.join(robot.also_at)}")
        if neighbour.is_silent:  # it has sent nothing by which its clock is known
            raise DeviceGone(robot.name, "the daemons have just met; try again")
        received_s = _now_s() - neighbour.freshness.late_s(request.sent_s, _now_s())
        participant = self._participant(neighbour, request.owner, request.owner_name)
        limited = participant.drive(
            robot, velocity, priority=request.priority, received_s=received_s, epoch=request.epoch
        )
        return Answer(number=request.number, velocity=limited.twist, epoch=robot.admission.epoch)

    def _stop(self, neighbour: Neighbour, request: StopRequest) -> Answer:
        name = request.robot
        robots = [robot for robot in self._hub.robots.here() if name in (None, robot.name)]
        try:
            if name is None:
                self._hub.robots.stop_all_here()
            for robot in robots if name is not None else ():
                if isinstance(request, Lock):
                    robot.lock_here(f"{request.reason} ({neighbour.sender.name})")
                else:
                    robot.stop_here()
        except HostlinkError as error:
            return _refusal(request.number, error)
        return Answer(number=request.number, robots=tuple(map(state_of, robots)))

    def _check_role(self, neighbour: Neighbour, what: str) -> None:
        name = neighbour.sender.name
        if not any(fnmatch.fnmatchcase(name, pattern) for pattern in self._post.may_drive):
            raise BadRequest(f"{what}: {printable(name)} may only read at {self._post.me.name} (zenoh.drivers there)")

    def _participant(self, neighbour: Neighbour, number: int, name: str) -> Participant:
        drivers = self._drivers.setdefault(neighbour.sender.zid, _Drivers()).of
        driver = drivers.pop(number, None)
        if driver is None or driver.participant.has_left:
            who = f"{printable(name)} at {printable(neighbour.sender.name)}"
            driver = _Driver(self._hub.join(who, group=GROUP), 0.0)
        driver.commanded_at_s = _now_s()
        drivers[number] = driver
        if len(drivers) > MAX_DRIVERS:
            self._post.counts["excess_drivers"] += 1
            drivers.pop(next(iter(drivers))).participant.leave()
        return driver.participant

    def _send(self, neighbour: Neighbour, answer: Answer) -> None:
        key = self._post.keys.key("answer", self._post.me, to=neighbour.sender.zid)
        self._post.session.put(key, encode(answer), is_urgent=True)


def _refusal(number: int, error: HostlinkError, robot: LocalRobot | None = None) -> Answer:
    holder = error.holder if isinstance(error, CommandRefused) else None
    owner = None if holder is None else str(holder)
    epoch = None if robot is None else robot.admission.epoch
    return Answer(number=number, error=error.kind, reason=str(error)[:512], owner=owner, epoch=epoch)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
