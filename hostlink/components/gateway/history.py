"""History of a robot over REST: its last minutes, and the minutes around an incident.

Ages are measured back from now, or from the incident.
"""

import asyncio
import heapq
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict, cast

import msgspec
from aiohttp import web

from hostlink.components.gateway.bodies import decode_body
from hostlink.components.gateway.recordings import find_file, needing_recorder, of_recorder, send_file
from hostlink.components.gateway.routes import BODY, FILE, Route, reply, reply_encoded
from hostlink.components.gateway.views import utc_text
from hostlink.components.recorder.black_box import MAX_DETAIL, BlackBox
from hostlink.components.recorder.channel import DEVICE, ROS1, VELOCITY, Channel
from hostlink.components.recorder.folder import StoredFile
from hostlink.components.recorder.history import PastPose, Rest, RobotHistory
from hostlink.components.recorder.incident import Incident, IncidentFiles, SavedIncident, read_incident
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.recordings import Recordings
from hostlink.components.recorder.ring import Entry
from hostlink.core.host import Host, RecordedMotion, Role
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryEstimator
from hostlink.core.robot.readings import READERS
from hostlink.core.robot.state_views import velocity_view
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity, Twist
from hostlink.core.robot.views import PoseView, VelocityView
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadRequest, RecordingFailed, UnknownTopic

WORK_S = 0.0005  # time that the reading thread works before it yields the interpreter for REST_S
REST_S = 0.001
SEND_TIMEOUT_S = 5.0  # without progress in writing the reader is disconnected
READ_S = 10.0  # longest reading of a recording
NEVER_NS = 2**64
PIECE = 100  # items of a list, encoded at once: about 0.1 ms


class PastPoseView(TypedDict):
    """Pose and motion of a robot at an earlier time."""

    age_s: float
    pose: PoseView
    twist: VelocityView


class PastCommandView(TypedDict):
    """Velocity sent to the device at an earlier time."""

    age_s: float
    velocity: VelocityView


class PastMessageView(TypedDict):
    """Message of an earlier time."""

    age_s: float
    msg: dict[str, Any]


class HistoryView(TypedDict):
    """History of one robot, the oldest first. Empty while the black box is off."""

    poses: list[PastPoseView]
    commands: list[PastCommandView]
    plot_data: list[PastMessageView]
    events: list[PastMessageView]


class FleetPoseView(TypedDict):
    """Pose of a robot of the fleet at an earlier time; of the chosen robot also its motion."""

    age_s: float
    pose: PoseView
    twist: NotRequired[VelocityView]


class FleetHistoryView(TypedDict):
    """History of one of several robots. `commands` and `plot_data` are empty except for the chosen robot."""

    name: str
    poses: list[FleetPoseView]
    commands: list[PastCommandView]
    plot_data: list[PastMessageView]
    events: list[PastMessageView]


class HistoriesView(TypedDict):
    """The history of every robot of this daemon."""

    robots: list[FleetHistoryView]


class IncidentRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST incidents."""

    robot: str
    reason: Annotated[str, msgspec.Meta(max_length=MAX_DETAIL)] = ""


class IncidentView(TypedDict):
    """One incident. `file` is empty until the half minute after it has passed."""

    robot: str
    cause: str
    detail: str
    at: str
    file: str
    bytes: int


class IncidentsView(TypedDict):
    """Incidents, the newest first; how many could not be saved; their folder on the daemon's computer."""

    incidents: list[IncidentView]
    missed: int
    folder: str


class IncidentHistoryView(IncidentView):
    """History around an incident. Ages are relative to the incident: those of later messages are negative."""

    history: HistoryView
    damage: list[str]


class RecordingHistoryView(TypedDict):
    """History of one robot in a recording. Ages are relative to `begin`, and negative.

    robots: those of the recording; empty if another program wrote it. damage: what could not be read.
    """

    file: str
    bytes: int
    robot: str
    robots: list[str]
    begin: str
    seconds: float
    history: HistoryView
    damage: list[str]


class Pauses:
    """Yields the interpreter to the event loop at intervals while a thread reads thousands of messages."""

    def __init__(self) -> None:
        self._began_s = time.perf_counter()

    def __call__(self) -> None:
        """Sleep for REST_S after each WORK_S."""
        if time.perf_counter() - self._began_s >= WORK_S:
            time.sleep(REST_S)
            self._began_s = time.perf_counter()


