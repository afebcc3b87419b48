"""Recordings over REST: start, stop, list, download and remove them."""

import asyncio
import dataclasses
import time
from collections.abc import AsyncIterator, Iterable
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, NotRequired, TypedDict, TypeVar

import msgspec
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from hostlink.components.gateway.access import caller_name
from hostlink.components.gateway.bodies import decode_body
from hostlink.components.gateway.routes import BODY, FILE, Route, reply
from hostlink.components.recorder.folder import NAME_PATTERN, Folder, StoredFile
from hostlink.components.recorder.recorder import TopicSelection
from hostlink.components.recorder.recordings import Recording, Recordings
from hostlink.core.host import Host, Role
from hostlink.errors import BadRequest, ComponentGone, UnknownTopic

MAX_PATTERNS = 256  # topics and robots in one request
MAX_LISTED = 1000  # files; the newest are listed
UPLOAD_S, SLOWEST_BYTES_S = 30.0, 50_000  # longest time of an upload: this, and its size at this rate
PIECE_S = 10.0  # longest pause of an upload
Service = TypeVar("Service")
_BUSY, _FULL = HTTPStatus.CONFLICT, HTTPStatus.INSUFFICIENT_STORAGE


Patterns = Annotated[list[str], msgspec.Meta(max_length=MAX_PATTERNS)]


class RecordingRequest(msgspec.Struct, forbid_unknown_fields=True):
    """Body of POST recordings, which may be empty: all topics of all robots."""

    topics: Patterns = []
    robots: Patterns = []
    name: Annotated[str, msgspec.Meta(pattern=f"{NAME_PATTERN}|^$")] = ""


class RecordingView(TypedDict):
    """A recording that is running or was just stopped. `removed`: files that another program removed meanwhile."""

    name: str
    owner: str
    topics: list[str]
    seconds: float
    messages: int
    dropped: int
    bytes: int
    files: list[str]
    removed: NotRequired[list[str]]
    failure: NotRequired[str]


class StoredView(TypedDict):
    """A file in the folder of recordings."""

    file: str
    bytes: int
    modified: str
    is_open: bool


class RecordingsView(TypedDict):
    """Running recordings and the newest files; their folder on the daemon's computer."""

    recordings: list[RecordingView]
    files: list[StoredView]
    folder: str


class RemovedView(TypedDict):
    """The removed file."""

    removed: str


def of_recorder(host: Host, kind: type[Service]) -> Service:
    """Return what the recorder offers of this type: `Recordings`, `BlackBox` or `DriveLog`.

    Raises:
        ComponentGone: it does not run.
    """
    found = host.offered(kind)
    if found is None:
        raise ComponentGone("recorder")
    return found


def needing_recorder(routes: Iterable[Route]) -> list[Route]:
    """Return the routes with the status of an answer without a recorder."""
    return [dataclasses.replace(route, fails=(*route.fails, HTTPStatus.SERVICE_UNAVAILABLE)) for route in routes]


