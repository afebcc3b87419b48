"""`hostlink stop`: a robot, or all of them, whoever drives."""

import asyncio
import json as json_text

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.chosen_robots import chosen
from hostlink.cli.connecting import connected
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL, RobotState


def command(robot: RobotName = None, *, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """Stop a robot, or all of them, whoever drives; who drives may go on. `hostlink lock` keeps them standing."""
    stopped = asyncio.run(_stop(url, token, robot))
    write(*([json_text.dumps(stopped)] if json else (f"{each['name']} is stopped" for each in stopped)))


async def _stop(url: str, token: str | None, name: str | None) -> list[RobotState]:
    async with connected(url, token) as host:
        if name is None:
            await host.post("/api/stop")
            return await chosen(host, None)
        for each in await chosen(host, name):
            await host.robot(each["name"]).stop()
        return await chosen(host, name)
