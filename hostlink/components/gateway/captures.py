"""Captures: raw bytes that passed on a link, as `hostlink inspect` reads them; of live links and the last ended ones.

The whole capture is JSON lines. A client that follows a link requests pieces: the bytes after a position, with the next
position. If the beginning is lost, the first line is an event `topics`: what the device had announced before.
"""

from typing import NotRequired, TypedDict

import msgspec
from aiohttp import web

from hostlink.components.gateway.bodies import whole_number
from hostlink.components.gateway.routes import Route, reply
from hostlink.core.host import Capture, Devices
from hostlink.errors import UnknownTopic

MAX_DIGITS = 18  # larger counts do not occur
_START = (0, 0)


class ReadView(TypedDict):
    """One line of a capture: seconds since the link opened, the sender (device or host), the bytes."""

    t: float
    dir: str
    hex: str
    conn: int
    event: NotRequired[str]
    protocol: NotRequired[str]  # of the first line of a link that does not speak rosserial


class CaptureView(TypedDict):
    """Bytes after a position, the next position, and how many bytes in between are lost."""

    reads: list[ReadView]
    position: str
    lost_bytes: int
    is_open: bool


class Captures:
    """The routes of captures."""

    def __init__(self, devices: Devices) -> None:
        self._devices = devices

    def routes(self) -> list[Route]:
        """Return the routes."""
        path = "/api/links/{number}/capture"
        return [
            Route(path, self._whole, response=None, media_type="application/x-ndjson"),
            Route(path + "/{position}", self._after, CaptureView),
        ]

    async def _whole(self, request: web.Request) -> web.Response:
        """The last 64 KiB of each direction of a link, as JSON lines for `hostlink inspect`."""
        lines = msgspec.json.Encoder().encode_lines(capture_view(self._find(request, _START))["reads"])
        return web.Response(body=lines, content_type="application/x-ndjson", headers={"Cache-Control": "no-store"})

    async def _after(self, request: web.Request) -> web.Response:
        """Bytes on a link after a position; the first position is 0-0."""
        since = _parse_position(request.match_info["position"])
        return reply(capture_view(self._find(request, since), since))

    def _find(self, request: web.Request, since: tuple[int, int]) -> Capture:
        text = request.match_info["number"]
        return self._devices.capture(whole_number(text, MAX_DIGITS), since, shown=text)


def capture_view(found: Capture, since: tuple[int, int] = _START) -> CaptureView:
    """Return the bytes on a link in order of time. `since`: bytes of each direction that the client already has."""
    number = found.number
    reads: list[ReadView] = []
    if since == _START:
        opened = _read_view(0.0, "device", b"", number) | {"event": "open"}
        protocol = found.protocol
        reads.append(opened if protocol == "rosserial" else opened | {"protocol": protocol})
        if found.lost[0]:
            reads.append(_read_view(found.pieces[0].time_s, "device", found.announced, number) | {"event": "topics"})
    for time_s, is_from_device, data in found.pieces:
        reads.append(_read_view(time_s, "device" if is_from_device else "host", data, number))
    if found.seconds is not None:
        reads.append(_read_view(found.seconds, "device", b"", number) | {"event": "close"})
    return {
        "reads": reads,
        "position": "{}-{}".format(*found.position),
        "lost_bytes": sum(found.lost),
        "is_open": found.seconds is None,
    }


def _read_view(time_s: float, sender: str, data: bytes, number: int) -> ReadView:
    return {"t": round(time_s, 6), "dir": sender, "hex": data.hex(), "conn": number}


def _parse_position(text: str) -> tuple[int, int]:
    from_device, _, to_device = (whole_number(part, MAX_DIGITS) for part in text.partition("-"))
    if from_device is None or to_device is None:
        raise UnknownTopic("position", text, ("0-0", "a position of an earlier answer"))
    return from_device, to_device
