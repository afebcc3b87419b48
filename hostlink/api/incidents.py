"""Incidents over REST: what happened, its file, and the wish to save a robot's last minutes."""

import asyncio
import time
from http import HTTPStatus
from typing import Annotated, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.recordings import send_file
from hostlink.api.replies import reply
from hostlink.api.rest import decode_body
from hostlink.api.routes import FILE, Route
from hostlink.errors import UnknownTopic
from hostlink.hub.node import Role
from hostlink.recording.black_box import MAX_DETAIL, BlackBox
from hostlink.recording.incident import Incident
from hostlink.recording.incident_files import IncidentFiles, SavedIncident


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


class IncidentRoutes:
    """The handlers."""

    def __init__(self, black_box: BlackBox) -> None:
        self._black_box = black_box
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
        name = request.match_info["name"]
        path = await asyncio.to_thread(self._black_box.folder.find, name)
        if path is None:
            raise UnknownTopic("incident", name)
        return send_file(path)


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
