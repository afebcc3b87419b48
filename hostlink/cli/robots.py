"""The commands for robots: robots, stop, lock, unlock."""

import asyncio
import functools
import json as json_text
from collections.abc import Awaitable, Callable
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import AllRobots, Json, RobotNames, Token, Url, not_empty, robot_names
from hostlink.cli.connecting import ask
from hostlink.cli.figures import robot_table
from hostlink.cli.names import driver, mean_all, natural, only_connected, unknown_robot
from hostlink.cli.output import write, write_error, write_table
from hostlink.client import DEFAULT_URL, Host, Robot, RobotState, Standstill, StandstillState
from hostlink.errors import CommandRefused, ConfigError, DeviceGone, HostlinkError, RefusalKind
from hostlink.robot.standstill import sentence

# -- choice of robots -------------------------------------------------------------------------------------------------


async def chosen(host: Host, *names: str) -> list[RobotState]:
    """Return the robots of these names; without a name every robot, in natural order.

    Raises:
        HostlinkError: no robot has one of the names, or none has connected.
    """
    robots = {robot["name"]: robot for robot in await host.robots()}
    if not robots:
        raise unknown_robot(None, ())
    wanted = [name.strip("/") for name in names] or sorted(robots, key=natural)
    for name in wanted:
        if name not in robots:
            raise unknown_robot(name, robots)
    return [robots[name] for name in wanted]


async def name_of(host: Host, name: str | None, *, example: str) -> str:
    """Return the name of the wanted robot; without one, of the only robot that is connected.

    `example` is a command with a place for the name, for the error.

    Raises:
        HostlinkError: no robot has that name; or without one, several are connected, or none.
    """
    if name is None:
        return only_connected({each["name"]: each["connected"] for each in await host.robots()}, example=example)
    (found,) = await chosen(host, name)
    return found["name"]


async def require_robot(host: Host, name: str) -> Robot:
    """Return the robot of that name.

    Raises:
        HostlinkError: no robot has that name; the error lists the known ones.
    """
    (found,) = await chosen(host, name)
    return host.robot(found["name"])


async def free_robot(host: Host, name: str, *, below: int = 0) -> RobotState:
    """Return the state of a robot that may be driven now. A driver of a priority `below` this one is overruled.

    Raises:
        DeviceGone: the robot is not connected.
        CommandRefused: the robot is locked.
        HostlinkError: no robot has that name, or another source drives it.
    """
    (state,) = await chosen(host, name)
    name = state["name"]
    if not state["connected"]:
        raise DeviceGone(name)
    if state.get("locked"):
        reason = f"{name}: locked: {state.get('lock_reason')}; to drive it again: hostlink unlock {name}"
        raise CommandRefused(name, RefusalKind.LOCKED, reason)
    priority = state.get("priority")
    if state["holder"] is not None and (priority is None or priority >= below):
        raise HostlinkError(f"{name} is driven by {driver(state)}; end that program first")
    return state


# -- robots -----------------------------------------------------------------------------------------------------------