class HistoryRoutes:
    """The routes of histories and of incidents. One history is made at a time."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._incidents: IncidentFiles | None = None  # of the recorder that ran at the last request
        self._turn = asyncio.Semaphore(1)

    def routes(self) -> list[Route]:
        """Return the routes."""
        routes = [
            Route(
                "/api/recordings/{name}/history",
                self._of_recording,
                RecordingHistoryView,
                fails=(HTTPStatus.BAD_REQUEST,),
            ),
            Route("/api/incidents", self._all_incidents, IncidentsView),
            Route(
                "/api/incidents",
                self._save,
                IncidentView,
                method="POST",
                request=IncidentRequest,
                role=Role.DRIVE,
                fails=(HTTPStatus.NOT_FOUND, HTTPStatus.CONFLICT, HTTPStatus.INSUFFICIENT_STORAGE),
            ),
            Route("/api/incidents/{name}", self._file, None, media_type=FILE),
            Route("/api/incidents/{name}/history", self._of_incident, IncidentHistoryView),
        ]
        return [
            *needing_recorder(routes),
            Route("/api/history", self._of_fleet, HistoriesView),
            Route("/api/robots/{name}/history", self._of_robot, HistoryView),
        ]

    @property
    def _black_box(self) -> BlackBox:
        return of_recorder(self._host, BlackBox)

    async def _of_recording(self, request: web.Request) -> web.Response:
        """Path, commands, plots and events of the first robot in a recording, or of `?robot=NAME`.

        Raises:
            UnknownTopic: there is no such recording, or no such robot in it.
            BadRequest: the file cannot be read.
        """
        path = await find_file(of_recorder(self._host, Recordings).folder, request, "recording")
        robot = request.query.get("robot", "")
        try:
            async with self._turn:
                body = await asyncio.to_thread(recording_history, self._host.messages, path, robot)
        except RecordingFailed as error:
            raise BadRequest(str(error).removeprefix(f"{path.parent}/")) from error
        return reply_encoded(body)

    async def _all_incidents(self, _: web.Request) -> web.Response:
        """Incidents of robots, the newest first."""
        box = self._black_box
        if self._incidents is None or self._incidents.folder is not box.folder:
            self._incidents = IncidentFiles(box.folder)
        pending = list(box.pending)
        saved = await asyncio.to_thread(self._incidents.newest_first)
        views = incident_views(pending, saved)
        return reply({"incidents": views, "missed": box.missed, "folder": str(box.folder.path)})

    async def _save(self, request: web.Request) -> web.Response:
        """Save the last minutes of a robot, and the next half minute."""
        body = decode_body(request[BODY], IncidentRequest, '{"robot": a name, "reason": a text}')
        return reply(_incident_view(await self._black_box.save(body.robot, body.reason)))

    async def _file(self, request: web.Request) -> web.StreamResponse:
        """The MCAP file of an incident."""
        return send_file(await find_file(self._black_box.folder, request, "incident"))

    async def _of_incident(self, request: web.Request) -> web.Response:
        """Path, commands, plots and events of the robot around an incident."""
        path = await find_file(self._black_box.folder, request, "incident")
        async with self._turn:
            body = await asyncio.to_thread(stored_history, self._host.messages, path)
        if body is None:  # the file has no description, or was removed meanwhile
            raise UnknownTopic("incident", path.name)
        return reply_encoded(body)

    async def _of_robot(self, request: web.Request) -> web.Response:
        """Path, commands, plots and events of a robot in its last minutes."""
        async with self._turn:
            motion = self._host.find(request.match_info["name"]).recorded_motion()
            if motion is None:  # another daemon has its history
                return reply({"poses": [], "commands": [], "plot_data": [], "events": []})
            body = await asyncio.to_thread(self._body, motion, *self._collect(motion))
        return reply_encoded(body)

    async def _of_fleet(self, request: web.Request) -> web.StreamResponse:
        """Path and events of every robot in its last minutes; `?chosen=NAME`: of this robot also its commands and its
        plots.
        """
        chosen = request.query.get("chosen", "")
        response = web.StreamResponse(headers={"Cache-Control": "no-store", "Content-Type": "application/json"})
        response.enable_compression()
        try:
            await response.prepare(request)
            before = b'{"robots":['
            for robot in self._host.robots_here():  # one after the other: nothing holds the history of the whole fleet
                async with self._turn:
                    motion = robot.recorded_motion()
                    if motion is None:  # it was forgotten meanwhile
                        continue
                    collected = self._collect(motion)
                    body = await asyncio.to_thread(self._body, motion, *collected, is_chosen=robot.name == chosen)
                async with asyncio.timeout(SEND_TIMEOUT_S):
                    await response.write(b'%s{"name":%s,%s' % (before, msgspec.json.encode(robot.name), body[1:]))
                before = b","
            await response.write(b"]}" if before == b"," else before + b"]}")
        except OSError:  # the reader has disconnected, or does not read
            if request.transport is not None:
                request.transport.abort()
        return response

    def _collect(self, motion: RecordedMotion) -> tuple[list[Iterator[Entry]], Pose | None, float]:
        """Copy the messages, the pose and the time in the event loop's thread, so that they belong together."""
        present, box = motion.present, self._host.offered(BlackBox)
        copies = [] if box is None else box.rings.copies(motion.robot)
        return copies, None if present is None else present.pose, loop_time_s()

    def _body(
        self,
        motion: RecordedMotion,
        copies: list[Iterator[Entry]],
        present: Pose | None,
        now_s: float,
        *,
        is_chosen: bool = True,
    ) -> bytes:
        """Read thousands of messages, in a thread. Without `is_chosen`, return only poses and events."""
        rest = Pauses()
        history = RobotHistory(motion.robot, odometry=motion.odometry, commands=motion.commands)
        for entry in heapq.merge(*copies, key=lambda entry: entry.at_s):
            rest()
            history.add(entry)
        estimator = motion.estimator
        if is_chosen:
            return encode_history(history_view(self._host.messages, history, estimator, present, now_s, rest), rest)
        return encode_history(
            {
                "poses": [_place_view(each, now_s) for each in history.poses(estimator, present, rest)],
                "commands": [],
                "plot_data": [],
                "events": _messages(history.events(rest), now_s),
            },
            rest,
        )


