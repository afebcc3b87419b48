"""The commands for recordings of the daemon: `record`, `drives`, `incidents`."""

import asyncio
import fnmatch
import json as json_text
import signal
import time
import urllib.parse
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.arguments import Json, RobotName, Token, Url
from hostlink.cli.connecting import ask, connected
from hostlink.cli.files import check_output, fetch
from hostlink.cli.local_time import now, offset, time_text
from hostlink.cli.names import named, similar, unknown
from hostlink.cli.output import quantity, show_progress, write, write_error, write_table
from hostlink.client import DEFAULT_URL, Host
from hostlink.components.recorder.folder import is_name
from hostlink.errors import ConfigError, HostlinkError, size

# -- record -----------------------------------------------------------------------------------------------------------

POLL_S = 0.5
BAGS = (".bag", ".db3")  # names of files of ROS
_PATH = "/api/recordings"
_CAUSES = {"lease": "silent"}  # as a user reads it; programs read the other one

NEWEST = 20  # entries of a list that a person reads

HEADS = ["s", "robot", "who", "top m/s", "rad/s", "why it ended"]


def record(
    topics: Annotated[
        list[str] | None, typer.Argument(help="Topics to record, by names or patterns: '/robot_0/*'. All without one.")
    ] = None,
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "-O",
            "--output",
            help="Download the file to this path at the end; else it stays in the daemon's folder.",
        ),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", "-a", help="Record every topic, as without a topic.")] = False,
    robot: Annotated[
        list[str] | None, typer.Option(help="Record this robot only, for a smaller file. May be repeated.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Duration, for scripts; else until Ctrl-C.")] = None,
    name: Annotated[str, typer.Option(help="Name of the recording, to find it again; else the time.")] = "",
    list_: Annotated[bool, typer.Option("--list", help="List the recordings of the daemon.")] = False,
    stop: Annotated[
        str | None, typer.Option(metavar="NAME", help="End a recording that another terminal or program started.")
    ] = None,
    repair: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Repair a file that was not closed, for example after a power cut."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Record topics, commands with their drivers, logs and parameters of robots into an MCAP file.

    The daemon writes the file on its own computer, and continues if this command is killed: `hostlink record --list`
    lists recordings, `--stop NAME` ends one. Foxglove, Lichtblick and PlotJuggler open the file.
    """
    if everything and topics:
        raise ConfigError("--all", f"means every topic, but {topics[0]!r} is named too; leave one of them out")
    for topic in topics or []:
        if topic.endswith((".mcap", *BAGS)):
            raise ConfigError(
                "TOPICS", f"{topic} is the name of a file; write -o before it: hostlink record -o {topic}"
            )
    if repair is not None:
        _repair(repair, as_json=as_json)
        return
    if output is not None:
        _check_format(output)
        check_output(output)
    if name and not is_name(name):
        raise ConfigError(
            "--name",
            f"{name} is not a name of a recording; use at most 100 letters and digits, with . _ + - between them",
        )
    if list_:
        _list(ask(url, token, lambda host: host.get(_PATH)), as_json=as_json)
    elif stop is not None:
        ask(url, token, lambda host: _stop(host, stop, output, as_json=as_json))
    else:
        wanted = [name if name[:1] in "*?[" else f"/{name.lstrip('/~')}" for name in topics or []]
        request = {"topics": wanted, "robots": robot or [], "name": name}
        asyncio.run(_record(url, token, request, output, seconds, as_json=as_json))


def _check_format(output: Path) -> None:
    """Refuse the name of a bag, because programs of ROS would read the file as one.

    Raises:
        ConfigError: the name is that of another format.
    """
    if output.suffix in BAGS:
        raise ConfigError(
            "--output",
            f"{output} would be a bag of ROS, but the file is MCAP; name it {output.with_suffix('.mcap')}, and "
            "`hostlink export FILE --to ros1` or `--to rosbag2` writes the bag",
        )


async def _record(
    url: str, token: str | None, request: dict[str, Any], output: Path | None, seconds: float | None, *, as_json: bool
) -> None:
    ending = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ending.set)
    async with connected(url, token) as host:
        view = await host.post(_PATH, request)
        name = view["name"]
        known = [topic["name"] for topic in await host.topics()] if request["topics"] else []
        for pattern in request["topics"]:
            if not fnmatch.filter(known, pattern):
                write_error(f"there is no topic {pattern} yet; {similar(pattern, known)}`hostlink topics` lists all")
        write_error(f"recording {name}; Ctrl-C ends")
        until_s = float("inf") if seconds is None else loop.time() + seconds
        while not ending.is_set() and loop.time() < until_s:
            view = await _find(host, name)
            show_progress(progress(view))
            try:
                async with asyncio.timeout(max(0.0, min(POLL_S, until_s - loop.time()))):
                    await ending.wait()
            except TimeoutError:
                continue
        view = await host.post(f"{_PATH}/{name}/stop")
        await _finish(host, view, output, as_json=as_json)


async def _find(host: Host, name: str) -> dict[str, Any]:
    """Return the present state of a recording.

    Raises:
        HostlinkError: the recording has ended.
    """
    for view in (await host.get(_PATH))["recordings"]:
        if view["name"] == name:
            return dict(view)
    raise HostlinkError(
        f"recording {name} has ended: the disk is full, or another program stopped it; see the daemon's log"
    )


async def _finish(host: Host, view: dict[str, Any], output: Path | None, *, as_json: bool) -> None:
    """Fetch the files of an ended recording; each of several files has a number.

    Raises:
        HostlinkError: a file cannot be fetched, or the recording ended early.
    """
    fetched = []
    for number, file in enumerate(view["files"]):
        if output is not None:
            target = output.with_stem(f"{output.stem}_{number + 1}") if number else output
            await fetch(host, f"{_PATH}/{file}", target)
            fetched.append(str(target))
    folder = (await host.get(_PATH))["folder"]
    places = fetched or [f"{folder}/{file}" for file in view["files"]]
    if as_json:
        write(msgspec.json.encode(view | {"places": places}).decode())
    else:
        write(progress(view), *places)
    if lost := view.get("removed"):
        write_error(f"removed by another program during the recording: {', '.join(lost)}")
    if "failure" in view:
        raise HostlinkError(f"recording {view['name']} ended early: {view['failure']}")


async def _stop(host: Host, name: str, output: Path | None, *, as_json: bool) -> None:
    await _finish(host, await host.post(f"{_PATH}/{name}/stop"), output, as_json=as_json)


def _list(view: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        write(msgspec.json.encode(view).decode())
        return
    here = now()
    rows = [
        [file["file"], size(file["bytes"]), time_text(file["modified"], here), "now" if file["is_open"] else ""]
        for file in view["files"]
    ]
    write(f"{quantity(len(view['files']), 'file')} in {view['folder']}")
    if rows:
        write("")
    write_table(["file", "size", f"written {offset(here)}", "recording"], rows, whole=["file"])


def progress(view: dict[str, Any]) -> str:
    """Return the line of a recording: duration, messages, size and what was dropped."""
    minutes, seconds = divmod(int(view["seconds"]), 60)
    messages = quantity(view["messages"], "message")
    return f"{minutes}:{seconds:02d}  {messages}  {size(view['bytes'])}  {view['dropped']} dropped"


def _repair(file: Path, *, as_json: bool) -> None:
    from hostlink.components.recorder.salvage import repair  # noqa: PLC0415 - other commands do not need it

    began_s = time.monotonic()
    found = repair(file, lambda count: show_progress(quantity(count, "message")))
    seconds, messages = time.monotonic() - began_s, quantity(found.messages, "message")
    if as_json:
        facts = {"file": str(file), "messages": found.messages, "damage": found.damage, "seconds": round(seconds, 3)}
        facts |= {} if found.output is None else {"output": str(found.output)}
        facts["original"] = None if found.original is None else str(found.original)
        write(msgspec.json.encode(facts).decode())
    elif found.damage:
        kept = "" if found.original is None else f". The damaged file is kept: {found.original}"
        write(f"{found.output or file}: {messages}; the file is repaired. It had: {'; '.join(found.damage)}{kept}")
    else:
        write(f"{file}: {messages}; the file is not damaged, and was not changed")


# -- lists ------------------------------------------------------------------------------------------------------------


Count = Annotated[
    int | None,
    typer.Option("--count", "-n", min=1, help="List only the newest.", show_default=f"{NEWEST}, with --json all"),
]


def write_newest(
    head: Sequence[str], rows: Sequence[Sequence[str]], count: int | None, *, whole: Sequence[str]
) -> None:
    """Write the first `count` rows, and how many older ones there are."""
    shown = rows[: count or NEWEST]
    write_table(head, shown, whole=whole)
    if older := len(rows) - len(shown):
        write_error(f"{quantity(older, 'older one is', 'older ones are')} not listed; -n {len(rows)} lists them too")


# -- drives -----------------------------------------------------------------------------------------------------------


def drives(
    robot: RobotName = None,
    *,
    count: Count = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List who drove a robot, or any robot, and when, with the newest drive first."""
    view, known = ask(url, token, lambda host: _drives(host, robot))
    if json:
        write(json_text.dumps({**view, "drives": view["drives"][:count]}))
    else:
        here = now()
        rows = [row(each, here) for each in view["drives"]]
        write_newest([offset(here), *HEADS], rows, count, whole=HEADS[-1:])
        if not view["drives"]:
            names = similar(robot, known) if robot is not None and robot not in known else ""
            write(f"there are no drives of {robot or 'any robot'} yet; {names}".rstrip("; "))


