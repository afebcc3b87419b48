"""The commands for robots: robots, stop, lock, unlock."""

import asyncio
import contextlib
import functools
import json as json_text
from collections.abc import Awaitable, Callable
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import AllRobots, Json, RobotNames, Token, Url, not_empty, robot_names
from hostlink.cli.connecting import ask
from hostlink.cli.explain import explanation, warnings
from hostlink.cli.figures import robot_table
from hostlink.cli.names import driver, mean_all, natural, only_connected, unknown_robot
from hostlink.cli.output import quantity, write, write_error, write_table
from hostlink.client import (
    DEFAULT_URL,
    CommandEndpoint,
    Host,
    Robot,
    RobotState,
    Standstill,
    StandstillState,
    Stopped,
    StoppedRobot,
)
from hostlink.core.robot.standstill import sentence
from hostlink.errors import (
    CommandRefused,
    ConfigError,
    DeviceGone,
    HostlinkError,
    RefusalKind,
    Refused,
    StopFailed,
    UnknownTopic,
)

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


def robots(
    *,
    explain: Annotated[
        bool, typer.Option("--explain", help="Say for each device why it is a robot, or why not.")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the robots: driver, speed and position of each. Warn of topics that command a motion and nothing guards."""
    ask(url, token, lambda host: _robots(host, is_explained=explain, json=json))


async def _robots(host: Host, *, is_explained: bool, json: bool) -> None:
    robots, found = await host.robots(), await host.get("/api/devices")
    devices = found["devices"]
    if json:
        write(json_text.dumps(found if is_explained else robots))
    elif is_explained:
        write(*explanation(devices))
    elif robots:
        shown: dict[str, Any] = {"robots": robots}
        write_table(*robot_table(shown, has_motion=True))
    elif not devices:
        write_error("no robot has connected yet; `hostlink doctor` finds out why, `hostlink sim` runs one")
    else:
        write_error(
            f"no robot has connected, but {quantity(len(devices), 'device')}; `hostlink robots --explain` says why"
        )
    if not is_explained:
        write_error(*warnings(devices, found["lock_reason"]))


# -- stop -------------------------------------------------------------------------------------------------------------


def stop(
    robots: RobotNames = None,
    *,
    everything: AllRobots = False,
    no_measure: Annotated[
        bool, typer.Option("--no-measure", help="Send the stop only; exit status 0: every zero was sent.")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Stop robots, or all of them, and measure whether they are stopped; exit status 1: at least one is not.

    Boards that are not robots are sent zeros, and named. A program that was driving must let go before it can drive
    again. `hostlink lock` keeps a robot stopped.
    """
    names = [] if everything else robots or []  # a stop of all is never refused because of a name
    ask(url, token, lambda host: _stop(host, names, is_measured=not no_measure, json=json))


async def _stop(host: Host, names: list[str], *, is_measured: bool = True, json: bool) -> None:
    if names and not mean_all(names, [robot["name"] for robot in await host.robots()]):
        await _halt(
            host, names, Robot.stop, is_measured=is_measured, json=json, of_all="`hostlink stop` stops every robot"
        )
    else:
        halting = host.stop_all() if is_measured else host.stop_all(wait_s=0.0)
        await _report_all(host, halting, is_measured=is_measured, json=json)


async def _report_all(
    host: Host, halting: Awaitable[Stopped], *, done: str = "", is_measured: bool = True, json: bool
) -> None:
    """Report a stop or a lock of all, also of one that failed for some; as `_report`."""
    try:
        stopped = await halting
    except StopFailed as failure:
        with contextlib.suppress(typer.Exit):
            await _report(host, failure.stopped, done=done, is_measured=is_measured, json=json)
        raise
    await _report(host, stopped, done=done, is_measured=is_measured, json=json)


async def _halt(
    host: Host,
    names: list[str],
    command: Callable[..., Awaitable[StoppedRobot]],
    *,
    done: str = "",
    is_measured: bool = True,
    json: bool,
    of_all: str,
) -> None:
    """Stop or lock robots, and report what was measured. The failure of one does not keep the others from stopping.

    `of_all` is a sentence with the command for every robot: a mistyped name must not keep robots moving.

    Raises:
        HostlinkError: no robot has one of the names, or a robot cannot be stopped.
        typer.Exit: not every robot is known to be stopped.
    """
    known = [robot["name"] for robot in await host.robots()]
    wanted = known if mean_all(names, known) else [name.strip("/") for name in names] or known
    # No stop waits for the measurement of another robot.
    no_wait = {"wait_s": 0.0} if len(wanted) > 1 or not is_measured else {}
    stopped, failed = dict[str, StoppedRobot](), dict[str, HostlinkError]()

    async def halt(name: str) -> None:
        try:
            if not name:  # refused here, because the other names count
                raise ConfigError("ROBOTS", "a name is empty; give one, or leave the argument out for all robots")
            stopped[name] = await command(
                host.robot(name), **no_wait
            )  # the settings may have a robot that is not known
        except Refused as error:
            is_unknown = name not in known and error.kind == UnknownTopic.kind
            failed[name] = unknown_robot(name, known, also=of_all) if is_unknown else error
        except HostlinkError as error:
            failed[name] = error

    async with asyncio.TaskGroup() as tasks:  # no stop waits for one of a daemon that does not answer
        for name in wanted:
            tasks.create_task(halt(name))
    endpoints = [each for name in wanted if name in stopped for each in stopped[name].endpoints]
    measured: dict[str, Standstill] = {**stopped}
    if no_wait and measured and is_measured:
        measured = {name: found for name, found in (await host.standstill()).items() if name in measured}
    try:
        if measured:
            await _report(host, Stopped(measured, endpoints), done=done, is_measured=is_measured, json=json)
    finally:
        if failed:
            *others, last = [failed[name] for name in dict.fromkeys(wanted) if name in failed]
            write_error(*(f"hostlink: {error}" for error in others))
            raise last


async def _report(host: Host, measured: Stopped, *, done: str = "", is_measured: bool = True, json: bool) -> None:
    """Write what was measured of each robot after a stop, and what became of boards that are not robots.

    `done` is what a lock has done to each, for example "is locked". A lock needs no measurement.

    Raises:
        HostlinkError: there is not a robot and no board.
        typer.Exit: not every robot is known to be stopped; after a lock, or without a measurement: not everything was
            sent a zero.
    """
    known = await chosen(host) if measured or not measured.endpoints else []
    robots = [robot for robot in known if robot["name"] in measured]
    if json:
        found: list[Any] = [{**robot, "standstill": measured[robot["name"]]._asdict()} for robot in robots]
        write(json_text.dumps([*found, *measured.endpoints]))
    else:
        for robot in robots:
            name = robot["name"]
            shown = sentence(name, measured[name]) if is_measured else sent_sentence(robot)
            write(*([f"{name} {done}"] if done else []), shown)
        write(*(endpoint_sentence(each, done=done) for each in measured.endpoints))
    needs_measurement = is_measured and not done
    is_covered = all(map(_is_covered, robots)) and all(
        each["is_zero_sent"] and (each["is_locked"] or not done) for each in measured.endpoints
    )
    states = {each.state for each in measured.values()}
    if needs_measurement:
        is_done = is_covered and states <= {StandstillState.STOPPED} and not measured.endpoints
    else:
        is_done = is_covered and not (is_measured and StandstillState.MOVING in states)
    if not is_done:
        raise typer.Exit(1)


def _is_covered(robot: RobotState) -> bool:
    """Whether all of a robot was sent a zero."""
    return robot["connected"] and robot.get("unreachable") is None


def sent_sentence(robot: RobotState) -> str:
    """Return what a stop without a measurement has done, as a sentence."""
    name, cause = robot["name"], robot.get("unreachable")
    if not robot["connected"]:
        return f"{name}: not sent a zero: {cause or 'its device is not connected'}"
    return f"{name}: zero sent" if cause is None else f"{name}: zero sent as far as possible: {cause}"


def endpoint_sentence(endpoint: CommandEndpoint, *, done: str = "") -> str:
    """Return what a stop or a lock of all has done to a topic that is not a robot's, as a sentence."""
    host = endpoint.get("host")  # an older daemon names none
    at_host = "" if host is None else f" at {host}"
    place = f"{endpoint['topic']} of link {endpoint['link']} ({endpoint['peer']}){at_host}"
    is_locked = f" {done};" if done and endpoint["is_locked"] else ""
    if not endpoint["is_zero_sent"]:
        step = "`hostlink robots --explain` shows the setting that makes a robot of it"
        return f"{place}{is_locked} was not sent a zero: {endpoint['reason']}; {step}"
    sent = f"{place}{is_locked or ':'} zero sent"
    return sent if done else f"{sent}; it is not a robot's, so nobody can say that it is stopped"


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

    A lock of all also locks boards that are not robots, and what connects later. Exit status 0: all are locked and were
    sent a zero; 1: something was not, for example because it is not connected, and is named, or a robot still moves.
    """
    names = [] if everything else robots or []
    ask(url, token, lambda host: _lock(host, names, reason, json=json))


async def _lock(host: Host, names: list[str], reason: str, *, json: bool) -> None:
    done = f"is locked: {reason}"
    if names and not mean_all(names, [robot["name"] for robot in await host.robots()]):
        command = functools.partial(Robot.lock, reason=reason)
        await _halt(host, names, command, done=done, json=json, of_all="`hostlink lock` locks every robot")
    else:
        await _report_all(host, host.lock_all(reason), done=done, json=json)


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
    ask(url, token, lambda host: _unlock(host, robots or [], everything=everything, json=json))


async def _unlock(host: Host, names: list[str], *, everything: bool, json: bool = False) -> None:
    if mean_all(names, [robot["name"] for robot in await host.robots()]):
        names, everything = [], True
    are_boards_locked = not names and (await host.get("/api/devices"))["lock_reason"] is not None
    meant = await _meant(host, names, everything=everything, are_boards_locked=are_boards_locked)
    if are_boards_locked or everything:
        await host.unlock_all()
    else:
        for each in meant:
            await host.robot(each["name"]).unlock()
    unlocked = [await host.robot(each["name"]).state() for each in meant]
    if json:
        write(json_text.dumps(unlocked))
    else:
        write(*(f"{each['name']} may be driven" for each in unlocked))
        write(*(["boards that are not robots may be driven"] if are_boards_locked else []))


async def _meant(host: Host, names: list[str], *, everything: bool, are_boards_locked: bool) -> list[RobotState]:
    robots = [] if are_boards_locked and not await host.robots() else await chosen(host, *names)
    if names:
        return robots
    locked = [robot for robot in robots if robot.get("locked")]
    if not locked and not are_boards_locked:
        raise HostlinkError("no robot is locked; `hostlink robots` lists them")
    if len(locked) > 1 and not everything:
        listed = ", ".join(robot["name"] for robot in locked)
        raise HostlinkError(
            f"several robots are locked: {listed}; name them, as in `hostlink unlock {locked[0]['name']}`, or use --all"
        )
    return locked
