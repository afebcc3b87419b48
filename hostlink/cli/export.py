"""`hostlink export`: a recording as CSV, as a bag of ROS 2 or as one of ROS 1."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypedDict

import msgspec
import typer

from hostlink.cli.output import show_progress, write, write_error
from hostlink.errors import ConfigError, HostlinkError
from hostlink.recording.reader import Reader


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
    file: Annotated[Path, typer.Argument(help="As `hostlink record` made it.", show_default=False)],
    *,
    format_: Annotated[
        Format,
        typer.Option("--to", help="csv: a folder, a table a topic; ros2: MCAP with CDR; rosbag2: SQLite; ros1: a .bag"),
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Else beside the recording.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON, for programs.")] = False,
) -> None:
    """Write a recording in a format that other programs read: spreadsheets, `ros2 bag play`, `rosbag play`."""
    target = output or file.with_name(f"{file.stem}{'.bag' if format_ is Format.ROS1 else f'_{format_.value}'}")
    if target.exists():
        raise ConfigError("--output", f"{target} is there already; choose another name, or remove it")
    show_progress(f"writing {target}")
    try:
        facts = _csv(file, target) if format_ is Format.CSV else _ros(file, target, format_)
    except OSError as error:
        raise HostlinkError(f"{target}: {error.strerror or error}") from error
    finally:
        show_progress("")
    if as_json:
        write(msgspec.json.encode(facts).decode())
        return
    for topic, reason in facts["left_out"].items():
        write_error(f"{topic} is left out: {reason}")
    for damage in facts["damage"]:
        write_error(f"{file}: {damage}")
    write(f"{target}: {facts['messages']} messages")


def _csv(file: Path, target: Path) -> _Facts:
    from hostlink.recording.export_csv import export_csv  # noqa: PLC0415 - numpy and the codec, for this format alone

    reader = Reader(file)
    lines = export_csv(reader, target)
    return {"output": str(target), "messages": sum(lines.values()), "left_out": {}, "damage": reader.damage}


def _ros(file: Path, target: Path, format_: Format) -> _Facts:
    from hostlink.recording.export_ros import RosFormat, export_ros  # noqa: PLC0415 - as above

    reader = Reader(file)
    done = export_ros(reader, target, RosFormat(format_.value))
    return {"output": str(target), "messages": done.messages, "left_out": done.left_out, "damage": reader.damage}
