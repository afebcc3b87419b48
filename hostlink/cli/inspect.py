"""`hostlink inspect`: what a recording of a link's bytes says."""

import sys
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.messages.catalog import Catalog
from hostlink.recording import Inspection, load_reads


def command(
    file: Annotated[Path, typer.Argument(help="A recording: JSON lines with t, dir, hex, conn.", show_default=False)],
    *,
    messages: Annotated[
        list[Path] | None, typer.Option(help="A folder of .msg and .srv files; may be given more than once.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object for programs.")] = False,
) -> None:
    """Decode a recording of a link, both directions, however its reads cut the frames."""
    inspection = Inspection(Catalog(messages or ()))
    inspection.take_all(load_reads(file))
    report = inspection.report()
    if json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    else:
        sys.stdout.write("\n".join(_lines(report)) + "\n")


def _lines(report: dict[str, Any]) -> list[str]:
    lines = [
        f"connections {report['connections']}   time requests {report['time_requests']}   "
        f"skipped bytes {report['skipped_bytes']}",
        "",
        f"{'id':>5}  {'kind':<15} {'topic':<34} type",
        *(f"{topic['id']:>5}  {topic['kind']:<15} {topic['name']:<34} {topic['type']}" for topic in report["topics"]),
    ]
    for title, key in (("from device", "messages"), ("to device", "to_device")):
        lines += ["", f"{title:<14} {'count':>7}  last"]
        lines += [f"{name:<14} {series['count']:>7}  {_short(series['last'])}" for name, series in report[key].items()]
    if report["services"]:
        lines += ["", "service        requests  responses"]
        lines += [
            f"{name:<14} {counts['requests']:>8}  {counts['responses']:>9}"
            for name, counts in report["services"].items()
        ]
    if report["parameters"]:
        lines += ["", "parameter      reply"]
        lines += [f"{item['name']:<14} {_short(item['reply'])}" for item in report["parameters"]]
    if report["logs"]:
        lines += ["", f"log lines {len(report['logs'])}, the last ones:"]
        lines += [f"  {log['level']} {_short(log['msg'])}" for log in report["logs"][-8:]]
    return lines


def _short(value: Any) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= 100 else text[:97] + "..."  # noqa: PLR2004 - what a line of a terminal holds
