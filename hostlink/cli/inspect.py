"""`hostlink inspect`: what a recording of a link's bytes says."""

from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from hostlink.cli.output import plain, say
from hostlink.inspection import Inspection, load_reads
from hostlink.messages.catalog import Catalog

LAST_LOGS = 8


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
        say(msgspec.json.encode(report).decode())
    else:
        say(*_lines(report))


def _lines(report: dict[str, Any]) -> list[str]:
    lines = [
        f"connections {report['connections']}   time requests {report['time_requests']}   "
        f"skipped bytes {report['skipped_bytes']}"
    ]
    topics = [[topic["id"], topic["kind"], topic["name"], topic["type"]] for topic in report["topics"]]
    lines += table(["id", "kind", "topic", "type"], topics)
    for title, key in (("from device", "messages"), ("to device", "to_device")):
        series = report[key].items()
        lines += table([title, "count", "last"], [[name, item["count"], _short(item["last"])] for name, item in series])
    services = report["services"].items()
    lines += table(
        ["service", "requests", "responses"], [[name, item["requests"], item["responses"]] for name, item in services]
    )
    lines += table(["parameter", "reply"], [[item["name"], _short(item["reply"])] for item in report["parameters"]])
    logs = report["logs"][-LAST_LOGS:]
    return lines + table(
        ["level", f"log, the last of {len(report['logs'])} lines"], [[x["level"], x["msg"]] for x in logs]
    )


def table(head: list[str], rows: list[list[Any]]) -> list[str]:
    """Columns under a head; nothing where there are no rows."""
    if not rows:
        return []
    cells = [head, *([plain(str(cell)) for cell in row] for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    return [
        "",
        *("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells),
    ]


def _short(value: Any) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= 100 else text[:97] + "..."  # noqa: PLR2004 - what a line of a terminal holds