async def _drives(host: Host, robot: str | None) -> tuple[dict[str, Any], list[str]]:
    """Return the drives, and the names of robots if a robot has none."""
    query = "" if robot is None else "?" + urllib.parse.urlencode({"robot": robot.strip("/")})
    view = await host.get(f"/api/drives{query}")
    return view, [] if view["drives"] else [state["name"] for state in await host.robots()]


def row(drive: dict[str, Any], here: datetime) -> list[str]:
    """Return the cells of a drive: its begin, under the offset of the time `here`, and those under HEADS."""
    began = time_text(drive["began"], here)
    who = named(drive["owner"], drive.get("address", ""))
    speeds = [f"{drive['fastest_m_s']:.2f}", f"{drive['fastest_rad_s']:.2f}"]
    return [began, f"{drive['seconds']:.1f}", drive["robot"], who, *speeds, drive["end"] or "drives now"]


# -- incidents --------------------------------------------------------------------------------------------------------

_INCIDENTS_PATH = "/api/incidents"
_FETCH = "`hostlink incidents NAME -o FILE` downloads one"


def incidents(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A robot, to list its incidents only; with --output: file of an incident, as the list names it."
        ),
    ] = None,
    *,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Download that file to this path.")] = None,
    save: Annotated[
        str | None,
        typer.Option(metavar="ROBOT", help="Save this robot's last minutes now, after something that you saw."),
    ] = None,
    reason: Annotated[str, typer.Option(help="With --save: reason that the list shows.")] = "",
    count: Count = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """List incidents of robots: locks, lost drivers, broken links, errors and findings of doctor.

    The daemon keeps an MCAP file of each, from two minutes before the incident to half a minute after it.
    """
    if output is not None and name is None:
        raise ConfigError("incidents", f"name the file of an incident, too; {_FETCH}")
    if reason and save is None:
        raise ConfigError("--reason", "is the reason of --save; add --save ROBOT")
    if output is not None:
        check_output(output)
    if save is not None:
        view = ask(url, token, lambda host: host.post(_INCIDENTS_PATH, {"robot": save, "reason": reason}))
        write_error("the incident will be saved in half a minute; `hostlink incidents` lists it then")
    elif output is not None:
        ask(url, token, lambda host: fetch(host, f"{_INCIDENTS_PATH}/{name}", output))
        write(str(output))
        return
    else:
        view = ask(url, token, lambda host: _incidents(host, name))
        view["incidents"] = view["incidents"][: count if as_json else None]
    here = now()
    if as_json:
        write(msgspec.json.encode(view).decode())
    elif save is None:
        rows = [
            [
                time_text(each["at"], here),
                each["robot"],
                _CAUSES.get(each["cause"], each["cause"]),
                each["file"] or "being saved",
                each["detail"],
            ]
            for each in view["incidents"]
        ]
        write_newest([offset(here), "robot", "cause", "file", "detail"], rows, count, whole=["file", "detail"])
        if not rows:
            write(f"there are no incidents{'' if name is None else f' of {name}'}")


async def _incidents(host: Host, robot: str | None) -> dict[str, Any]:
    """Return the incidents, of one robot if it is named.

    Raises:
        HostlinkError: no robot has that name, now or in an incident.
    """
    view = await host.get(_INCIDENTS_PATH)
    if robot is None:
        return view
    name, found = robot.strip("/"), view["incidents"]
    of_it = [each for each in found if each["robot"] == name]
    if not of_it:
        if any(each["file"] == robot for each in found):
            raise HostlinkError(f"{robot} is the file of an incident; {_FETCH}")
        known = {each["robot"] for each in found} | {state["name"] for state in await host.robots()}
        if name not in known:
            raise unknown("robot", name, known, command="incidents")
    return {**view, "incidents": of_it}
