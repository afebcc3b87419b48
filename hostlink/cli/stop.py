"""`hostlink stop`: a robot, or all of them, whoever drives."""

import asyncio
import json as json_text

import typer

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.chosen_robots import chosen
from hostlink.cli.connecting import connected
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL, Host, Standstill, StandstillState
from hostlink.robot.standstill import sentence


def command(robot: RobotName = None, *, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """Stop a robot, or all of them, whoever drives, and measure whether it stands; exit status 1: not all do.

    A source that was driving must let go before it can drive again. `hostlink lock` keeps a robot stopped.
    """
    asyncio.run(_stop(url, token, robot, json=json))


async def _stop(url: str, token: str | None, name: str | None, *, json: bool) -> None:
    async with connected(url, token) as host:
        if name is None:
            measured = await host.stop_all()
        else:
            names = [robot["name"] for robot in await chosen(host, name)]
            measured = {each: await host.robot(each).stop() for each in names}
        await report(host, name, measured, json=json)


async def report(
    host: Host, name: str | None, measured: dict[str, Standstill], *, done: str = "", json: bool = False
) -> None:
    """Write what was measured of each robot after a stop; `done` is what was done to each, for example "is locked".

    Raises:
        typer.Exit: not all of them are known to stand.
    """
    robots = [robot for robot in await chosen(host, name) if robot["name"] in measured]
    if json:
        write(json_text.dumps([{**robot, "standstill": measured[robot["name"]]._asdict()} for robot in robots]))
    else:
        for robot in robots:
            write(*([f"{robot['name']} {done}"] if done else []), sentence(robot["name"], measured[robot["name"]]))
    if any(each.state is not StandstillState.STANDS for each in measured.values()):
        raise typer.Exit(1)
