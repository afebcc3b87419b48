"""The REST API: robots, their velocity and odometry, links and topics; for curl and for scripts."""

import contextlib
import dataclasses
import ipaddress
from collections import OrderedDict
from collections.abc import Callable, Container, Iterable, Sequence
from functools import partial
from http import HTTPStatus
from typing import Annotated, Any, TypedDict, TypeVar

import msgspec
from aiohttp import web

from hostlink.components.gateway.access import GRANT, caller_name
from hostlink.components.gateway.bodies import convert_velocity, decode_body, whole_number
from hostlink.components.gateway.clients import Clients, ClientView
from hostlink.components.gateway.recordings import of_recorder
from hostlink.components.gateway.routes import BODY, CAME, Route, error_status, error_view, refusal, reply
from hostlink.components.gateway.settings import GatewaySettings
from hostlink.components.gateway.views import Slices, VelocityAnswer, links_view, utc_text, velocity_answer
from hostlink.components.recorder.drives import Drive, DriveLog
from hostlink.core.config import TcpConfig, UdpConfig
from hostlink.core.host import (
    LOCK_REASON,
    MAX_WAIT_S,
    PROGRAM_PRIORITY,
    WAIT_S,
    CommandEndpoint,
    Host,
    Listening,
    Participant,
    PlanarVelocity,
    RobotHandle,
    Role,
)
from hostlink.core.robot.command_endpoint import command_endpoint_view
from hostlink.core.robot.device_views import ArrivalView, DevicesView, FindingView, LinksView
from hostlink.core.robot.state import MAX_PRIORITY
from hostlink.core.robot.state_views import odometry_view, robot_view, stopped_view
from hostlink.core.robot.views import CommandEndpointView, OdometryView, RobotView, StoppedRobotView, TopicView
from hostlink.core.runtime.listening import own_address, spelled
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadRequest, DeviceGone, HostlinkError, UnknownTopic

MAX_OWNERS = 64  # the number of sources that one robot distinguishes; a driving one sends a request in every lease

SIM = "hostlink sim"
SIM_CONNECTS_TO = ("127.0.0.1", 11411)  # the address that it uses without --connect
LOOPBACK = {4: "127.0.0.1", 6: "::1"}

MAX_DIGITS = 6  # digits of a limit

VELOCITY_BYTES = 1024  # of a body
LOCK_BYTES = 4096

VELOCITY = '{"linear": m/s, "angular": rad/s}'


def _caller(request: web.Request) -> str:
    """Return the name of the participant that a request has, or would have if it drove."""
    return f"program ({caller_name(request)})"


class Owners:
    """Participants of REST requests: one for each token, or for each client address without tokens.

    When there are more than MAX_OWNERS, the one that was silent longest leaves, and what it drives stops.
    """

    def __init__(self, host: Host) -> None:
        self.evicted = 0
        self._host = host
        self._owners: OrderedDict[str, Participant] = OrderedDict()

    def __len__(self) -> int:
        return len(self._owners)

    def end(self, revoked: Container[str]) -> None:
        """Remove participants whose tokens are revoked: what they drive stops. Empty name: those without tokens."""
        for name in list(self._owners):
            if name in revoked or "" in revoked:
                self._owners.pop(name).leave()

    def of(self, name: str, role: Role) -> Participant:
        """Return the participant of this name; create it if there is none."""
        owner = self._owners.pop(name, None)
        if owner is None or owner.has_left:
            owner = self._host.join(f"program ({name})", role=role)
        self._owners[name] = owner
        if len(self._owners) > MAX_OWNERS:
            self._owners.popitem(last=False)[1].leave()
            self.evicted += 1
        return owner


class AddressView(TypedDict):
    """An address. `0.0.0.0` and `::` are all addresses of the computer."""

    host: str
    port: int


class SerialPortView(TypedDict):
    """A serial port that is opened when it exists, and the rates that are tried."""

    port: str
    bauds: list[int]