def history_view(
    catalog: Catalog,
    history: RobotHistory,
    estimator: OdometryEstimator,
    present: Pose | None,
    now_s: float,
    rest: Rest,
) -> HistoryView:
    """Return the history of one robot. Ages are relative to `now_s`; `RobotHistory.poses` explains the others."""
    twist = catalog.message(TWIST_TYPE)
    assert twist is not None  # noqa: S101 - built in
    commands = history.commands(twist.decode, rest)
    return {
        "poses": [_pose_view(each, now_s) for each in history.poses(estimator, present, rest)],
        "commands": [
            {"age_s": _age(now_s, at_s), "velocity": velocity_view(Twist.from_fields(fields).planar)}
            for at_s, fields in commands
        ],
        "plot_data": _messages(history.plot_data(twist.decode, rest), now_s),
        "events": _messages(history.events(rest), now_s),
    }


def encode_history(view: Mapping[str, object], rest: Rest) -> bytes:
    """Encode as JSON in pieces: the encoder holds the interpreter while it works."""
    fields: list[bytes] = []
    for name, items in view.items():
        pieces = []
        for begin in range(0, len(cast("list[object]", items)), PIECE):
            rest()
            pieces.append(msgspec.json.encode(cast("list[object]", items)[begin : begin + PIECE])[1:-1])
        fields.append(b'"%s":[%s]' % (name.encode(), b",".join(pieces)))
    return b"{%s}" % b",".join(fields)


def _messages(found: list[tuple[float, dict[str, Any]]], now_s: float) -> list[PastMessageView]:
    return [{"age_s": _age(now_s, at_s), "msg": message} for at_s, message in found]


def _age(now_s: float, at_s: float) -> float:
    return round(now_s - at_s, 3)


def _pose_view(past: PastPose, now_s: float) -> PastPoseView:
    twist = velocity_view(PlanarVelocity(*(round(component, 4) for component in past.twist)))
    return {"age_s": _age(now_s, past.at_s), "pose": _rounded_pose(past.pose), "twist": twist}


def _place_view(past: PastPose, now_s: float) -> FleetPoseView:
    return {"age_s": _age(now_s, past.at_s), "pose": _rounded_pose(past.pose)}


def _rounded_pose(pose: Pose) -> PoseView:
    return {"x_m": round(pose.x_m, 6), "y_m": round(pose.y_m, 6), "theta_rad": round(pose.theta_rad, 6)}


