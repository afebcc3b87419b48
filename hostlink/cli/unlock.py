"""`hostlink unlock`: let a robot be driven again."""

import asyncio
import json as json_text
from typing import Annotated

import typer

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.chosen_robots import chosen
from hostlink.cli.connecting import connected
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL, Host, RobotState
from hostlink.errors import ConfigError, HostlinkError


def command(
    robot: RobotName = None,
    *,
    everything: Annotated[bool, typer.Option("--all", help="Every robot that is locked.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Let a robot be driven again; its name may be left out where only one is locked. Nothing moves by that."""
    if robot is not None and everything:
        raise ConfigError("--all", "is every robot: give no name")
    unlocked = asyncio.run(_unlock(url, token, robot, everything=everything))
    write(*([json_text.dumps(unlocked)] if json else (f"{each['name']} may be driven" for each in unlocked)))


async def _unlock(url: str, token: str | None, name: str | None, *, everything: bool) -> list[RobotState]:
    async with connected(url, token) as host:
        meant = await _meant(host, name, everything=everything)
        for each in meant:
            await host.robot(each["name"]).unlock()
        return [await host.robot(each["name"]).state() for each in meant]


async def _meant(host: Host, name: str | None, *, everything: bool) -> list[RobotState]:
    robots = await chosen(host, name)
    if name is not None:
        return robots
    locked = [robot for robot in robots if robot.get("locked")]
    if not locked:
        raise HostlinkError("no robot is locked")
    if len(locked) > 1 and not everything:
        names = ", ".join(robot["name"] for robot in locked)
        raise HostlinkError(f"which robot? `hostlink unlock NAME`, or --all; locked are: {names}")
    return locked
