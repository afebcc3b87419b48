"""`hostlink lock`: the emergency stop, of a robot or of all of them."""

import asyncio
from typing import Annotated

import typer

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.chosen_robots import chosen
from hostlink.cli.connecting import connected
from hostlink.cli.stop import report
from hostlink.client import DEFAULT_URL


def command(
    robot: RobotName = None,
    *,
    reason: Annotated[str, typer.Option(help="For the next driver.")] = "a lock from the terminal",
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Emergency stop of a robot, or of all of them: zero at once, and no command until `hostlink unlock`.

    It measures whether they stand, too; exit status 1: not all do.
    """
    asyncio.run(_lock(url, token, robot, reason, json=json))


async def _lock(url: str, token: str | None, name: str | None, reason: str, *, json: bool) -> None:
    async with connected(url, token) as host:
        names = [robot["name"] for robot in await chosen(host, name)]
        if len(names) == 1:
            measured = {names[0]: await host.robot(names[0]).lock(reason)}
        else:  # none waits for the measurement of another
            for each in names:
                await host.robot(each).lock(reason, wait_s=0.0)
            measured = {each: found for each, found in (await host.standstill()).items() if each in names}
        await report(host, name, measured, done=f"is locked: {reason}", json=json)
