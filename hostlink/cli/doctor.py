"""`hostlink doctor`: diagnosis of the devices, with a next step for each finding."""

import asyncio
import importlib
import json as json_text
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer

from hostlink.cli.addresses import parse_address, parse_serial
from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.figures import finding_lines, place
from hostlink.cli.files import MessageFolders
from hostlink.cli.output import duration, quantity, show_progress, write, write_error
from hostlink.client import DEFAULT_URL
from hostlink.errors import HostlinkError

# -- report -----------------------------------------------------------------------------------------------------------

Report = dict[str, Any]  # {"source", "links", "findings"}: what `hostlink doctor --json` prints

RECENT_END_S = 60.0
YOUNG_S = 10.0  # a younger link may not have shown its fault yet, but the link before it has
MAX_NAMES = 6  # of topics in a line

LISTEN = "0.0.0.0:11411"


def report_of(view: dict[str, Any], source: str, robots: Sequence[Any] = ()) -> Report:
    """Return the live links of a daemon, and the recently ended ones that explain more."""
    by_link = {robot["link"]: robot for robot in robots}
    live = [_live(link, by_link.get(link["number"])) for link in view["links"]]
    gone: dict[str, Report] = {}
    for link in view["ended"]:  # the latest first
        if link["ended_ago_s"] < RECENT_END_S and _explains_more(link, _successor(link, live)):
            gone.setdefault(_device(link), {"topics": 0, **link})
    findings = [each for port in view["ports"] for each in port["diagnosis"]]
    return {"source": source, "links": live + list(gone.values()), "findings": findings}


def rates(counts: dict[str, Any], seconds: float) -> Report:
    """Return the mean rates of a link since it opened, from its counters."""
    came = counts["bytes_from_device"]
    return {
        "frames_from_device_s": round(counts["frames_from_device"] / max(seconds, 1e-3), 1),
        "frames_to_device_s": round(counts["frames_to_device"] / max(seconds, 1e-3), 1),
        "lost_percent": round(100 * counts["skipped_bytes"] / came, 1) if came else 0.0,
        "lost_messages": counts.get("lost_messages", 0),  # an older daemon does not count them
    }


def _live(link: dict[str, Any], robot: Report | None) -> Report:
    keys = ("number", "transport", "protocol", "peer", "robot", "seconds", "diagnosis", "silent_s")
    known = {key: link[key] for key in keys if key in link}
    names = sorted({info["name"] for info in link["topics"]})
    odometry = None if robot is None else robot["odometry"]
    return {
        **known,
        **rates(link, link["seconds"]),
        "topics": len(link["topics"]),
        "names": names,
        "odometry": odometry and {key: odometry[key] for key in ("rate_hz", "age_s")},
        "driver": None if robot is None else robot["holder"],
        "end": None,
    }


def _successor(ended: Report, live: list[Report]) -> Report | None:
    """Return the live link of the robot whose link has ended; without a robot, any link of the device's address."""
    if ended["robot"] is not None:
        return next((link for link in live if link["robot"] == ended["robot"]), None)
    return next((link for link in live if _host(link) == _host(ended)), None)


def _explains_more(ended: Report, live: Report | None) -> bool:
    """Whether an ended link explains more than the device's live link, if it has one."""
    if live is None:
        return True
    return bool(ended["diagnosis"]) and not live["diagnosis"] and live["seconds"] < YOUNG_S


def _device(link: Report) -> str:
    return link["robot"] or _host(link)


def _host(link: Report) -> str:
    peer: str = link["peer"]
    return peer.rpartition(":")[0] or peer


# -- text -------------------------------------------------------------------------------------------------------------


def report_lines(report: Report) -> list[str]:
    """Return the findings that belong to no link, then those of each link."""
    lines = [line for found in report["findings"] for line in finding_lines(found)]
    return lines + [line for link in report["links"] for line in _link_lines(link)]