class ListeningView(TypedDict):
    """Addresses that devices connect to. simulate: command that starts a simulated robot here; null: refused.

    micro_ros: addresses for micro-ROS boards, such as udp://192.168.4.1:8888.
    address: of this computer in its network; null: it is in none.
    """

    tcp: AddressView | None
    udp: AddressView | None
    micro_ros: list[str]
    serial: list[SerialPortView]
    simulate: str | None
    address: str | None


class DaemonDiagnosisView(TypedDict):
    """Findings that belong to no link, as `hostlink doctor` prints them, and arrivals of the last minute."""

    findings: list[FindingView]
    arrivals: list[ArrivalView]


def listening_text(listening: Listening, settings: GatewaySettings) -> str:
    """Describe where devices connect: `listening on TCP 0.0.0.0:11411, /dev/ttyACM0`."""
    addresses = (("TCP", listening.tcp), ("UDP", listening.udp))
    places = [f"{name} {spelled(*address)}" for name, address in addresses if address is not None]
    places += [f"{each} for micro-ROS" for each in listening.micro_ros]
    places += [port.name for port in settings.serial]
    return f"listening on {', '.join(places)}" if places else "listening on no port"


def listening_view(listening: Listening, settings: GatewaySettings, address: str | None = None) -> ListeningView:
    """Return the addresses that devices connect to. `address` is this computer's in its network."""
    return {
        "tcp": _address(listening.tcp),
        "udp": _address(listening.udp),
        "micro_ros": list(listening.micro_ros),
        "serial": [{"port": port.name, "bauds": list(port.bauds)} for port in settings.serial],
        "simulate": _simulate(listening.tcp, settings.tcp) or _simulate(listening.udp, settings.udp, " --udp"),
        "address": address,
    }


def _address(address: tuple[str, int] | None) -> AddressView | None:
    return None if address is None else {"host": address[0], "port": address[1]}


def _simulate(address: tuple[str, int] | None, config: TcpConfig | UdpConfig | None, option: str = "") -> str | None:
    """Return the command; None without a listener, or if a keyless robot of this computer is refused."""
    if address is None or config is None:
        return None
    bound = ipaddress.ip_address(address[0])
    host = LOOPBACK[bound.version] if bound.is_unspecified else str(bound)
    if (config.allow and not _is_in(host, config.allow)) or (config.key_file and not _is_in(host, config.keyless)):
        return None
    if (host, address[1]) == SIM_CONNECTS_TO:
        return SIM + option
    return f"{SIM}{option} --connect {spelled(host, address[1])}"


def _is_in(host: str, networks: Iterable[str]) -> bool:
    """Whether an address of this computer is in one of the networks."""
    return any(ipaddress.ip_address(host) in ipaddress.ip_network(network) for network in networks)


class ReloadView(TypedDict):
    """Settings that changed, settings that need a restart, and new names of robots by their old names."""

    changed: list[str]
    needs_restart: list[str]
    renamed: dict[str, str]


class DriveView(TypedDict):
    """One drive: its driver, its times (UTC), its highest speeds (m/s, rad/s). `end` is empty while it lasts.

    address: of the driver's connection; empty for a part of a daemon, and for a driver at another daemon.
    """

    robot: str
    owner: str
    address: str
    priority: int
    began: str
    ended: str
    seconds: float
    commands: int
    fastest_m_s: float
    fastest_rad_s: float
    end: str


class DrivesView(TypedDict):
    """Drives, the newest first. lost: number of drives that could not be written to the disk."""

    drives: list[DriveView]
    lost: int


def _drive_view(drive: Drive) -> DriveView:
    seconds = max(drive.ended_ns - drive.began_ns, 0) / NS_PER_S if drive.seconds is None else drive.seconds
    return {
        "robot": drive.robot,
        "owner": drive.owner,
        "address": drive.address,
        "priority": drive.priority,
        "began": utc_text(drive.began_ns),
        "ended": utc_text(drive.ended_ns),
        "seconds": round(seconds, 3),
        "commands": drive.commands,
        "fastest_m_s": round(drive.fastest_m_s, 4),
        "fastest_rad_s": round(drive.fastest_rad_s, 4),
        "end": drive.end,
    }


