"""`hostlink export`: a recording as CSV, as a bag of ROS 2 or as one of ROS 1."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypedDict

import msgspec
import typer

from hostlink.cli.output import show_progress, write, write_error
from hostlink.errors import ConfigError, HostlinkError

if TYPE_CHECKING:
    from hostlink.recording.export import Exported


class Format(StrEnum):
    """What a recording becomes."""

    CSV = "csv"
    ROS2 = "ros2"
    ROSBAG2 = "rosbag2"
    ROS1 = "ros1"


class _Facts(TypedDict):
    output: str
    messages: int
    left_out: dict[str, str]
    damage: list[str]


def command(
    file: Annotated[
        Path,
        typer.Argument(
            help="An MCAP file, as `hostlink record` made it; a bag of ROS 1; a folder or file of rosbag2.",
            show_default=False,
        ),
    ],
    topics: Annotated[list[str] | None, typer.Argument(help="Names, or patterns: '/robot_0/*'. None: all.")] = None,
    *,
    format_: Annotated[
        Format,
        typer.Option("--to", help="csv: a folder, a table a topic; ros2: MCAP with CDR; rosbag2: SQLite; ros1: a .bag"),
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Else beside the recording.")] = None,
    skip_unknown: Annotated[
        bool, typer.Option("--skip-unknown", help="Leave out topics that cannot be converted; else they are an error.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="JSON, for programs.")] = False,
) -> None:
    """Write a recording in a format that other programs read: spreadsheets, `ros2 bag play`, `rosbag play`."""
    target = output or file.with_name(f"{file.stem}{'.bag' if format_ is Format.ROS1 else f'_{format_.value}'}")
    if target.exists():
        raise ConfigError("--output", f"{target} is there already; choose another name, or remove it")
    show_progress(f"writing {target}")
    try:
        done = _export(file, target, format_, topics or [], skips_unknown=skip_unknown)
    except OSError as error:
        raise HostlinkError(f"{target}: {error.strerror or error}") from error
    finally:
        show_progress("")
    if as_json:
        facts: _Facts = {
            "output": str(target),
            "messages": done.messages,
            "left_out": done.left_out,
            "damage": done.damage,
        }
        write(msgspec.json.encode(facts).decode())
        return
    for topic, reason in done.left_out.items():
        write_error(f"{topic} is left out: {reason}")
    for damage in done.damage:
        write_error(f"{file}: {damage}")
    write(f"{target}: {done.messages} messages")


def _export(file: Path, target: Path, format_: Format, topics: list[str], *, skips_unknown: bool) -> "Exported":
    from hostlink.recording.source import open_source  # noqa: PLC0415 - numpy and the codec, when they are used

    source = open_source(file)
    if format_ is Format.CSV:
        from hostlink.recording.export_csv import export_csv  # noqa: PLC0415 - as above

        return export_csv(source, target, topics=topics, skips_unknown=skips_unknown)[0]
    from hostlink.recording.export_ros import RosFormat, export_ros  # noqa: PLC0415 - as above

    return export_ros(source, target, RosFormat(format_.value), topics=topics, skips_unknown=skips_unknown)
