"""The commands for robots: robots, stop, lock, unlock."""

import json as json_text
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.connecting import ask
from hostlink.cli.figures import robot_table
from hostlink.cli.names import driver, natural, unknown_robot
from hostlink.cli.output import write, write_error, write_table
from hostlink.client import DEFAULT_URL, Host, Robot, RobotState, Standstill, StandstillState
from hostlink.errors import CommandRefused, ConfigError, DeviceGone, HostlinkError, RefusalKind
from hostlink.robot.standstill import sentence

# -- choice of robots -------------------------------------------------------------------------------------------------


async def chosen(host: Host, name: str | None) -> list[RobotState]:
    """Return the robot of that name; without a name every robot, in natural order.

    Raises:
        HostlinkError: no robot has that name, or none has connected.
    """
    robots = await host.robots()
    if not robots:
        raise unknown_robot(name, ())
    if name is None:
        return sorted(robots, key=lambda robot: natural(robot["name"]))
    found = [robot for robot in robots if robot["name"] == name.strip("/")]
    if not found:
        raise unknown_robot(name, (robot["name"] for robot in robots))
    return found


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


def stop(robot: RobotName = None, *, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """Stop a robot, or all of them, and measure whether they are stopped; exit status 1: at least one is not.

    A program that was driving must let go before it can drive again. `hostlink lock` keeps a robot stopped.
    """
    ask(url, token, lambda host: _stop(host, robot, json=json))


async def _stop(host: Host, name: str | None, *, json: bool) -> None:
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
        typer.Exit: not every robot is known to be stopped.
    """
    robots = [robot for robot in await chosen(host, name) if robot["name"] in measured]
    if json:
        write(json_text.dumps([{**robot, "standstill": measured[robot["name"]]._asdict()} for robot in robots]))
    else:
        for robot in robots:
            write(*([f"{robot['name']} {done}"] if done else []), sentence(robot["name"], measured[robot["name"]]))
    if any(each.state is not StandstillState.STOPPED for each in measured.values()):
        raise typer.Exit(1)


# -- lock -------------------------------------------------------------------------------------------------------------


def lock(
    robot: RobotName = None,
    *,
    reason: Annotated[str, typer.Option(help="Reason that the next driver is shown.")] = "a lock from the terminal",
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Emergency stop of a robot, or of all of them: zero at once, and no command until `hostlink unlock`.

    Measures whether the robots are stopped; exit status 1: at least one is not.
    """
    ask(url, token, lambda host: _lock(host, robot, reason, json=json))


async def _lock(host: Host, name: str | None, reason: str, *, json: bool) -> None:
    names = [robot["name"] for robot in await chosen(host, name)]
    if len(names) == 1:
        measured = {names[0]: await host.robot(names[0]).lock(reason)}
    else:  # no lock waits for the measurement of another robot
        for each in names:
            await host.robot(each).lock(reason, wait_s=0.0)
        measured = {each: found for each, found in (await host.standstill()).items() if each in names}
    await report(host, name, measured, done=f"is locked: {reason}", json=json)


# -- unlock -----------------------------------------------------------------------------------------------------------


def unlock(
    robot: RobotName = None,
    *,
    everything: Annotated[bool, typer.Option("--all", help="Unlock every robot that is locked.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Let a robot be driven again. The name is optional if only one robot is locked. No robot moves by this command."""
    if robot is not None and everything:
        raise ConfigError("--all", f"means every robot, but {robot!r} is named too; leave one of them out")
    unlocked = ask(url, token, lambda host: _unlock(host, robot, everything=everything))
    write(*([json_text.dumps(unlocked)] if json else (f"{each['name']} may be driven" for each in unlocked)))


async def _unlock(host: Host, name: str | None, *, everything: bool) -> list[RobotState]:
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
        raise HostlinkError("no robot is locked; `hostlink robots` lists them")
    if len(locked) > 1 and not everything:
        names = ", ".join(robot["name"] for robot in locked)
        raise HostlinkError(f"several robots are locked: {names}; name one, as in `hostlink unlock NAME`, or use --all")
    return locked
