"""`hostlink doctor`: what is wrong with the devices, and what to do about it.

Exit status: 0 nothing is wrong, 1 something is, 2 the arguments are.
"""

import asyncio
import contextlib
import json as json_text
from pathlib import Path
from typing import Annotated

import typer

from hostlink import logs
from hostlink.api.views import finding_views
from hostlink.cli.addresses import parse_address, parse_serial
from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.output import show_progress, write, write_error
from hostlink.cli.probe import probe_capture, probe_network, probe_port
from hostlink.cli.report import Report, report_lines, report_of
from hostlink.client import DEFAULT_URL
from hostlink.diagnosis.finding import finding
from hostlink.errors import HostlinkError

LISTEN = "0.0.0.0:11411"


def command(  # noqa: PLR0913 - the options of a command line
    file: Annotated[Path | None, typer.Argument(help="A recording: diagnose that.", show_default=False)] = None,
    *,
    serial: Annotated[
        str | None, typer.Option(help="Listen on this serial port: /dev/ttyACM0@57600.", show_default=False)
    ] = None,
    listen: Annotated[
        str | None, typer.Option(help="Listen here for devices: HOST:PORT.", show_default=f"{LISTEN}, without a daemon")
    ] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="How long to listen.")] = 15.0,
    messages: Annotated[
        list[Path] | None, typer.Option(help="A folder of .msg and .srv files. May be repeated.")
    ] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Find what is wrong with the devices, why, and what to do next.

    Queries the running daemon. Without one it listens for devices itself, on a serial port, or reads a recording.
    Exit status: 0 nothing is wrong, 1 something is.
    """
    logs.configure(level="critical")
    folders = tuple(messages or ())
    if file is not None:
        report = probe_capture(file, folders)
    elif serial is not None:
        report = asyncio.run(probe_port(parse_serial(serial), folders, _show_progress))
    elif listen is not None:
        report = asyncio.run(_listen(listen, seconds, folders))
    else:
        report = asyncio.run(_query_or_listen(url, token, seconds, folders))
    with contextlib.suppress(OSError):
        show_progress("")
    write(*([json_text.dumps(report)] if json else report_lines(report)))
    is_healthy = not report["findings"] and not any(link["diagnosis"] for link in report["links"])
    raise typer.Exit(0 if is_healthy else 1)


async def _query_or_listen(url: str, token: str | None, seconds: float, folders: tuple[Path, ...]) -> Report:
    try:
        async with connected(url, token) as host:
            view, robots = await host.get("/api/links"), await host.robots()
    except HostlinkError as error:
        write_error(str(error))
        if url != DEFAULT_URL:  # named by the user: another daemon is no answer
            raise
        return await _listen(LISTEN, seconds, folders)
    report = report_of(view, url, robots)
    if not report["links"] and not report["findings"]:
        refused = ", ".join(f"{cause} {count}" for cause, count in view["refused"].items())
        report["findings"] += finding_views([finding("not_let_in", refused) if refused else finding("no_device")])
    return report


async def _listen(address: str, seconds: float, folders: tuple[Path, ...]) -> Report:
    return await probe_network(*parse_address("--listen", address, "0.0.0.0"), seconds, folders, _show_progress)  # noqa: S104


def _show_progress(line: str) -> None:
    show_progress(f"{line} ...")
