"""`hostlink record`: let the daemon record into an MCAP file, and fetch it; repair one that was never finished."""

import asyncio
import signal
import time
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.fetching import check_output, fetch
from hostlink.cli.measuring import BYTES_PER_MB, megabytes
from hostlink.cli.output import show_progress, table, write, write_error
from hostlink.client import DEFAULT_URL, Host, connect
from hostlink.errors import ConfigError, HostlinkError
from hostlink.recording.folder import is_name

POLL_S = 0.5
_PATH = "/api/recordings"


def command(
    topics: Annotated[list[str] | None, typer.Argument(help="Names, or patterns: '/robot_0/*'. None: all.")] = None,
    *,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Where the file is put at the end; else it stays there.")
    ] = None,
    robot: Annotated[list[str] | None, typer.Option(help="Of this robot alone. May be repeated.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="For so long; else until Ctrl-C.")] = None,
    name: Annotated[str, typer.Option(help="What the daemon calls it; else the time.")] = "",
    list_: Annotated[bool, typer.Option("--list", help="List the recordings of the daemon.")] = False,
    stop: Annotated[str | None, typer.Option(metavar="NAME", help="End a recording that somebody began.")] = None,
    repair: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Give a file that was never finished its index.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON, for programs.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Record topics, commands and who gave them, log and parameters of robots into an MCAP file.

    The daemon writes it, on its own computer, and goes on if this command is killed: `hostlink record --list` shows
    what is recorded, `--stop NAME` ends it. Foxglove, Lichtblick and PlotJuggler open the file.
    """
    if repair is not None:
        _repair(repair, as_json=as_json)
        return
    if output is not None:
        check_output(output)
    if name and not is_name(name):
        raise ConfigError("--name", f"{name} is none: letters and digits, and . _ + - between them, 100 at most")
    if list_:
        work = _list(url, token, as_json=as_json)
    elif stop is not None:
        work = _stop(url, token, stop, output, as_json=as_json)
    else:
        request = {"topics": topics or [], "robots": robot or [], "name": name}
        work = _record(url, token, request, output, seconds, as_json=as_json)
    asyncio.run(work)


async def _record(
    url: str, token: str | None, request: dict[str, Any], output: Path | None, seconds: float | None, *, as_json: bool
) -> None:
    ending = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ending.set)
    async with connect(url, token=token, reconnect=False) as host:
        view = await host.post(_PATH, request)
        name = view["name"]
        write_error(f"recording {name}; Ctrl-C ends it")
        until_s = float("inf") if seconds is None else loop.time() + seconds
        while not ending.is_set() and loop.time() < until_s:
            view = await _find(host, name)
            show_progress(_line(view))
            try:
                async with asyncio.timeout(max(0.0, min(POLL_S, until_s - loop.time()))):
                    await ending.wait()
            except TimeoutError:
                continue
        show_progress("")
        view = await host.post(f"{_PATH}/{name}/stop")
        await _finish(host, view, output, as_json=as_json)


async def _find(host: Host, name: str) -> dict[str, Any]:
    """The recording, as it is now.

    Raises:
        HostlinkError: it ended without us.
    """
    for view in (await host.get(_PATH))["recordings"]:
        if view["name"] == name:
            return dict(view)
    raise HostlinkError(f"recording {name} has ended: its disk is full, or somebody stopped it; see the daemon's log")


async def _finish(host: Host, view: dict[str, Any], output: Path | None, *, as_json: bool) -> None:
    """Fetch the files; several have a number each."""
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
        write(_line(view), *places)
    if "failure" in view:
        raise HostlinkError(f"recording {view['name']} ended early: {view['failure']}")


async def _stop(url: str, token: str | None, name: str, output: Path | None, *, as_json: bool) -> None:
    async with connect(url, token=token, reconnect=False) as host:
        await _finish(host, await host.post(f"{_PATH}/{name}/stop"), output, as_json=as_json)


async def _list(url: str, token: str | None, *, as_json: bool) -> None:
    async with connect(url, token=token, reconnect=False) as host:
        view = await host.get(_PATH)
    if as_json:
        write(msgspec.json.encode(view).decode())
        return
    rows = [
        [file["file"], f"{file['bytes'] / BYTES_PER_MB:.1f}", file["modified"], "now" if file["is_open"] else ""]
        for file in view["files"]
    ]
    write(f"{len(view['files'])} files in {view['folder']}", *table(["file", "MB", "written", "recording"], rows))


def _line(view: dict[str, Any]) -> str:
    minutes, seconds = divmod(int(view["seconds"]), 60)
    return (
        f"{minutes}:{seconds:02d}  {view['messages']} messages  {megabytes(view['bytes'])}  {view['dropped']} dropped"
    )


def _repair(file: Path, *, as_json: bool) -> None:
    from hostlink.recording.repair import repair  # noqa: PLC0415 - nobody else waits for the library

    began_s = time.monotonic()
    found = repair(file, lambda count: show_progress(f"{count} messages"))
    show_progress("")
    seconds = time.monotonic() - began_s
    if as_json:
        facts = {"file": str(file), "messages": found.messages, "damage": found.damage, "seconds": round(seconds, 3)}
        write(msgspec.json.encode(facts).decode())
    elif found.damage:
        write(f"{file}: {found.messages} messages; it is whole now. Before: {'; '.join(found.damage)}")
    else:
        write(f"{file}: {found.messages} messages; it was whole, and stays as it is")