Body = TypeVar("Body", bound=msgspec.Struct)


NOT_FOUND, CONFLICT, UNAVAILABLE = HTTPStatus.NOT_FOUND, HTTPStatus.CONFLICT, HTTPStatus.SERVICE_UNAVAILABLE
TOO_LARGE, BAD_REQUEST = HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.BAD_REQUEST


class VelocityRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of PUT velocity: m/s and rad/s, counter-clockwise positive. linear_y: to the left. One of them is enough.

    The names of the answer are accepted, too: linear_m_s, linear_y_m_s, angular_rad_s.
    """

    linear: float = 0.0
    angular: float = 0.0
    linear_y: float = 0.0
    priority: Annotated[int, msgspec.Meta(ge=0, le=MAX_PRIORITY)] = PROGRAM_PRIORITY
    epoch: int | None = None  # of the robot, from its state or an answer
    take_over: bool = False  # from a source of the same priority that drives


class LockRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST lock, which may be empty. reason: text for the next driver."""

    reason: str = LOCK_REASON


class RobotsView(TypedDict):
    """Every known robot, connected or not, of this daemon and of the other daemons of the fleet."""

    robots: list[RobotView]


class StoppedRobotsView(TypedDict):
    """Every known robot, and what was measured of each after a stop."""

    robots: list[StoppedRobotView]


class StoppedAllView(StoppedRobotsView):
    """After a stop or a lock of all, also every topic that commands a motion and is not a robot's."""

    endpoints: list[CommandEndpointView]


class StoppedBoardView(StoppedRobotView):
    """After a stop or a lock of a robot, also every topic of its board that commands a motion and is not a robot's."""

    endpoints: list[CommandEndpointView]


class ResetAnswer(TypedDict):
    """The topic on which the device received the reset."""

    reset: str


class TopicsView(TypedDict):
    """Every topic."""

    topics: list[TopicView]


class ClientsView(TypedDict):
    """Every client, and how many were refused because there were too many."""

    clients: list[ClientView]
    refused: int


class HealthView(TypedDict):
    """The daemon's event loop runs."""

    status: str
    loop_time_s: float


class ReadinessView(TypedDict):
    """At least one robot is connected, and no known robot of this daemon is disconnected."""

    status: str


