"""Incidents over REST: what happened, its file, and the request to save a robot's last minutes."""

import asyncio
import time
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.history import HistoryView, Pauses, encode_history, history_view
from hostlink.api.recordings import send_file
from hostlink.api.replies import reply, reply_encoded
from hostlink.api.rest import decode_body
from hostlink.api.routes import BODY, FILE, Route
from hostlink.errors import RecordingFailed, UnknownTopic
from hostlink.hub.node import Role
from hostlink.messages.catalog import Catalog
from hostlink.recording.black_box import MAX_DETAIL, BlackBox
from hostlink.recording.channel import NS_PER_S
from hostlink.recording.folder import StoredFile
from hostlink.recording.history import RobotHistory
from hostlink.recording.incident import Incident, IncidentFiles, SavedIncident, read_incident
from hostlink.recording.reader import McapReader
from hostlink.recording.ring import Entry
from hostlink.robot.odometry_estimator import OdometryEstimator

NEVER_NS = 2**64


class IncidentRequest(msgspec.Struct, forbid_unknown_fields=True):
    """The body of POST incidents."""

    robot: str
    reason: Annotated[str, msgspec.Meta(max_length=MAX_DETAIL)] = ""


class IncidentView(TypedDict):
    """What happened. `file` is empty while the half minute after it lasts."""

    robot: str
    cause: str
    detail: str
    at: str
    file: str
    bytes: int


class IncidentsView(TypedDict):
    """The newest first; how many could not be saved; where they are on the daemon's computer."""

    incidents: list[IncidentView]
    missed: int
    folder: str


class IncidentHistoryView(IncidentView):
    """What is in its file: ages count back from the incident, so that what came after it has one below zero."""

    history: HistoryView
    damage: list[str]


class IncidentRoutes:
    """The handlers."""

    def __init__(self, black_box: BlackBox, catalog: Catalog, turn: asyncio.Semaphore) -> None:
        """`turn`: one history is made at a time, of a robot or of an incident."""
        self._black_box, self._catalog, self._turn = black_box, catalog, turn
        self._files = IncidentFiles(black_box.folder)

    def routes(self) -> list[Route]:
        """Every path of this file."""
        not_found = HTTPStatus.NOT_FOUND
        return [
            Route("/api/incidents", self._all, "What happened to robots, the newest first", IncidentsView),
            Route(
                "/api/incidents",
                self._save,
                "Save a robot's last minutes, and the half minute to come",
                IncidentView,
                method="POST",
                request=IncidentRequest,
                role=Role.DRIVE,
                fails=(
                    HTTPStatus.BAD_REQUEST,
                    not_found,
                    HTTPStatus.CONFLICT,
                    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                ),
            ),
            Route(
                "/api/incidents/{name}",
                self._file,
                "The MCAP file of an incident",
                None,
                media_type=FILE,
                fails=(not_found,),
            ),
            Route(
                "/api/incidents/{name}/history",
                self._history,
                "Where the robot drove around an incident, its commands, its plots, and what happened",
                IncidentHistoryView,
                fails=(not_found,),
            ),
        ]

    async def _all(self, _: web.Request) -> web.Response:
        box = self._black_box
        pending = [_view(incident) for incident in reversed(box.pending)]
        saved = await asyncio.to_thread(self._files.newest_first)
        views = [*pending, *map(_saved_view, saved)]
        return reply({"incidents": views, "missed": box.missed, "folder": str(box.folder.path)})

    async def _save(self, request: web.Request) -> web.Response:
        body = decode_body(request[BODY], IncidentRequest, '{"robot": a name, "reason": a text}')
        return reply(_view(self._black_box.save(body.robot, body.reason)))

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return send_file(await self._find(request))

    async def _history(self, request: web.Request) -> web.Response:
        path = await self._find(request)
        async with self._turn:
            body = await asyncio.to_thread(stored_history, self._catalog, path)
        if body is None:  # it says nothing of itself, or was removed meanwhile
            raise UnknownTopic("incident", path.name)
        return reply_encoded(body)

    async def _find(self, request: web.Request) -> Path:
        name = request.match_info["name"]
        path = await asyncio.to_thread(self._black_box.folder.find, name)
        if path is None:
            raise UnknownTopic("incident", name)
        return path


def _view(incident: Incident) -> IncidentView:
    at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(incident.stamp_ns // 1_000_000_000))
    return {
        "robot": incident.robot,
        "cause": incident.cause,
        "detail": incident.detail,
        "at": at,
        "file": "",
        "bytes": 0,
    }


def _saved_view(saved: SavedIncident) -> IncidentView:
    return {**_view(saved.incident), "file": saved.file.name, "bytes": saved.file.size_bytes}


def stored_history(catalog: Catalog, path: Path) -> bytes | None:
    """The IncidentHistoryView of a file, as JSON. In a thread. None: it is not an incident's.

    Of the file, the chunks are read that have what is shown, and of that a bounded part is decoded.
    """
    with suppress(RecordingFailed, OSError):
        incident = read_incident(path)
        if incident is None:
            return None
        rest, reader, history = Pauses(), McapReader(path), RobotHistory(incident.robot)
        zero_ns, nearest_ns = incident.stamp_ns, NEVER_NS
        for message in reader.messages(history.is_wanted):
            rest()
            at_s = (message.steady_ns - incident.stamp_ns) / NS_PER_S
            history.add(Entry(message.channel, message.stamp_ns, message.payload, at_s))
            apart_ns = incident.stamp_ns - message.stamp_ns
            if not reader.has_steady_times and abs(apart_ns) < nearest_ns:  # then the clock may have been set before
                zero_ns, nearest_ns = message.steady_ns + apart_ns, abs(apart_ns)
        view = _saved_view(SavedIncident(incident, StoredFile(path.name, reader.size_bytes, 0.0, is_open=False)))
        zero_s = (zero_ns - incident.stamp_ns) / NS_PER_S
        shown = encode_history(history_view(catalog, history, OdometryEstimator(), None, zero_s, rest), rest)
        head = msgspec.json.encode({**view, "damage": reader.damage})
        return b'%s,"history":%s}' % (head[:-1], shown)
    return None
