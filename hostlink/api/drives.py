"""Who drove when, over REST."""

from datetime import UTC, datetime
from http import HTTPStatus
from typing import TypedDict

from aiohttp import web

from hostlink.api.replies import reply
from hostlink.api.routes import Route
from hostlink.errors import BadRequest
from hostlink.recording.drives import Drive, DriveLog

MAX_DIGITS = 6  # of a limit


class DriveView(TypedDict):
    """One drive: who, from when to when (UTC), how fast at most (m/s, rad/s). `end` is empty while it lasts.

    address: from which he was connected; empty: of a part of a daemon, or at another daemon.
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
    """The newest first; how many could not be written to the disk."""

    drives: list[DriveView]
    lost: int


class DriveRoute:
    """`GET /api/drives`."""

    def __init__(self, drives: DriveLog) -> None:
        self._drives = drives

    def routes(self) -> list[Route]:
        """The path of this file."""
        summary = "Who drove which robot, from when to when, the newest first; ?robot=NAME of one, ?limit=N so many"
        return [Route("/api/drives", self._all, summary, DrivesView, fails=(HTTPStatus.BAD_REQUEST,))]

    async def _all(self, request: web.Request) -> web.Response:
        """Raises:
        BadRequest: the limit is no number.
        """
        limit = request.query.get("limit")
        if limit is not None and not (limit.isascii() and limit.isdigit() and len(limit) <= MAX_DIGITS):
            raise BadRequest("limit must be a number: how many drives")
        count = None if limit is None else int(limit)
        drives = self._drives.newest_first(robot=request.query.get("robot"), limit=count)
        return reply({"drives": [_view(drive) for drive in drives], "lost": self._drives.lost})


def _view(drive: Drive) -> DriveView:
    return {
        "robot": drive.robot,
        "owner": drive.owner,
        "address": drive.address,
        "priority": drive.priority,
        "began": _utc(drive.began_ns),
        "ended": _utc(drive.ended_ns),
        "seconds": round(_seconds(drive), 3),
        "commands": drive.commands,
        "fastest_m_s": round(drive.fastest_m_s, 4),
        "fastest_rad_s": round(drive.fastest_rad_s, 4),
        "end": drive.end,
    }


def _seconds(drive: Drive) -> float:
    return max(drive.ended_ns - drive.began_ns, 0) / 1e9 if drive.seconds is None else drive.seconds


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds")
