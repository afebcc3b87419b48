"""`hostlink incidents`: what happened to robots; the last minutes of each are in a file."""

import asyncio
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.fetching import check_output, fetch
from hostlink.cli.output import table, write, write_error
from hostlink.client import DEFAULT_URL, connect
from hostlink.errors import ConfigError

_PATH = "/api/incidents"


def command(
    name: Annotated[str | None, typer.Argument(help="The file of one, as the list names it; with --output.")] = None,
    *,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Where to put that file.")] = None,
    save: Annotated[str | None, typer.Option(metavar="ROBOT", help="Save this robot's last minutes now.")] = None,
    reason: Annotated[str, typer.Option(help="With --save: why.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="JSON, for programs.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """List what happened to robots: locks, drivers that vanished, links that broke, errors, what doctor found.

    The daemon has the two minutes before each and the half minute after in an MCAP file.
    """
    if (name is None) != (output is None):
        raise ConfigError("incidents", "name the file of one, and say where to put it with -o FILE")
    if output is not None:
        check_output(output)
    asyncio.run(_work(url, token, name, output, save, reason, as_json=as_json))


async def _work(
    url: str,
    token: str | None,
    name: str | None,
    output: Path | None,
    save: str | None,
    reason: str,
    *,
    as_json: bool,
) -> None:
    async with connect(url, token=token, reconnect=False) as host:
        if save is not None:
            view = await host.post(_PATH, {"robot": save, "reason": reason})
            write_error("it is saved when the time after it is over: hostlink incidents")
        elif name is not None and output is not None:
            await fetch(host, f"{_PATH}/{name}", output)
            write(str(output))
            return
        else:
            view = await host.get(_PATH)
    if as_json:
        write(msgspec.json.encode(view).decode())
    elif save is None:
        rows = [
            [each["at"], each["robot"], each["cause"], each["file"] or "being saved", each["detail"]]
            for each in view["incidents"]
        ]
        write(*(table(["when", "robot", "cause", "file", "detail"], rows)[1:] or ["nothing has happened"]))