def recording_history(catalog: Catalog, path: Path, robot: str, *, read_s: float = READ_S) -> bytes:
    """Return the RecordingHistoryView of a file, as JSON. Runs in a thread, for about `read_s` seconds at most.

    Raises:
        RecordingFailed: the file cannot be read.
        UnknownTopic: the recording does not have this robot.
    """
    reader = McapReader(path)
    channels = reader.read_channels()
    robots = sorted({each.robot for each in channels if each.robot and each.origin in (DEVICE, VELOCITY)})
    if robot and robot not in robots:
        raise UnknownTopic("robot in the recording", robot, robots)
    robot = robot or next(iter(robots), "")
    history = RobotHistory(robot, odometry=None if robots else _any_odometry(channels))
    rest, began_s = Pauses(), time.perf_counter()
    limit: list[str] = []
    first_ns, last_ns, stamp_ns = NEVER_NS, 0, 0
    for message in reader.messages(lambda each: each.robot in ("", robot) and history.is_wanted(each)):
        rest()
        if first_ns == NEVER_NS:
            first_ns, stamp_ns = message.steady_ns, message.stamp_ns
        at_s = (message.steady_ns - first_ns) / NS_PER_S
        if time.perf_counter() > began_s + read_s:
            limit = [f"only the first {at_s:.0f} s are shown; `hostlink plot {path.name}` shows all"]
            break
        last_ns = max(last_ns, message.steady_ns)
        history.add(Entry(message.channel, message.stamp_ns, message.payload, at_s))
    view = history_view(catalog, history, OdometryEstimator(), None, 0.0, rest)
    view["events"] = [each for each in view["events"] if each["msg"].get("robot", "") in ("", robot)]
    head = msgspec.json.encode(
        {
            "file": path.name,
            "bytes": reader.size_bytes,
            "robot": robot,
            "robots": robots,
            "begin": utc_text(stamp_ns),
            "seconds": max(0, last_ns - first_ns) / NS_PER_S,
            "damage": [*reader.damage, *limit],
        }
    )
    return b'%s,"history":%s}' % (head[:-1], encode_history(view, rest))


def _any_odometry(channels: list[Channel]) -> tuple[str, str] | None:
    """Return topic and type of the first odometry in a recording of another program."""
    found = ((each.topic, each.type_name) for each in channels if each.type_name in READERS and each.encoding == ROS1)
    return min(found, default=None)


def _incident_view(incident: Incident) -> IncidentView:
    at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(incident.stamp_ns // NS_PER_S))
    return {
        "robot": incident.robot,
        "cause": incident.cause,
        "detail": incident.detail,
        "at": at,
        "file": "",
        "bytes": 0,
    }


def incident_views(pending: Iterable[Incident], saved: Iterable[SavedIncident]) -> list[IncidentView]:
    """Return the views, the newest first. A pending incident that was saved while the files were read is saved."""
    views = [_saved_view(each) for each in saved]
    known = {(each["robot"], each["cause"], each["at"]) for each in views}
    unsaved = [_incident_view(incident) for incident in reversed(list(pending))]
    return [*(each for each in unsaved if (each["robot"], each["cause"], each["at"]) not in known), *views]


def _saved_view(saved: SavedIncident) -> IncidentView:
    return {**_incident_view(saved.incident), "file": saved.file.name, "bytes": saved.file.size_bytes}


def stored_history(catalog: Catalog, path: Path) -> bytes | None:
    """Return the IncidentHistoryView of a file, as JSON; None if the file is not of an incident. Runs in a thread.

    Only the chunks with the shown topics are read, and a bounded part of them is decoded.
    """
    with suppress(RecordingFailed, OSError):
        incident = read_incident(path)
        if incident is None:
            return None
        rest, reader, history = Pauses(), McapReader(path), RobotHistory(incident.robot)
        for message in reader.messages(history.is_wanted):
            rest()
            at_s = (message.steady_ns - incident.stamp_ns) / NS_PER_S
            history.add(Entry(message.channel, message.stamp_ns, message.payload, at_s))
        view = _saved_view(SavedIncident(incident, StoredFile(path.name, reader.size_bytes, 0.0, is_open=False)))
        shown = encode_history(history_view(catalog, history, OdometryEstimator(), None, 0.0, rest), rest)
        head = msgspec.json.encode({**view, "damage": reader.damage})
        return b'%s,"history":%s}' % (head[:-1], shown)
    return None
