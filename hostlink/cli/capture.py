"""`hostlink capture`: the raw bytes of a link into a file, also of one that has ended."""

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.following import run_until_interrupted
from hostlink.cli.output import show_progress, write_error
from hostlink.client import DEFAULT_URL, Host
from hostlink.errors import BadRequest, ConfigError, HostlinkError

POLL_S = 0.5  # 64 KiB last longer at any speed of a serial line
_START = "0-0"


def command(
    link: Annotated[int | None, typer.Argument(help="Its number, as the log and `hostlink top` show it.")] = None,
    *,
    last: Annotated[bool, typer.Option("--last", help="The link that ended last, or the newest.")] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="A file; standard output without it.")] = None,
    seconds: Annotated[float, typer.Option(min=0.0, help="Follow a live link for this time.")] = 0.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Save the raw bytes of a link, as JSON lines that `hostlink inspect` and `hostlink doctor` read.

    The daemon keeps the last 64 KiB of each direction, of the live links and of the last 16 that ended.
    """
    if (link is None) != last:
        raise ConfigError("capture", "name a link by its number, or say --last")
    saved = Saved()
    run_until_interrupted(_capture(url, token, link, output, seconds, saved))
    show_progress("")
    write_error(f"link {saved.link}: {saved.bytes} bytes{f' in {output}' if output else ''}")


@dataclass(slots=True)
class Saved:
    """What was saved so far: reported also after Ctrl-C."""

    link: int | None = None
    bytes: int = 0


async def _capture(
    url: str, token: str | None, number: int | None, output: Path | None, seconds: float, saved: Saved
) -> None:
    async with connected(url, token) as host:
        saved.link = await _last(host) if number is None else number
        with _opened(output) as write:
            async for read in _reads(host, saved.link, seconds):
                write(msgspec.json.encode(read) + b"\n")
                saved.bytes += len(read["hex"]) // 2


@contextlib.contextmanager
def _opened(output: Path | None) -> Iterator[Callable[[bytes], object]]:
    """How to write for the length of the block.

    Raises:
        ConfigError: the file cannot be opened.
        HostlinkError: it cannot be written to its end.
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
        raise HostlinkError(f"{output} is not complete: {error.strerror}") from error


async def _last(host: Host) -> int:
    view = await host.get("/api/links")
    numbers = [link["number"] for link in view["ended"][:1] or view["links"][-1:]]
    if not numbers:
        raise BadRequest("no link has ended, and none is there: no device has connected")
    return int(numbers[0])


async def _reads(host: Host, number: int, seconds: float) -> AsyncIterator[dict[str, Any]]:
    """What is kept, then what comes, until the time is over or the link is."""
    loop = asyncio.get_running_loop()
    until_s = loop.time() + seconds
    position, has_begun = _START, False
    while True:
        piece = await host.get(f"/api/links/{number}/capture/{position}")
        for read in piece["reads"]:
            if has_begun and read.get("event") == "open":
                continue  # nothing has passed since the first piece
            yield read
        has_begun, position = True, piece["position"]
        if piece["lost_bytes"]:
            write_error(f"{piece['lost_bytes']} bytes before that are lost")
        if loop.time() >= until_s or not piece["is_open"]:
            return
        show_progress(f"link {number}: {until_s - loop.time():.0f} s left ...")
        await asyncio.sleep(min(POLL_S, until_s - loop.time()))
