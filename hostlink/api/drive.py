"""Drive: the operation of a program that drives a robot, beside those of rosbridge."""

from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import msgspec

from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.request import Request
from hostlink.api.views import velocity_answer
from hostlink.errors import BadRequest, CommandRefused, HostlinkError
from hostlink.hub.message import PROGRAM_PRIORITY
from hostlink.hub.participant import Participant
from hostlink.hub.robot import Robot
from hostlink.hub.robots import Robots
from hostlink.robot.admission import EARLIER_EPOCH
from hostlink.robot.state import MAX_PRIORITY
from hostlink.robot.velocity import PlanarVelocity

MAX_ANSWERS = 64  # that one client waits for


class DriveRequest(msgspec.Struct):
    """m/s, rad/s counter-clockwise; `linear_y`: to the left.

    All from `link` on is for commands that a program sends by itself.
    """

    robot: str
    linear: float
    angular: float
    linear_y: float = 0.0
    priority: int = PROGRAM_PRIORITY
    sent_s: float | None = None  # when, by the client's own clock
    epoch: int | None = None  # of the robot, as the answer before gave it
    stops: int | None = None  # a synonym of `epoch`
    link: int | None = None  # the connection of the device for which it is meant: with another, an earlier epoch


class Drive:
    """One client's commands. Each is answered, so that a refusal is known at once and not by the next command.

    A robot of another daemon answers from there, MAX_ANSWERS of one client at a time; over that what was sent is the
    answer.
    """

    def __init__(
        self,
        participant: Participant,
        robots: Robots,
        queue: ClientQueue,
        *,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
    ) -> None:
        """`spawn` runs what waits for an answer, at most as long as the client is there."""
        self._participant, self._robots, self._queue, self._spawn = participant, robots, queue, spawn
        self._waiting = 0

    def receive(self, request: Request) -> None:
        """Do the operation; whatever comes of it is the answer, also to those in the place of which it is done."""
        try:
            robot, velocity, limited = self._command(request)
        except HostlinkError as error:
            self._refuse(request, error)
            return
        answer = robot.answer(self._participant) if self._waiting < MAX_ANSWERS else None
        if answer is None:
            self._accept(request, robot, velocity, limited)
        else:
            self._waiting += 1
            self._spawn(self._wait(request, robot, velocity, answer))

    async def _wait(
        self, request: Request, robot: Robot, velocity: PlanarVelocity, answer: Awaitable[PlanarVelocity]
    ) -> None:
        try:
            self._accept(request, robot, velocity, await answer)
        except HostlinkError as error:
            self._refuse(request, error)
        finally:
            self._waiting -= 1

    def _accept(self, request: Request, robot: Robot, velocity: PlanarVelocity, limited: PlanarVelocity) -> None:
        link = None if robot.link is None else robot.link.number
        answer = {
            "op": "drive_result",
            "result": True,
            "link": link,
            "epoch": robot.admission.epoch,
            "stops": robot.admission.epoch,
            "client": self._participant.name,
        }
        self._put(request, answer | velocity_answer(robot, velocity, limited))

    def _refuse(self, request: Request, error: HostlinkError) -> None:
        answer = {"op": "drive_result", "result": False, "kind": error.kind, "reason": str(error)}
        if isinstance(error, CommandRefused):
            answer["epoch"] = self._robots.find(error.robot).admission.epoch
        self._put(request, answer)

    def _put(self, request: Request, answer: dict[str, object]) -> None:
        for replaced in request.replaced:
            put_json(self._queue, answer | {"id": replaced.fields.get("id"), "is_replaced": True})
        put_json(self._queue, answer | {"id": request.fields.get("id")})

    def _command(self, request: Request) -> tuple[Robot, PlanarVelocity, PlanarVelocity]:
        try:
            wanted = msgspec.convert(request.fields, DriveRequest)
        except msgspec.ValidationError as error:
            raise BadRequest(f"drive: {error}") from error
        if not 0 <= wanted.priority <= MAX_PRIORITY:
            raise BadRequest(f"drive: priority must be a number from 0 to {MAX_PRIORITY}")
        velocity = PlanarVelocity(wanted.linear, wanted.linear_y, wanted.angular)
        robot = self._robots.find(wanted.robot, driver=None if velocity.is_zero else lambda: self._participant)
        epoch = wanted.stops if wanted.epoch is None else wanted.epoch
        if wanted.link is not None and robot.link is not None:
            is_same = robot.resumed_link <= wanted.link <= robot.link.number
            epoch = epoch if is_same else EARLIER_EPOCH
        limited = self._participant.drive(
            robot, velocity, priority=wanted.priority, received_s=request.came_s, sent_s=wanted.sent_s, epoch=epoch
        )
        return robot, velocity, limited
