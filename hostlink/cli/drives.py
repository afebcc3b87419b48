"""`hostlink drives`: who drove which robot, and when."""

import asyncio
import json as json_text
import urllib.parse
from datetime import UTC, datetime
from typing import Any

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.drivers import named
from hostlink.cli.output import table, write
from hostlink.client import DEFAULT_URL

HEADS = ["from UTC", "s", "robot", "who", "top m/s", "rad/s", "why it ended"]


def command(robot: RobotName = None, *, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List who drove a robot, or any robot, and when; the newest first."""
    view = asyncio.run(_fetch(url, token, robot))
    if json:
        write(json_text.dumps(view))
    else:
        nobody = "nobody drove yet" if robot is None else f"nobody drove {robot} yet"
        today = datetime.now(UTC).date().isoformat()
        write(*(table(HEADS, [row(each, today) for each in view["drives"]])[1:] or [nobody]))


async def _fetch(url: str, token: str | None, robot: str | None) -> dict[str, Any]:
    query = "" if robot is None else "?" + urllib.parse.urlencode({"robot": robot.strip("/")})
    async with connected(url, token) as host:
        return await host.get(f"/api/drives{query}")


def row(drive: dict[str, Any], today: str) -> list[str]:
    """The cells of a drive under HEADS. `today` is the date, as 2026-11-22: of its drives the time is enough."""
    began = drive["began"].replace("T", " ").partition(".")[0].removeprefix(f"{today} ")
    who = named(drive["owner"], drive.get("address", ""))
    speeds = [f"{drive['fastest_m_s']:.2f}", f"{drive['fastest_rad_s']:.2f}"]
    return [began, f"{drive['seconds']:.1f}", drive["robot"], who, *speeds, drive["end"] or "drives now"]
