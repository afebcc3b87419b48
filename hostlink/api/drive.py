"""Drive: the operation by which a program holds the velocity of a robot, beside those of rosbridge."""

import asyncio
from typing import Any

import msgspec

from hostlink.api.client_queue import ClientQueue
from hostlink.api.freshness import Freshness
from hostlink.api.views import velocity_answer
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.robots import MAX_PRIORITY, PROGRAM_PRIORITY, Robots
from hostlink.robot.velocity import Velocity


class DriveRequest(msgspec.Struct):
    """m/s, rad/s counter-clockwise. `link` and `sent_s` are for commands that are repeated without anybody's asking."""

    robot: str
    linear: float
    angular: float
    priority: int = PROGRAM_PRIORITY
    link: int | None = None  # the connection of the device for which it is meant; None: whichever there is
    sent_s: float | None = None  # when, by the client's own clock


class Drive:
    """One client's commands. Each is answered, so that a refusal is known at once and not by the next command.

    What was delayed on the way for longer than a command holds is refused: a network that comes back must not
    deliver a motion that nobody means any more. So is what was meant for a device that has connected again since.
    """

    def __init__(self, client: str, robots: Robots, queue: ClientQueue) -> None:
        self._client, self._robots, self._queue = client, robots, queue
        self._freshness = Freshness()

    def receive(self, request: dict[str, Any]) -> None:
        """Take the operation; whatever comes of it is the answer."""
        answer: dict[str, Any] = {"op": "drive_result", "id": request.get("id")}
        try:
            answer |= {"result": True, **self._command(request)}
        except HostlinkError as error:
            answer |= {"result": False, "kind": type(error).__name__, "reason": str(error)}
        self._queue.put_result(msgspec.json.encode(answer))

    def _command(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            wanted = msgspec.convert(request, DriveRequest)
        except msgspec.ValidationError as error:
            raise BadRequest(f"drive: {error}") from error
        if not 0 <= wanted.priority <= MAX_PRIORITY:
            raise BadRequest(f"drive: priority must be a number from 0 to {MAX_PRIORITY}")
        robot = self._robots.find(wanted.robot)
        if wanted.sent_s is not None:
            late_s = self._freshness.late_s(wanted.sent_s, asyncio.get_running_loop().time())
            if late_s > robot.gate.lease_s:
                raise BadRequest(f"{robot.name}: the command was {late_s:.1f} s on its way, longer than it holds")
        if wanted.link is not None and robot.link is not None and robot.link.number != wanted.link:
            raise BadRequest(f"{robot.name}: its device has connected again since; drive again if it is still meant")
        velocity = Velocity(linear_x_m_s=wanted.linear, angular_z_rad_s=wanted.angular)
        limited = self._robots.command(robot, velocity, owner=self._client, priority=wanted.priority)
        link = None if robot.link is None else robot.link.number
        return {"link": link, **velocity_answer(robot, velocity, limited)}
