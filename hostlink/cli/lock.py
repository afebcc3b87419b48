"""`hostlink lock`: the emergency stop, of a robot or of all of them."""

import asyncio
import json as json_text
from typing import Annotated

import typer

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.chosen_robots import chosen
from hostlink.cli.connecting import connected
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL, RobotState


def command(
    robot: RobotName = None,
    *,
    reason: Annotated[str, typer.Option(help="For the next driver.")] = "a lock from the terminal",
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Emergency stop of a robot, or of all of them: zero at once, and no command until `hostlink unlock`."""
    locked = asyncio.run(_lock(url, token, robot, reason))
    lines = (f"{each['name']} is locked: {each.get('lock_reason')}" for each in locked)
    write(*([json_text.dumps(locked)] if json else lines))


async def _lock(url: str, token: str | None, name: str | None, reason: str) -> list[RobotState]:
    async with connected(url, token) as host:
        for each in await chosen(host, name):
            await host.robot(each["name"]).lock(reason)
        return await chosen(host, name)
