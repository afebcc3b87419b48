"""`hostlink robots`: every robot as it is now."""

import asyncio
import json as json_text
from typing import Any

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.figures import robot_table
from hostlink.cli.output import table, write, write_error
from hostlink.client import DEFAULT_URL, RobotState


def command(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the robots: who drives them, how fast they are, where they are."""
    robots = asyncio.run(_robots(url, token))
    if json:
        write(json_text.dumps(robots))
    elif robots:
        shown: dict[str, Any] = {"robots": robots}
        columns, rows = robot_table(shown)
        write(*table(list(columns), [list(row) for row in rows])[1:])
    else:
        write_error("no robot has connected yet; `hostlink doctor` finds out why, `hostlink sim` runs one")


async def _robots(url: str, token: str | None) -> list[RobotState]:
    async with connected(url, token) as host:
        return await host.robots()
