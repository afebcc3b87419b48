"""`hostlink doctor`: what is wrong with the devices, and what to do about it.

Exit status: 0 nothing is wrong, 1 something is, 2 the arguments are.
"""

import asyncio
import contextlib
import dataclasses
import importlib
import json as json_text
from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from hostlink.cli.addresses import parse_address, parse_serial
from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.output import show_progress, write, write_error
from hostlink.cli.report import Report, report_lines, report_of
from hostlink.client import DEFAULT_URL
from hostlink.diagnosis.finding import finding
from hostlink.errors import HostlinkError

LISTEN = "0.0.0.0:11411"


def command(
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
    report: Report
    folders = tuple(messages or ())
    if file is not None:
        report = _probe().probe_capture(file, folders)
    elif serial is not None:
        report = asyncio.run(_probe().probe_port(parse_serial(serial), folders, _show_progress))
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
        if url != DEFAULT_URL or not isinstance(error.__cause__, OSError):  # named by the user; or there is a daemon
            raise
        write_error(str(error))
        return await _listen(LISTEN, seconds, folders)
    report = report_of(view, url, robots)
    if not report["links"] and not report["findings"]:
        refused = ", ".join(f"{cause} {count}" for cause, count in view["refused"].items())
        found = finding("not_let_in", refused) if refused else finding("no_device")
        report["findings"].append(dataclasses.asdict(found))
    return report


async def _listen(address: str, seconds: float, folders: tuple[Path, ...]) -> Report:
    host, port = parse_address("--listen", address, "0.0.0.0")  # noqa: S104
    report: Report = await _probe().probe_network(host, port, seconds, folders, _show_progress)
    return report


def _probe() -> ModuleType:
    """What listens by itself, with a log of its own: a whole daemon. Where one runs, nobody waits for these imports."""
    importlib.import_module("hostlink.logs").configure(level="critical")
    return importlib.import_module("hostlink.cli.probe")


def _show_progress(line: str) -> None:
    show_progress(f"{line} ...")
