"""Captures: the raw bytes that passed on a link, as `hostlink inspect` reads them; live links and the last that ended.

The whole is JSON lines. Who follows a link gets pieces: what passed after a position, and the next position. Where the
beginning is lost, it begins with the topics that the device had announced before: a line with the event `topics`.
"""

from http import HTTPStatus
from typing import NotRequired, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.routes import Route, reply
from hostlink.errors import UnknownTopic
from hostlink.hub.diagnoses import Diagnosis
from hostlink.hub.hub import Hub

MAX_DIGITS = 18  # no count is longer
_START = (0, 0)


class ReadView(TypedDict):
    """One line of a recording: seconds since the link opened, who sent (device or host), the bytes."""

    t: float
    dir: str
    hex: str
    conn: int
    event: NotRequired[str]


class CaptureView(TypedDict):
    """What passed after a position, the next position, and how many bytes in between are lost."""

    reads: list[ReadView]
    position: str
    lost_bytes: int
    is_open: bool


class Captures:
    """The handlers of its routes."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    def routes(self) -> list[Route]:
        """Every path of this file."""
        path = "/api/links/{number}/capture"
        return [
            Route(
                path,
                self._whole,
                "The last 64 KiB of each direction of a link, as JSON lines for `hostlink inspect`",
                response=None,
                media_type="application/x-ndjson",
                fails=(HTTPStatus.NOT_FOUND,),
            ),
            Route(
                path + "/{position}",
                self._after,
                "What passed on a link after a position; the first one is 0-0",
                CaptureView,
                fails=(HTTPStatus.NOT_FOUND,),
            ),
        ]

    async def _whole(self, request: web.Request) -> web.Response:
        diagnosis = self._find(request)
        lines = b"".join(msgspec.json.encode(read) + b"\n" for read in capture_view(diagnosis)["reads"])
        return web.Response(body=lines, content_type="application/x-ndjson", headers={"Cache-Control": "no-store"})

    async def _after(self, request: web.Request) -> web.Response:
        since = _parse_position(request.match_info["position"])
        return reply(capture_view(self._find(request), since))

    def _find(self, request: web.Request) -> Diagnosis:
        number = request.match_info["number"]
        diagnoses = self._hub.diagnoses
        diagnosis = diagnoses.find(int(number)) if _is_number(number) else None
        if diagnosis is None:
            raise UnknownTopic("link", number, tuple(str(each) for each in diagnoses.numbers()))
        return diagnosis


def capture_view(diagnosis: Diagnosis, since: tuple[int, int] = _START) -> CaptureView:
    """What passed on a link, in order of time; `since`: bytes of each direction that are known already."""
    number, found = diagnosis.link.number, diagnosis.captured(since)
    reads: list[ReadView] = []
    if since == _START:
        reads.append(_read_view(0.0, "device", b"", number) | {"event": "open"})
        if found.lost[0]:
            time_s, announced = found.pieces[0].time_s, diagnosis.announced_before(found.lost[0])
            reads.append(_read_view(time_s, "device", announced, number) | {"event": "topics"})
    for time_s, is_from_device, data in found.pieces:
        reads.append(_read_view(time_s, "device" if is_from_device else "host", data, number))
    if diagnosis.end is not None:
        reads.append(_read_view(diagnosis.seconds, "device", b"", number) | {"event": "close"})
    return {
        "reads": reads,
        "position": "{}-{}".format(*found.position),
        "lost_bytes": found.lost_bytes,
        "is_open": diagnosis.end is None,
    }


def _read_view(time_s: float, sender: str, data: bytes, number: int) -> ReadView:
    return {"t": round(time_s, 6), "dir": sender, "hex": data.hex(), "conn": number}


def _is_number(text: str) -> bool:
    """Whether it is a whole number, and not one of so many digits that Python refuses to read it."""
    return text.isdecimal() and len(text) <= MAX_DIGITS


def _parse_position(text: str) -> tuple[int, int]:
    from_device, dash, to_device = text.partition("-")
    if not (dash and _is_number(from_device) and _is_number(to_device)):
        raise UnknownTopic("position", text, ("0-0", "what an earlier answer gave"))
    return int(from_device), int(to_device)