class RecordingRoutes:
    """The routes of recordings."""

    def __init__(self, host: Host) -> None:
        self._host = host

    @property
    def _recordings(self) -> Recordings:
        return of_recorder(self._host, Recordings)

    def routes(self) -> list[Route]:
        """Return the routes."""
        path = "/api/recordings"
        one = f"{path}/{{name}}"
        routes = [
            Route(path, self._all, RecordingsView),
            Route(
                path,
                self._start,
                RecordingView,
                method="POST",
                request=RecordingRequest,
                is_body_optional=True,
                role=Role.DRIVE,
                fails=(HTTPStatus.NOT_FOUND, _BUSY, _FULL),
            ),
            Route(one, self._file, None, media_type=FILE),
            Route(
                one,
                self._store,
                StoredView,
                method="PUT",
                is_upload=True,
                role=Role.DRIVE,
                fails=(
                    HTTPStatus.BAD_REQUEST,
                    HTTPStatus.REQUEST_TIMEOUT,
                    _BUSY,
                    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                    _FULL,
                ),
            ),
            Route(f"{one}/stop", self._stop, RecordingView, method="POST", role=Role.DRIVE),
            Route(one, self._remove, RemovedView, method="DELETE", role=Role.DRIVE, fails=(_BUSY,)),
        ]
        return needing_recorder(routes)

    async def _all(self, _: web.Request) -> web.Response:
        """Running recordings, and the files."""
        recordings = self._recordings
        folder = recordings.folder
        files = await asyncio.to_thread(folder.files, recordings.open_files())
        return reply(
            {
                "recordings": [recording_view(each) for each in recordings.under_way()],
                "files": [_stored_view(file) for file in files[-MAX_LISTED:][::-1]],
                "folder": str(folder.path),
            }
        )

    async def _start(self, request: web.Request) -> web.Response:
        """Record topics, events, log and parameters into an MCAP file."""
        shape = '{"topics": [names or patterns], "robots": [names], "name": letters, digits and . _ + -}, or empty'
        body = decode_body(request[BODY] or b"{}", RecordingRequest, shape)
        recordings = self._recordings
        for robot in body.robots:
            recordings.check_robot(robot)
        selection = TopicSelection(tuple(body.topics), tuple(body.robots))
        recording = await recordings.start(selection, name=body.name, owner=caller_name(request))
        return reply(recording_view(recording))

    async def _stop(self, request: web.Request) -> web.Response:
        """Stop a recording and complete its file."""
        return reply(recording_view(await self._recordings.stop(request.match_info["name"])))

    async def _file(self, request: web.Request) -> web.StreamResponse:
        """The MCAP file of that name, or ranges of it, also while it is written."""
        return send_file(await find_file(self._recordings.folder, request, "recording"))

    async def _store(self, request: web.Request) -> web.Response:
        """Store an MCAP file as a recording of that name, at most recording.max_file_mb large, one at a time."""
        recordings = self._recordings
        size_bytes, most_bytes = request.content_length, recordings.max_file_bytes
        if size_bytes is None:
            raise BadRequest("the request has no Content-Length: the size of the file")
        if size_bytes > most_bytes:
            raise web.HTTPRequestEntityTooLarge(
                most_bytes, size_bytes, reason=f"the file may have {most_bytes} bytes at most (recording.max_file_mb)"
            )
        try:
            async with asyncio.timeout(UPLOAD_S + size_bytes / SLOWEST_BYTES_S):
                path = await recordings.store(request.match_info["name"], size_bytes, _pieces(request))
        except TimeoutError:
            raise web.HTTPRequestTimeout(reason="the file did not arrive in time") from None
        return reply(_stored_view(StoredFile(path.name, size_bytes, time.time())))

    async def _remove(self, request: web.Request) -> web.Response:
        """Remove a file."""
        return reply({"removed": await self._recordings.remove(request.match_info["name"])})


async def _pieces(request: web.Request) -> AsyncIterator[bytes]:
    """Yield the body in pieces, as they arrive.

    Raises:
        BadRequest: the client sent less than its head says.
        TimeoutError: nothing came for PIECE_S seconds.
    """
    try:
        while True:
            async with asyncio.timeout(PIECE_S):
                piece = await request.content.readany()
            if not piece:
                return
            yield piece
    except (OSError, web.RequestPayloadError, HttpProcessingError) as error:
        if isinstance(error, TimeoutError):
            raise
        raise BadRequest("the file is incomplete") from error


async def find_file(folder: Folder, request: web.Request, kind: str) -> Path:
    """Return the file of the folder that the path of a request names.

    Raises:
        UnknownTopic: there is none. `kind` is what the error calls it.
    """
    name = request.match_info["name"]
    path = await asyncio.to_thread(folder.find, name)
    if path is None:
        raise UnknownTopic(kind, name)
    return path


def send_file(path: Path) -> web.FileResponse:
    """Send a file, whole or in ranges."""
    headers = {"Cache-Control": "no-store", "Content-Disposition": f'attachment; filename="{path.name}"'}
    return web.FileResponse(path, headers={**headers, "Content-Type": FILE})


def recording_view(recording: Recording) -> RecordingView:
    """Return a recording as the API shows it."""
    thread = recording.thread
    view: RecordingView = {
        "name": recording.name,
        "owner": recording.owner,
        "topics": recording.recorder.topics,
        "seconds": round(recording.seconds, 3),
        "messages": thread.messages - thread.lost,
        "dropped": thread.dropped,
        "bytes": thread.written_bytes,
        "files": [path.name for path in thread.paths],
    }
    if recording.removed:
        view["removed"] = recording.removed
    if thread.failure is not None:
        view["failure"] = thread.failure
    return view


def _stored_view(file: StoredFile) -> StoredView:
    modified = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(file.modified_s))
    return {"file": file.name, "bytes": file.size_bytes, "modified": modified, "is_open": file.is_open}