class Rest:
    """Handlers of the routes. Each calls the host and returns its result."""

    def __init__(self, host: Host, settings: GatewaySettings, clients: Clients, owners: Owners) -> None:
        self._host, self._settings, self._clients, self._owners = host, settings, clients, owners

    def routes(self) -> list[Route]:
        """Return the routes."""
        robot = "/api/robots/{name}"
        return [
            Route("/api/robots", self._robots, RobotsView),
            Route(robot, self._robot, RobotView),
            Route(f"{robot}/odometry", self._odometry, OdometryView, fails=(UNAVAILABLE,)),
            Route(
                f"{robot}/velocity",
                self._velocity,
                VelocityAnswer,
                method="PUT",
                request=VelocityRequest,
                max_body_bytes=VELOCITY_BYTES,
                check_head=self._find_to_drive,
                role=Role.DRIVE,
                fails=(CONFLICT, UNAVAILABLE),
            ),
            Route(
                f"{robot}/stop",
                self._stop,
                StoppedBoardView,
                method="POST",
                is_limited=False,
                fails=(BAD_REQUEST, TOO_LARGE, UNAVAILABLE),
            ),
            Route(
                "/api/stop",
                self._stop_all,
                StoppedAllView,
                method="POST",
                is_limited=False,
                fails=(BAD_REQUEST, NOT_FOUND, TOO_LARGE, UNAVAILABLE),
            ),
            Route(
                "/api/lock",
                self._lock_all,
                StoppedAllView,
                method="POST",
                request=LockRequest,
                max_body_bytes=LOCK_BYTES,
                is_body_optional=True,
                on_head=self._lock_all_at_once,
                is_limited=False,
                fails=(NOT_FOUND, UNAVAILABLE),
            ),
            Route("/api/unlock", self._unlock_all, RobotsView, method="POST", role=Role.DRIVE, fails=(UNAVAILABLE,)),
            Route(
                f"{robot}/lock",
                self._lock,
                StoppedBoardView,
                method="POST",
                request=LockRequest,
                max_body_bytes=LOCK_BYTES,
                is_body_optional=True,
                on_head=self._lock_at_once,
                is_limited=False,
                fails=(UNAVAILABLE,),
            ),
            Route(f"{robot}/unlock", self._unlock, RobotView, method="POST", role=Role.DRIVE, fails=(UNAVAILABLE,)),
            Route(
                f"{robot}/odometry/reset",
                self._reset_odometry,
                ResetAnswer,
                method="POST",
                role=Role.DRIVE,
                fails=(UNAVAILABLE,),
            ),
            Route(f"{robot}/standstill", self._standstill, StoppedRobotView, fails=(BAD_REQUEST,)),
            Route("/api/standstill", self._standstills, StoppedRobotsView, fails=(BAD_REQUEST,)),
            Route("/api/links", self._links, LinksView),
            Route("/api/devices", self._devices, DevicesView),
            Route("/api/topics", self._topics, TopicsView),
            Route("/api/clients", self._all_clients, ClientsView),
            Route("/api/drives", self._all_drives, DrivesView, fails=(BAD_REQUEST, UNAVAILABLE)),
            Route("/api/listening", self._listening, ListeningView),
            Route("/api/diagnosis", self._diagnosis, DaemonDiagnosisView),
            Route(
                "/api/reload",
                self._reload,
                ReloadView,
                method="POST",
                role=Role.DRIVE,
                fails=(CONFLICT, HTTPStatus.INTERNAL_SERVER_ERROR),
            ),
            Route("/healthz", self._health, HealthView, role=None),
            Route("/readyz", self._readiness, ReadinessView, role=None, fails=(UNAVAILABLE,)),
        ]

    def _find(self, request: web.Request) -> RobotHandle:
        """Return the robot that the path names.

        Raises:
            UnknownTopic: no robot has this name.
        """
        return self._host.find(request.match_info["name"])

    def _find_to_stop(self, request: web.Request) -> RobotHandle:
        """Return the robot that the path names, also one of the settings that was not connected yet. As `_find`."""
        return self._host.find_to_stop(request.match_info["name"])

    def _find_to_drive(self, request: web.Request) -> RobotHandle:
        """Return the robot that the path names, for a request that drives it. Raises as `_find`."""
        return self._host.find(request.match_info["name"], driver=lambda: self._owner(request))

    async def _robots(self, _: web.Request) -> web.Response:
        """Every robot."""
        return reply({"robots": [robot_view(state) for state in self._host.robots()]})

    async def _robot(self, request: web.Request) -> web.Response:
        """One robot."""
        return reply(robot_view(self._find(request).state()))

    async def _odometry(self, request: web.Request) -> web.Response:
        """Pose and twist."""
        robot = self._find(request)
        odometry = robot.odometry()
        if odometry is None:
            raise DeviceGone(robot.name, robot.why_unknown())
        return reply(odometry_view(odometry))

    async def _velocity(self, request: web.Request) -> web.Response:
        """Drive for the length of a lease; repeat the request to keep driving."""
        robot = self._find_to_drive(request)
        fields = decode_body(request[BODY], dict[str, Any], VELOCITY)
        body = convert_velocity(fields, VelocityRequest, f"the body must be {VELOCITY}")
        velocity = PlanarVelocity(body.linear, body.linear_y, body.angular)
        owner = self._owner(request)
        limited = robot.drive(
            owner,
            velocity,
            priority=body.priority,
            received_s=request[CAME],
            epoch=body.epoch,
            take_over=body.take_over,
        )
        limited = await robot.driven(owner, limited)
        return reply(velocity_answer(robot, velocity, limited))

    def _owner(self, request: web.Request) -> Participant:
        owner = self._owners.of(caller_name(request), request[GRANT].role)
        owner.address = request.remote or ""
        return owner

    async def _stop(self, request: web.Request) -> web.Response:
        """Stop the robot, whichever client drives it, with the role read.

        Answers with the measured result after wait_s seconds at most (1.5).
        """
        robot = self._find_to_stop(request)
        return await self._halt(request, partial(robot.stop, by=_caller(request)), robot)

    async def _stop_all(self, request: web.Request) -> web.Response:
        """Stop every robot and board. Answers with the measured result after wait_s seconds at most (1.5).

        The topics that command a motion and are not a robot's are listed, with those that could not be sent a zero. If
        a robot could not be sent one, or a daemon did not answer, the error's answer has all of that, too.
        """
        return await self._halt(request, partial(self._host.stops.stop, by=_caller(request)))

    async def _halt(
        self, request: web.Request, halt: Callable[[], object], robot: RobotHandle | None = None
    ) -> web.Response:
        """Stop or lock the robot, or all, and measure. A failure is answered with what became of all the others."""
        since_s, failure, found = loop_time_s(), None, list[CommandEndpoint]()
        try:
            halt()
        except HostlinkError as error:  # the others have been sent theirs
            failure = error
        try:
            found = await self._host.stops.settled()
        except HostlinkError as error:
            failure = failure or error
        endpoints = [*(robot or self._host.stops).endpoints(), *found]
        return await self._measured(request, since_s, robot, endpoints=endpoints, failure=failure)

    async def _standstill(self, request: web.Request) -> web.Response:
        """Whether odometry says from now on that the robot is stopped; waits wait_s seconds at most (1.5)."""
        return await self._measured(request, loop_time_s(), self._find(request))

    async def _standstills(self, request: web.Request) -> web.Response:
        """Whether odometry says that the robots are stopped."""
        return await self._measured(request, loop_time_s())

    async def _measured(
        self,
        request: web.Request,
        since_s: float,
        robot: RobotHandle | None = None,
        *,
        endpoints: Sequence[CommandEndpoint] | None = None,
        failure: HostlinkError | None = None,
    ) -> web.Response:
        """Measure whether the robot is stopped, or whether all are. Every stop has been sent before this waits."""
        measured = await (robot or self._host.stops).measure(since_s, wait_s=_wait_s(request))
        views = [stopped_view(*each) for each in measured]
        found: dict[str, object] = {"robots": views} if robot is None else {**views[0]}
        if endpoints is not None:
            found["endpoints"] = [command_endpoint_view(each) for each in endpoints]
        if failure is None:
            return reply(found)
        return reply({**error_view(failure), **found}, error_status(failure))

    def _lock_all_at_once(self, request: web.Request) -> None:
        with contextlib.suppress(HostlinkError):  # `_lock_all` answers it
            self._host.stops.lock(by=_caller(request))

    def _lock_at_once(self, request: web.Request) -> None:
        robot = self._find_to_stop(request)
        with contextlib.suppress(HostlinkError):  # `_lock` answers it
            robot.lock(by=_caller(request))

    async def _lock_all(self, request: web.Request) -> web.Response:
        """Emergency stop of every robot and board, until unlock. Answers as stop does.

        What connects later is locked, too.
        """
        stops, by = self._host.stops, _caller(request)
        try:  # an invalid reason locks, too
            body = decode_body(request[BODY] or b"{}", LockRequest, '{"reason": a text} or empty; all are locked')
        except BadRequest:
            stops.lock(by=by)
            raise
        return await self._halt(request, partial(stops.lock, body.reason, by=by))

    async def _unlock_all(self, request: web.Request) -> web.Response:
        """Unlock every robot and board."""
        self._host.stops.unlock(by=_caller(request))
        await self._host.stops.settled()
        return await self._robots(request)

    async def _lock(self, request: web.Request) -> web.Response:
        """Emergency stop: zero velocity at once, commands are refused until unlock. Answers as stop does."""
        robot = self._find_to_stop(request)
        try:  # an invalid reason locks the robot too
            body = decode_body(request[BODY] or b"{}", LockRequest, '{"reason": a text} or empty; the robot is locked')
        except BadRequest:
            robot.lock(by=_caller(request))
            raise
        return await self._halt(request, partial(robot.lock, body.reason, by=_caller(request)), robot)

    async def _unlock(self, request: web.Request) -> web.Response:
        """Unlock the robot."""
        robot = self._find(request)
        robot.unlock(by=_caller(request))
        await self._host.stops.settled()
        return reply(robot_view(robot.state()))

    async def _reset_odometry(self, request: web.Request) -> web.Response:
        """Set the origin of odometry to the present pose."""
        robot = self._find(request)
        reset = robot.state().reset_topic
        if reset is None:
            raise UnknownTopic("reset topic", f"{robot.name}/reset_odometry")
        if robot.link is None:
            raise DeviceGone(robot.name)
        self._owner(request).publish(reset, b"")  # std_msgs/Empty
        return reply({"reset": reset})

    async def _links(self, _: web.Request) -> web.Response:
        """Every live connection of a device."""
        return reply(await links_view(self._host.devices, Slices(self._host.turns())))

    async def _devices(self, _: web.Request) -> web.Response:
        """Whether each connected device is a robot, and why."""
        return reply(self._host.devices.all())

    async def _topics(self, _: web.Request) -> web.Response:
        """Every topic."""
        return reply({"topics": self._host.graph.topic_views()})

    async def _all_clients(self, _: web.Request) -> web.Response:
        """Every client and its backlog."""
        return reply({"clients": self._clients.views(), "refused": self._clients.refused})

    async def _all_drives(self, request: web.Request) -> web.Response:
        """Drives of robots, the newest first; ?robot=NAME: of one robot, ?limit=N: at most N.

        Raises:
            BadRequest: the limit is not a number.
        """
        text = request.query.get("limit")
        limit = None if text is None else whole_number(text, MAX_DIGITS)
        if text is not None and limit is None:
            raise BadRequest("limit must be a number: how many drives")
        log = of_recorder(self._host, DriveLog)
        drives = log.newest_first(robot=request.query.get("robot"), limit=limit)
        return reply({"drives": [_drive_view(drive) for drive in drives], "lost": log.lost})

    async def _listening(self, _: web.Request) -> web.Response:
        """Addresses and serial ports where devices connect."""
        return reply(listening_view(self._host.listening, self._settings, own_address()))

    async def _diagnosis(self, _: web.Request) -> web.Response:
        """Findings that belong to no link, and what came in the last minute and is not a robot."""
        devices = self._host.devices
        findings = devices.findings(listening_text(self._host.listening, self._settings))
        return reply({"findings": findings, "arrivals": devices.arrivals()})

    async def _reload(self, _: web.Request) -> web.Response:
        """Read the configuration again: names and limits of robots, tokens, origins. An error changes nothing."""
        return reply(dataclasses.asdict(await self._host.reload()))

    async def _health(self, _: web.Request) -> web.Response:
        """Whether the daemon runs."""
        return reply({"status": "alive", "loop_time_s": round(loop_time_s(), 3)})

    async def _readiness(self, _: web.Request) -> web.Response:
        """Whether every known robot is connected."""
        robots = self._host.robots_here()
        missing = [robot.name for robot in robots if robot.link is None]
        is_ready = bool(robots) and not missing
        if not is_ready:
            return refusal("NotReady", f"not connected: {', '.join(missing) or 'no robot yet'}", UNAVAILABLE)
        return reply({"status": "ready"})


def _wait_s(request: web.Request) -> float:
    """Return how long the request waits for a measurement. The stop is sent before, also for an invalid value.

    Raises:
        BadRequest: `wait_s` is not a number from 0 to MAX_WAIT_S.
    """
    text = request.query.get("wait_s", str(WAIT_S))
    try:
        wait_s = float(text)
    except ValueError:
        wait_s = -1.0
    if not 0.0 <= wait_s <= MAX_WAIT_S:
        raise BadRequest(f"wait_s must be a number of seconds from 0 to {MAX_WAIT_S:g}, not {text!r}")
    return wait_s
