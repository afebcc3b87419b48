"""Drive: the operation of a program that drives a robot, beside those of rosbridge."""

from typing import Any

import msgspec

from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.views import velocity_answer
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.message import MAX_PRIORITY, PROGRAM_PRIORITY
from hostlink.hub.participant import Participant
from hostlink.hub.robots import Robots
from hostlink.robot.velocity import Velocity


class DriveRequest(msgspec.Struct):
    """m/s, rad/s counter-clockwise. `link` and `sent_s` are for commands that a program repeats by itself."""

    robot: str
    linear: float
    angular: float
    priority: int = PROGRAM_PRIORITY
    link: int | None = None  # the connection of the device for which it is meant; None: whichever there is
    sent_s: float | None = None  # when, by the client's own clock


class Drive:
    """One client's commands. Each is answered, so that a refusal is known at once and not by the next command."""

    def __init__(self, participant: Participant, robots: Robots, queue: ClientQueue) -> None:
        self._participant, self._robots, self._queue = participant, robots, queue

    def receive(self, request: dict[str, Any]) -> None:
        """Do the operation; whatever comes of it is the answer."""
        answer: dict[str, Any] = {"op": "drive_result", "id": request.get("id")}
        try:
            answer |= {"result": True, **self._command(request)}
        except HostlinkError as error:
            answer |= {"result": False, "kind": type(error).__name__, "reason": str(error)}
        put_json(self._queue, answer)

    def _command(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            wanted = msgspec.convert(request, DriveRequest)
        except msgspec.ValidationError as error:
            raise BadRequest(f"drive: {error}") from error
        if not 0 <= wanted.priority <= MAX_PRIORITY:
            raise BadRequest(f"drive: priority must be a number from 0 to {MAX_PRIORITY}")
        robot = self._robots.find(wanted.robot)
        velocity = Velocity(linear_x_m_s=wanted.linear, angular_z_rad_s=wanted.angular)
        limited = self._participant.drive(
            robot, velocity, priority=wanted.priority, link=wanted.link, sent_s=wanted.sent_s
        )
        link = None if robot.link is None else robot.link.number
        return {"link": link, **velocity_answer(robot, velocity, limited)}