def _link_lines(link: Report) -> Iterator[str]:
    state = f"ended: {link['end']}" if link["end"] else f"{link['seconds']:.0f} s"
    baud = f", {link['baud']} baud" if link.get("baud") else ""
    way = ", UDP" if link.get("transport") == "udp" else ""
    robot = f"  {link['robot']}" if link.get("robot") else ""
    well = "" if link["diagnosis"] else "  nothing was wrong" if link["end"] else "  healthy"
    topics = quantity(link["topics"], "topic")
    yield f"link {link['number']}  {place(link)}{robot}  ({state}, {topics}{baud}{way}){well}"
    yield from (f"  {line}" for found in link["diagnosis"] for line in finding_lines(found))
    if link.get("frames_from_device_s"):
        yield f"  {_rates_line(link)}"
    if link.get("odometry"):
        odometry = link["odometry"]
        age = duration(odometry["age_s"])
        yield f"  odometry {odometry['rate_hz']:.1f} Hz, {age} old; driven by {link['driver'] or 'nobody'}"
    if link.get("names"):
        more = len(link["names"]) - MAX_NAMES
        yield f"  topics {', '.join(link['names'][:MAX_NAMES])}{f' and {more} more' if more > 0 else ''}"


def _rates_line(link: Report) -> str:
    losses = [f"{link['lost_percent']} % of its bytes"] if link["lost_percent"] else []
    losses += [quantity(link["lost_messages"], "message")] if link["lost_messages"] else []
    lost = f"{' and '.join(losses) or 'nothing'} lost"
    silent = "" if link["silent_s"] is None else f", last heard {duration(link['silent_s'])} ago"
    to_device = "" if link["frames_to_device_s"] is None else f", {link['frames_to_device_s']} to it"
    return f"{link['frames_from_device_s']} frames/s from it{to_device}, {lost}{silent}"


# -- doctor -----------------------------------------------------------------------------------------------------------


def command(
    file: Annotated[Path | None, typer.Argument(help="Recording of a link's bytes to diagnose.")] = None,
    *,
    serial: Annotated[
        str | None, typer.Option(help="Diagnose the device on this serial port, without a daemon: /dev/ttyACM0@57600.")
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(
            help="Wait for devices at this address, without a daemon: HOST:PORT.",
            show_default=f"{LISTEN}, without a daemon",
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, help="Time to wait for devices: longer for one that connects rarely.")
    ] = 15.0,
    messages: MessageFolders = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
) -> None:
    """Find faults of devices, their causes and the next steps.

    Queries the running daemon. Without a daemon it waits for devices itself, opens a serial port or reads a recording.
    Exit status: 0 without a finding, 1 with a finding.
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
    write(*([json_text.dumps(report)] if json else report_lines(report)))
    is_healthy = not report["findings"] and not any(link["diagnosis"] for link in report["links"])
    raise typer.Exit(0 if is_healthy else 1)


async def _query_or_listen(url: str, token: str | None, seconds: float, folders: tuple[Path, ...]) -> Report:
    try:
        async with connected(url, token) as host:
            view, robots = await host.get("/api/links"), await host.robots()
            diagnosis = await host.get("/api/diagnosis")
    except HostlinkError as error:
        if url != DEFAULT_URL or not isinstance(
            error.__cause__, OSError
        ):  # the user named the address, or a daemon answers
            raise
        write_error(str(error))
        return await _listen(LISTEN, seconds, folders)
    return {**report_of(view, url, robots), "findings": diagnosis["findings"]}


async def _listen(address: str, seconds: float, folders: tuple[Path, ...]) -> Report:
    host, port = parse_address("--listen", address, "0.0.0.0")  # noqa: S104
    report: Report = await _probe().probe_network(host, port, seconds, folders, _show_progress)
    return report


def _probe() -> ModuleType:
    """Import the probe, which contains a whole daemon and would slow down a query of a running one."""
    importlib.import_module("hostlink.core.runtime.logs").configure(level="critical")
    return importlib.import_module("hostlink.cli.probe")


def _show_progress(line: str) -> None:
    show_progress(f"{line} ...")
