"""Captures: the raw bytes that passed on a link, as `hostlink inspect` reads them; live links and the last that ended.

Whole, they are JSON lines. For those who follow a link, they come in pieces: what passed after a position, and the next
position.
"""

import heapq
from collections.abc import Iterator
from http import HTTPStatus
from typing import NotRequired, TypedDict

import msgspec
from aiohttp import web

from hostlink.api.replies import reply
from hostlink.api.routes import Route
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
    """What passed after a position, the position to ask for next, and how many bytes in between are lost."""

    reads: list[ReadView]
    position: str
    lost_bytes: int
    is_open: bool


class Captures:
    """The handlers."""

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
                says=None,
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
        lines = b"".join(msgspec.json.encode(read) + b"\n" for read in reads(diagnosis))
        return web.Response(body=lines, content_type="application/x-ndjson", headers={"Cache-Control": "no-store"})

    async def _after(self, request: web.Request) -> web.Response:
        since = _parse_position(request.match_info["position"])
        diagnosis = self._find(request)
        from_device, to_device = diagnosis.link.captured_from_device, diagnosis.link.captured_to_device
        view: CaptureView = {
            "reads": list(reads(diagnosis, since)),
            "position": f"{from_device.total_bytes}-{to_device.total_bytes}",
            "lost_bytes": from_device.lost_bytes(since[0]) + to_device.lost_bytes(since[1]),
            "is_open": diagnosis.end is None,
        }
        return reply(view)

    def _find(self, request: web.Request) -> Diagnosis:
        number = request.match_info["number"]
        diagnoses = self._hub.diagnoses
        diagnosis = diagnoses.find(int(number)) if _is_number(number) else None
        if diagnosis is None:
            raise UnknownTopic("link", number, tuple(str(each) for each in diagnoses.numbers()))
        return diagnosis


def reads(diagnosis: Diagnosis, since: tuple[int, int] = _START) -> Iterator[ReadView]:
    """The lines of a recording, in order of time; `since`: bytes of each direction that are known already."""
    link, number = diagnosis.link, diagnosis.link.number
    if since == _START:
        yield {"t": 0.0, "dir": "device", "hex": "", "conn": number, "event": "open"}
    buffers = ((link.captured_from_device, "device", since[0]), (link.captured_to_device, "host", since[1]))
    both = [[(piece.time_s, who, piece.data) for piece in buffer.pieces(known)] for buffer, who, known in buffers]
    for time_s, who, data in heapq.merge(*both):
        yield {"t": round(time_s - link.opened_at_s, 6), "dir": who, "hex": data.hex(), "conn": number}
    if diagnosis.end is not None:
        end_s = round(diagnosis.ended_at_s - link.opened_at_s, 6)
        yield {"t": end_s, "dir": "device", "hex": "", "conn": number, "event": "close"}


def _is_number(text: str) -> bool:
    """Whether it is a whole number, and not one of so many digits that Python refuses to read it."""
    return text.isdecimal() and len(text) <= MAX_DIGITS


def _parse_position(text: str) -> tuple[int, int]:
    from_device, dash, to_device = text.partition("-")
    if not (dash and _is_number(from_device) and _is_number(to_device)):
        raise UnknownTopic("position", text, ("0-0", "what an earlier answer gave"))
    return int(from_device), int(to_device)
