"""Drive: the operation of a program that drives a robot, beside those of rosbridge."""

from collections.abc import Callable, Coroutine
from typing import Any

import msgspec

from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.views import velocity_answer
from hostlink.errors import BadRequest, HostlinkError, RobotHeld
from hostlink.hub.gates import check_stream
from hostlink.hub.message import MAX_PRIORITY, PROGRAM_PRIORITY
from hostlink.hub.participant import Participant
from hostlink.hub.remote_robot import RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.hub.robots import Robots
from hostlink.robot.velocity import Velocity

MAX_ANSWERS = 64  # that one client waits for


class DriveRequest(msgspec.Struct):
    """m/s, rad/s counter-clockwise. All from `link` on is for commands that a program sends by itself."""

    robot: str
    linear: float
    angular: float
    priority: int = PROGRAM_PRIORITY
    link: int | None = None  # the connection of the device for which it is meant; None: whichever there is
    sent_s: float | None = None  # when, by the client's own clock
    stops: int | None = None  # of the robot, as the answer before counted them; None: however often it was stopped
    is_stream: bool = False  # its sender goes on without waiting for answers


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

    def receive(self, request: dict[str, Any]) -> None:
        """Do the operation; whatever comes of it is the answer."""
        try:
            robot, velocity, limited = self._command(request)
        except HostlinkError as error:
            self._refuse(request, error)
            return
        if isinstance(robot, RemoteRobot) and self._waiting < MAX_ANSWERS:
            self._waiting += 1
            self._spawn(self._wait(request, robot, velocity))
        else:
            self._accept(request, robot, velocity, limited)

    async def _wait(self, request: dict[str, Any], robot: RemoteRobot, velocity: Velocity) -> None:
        try:
            self._accept(request, robot, velocity, await self._participant.driven(robot, velocity))
        except HostlinkError as error:
            self._refuse(request, error)
        finally:
            self._waiting -= 1

    def _accept(
        self, request: dict[str, Any], robot: Robot | RemoteRobot, velocity: Velocity, limited: Velocity
    ) -> None:
        link = None if robot.link is None else robot.link.number
        answer = {
            "op": "drive_result",
            "id": request.get("id"),
            "result": True,
            "link": link,
            "stops": robot.gate.stops,
            "client": self._participant.name,
        }
        put_json(self._queue, answer | velocity_answer(robot, velocity, limited))

    def _refuse(self, request: dict[str, Any], error: HostlinkError) -> None:
        answer = {"op": "drive_result", "id": request.get("id"), "result": False}
        is_locked = isinstance(error, RobotHeld) and error.lock_reason is not None
        lock = {"is_locked": True} if is_locked else {}
        put_json(self._queue, answer | {"kind": type(error).__name__, "reason": str(error)} | lock)

    def _command(self, request: dict[str, Any]) -> tuple[Robot | RemoteRobot, Velocity, Velocity]:
        try:
            wanted = msgspec.convert(request, DriveRequest)
        except msgspec.ValidationError as error:
            raise BadRequest(f"drive: {error}") from error
        if not 0 <= wanted.priority <= MAX_PRIORITY:
            raise BadRequest(f"drive: priority must be a number from 0 to {MAX_PRIORITY}")
        robot = self._robots.find(wanted.robot)
        velocity = Velocity(linear_x_m_s=wanted.linear, angular_z_rad_s=wanted.angular)
        if wanted.is_stream:
            check_stream(robot, velocity, self._participant)
        limited = self._participant.drive(
            robot, velocity, priority=wanted.priority, link=wanted.link, sent_s=wanted.sent_s, stops=wanted.stops
        )
        return robot, velocity, limited
