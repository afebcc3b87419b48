"""The commands for connections: links, clients, capture."""

import asyncio
import contextlib
import json as json_text
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import ask, connected, run_until_interrupted
from hostlink.cli.figures import LINK_COLUMNS, Snapshot, advice, figures, link_rows, place
from hostlink.cli.output import duration, quantity, show_progress, write, write_error, write_table
from hostlink.client import DEFAULT_URL, Host
from hostlink.errors import BadRequest, ConfigError, HostlinkError, size

COLUMNS = ("client", "kind", "peer", "role", "for s", "from", "to", "bytes to", "waiting", "lag", "dropped", "program")

POLL_S = 0.5  # a serial line needs longer for the 64 KiB that the daemon keeps

# -- links ------------------------------------------------------------------------------------------------------------


def links(
    *,
    ended: Annotated[
        bool, typer.Option("--ended", help="List the last links that ended, too: why a robot was lost.")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the connections of devices: rates since they opened, losses, silence and findings."""
    view, robots = ask(url, token, _links)
    if json:
        write(json_text.dumps(view))
        return
    shown = figures(Snapshot(0.0, {"links": []}, []), Snapshot(0.0, view, robots))
    if not shown["links"]:
        write_error("no device is connected; `hostlink doctor` finds out why")
    write_table(LINK_COLUMNS, link_rows(shown))
    if ended:
        if view["ended"]:
            write("")
        write_table(["ended", "peer", "why", "after s", "s ago", "diagnosis"], _ended_rows(view))
    write(*advice({**shown, "ended": []}))


async def _links(host: Host) -> tuple[dict[str, Any], list[Any]]:
    return await host.get("/api/links"), await host.robots()


def _ended_rows(view: dict[str, Any]) -> list[list[str]]:
    return [
        [
            str(link["number"]),
            place(link),
            link["end"],
            f"{link['seconds']:.1f}",
            f"{link['ended_ago_s']:.0f}",
            ", ".join(each["code"] for each in link["diagnosis"]) or "nothing was wrong",
        ]
        for link in view["ended"]
    ]


# -- clients ----------------------------------------------------------------------------------------------------------


def clients(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the programs that are connected: name and role, traffic, and what was dropped because they are too slow."""
    view = ask(url, token, lambda host: host.get("/api/clients"))
    if json:
        write(json_text.dumps(view))
    else:
        write_table(COLUMNS, [_row(client) for client in view["clients"]])
        if view["refused"]:
            write(f"{quantity(view['refused'], 'client was', 'clients were')} refused, because too many were connected")


def _row(client: dict[str, Any]) -> list[str]:
    return [
        client["name"],
        client["kind"],
        client["peer"],
        client["role"],
        f"{client['seconds']:.0f}",
        str(client["messages_from_client"]),
        str(client["messages_to_client"]),
        size(client["bytes_to_client"]),
        str(client["waiting_messages"]),
        duration(client["lag_s"]),
        str(client["dropped"]),
        client["program"],
    ]


# -- capture ----------------------------------------------------------------------------------------------------------

_START = "0-0"  # position from which all kept bytes are fetched


def capture(
    link: Annotated[int | None, typer.Argument(help="Number of the link, as in the log and in `hostlink top`.")] = None,
    *,
    last: Annotated[
        bool,
        typer.Option("--last", help="Save the link that ended last, or else the newest one: after a robot was lost."),
    ] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write; else standard output.")] = None,
    seconds: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Also save what a live link transfers within this time, to catch a fault that occurs now and then.",
        ),
    ] = 0.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Save the raw bytes of a link, as JSON lines that `hostlink inspect` and `hostlink doctor` read.

    The daemon keeps the last 64 KiB of each direction of each live link and of the last 16 that ended.
    """
    if (link is None) != last:
        raise ConfigError("capture", "name a link by its number, or use --last; `hostlink links` lists them")
    saved = CaptureProgress()
    run_until_interrupted(_capture(url, token, link, output, seconds, saved))
    write_error(f"link {saved.link}: {quantity(saved.bytes, 'byte')}{f' in {output}' if output else ''}")


@dataclass(slots=True)
class CaptureProgress:
    """Progress of a capture, which is reported also after Ctrl-C."""

    link: int | None = None
    bytes: int = 0


async def _capture(
    url: str, token: str | None, number: int | None, output: Path | None, seconds: float, saved: CaptureProgress
) -> None:
    async with connected(url, token) as host:
        saved.link = await _last(host) if number is None else number
        with _opened(output) as write:
            async for read in _reads(host, saved.link, seconds):
                write(msgspec.json.encode(read) + b"\n")
                saved.bytes += len(read["hex"]) // 2


@contextlib.contextmanager
def _opened(output: Path | None) -> Iterator[Callable[[bytes], object]]:
    """Open the file, or standard output, for the length of the block.

    Raises:
        ConfigError: the file cannot be opened.
        HostlinkError: the file cannot be written completely.
    """
    if output is None:
        yield sys.stdout.buffer.write
        sys.stdout.buffer.flush()
        return
    try:
        file = output.open("wb")
    except OSError as error:
        raise ConfigError("-o", f"{output} cannot be written: {error.strerror}; name another file") from error
    try:
        with file:
            yield file.write
    except OSError as error:
        raise HostlinkError(
            f"{output} is not complete: {error.strerror}; free some space, or name another file"
        ) from error


async def _last(host: Host) -> int:
    view = await host.get("/api/links")
    numbers = [link["number"] for link in view["ended"][:1] or view["links"][-1:]]
    if not numbers:
        raise BadRequest("no device has connected yet, so there is no link; `hostlink doctor` finds out why")
    return int(numbers[0])


async def _reads(host: Host, number: int, seconds: float) -> AsyncIterator[dict[str, Any]]:
    """Yield the reads that the daemon keeps, then new ones, until the time is over or the link ends."""
    loop = asyncio.get_running_loop()
    until_s = loop.time() + seconds
    position, has_begun = _START, False
    while True:
        piece = await host.get(f"/api/links/{number}/capture/{position}")
        for read in piece["reads"]:
            if has_begun and read.get("event") == "open":
                continue  # nothing was transferred since the first piece
            yield read
        has_begun, position = True, piece["position"]
        if piece["lost_bytes"]:
            write_error(f"{quantity(piece['lost_bytes'], 'earlier byte is', 'earlier bytes are')} lost")
        if loop.time() >= until_s or not piece["is_open"]:
            return
        show_progress(f"link {number}: {until_s - loop.time():.0f} s left ...")
        await asyncio.sleep(min(POLL_S, until_s - loop.time()))
