"""PageServer: the built page, and a daemon's API with a state that the test gives it.

It serves the events, the WebSocket's answers and the requests that the page sends. The states have the types of the
daemon's own views, and are checked against them.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any

import msgspec
from aiohttp import WSMsgType, web

from hostlink.components.gateway.events import ROLE_HEADER
from hostlink.components.gateway.history import IncidentView
from hostlink.components.gateway.rest import DaemonDiagnosisView, DriveView, ListeningView
from hostlink.core.robot.device_views import LinkView
from hostlink.core.robot.views import CommandEndpointView, RobotView, StoppedRobotView
from tests.support.tcp_server import http_server

BUILT = Path(__file__).parents[2] / "hostlink" / "components" / "gateway" / "web" / "built"
BEAT_S = 0.1
OF_ALL = ("/api/stop", "/api/lock")


@dataclass
class State:
    """State that the daemon would send."""

    robots: list[dict[str, Any]] = field(default_factory=list)
    links: list[dict[str, Any]] = field(default_factory=list)
    clients: list[dict[str, Any]] = field(default_factory=list)
    silent: frozenset[str] = frozenset()  # robots that send nothing
    drives: list[dict[str, Any]] = field(default_factory=list)
    past: list[dict[str, Any]] = field(default_factory=list)  # where each robot drove before the page was opened
    past_events: list[dict[str, Any]] = field(default_factory=list)  # of each robot, before the page was opened
    log: list[dict[str, Any]] = field(default_factory=list)  # lines that each page receives
    topics: list[dict[str, Any]] = field(default_factory=list)  # without the odometry of robot_0
    incidents: list[dict[str, Any]] = field(default_factory=list)  # each with `past` and `past_events`
    role: str = "drive"
    refusal: str = ""  # of every request that changes something
    drive_answer: dict[str, Any] = field(default_factory=dict)  # what else the answer to a command has
    drive_refusal: dict[str, Any] = field(default_factory=dict)  # of every command: kind, reason
    answering: asyncio.Event | None = None  # commands are read and answered once it is set
    is_mute: bool = False  # commands are read, and answered once it is no longer so
    refusal_status: HTTPStatus = HTTPStatus.FORBIDDEN
    is_lost: bool = False  # nothing answers
    late_s: float = 0.0  # how long the events are on their way
    listening: dict[str, Any] = field(
        default_factory=lambda: {
            "tcp": None,
            "udp": None,
            "micro_ros": [],
            "serial": [],
            "simulate": None,
            "address": None,
        }
    )  # where devices connect
    diagnosis: dict[str, Any] = field(default_factory=lambda: {"findings": [], "arrivals": []})
    is_stop_lost: bool = False  # no request that changes something arrives
    standstills: dict[str, dict[str, Any]] = field(default_factory=dict)  # by robot, what differs from standing
    endpoints: list[dict[str, Any]] = field(default_factory=list)  # of boards, after a stop or a lock of all


class PageServer:
    """One daemon that a page believes in."""

    def __init__(self) -> None:
        self.url = ""
        self.requests: list[tuple[str, str]] = []  # method and path, of what changes something
        self.published: list[dict[str, Any]] = []  # what came by WebSocket
        self._state = State()
        self._news = asyncio.Event()
        self._sockets: set[web.WebSocketResponse] = set()
        self._version = self._beat = 0
        self._beats: dict[str, int] = {}  # the last one of each robot
        self._is_ending = False

    def show(self, state: State) -> None:
        """Send this to every page from now on. A page with another role than before connects again.

        Raises:
            msgspec.ValidationError: the daemon would send no such robot, link or drive.
        """
        msgspec.convert(state.robots, list[RobotView])
        msgspec.convert(state.links, list[LinkView])
        msgspec.convert(state.drives, list[DriveView])
        msgspec.convert(state.incidents, list[IncidentView])
        msgspec.convert(state.listening, ListeningView)
        msgspec.convert(state.diagnosis, DaemonDiagnosisView)
        self._state = state
        self._version += 1
        self._wake()

    async def publish(self, topic: str, message: dict[str, Any]) -> None:
        """Send a message to every page, also without a subscription."""
        for socket in tuple(self._sockets):
            await socket.send_json({"op": "publish", "topic": topic, "msg": message})

    def _fresh_robots(self) -> list[dict[str, Any]]:
        """Each with a frame and a pose that are newer than the ones before, unless it is silent."""
        self._beat += 1
        for view in self._state.robots:
            if view["name"] not in self._state.silent:
                self._beats[view["name"]] = self._beat
        return [
            {
                **view,
                "frames": view["link"] and self._beats.get(view["name"], 0),
                "odometry": view["odometry"] and {**view["odometry"], "count": self._beats.get(view["name"], 0)},
            }
            for view in self._state.robots
        ]

    def _wake(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()

    async def _events(self, request: web.Request) -> web.StreamResponse:
        if self._state.is_lost:
            raise web.HTTPServiceUnavailable
        headers = {"Content-Type": "text/event-stream", ROLE_HEADER: self._state.role}
        response = web.StreamResponse(headers=headers)
        await response.prepare(request)
        version, role = 0, self._state.role
        with contextlib.suppress(OSError):
            while not self._is_ending and not self._state.is_lost and role == self._state.role:
                news = self._news
                if version != self._version:
                    version = self._version
                    for name in ("links", "clients"):
                        await _send(response, name, {name: getattr(self._state, name)})
                    for line in self._state.log:
                        await _send(response, "log", line)
                    counts = {"pending": 0, "saved": len(self._state.incidents), "missed": 0}
                    await _send(response, "recordings", {"recordings": [], "changes": 0, "incidents": counts})
                await _send(response, "robots", {"robots": self._fresh_robots()})
                sent_s = asyncio.get_running_loop().time() - self._state.late_s
                await response.write(b": sent %.3f\n\n" % sent_s)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(BEAT_S):
                        await news.wait()
        return response

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if request.headers.get("Upgrade") != "websocket":
            return web.FileResponse(BUILT / "index.html")
        if self._state.is_lost:
            raise web.HTTPServiceUnavailable
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        self._sockets.add(socket)
        late: list[dict[str, Any]] = []
        async for message in socket:
            if message.type is not WSMsgType.TEXT:
                break
            asked = message.json()
            self.published.append(asked)
            if self._state.is_lost:
                break
            if asked["op"] == "drive":
                refusal = self._state.drive_refusal
                answer = {"op": "drive_result", "id": asked["id"], "result": not refusal}
                if self._state.answering is not None:
                    await self._state.answering.wait()
                late.append({**answer, **self._state.drive_answer, **refusal})
            while late and not self._state.is_mute:
                await socket.send_json(late.pop(0))
            if asked["op"] == "call_service":
                answer = {"op": "service_response", "id": asked.get("id"), "service": asked["service"]}
                await socket.send_json({**answer, "values": {"time": {"secs": 0, "nsecs": 0}}, "result": True})
        self._sockets.discard(socket)
        return socket

    async def _change(self, request: web.Request) -> web.Response:
        if self._state.is_lost or self._state.is_stop_lost:
            if request.transport is not None:
                request.transport.abort()
            raise web.HTTPServiceUnavailable
        self.requests.append((request.method, request.path))
        if self._state.refusal:
            error = {"kind": "Forbidden", "reason": self._state.refusal}
            return web.json_response({"error": error}, status=self._state.refusal_status)
        msgspec.convert(self._state.endpoints, list[CommandEndpointView])
        return web.json_response({"endpoints": self._state.endpoints} if request.path in OF_ALL else {})

    async def _standstill(self, request: web.Request) -> web.Response:
        names = [view["name"] for view in self._state.robots if request.match_info.get("name") in (None, view["name"])]
        known = {view["name"]: view for view in self._fresh_robots()}
        stands = {"state": "stopped", "speed_m_s": 0.0, "turn_rad_s": 0.0, "after_s": 0.4, "reason": ""}
        robots = [{**known[name], "standstill": {**stands, **self._state.standstills.get(name, {})}} for name in names]
        msgspec.convert(robots, list[StoppedRobotView])
        return web.json_response(robots[0] if "name" in request.match_info else {"robots": robots})

    async def _history(self, _: web.Request) -> web.Response:
        return web.json_response(self._past())

    async def _histories(self, _: web.Request) -> web.Response:
        return web.json_response({"robots": [{"name": view["name"], **self._past()} for view in self._state.robots]})

    def _past(self) -> dict[str, Any]:
        return {"poses": self._state.past, "plot_data": [], "events": self._state.past_events}

    async def _topics(self, _: web.Request) -> web.Response:
        odometry = topic_view("/robot_0/odometry", "geometry_msgs/Pose2D")
        return web.json_response({"topics": [odometry, *self._state.topics]})

    async def _incidents(self, _: web.Request) -> web.Response:
        return web.json_response({"incidents": self._state.incidents, "missed": 0, "folder": ""})

    async def _incident(self, request: web.Request) -> web.Response:
        found = next(each for each in self._state.incidents if each["file"] == request.match_info["file"])
        return web.json_response({**found, "history": self._past(), "damage": []})

    async def _drives(self, request: web.Request) -> web.Response:
        shown = self._state.drives[: int(request.query["limit"])]
        return web.json_response({"drives": shown, "lost": 0})

    async def _listening(self, _: web.Request) -> web.Response:
        return web.json_response(self._state.listening)

    async def _diagnosis(self, _: web.Request) -> web.Response:
        return web.json_response(self._state.diagnosis)

    async def _end(self, _: web.Application) -> None:
        self._is_ending = True
        self._wake()
        for socket in tuple(self._sockets):
            await socket.close()

    def application(self) -> web.Application:
        """Return the application with all routes."""
        application = web.Application()
        application.router.add_get("/", self._socket)
        application.router.add_static("/web", BUILT / "web")
        application.router.add_get("/api/events", self._events)
        application.router.add_get("/api/history", self._histories)
        application.router.add_get("/api/robots/{name}/history", self._history)
        application.router.add_get("/api/robots/{name}/standstill", self._standstill)
        application.router.add_get("/api/standstill", self._standstill)
        application.router.add_get("/api/drives", self._drives)
        application.router.add_get("/api/incidents", self._incidents)
        application.router.add_get("/api/incidents/{file}/history", self._incident)
        application.router.add_get("/api/recordings", _recordings)
        application.router.add_get("/api/listening", self._listening)
        application.router.add_get("/api/diagnosis", self._diagnosis)
        application.router.add_get("/api/topics", self._topics)
        application.router.add_post("/api/{path:.*}", self._change)
        application.on_shutdown.append(self._end)
        return application


async def _recordings(_: web.Request) -> web.Response:
    return web.json_response({"recordings": [], "files": [], "folder": ""})


def topic_view(name: str, kind: str, **changes: Any) -> dict[str, Any]:
    """Return a topic with one publisher and one subscriber, on which nothing new is published."""
    return {"name": name, "type": kind, "publishers": 1, "subscribers": 1, "messages": 9, **changes}


async def _send(response: web.StreamResponse, name: str, value: object) -> None:
    await response.write(b"event: %b\ndata: %b\n\n" % (name.encode(), msgspec.json.encode(value)))


@contextlib.asynccontextmanager
async def page_server() -> AsyncIterator[PageServer]:
    """Runs for the length of the block."""
    server = PageServer()
    async with http_server(server.application()) as server.url:
        yield server


def robot(name: str, **changes: Any) -> dict[str, Any]:
    """Return the view of a healthy robot that does not move and has no driver."""
    number = int(name.rsplit("_", 1)[-1])
    view: dict[str, Any] = {
        "name": name,
        "host": None,
        "also_at": [],
        "connected": True,
        "link": number + 1,
        "frames": 1,
        "velocity_topic": f"/{name}/velocity_commands",
        "command_type": "geometry_msgs/Twist",
        "feedback": "pose",
        "odometry_topic": f"/{name}/odometry",
        "played": False,
        "holder": None,
        "holder_address": None,
        "priority": None,
        "locked": False,
        "lock_reason": None,
        "epoch": 1,
        "unreachable": None,
        "wheel_separation_m": 0.21,
        "kinematics": "differential",
        "lease_s": 0.5,
        "velocity": {"linear_m_s": 0.0, "linear_y_m_s": 0.0, "angular_rad_s": 0.0},
        "odometry": odometry(number % 8 * 0.35, number // 8 * 0.35, number * 0.7),
        "battery_v": None,
        "battery_percent": None,
        "signal_dbm": -57 - number % 20,
        "device_errors": [],
        "firmware": None,
    }
    return {**view, **changes}


def odometry(x_m: float, y_m: float, theta_rad: float, **changes: Any) -> dict[str, Any]:
    """A pose that is new."""
    view: dict[str, Any] = {
        "pose": {"x_m": x_m, "y_m": y_m, "theta_rad": theta_rad},
        "twist": {"linear_m_s": 0.14, "linear_y_m_s": 0.0, "angular_rad_s": 0.0},
        "is_moving": None,
        "stamp_ns": 0,
        "age_s": 0.05,
        "rate_hz": 10.0,
        "count": 1,
        "restarts": 0,
        "ignored": 0,
    }
    return {**view, **changes}


def link(name: str, **changes: Any) -> dict[str, Any]:
    """The link of a robot, with its topics."""
    number = int(name.rsplit("_", 1)[-1])
    kinds = {"velocity_commands": "geometry_msgs/Twist", "odometry": "geometry_msgs/Pose2D"}
    kinds |= {"plot_data": "geometry_msgs/Twist", "battery": "sensor_msgs/BatteryState"}
    view: dict[str, Any] = {
        "number": number + 1,
        "transport": "tcp",
        "protocol": "rosserial",
        "peer": f"10.0.0.{number + 1}:50000",
        "robot": name,
        "silent_s": 0.01,
        "diagnosis": [],
        "topics": [
            {
                "kind": "publisher",
                "id": 100 + at,
                "name": f"/{name}/{leaf}",
                "own_name": f"/{name}/{leaf}",
                "type": kind,
                "md5": "",
                "buffer_bytes": 512,
            }
            for at, (leaf, kind) in enumerate(kinds.items())
        ],
        "parameters": {},
        **dict.fromkeys(
            [
                "bytes_from_device",
                "bytes_to_device",
                "skipped_bytes",
                "unknown_ids",
                "refused_frames",
                "malformed",
                "excess_topics",
                "negotiations",
                "lost_messages",
                "topic_requests",
                "replaced",
                "frames_from_device",
                "frames_to_device",
            ],
            0,
        ),
        "seconds": 100.0,
        "rejected": {},
        "slowest_wait_s": 0.0,
        "oldest_waiting_s": 0.0,
        "signal_dbm": -57 - number % 20,
        "clock": {"offset_s": 0.0, "drift_ppm": 0.0, "round_trip_s": 0.004, "answer_s": None},
    }
    return {**view, **changes}
