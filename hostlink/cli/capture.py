"""`hostlink capture`: the raw bytes of a link into a file, also of one that has ended."""

import asyncio
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.output import write_error
from hostlink.client import DEFAULT_URL, Host, connect
from hostlink.errors import BadRequest, ConfigError

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
    asyncio.run(_capture(url, token, link, output, seconds))


async def _capture(url: str, token: str | None, number: int | None, output: Path | None, seconds: float) -> None:
    async with connect(url, token=token, reconnect=False) as host:
        wanted = await _last(host) if number is None else number
        out = sys.stdout.buffer if output is None else output.open("wb")
        count = 0
        try:
            async for read in _reads(host, wanted, seconds):
                out.write(msgspec.json.encode(read) + b"\n")
                count += len(read["hex"]) // 2
            out.flush()
        finally:
            if output is not None:
                out.close()
    write_error(f"link {wanted}: {count} bytes{f' in {output}' if output else ''}")


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
        await asyncio.sleep(min(POLL_S, until_s - loop.time()))
