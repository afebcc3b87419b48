"""Incidents over REST: what happened, its file, and the request to save a robot's last minutes."""

import asyncio
import time
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.history import HistoryView, stored_history_view
from hostlink.api.recordings import send_file
from hostlink.api.replies import reply
from hostlink.api.rest import decode_body
from hostlink.api.routes import FILE, Route
from hostlink.errors import RecordingFailed, UnknownTopic
from hostlink.hub.node import Role
from hostlink.messages.catalog import Catalog
from hostlink.recording.black_box import MAX_DETAIL, BlackBox
from hostlink.recording.disk_budget import StoredFile
from hostlink.recording.incident import Incident
from hostlink.recording.incident_files import IncidentFiles, SavedIncident, read_incident
from hostlink.recording.reader import Reader
from hostlink.recording.ring import Entry


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

    def __init__(self, black_box: BlackBox, catalog: Catalog) -> None:
        self._black_box, self._catalog = black_box, catalog
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
        body = decode_body(await request.read(), IncidentRequest, '{"robot": a name, "reason": a text}')
        return reply(_view(self._black_box.save(body.robot, body.reason)))

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return send_file(await self._find(request))

    async def _history(self, request: web.Request) -> web.Response:
        path = await self._find(request)
        view = await asyncio.to_thread(_stored_view, self._catalog, path)
        if view is None:  # it says nothing of itself, or was removed meanwhile
            raise UnknownTopic("incident", path.name)
        return reply(view)

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


def _stored_view(catalog: Catalog, path: Path) -> IncidentHistoryView | None:
    """In a thread: a whole file is read. None: it is no incident's."""
    with suppress(RecordingFailed, OSError):
        reader = Reader(path)
        incident = read_incident(path)
        if incident is not None:
            entries = [Entry(*message) for message in reader.messages()]
            view = _saved_view(SavedIncident(incident, StoredFile(path.name, path.stat().st_size, 0.0, is_open=False)))
            history = stored_history_view(catalog, incident.robot, entries, stamp_ns=incident.stamp_ns)
            return {**view, "history": history, "damage": reader.damage}
    return None
