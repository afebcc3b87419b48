"""The REST door: robots, their velocity and odometry, links and topics; for curl and for scripts."""

import asyncio
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Annotated, Any, TypeVar

import msgspec
from aiohttp import web

from hostlink.api.views import link_views, odometry_view, robot_view, topic_views
from hostlink.errors import (
    BadPayload,
    BadRequest,
    ConfigError,
    DeviceBusy,
    DeviceGone,
    FrameTooLarge,
    HostlinkError,
    RobotHeld,
    ServiceTimeout,
    UnknownTopic,
    WrongType,
)
from hostlink.hub.hub import Hub
from hostlink.hub.robots import LOCK_REASON, MAX_PRIORITY, PROGRAM_PRIORITY
from hostlink.robot.velocity import Velocity

Wanted = TypeVar("Wanted")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

STATUS = {
    BadRequest: HTTPStatus.BAD_REQUEST,
    WrongType: HTTPStatus.BAD_REQUEST,
    UnknownTopic: HTTPStatus.NOT_FOUND,
    RobotHeld: HTTPStatus.CONFLICT,
    FrameTooLarge: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    BadPayload: HTTPStatus.BAD_GATEWAY,
    DeviceGone: HTTPStatus.SERVICE_UNAVAILABLE,
    DeviceBusy: HTTPStatus.SERVICE_UNAVAILABLE,
    ServiceTimeout: HTTPStatus.GATEWAY_TIMEOUT,
    ConfigError: HTTPStatus.INTERNAL_SERVER_ERROR,
}


class VelocityRequest(msgspec.Struct, forbid_unknown_fields=True):
    """The body of PUT velocity: m/s and rad/s, counter-clockwise positive."""

    linear: float
    angular: float
    priority: Annotated[int, msgspec.Meta(ge=0, le=MAX_PRIORITY)] = PROGRAM_PRIORITY


class LockRequest(msgspec.Struct, forbid_unknown_fields=True):
    """The body of POST lock, which may be empty: why, for the next who wants to drive."""

    reason: str = LOCK_REASON


class Rest:
    """The handlers; each asks the hub and shows what it says."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    def routes(self) -> list[web.RouteDef]:
        """Every path of the door."""
        robot = "/api/robots/{name}"
        return [
            web.get("/api/robots", self._robots),
            web.get(robot, self._robot),
            web.get(f"{robot}/odometry", self._odometry),
            web.put(f"{robot}/velocity", self._velocity),
            web.post(f"{robot}/stop", self._stop),
            web.post("/api/stop", self._stop_all),
            web.post(f"{robot}/lock", self._lock),
            web.post(f"{robot}/unlock", self._unlock),
            web.post(f"{robot}/odometry/reset", self._reset_odometry),
            web.get("/api/links", self._links),
            web.get("/api/topics", self._topics),
            web.get("/healthz", self._health),
            web.get("/readyz", self._readiness),
        ]

    async def _robots(self, _: web.Request) -> web.Response:
        return reply({"robots": [robot_view(robot) for robot in self._hub.robots.all()]})

    async def _robot(self, request: web.Request) -> web.Response:
        return reply(robot_view(self._hub.robots.find(request.match_info["name"])))

    async def _odometry(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        odometry = odometry_view(robot)
        if odometry is None:
            raise DeviceGone(f"{robot.name}: no odometry came yet")
        return reply(odometry)

    async def _velocity(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        wanted = _read(await request.read(), VelocityRequest, '{"linear": m/s, "angular": rad/s}')
        velocity = Velocity(linear_x_m_s=wanted.linear, angular_z_rad_s=wanted.angular)
        limited = self._hub.robots.command(robot, velocity, owner=f"rest {request.remote}", priority=wanted.priority)
        return reply(
            {
                "velocity": {"linear_m_s": limited.linear_x_m_s, "angular_rad_s": limited.angular_z_rad_s},
                "is_limited": limited != velocity,
                "lease_s": robot.gate.lease_s,
            }
        )

    async def _stop(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        self._hub.robots.stop(robot)
        return reply(robot_view(robot))

    async def _stop_all(self, request: web.Request) -> web.Response:
        for robot in self._hub.robots.all():
            self._hub.robots.stop(robot)
        return await self._robots(request)

    async def _lock(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        wanted = _read(await request.read() or b"{}", LockRequest, '{"reason": a text} or empty')
        self._hub.robots.lock(robot, wanted.reason)
        return reply(robot_view(robot))

    async def _unlock(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        self._hub.robots.unlock(robot)
        return reply(robot_view(robot))

    async def _reset_odometry(self, request: web.Request) -> web.Response:
        robot = self._hub.robots.find(request.match_info["name"])
        if robot.topics.reset is None:
            raise UnknownTopic("reset topic", f"{robot.name}/reset_odometry")
        if robot.link is None:
            raise DeviceGone(robot.name)
        self._hub.publish(robot.topics.reset, {}, source=f"rest {request.remote}")
        return reply({"reset": robot.topics.reset})

    async def _links(self, _: web.Request) -> web.Response:
        return reply({"links": link_views(self._hub), "crashes": self._hub.crashes, "refused": self._hub.refused})

    async def _topics(self, _: web.Request) -> web.Response:
        return reply({"topics": topic_views(self._hub)})

    async def _health(self, _: web.Request) -> web.Response:
        return reply({"status": "alive", "loop_time_s": round(asyncio.get_running_loop().time(), 3)})

    async def _readiness(self, _: web.Request) -> web.Response:
        """Ready: at least one robot is connected, and every one that was seen still is."""
        robots = self._hub.robots.all()
        missing = [robot.name for robot in robots if robot.link is None]
        is_ready = bool(robots) and not missing
        reason = "ready" if is_ready else f"not connected: {', '.join(missing) or 'no robot yet'}"
        return reply({"status": reason}, HTTPStatus.OK if is_ready else HTTPStatus.SERVICE_UNAVAILABLE)


def _read(body: bytes, wanted: type[Wanted], shape: str) -> Wanted:
    try:
        return msgspec.json.decode(body, type=wanted)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadRequest(f"the body must be {shape}: {error}") from error


def reply(body: dict[str, Any], status: HTTPStatus = HTTPStatus.OK) -> web.Response:
    """JSON that nobody may keep: it is a robot's present state."""
    return web.Response(
        body=msgspec.json.encode(body),
        status=status,
        content_type="application/json",
        headers={"Cache-Control": "no-store"},
    )


@web.middleware
async def explain_errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Every error is JSON with a kind and a reason."""
    try:
        return await handler(request)
    except HostlinkError as error:
        return reply({"error": {"kind": type(error).__name__, "reason": str(error)}}, STATUS[type(error)])
    except web.HTTPException as error:
        if error.status < HTTPStatus.BAD_REQUEST:
            raise
        reason = f"{request.method} {request.path}: {error.reason}"
        answer = reply({"error": {"kind": "HTTP", "reason": reason}}, HTTPStatus(error.status))
        if "Allow" in error.headers:
            answer.headers["Allow"] = error.headers["Allow"]
        return answer