def robots(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the robots: driver, speed and position of each."""
    robots = ask(url, token, Host.robots)
    if json:
        write(json_text.dumps(robots))
    elif robots:
        shown: dict[str, Any] = {"robots": robots}
        write_table(*robot_table(shown))
    else:
        write_error("no robot has connected yet; `hostlink doctor` finds out why, `hostlink sim` runs one")


# -- stop -------------------------------------------------------------------------------------------------------------


def stop(
    robots: RobotNames = None,
    *,
    everything: AllRobots = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Stop robots, or all of them, and measure whether they are stopped; exit status 1: at least one is not.

    A program that was driving must let go before it can drive again. `hostlink lock` keeps a robot stopped.
    """
    names = [] if everything else robots or []  # a stop of all is never refused because of a name
    ask(url, token, lambda host: _stop(host, names, json=json))


async def _stop(host: Host, names: list[str], *, json: bool) -> None:
    if names and not mean_all(names, [robot["name"] for robot in await host.robots()]):
        await _halt(host, names, Robot.stop, json=json, of_all="`hostlink stop` stops every robot")
    else:
        await _report(host, await host.stop_all(), json=json)


async def _halt(
    host: Host,
    names: list[str],
    command: Callable[..., Awaitable[Standstill]],
    *,
    done: str = "",
    json: bool,
    of_all: str,
) -> None:
    """Stop or lock robots, and report what was measured. The failure of one does not keep the others from stopping.

    `of_all` is a sentence with the command for every robot: a mistyped name must not keep robots moving.

    Raises:
        HostlinkError: no robot has one of the names, or a robot cannot be stopped.
        typer.Exit: not every robot is known to be stopped.
    """
    known = [robot["name"] for robot in await chosen(host)]
    wanted = known if mean_all(names, known) else [name.strip("/") for name in names] or known
    no_wait = {"wait_s": 0.0} if len(wanted) > 1 else {}  # no stop waits for the measurement of another robot
    measured, failed = dict[str, Standstill](), dict[str, HostlinkError]()

    async def halt(name: str) -> None:
        try:
            if not name:  # refused here, because the other names count
                raise ConfigError("ROBOTS", "a name is empty; give one, or leave the argument out for all robots")
            if name not in known:
                raise unknown_robot(name, known, also=of_all)
            measured[name] = await command(host.robot(name), **no_wait)
        except HostlinkError as error:
            failed[name] = error

    async with asyncio.TaskGroup() as tasks:  # no stop waits for one of a daemon that does not answer
        for name in wanted:
            tasks.create_task(halt(name))
    if no_wait and measured:
        measured = {name: found for name, found in (await host.standstill()).items() if name in measured}
    try:
        if measured:
            await _report(host, measured, done=done, json=json)
    finally:
        if failed:
            *others, last = [failed[name] for name in dict.fromkeys(wanted) if name in failed]
            write_error(*(f"hostlink: {error}" for error in others))
            raise last


async def _report(host: Host, measured: dict[str, Standstill], *, done: str = "", json: bool) -> None:
    """Write what was measured of each robot after a stop; `done` is what was done to each, for example "is locked".

    Raises:
        typer.Exit: not every robot is known to be stopped.
    """
    robots = [robot for robot in await chosen(host) if robot["name"] in measured]
    if json:
        write(json_text.dumps([{**robot, "standstill": measured[robot["name"]]._asdict()} for robot in robots]))
    else:
        for robot in robots:
            write(*([f"{robot['name']} {done}"] if done else []), sentence(robot["name"], measured[robot["name"]]))
    if any(each.state is not StandstillState.STOPPED for each in measured.values()):
        raise typer.Exit(1)


# -- lock -------------------------------------------------------------------------------------------------------------


def lock(
    robots: RobotNames = None,
    *,
    everything: AllRobots = False,
    reason: Annotated[str, typer.Option(help="Reason that the next driver is shown.")] = "a lock from the terminal",
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Emergency stop of robots, or of all of them: zero at once, and no command until `hostlink unlock`.

    Measures whether the robots are stopped; exit status 1: at least one is not.
    """
    names = [] if everything else robots or []
    ask(url, token, lambda host: _lock(host, names, reason, json=json))


async def _lock(host: Host, names: list[str], reason: str, *, json: bool) -> None:
    command, done = functools.partial(Robot.lock, reason=reason), f"is locked: {reason}"
    await _halt(host, names, command, done=done, json=json, of_all="`hostlink lock` locks every robot")


# -- unlock -----------------------------------------------------------------------------------------------------------


def unlock(
    robots: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names of robots, or the word all; may be left out if only one is locked.",
            callback=not_empty,
            autocompletion=robot_names,
        ),
    ] = None,
    *,
    everything: Annotated[bool, typer.Option("--all", help="Unlock every robot that is locked.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Let robots be driven again. The name is optional if only one robot is locked. No robot moves by this command."""
    if robots and everything:
        raise ConfigError("--all", f"means every robot, but {robots[0]!r} is named too; leave one of them out")
    unlocked = ask(url, token, lambda host: _unlock(host, robots or [], everything=everything))
    write(*([json_text.dumps(unlocked)] if json else (f"{each['name']} may be driven" for each in unlocked)))


async def _unlock(host: Host, names: list[str], *, everything: bool) -> list[RobotState]:
    meant = await _meant(host, names, everything=everything)
    for each in meant:
        await host.robot(each["name"]).unlock()
    return [await host.robot(each["name"]).state() for each in meant]


async def _meant(host: Host, names: list[str], *, everything: bool) -> list[RobotState]:
    if mean_all(names, [robot["name"] for robot in await host.robots()]):
        names, everything = [], True
    robots = await chosen(host, *names)
    if names:
        return robots
    locked = [robot for robot in robots if robot.get("locked")]
    if not locked:
        raise HostlinkError("no robot is locked; `hostlink robots` lists them")
    if len(locked) > 1 and not everything:
        listed = ", ".join(robot["name"] for robot in locked)
        raise HostlinkError(
            f"several robots are locked: {listed}; name them, as in `hostlink unlock {locked[0]['name']}`, or use --all"
        )
    return locked
