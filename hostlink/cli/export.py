"""The commands for recordings on this computer: `export`, `plot`, and the content that `info` shows."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import typer

from hostlink.cli.files import check_absent, check_picture, writing
from hostlink.cli.local_time import wall_text
from hostlink.cli.output import quantity, show_progress, write, write_error, write_table
from hostlink.components.recorder.definitions import need_rosbags, why_unknown
from hostlink.components.recorder.reader import Contents, TopicContents, contents_of
from hostlink.errors import ConfigError, size

# -- export -----------------------------------------------------------------------------------------------------------

if TYPE_CHECKING:
    from hostlink.components.recorder.export import Exported


Format = Literal["csv", "ros2", "rosbag2", "ros1"]


def export(
    file: Annotated[
        Path, typer.Argument(help="MCAP file of `hostlink record`, a bag of ROS 1, or a folder or file of rosbag2.")
    ],
    topics: Annotated[
        list[str] | None, typer.Argument(help="Topics to export, by names or patterns: '/robot_0/*'. All without one.")
    ] = None,
    *,
    format_: Annotated[
        Format,
        typer.Option("--to", help="csv: a folder, a table a topic; ros2: MCAP with CDR; rosbag2: SQLite; ros1: a .bag"),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File or folder to write, else next to the recording.")
    ] = None,
    skip_unknown: Annotated[
        bool,
        typer.Option(
            "--skip-unknown", help="Leave out topics that cannot be converted, instead of refusing the export."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
) -> None:
    """Write a recording in a format that other programs read: spreadsheets, `ros2 bag play`, `rosbag play`."""
    suffix = ".bag" if format_ == "ros1" else f"_{format_}"
    target = output or file.parent / f"{file.stem}{suffix}"
    check_absent(target)
    show_progress(f"writing {target}")
    with writing(target, "name another with -o"):
        done = _export(file, target, format_, topics or [], skips_unknown=skip_unknown)
    if as_json:
        facts = {
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
    write(f"{target}: {quantity(done.messages, 'message')}")


def _export(file: Path, target: Path, format_: Format, topics: list[str], *, skips_unknown: bool) -> "Exported":
    from hostlink.components.recorder.reader import open_source  # noqa: PLC0415 - numpy and the codec, only when they are used

    source = open_source(file)
    if format_ == "csv":
        from hostlink.components.recorder.export import export_csv  # noqa: PLC0415 - as above

        return export_csv(source, target, topics=topics, skips_unknown=skips_unknown)[0]
    need_rosbags(f"--to {format_}")
    from hostlink.components.recorder.bags import RosFormat, export_ros  # noqa: PLC0415 - of the extra `export`

    return export_ros(source, target, RosFormat(format_), topics=topics, skips_unknown=skips_unknown)


# -- plot -------------------------------------------------------------------------------------------------------------


def plot(
    file: Annotated[Path, typer.Argument(help="Recording of `hostlink record`.")],
    fields: Annotated[
        list[str] | None, typer.Argument(help="One or more fields, for example /robot_0/odometry.x.")
    ] = None,
    *,
    map_: Annotated[bool, typer.Option("--map", help="Draw the paths of the robots instead of fields.")] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="File to write: .png, .svg or .pdf; else a .png next to the recording."),
    ] = None,
) -> None:
    """Draw fields of a recording over time, or with --map the paths of the robots."""
    target = output or file.parent / f"{file.stem}.png"
    if fields and map_:
        raise ConfigError("plot", "--map draws paths instead of fields; leave the fields or --map out")
    if not fields and not map_:
        raise ConfigError("plot", "name fields, for example /robot_0/odometry.x, or use --map")
    check_picture("--output", target, needs="plot", extra="plot")
    check_absent(target)
    # matplotlib and the codec are imported after the checks that need neither
    from hostlink.components.recorder.plot import draw_fields, draw_map, read_lines, read_paths  # noqa: PLC0415
    from hostlink.components.recorder.reader import open_source  # noqa: PLC0415

    source = open_source(file)
    show_progress(f"reading {file}")
    draw = partial(draw_map, read_paths(source)) if map_ else partial(draw_fields, read_lines(source, fields or []))
    for damage in source.damage:
        write_error(f"{file}: {damage}")
    with writing(target, "name another with -o"):
        draw(target)
    write(str(target))


# -- recording info ---------------------------------------------------------------------------------------------------


def show_recording(file: Path, *, as_json: bool) -> None:
    """Write the content of a recording.

    Raises:
        RecordingFailed: the file cannot be read, or is not a recording.
    """
    found = contents_of(file)
    if as_json:
        write(msgspec.json.encode(_view(found)).decode())
        return
    messages = quantity(found.messages, "message")
    write(
        f"{file}: {size(found.size_bytes)}, {messages}, {found.seconds:.1f} s from {wall_text(found.begin_ns)}",
        *(f"  {name}: {value}" for name, value in found.metadata.items() if value),
        *(f"  the clock was set by {step.step_s:+.1f} s after {step.at_s:.1f} s" for step in found.clock_steps),
        *(f"  damage: {damage}{_mended(file)}" for damage in found.damage),
    )
    if found.topics:
        write("")
    heads = ["topic", "type", "messages", "Hz", "robot", "from", "export"]
    write_table(heads, [_row(topic) for topic in found.topics])


def _mended(file: Path) -> str:
    return (
        f"; hostlink record --repair {file} repairs it" if file.name.endswith((".mcap", ".bag", ".bag.active")) else ""
    )


def _row(topic: TopicContents) -> list[str]:
    channel, rate_hz = topic.channel, topic.rate_hz
    why = why_unknown(channel)
    rate = "" if rate_hz is None else f"{rate_hz:.1f}"
    return [channel.topic, channel.type_name, str(topic.messages), rate, channel.robot, channel.origin, why or "yes"]


def _view(found: Contents) -> dict[str, object]:
    return {
        "file": str(found.path),
        "bytes": found.size_bytes,
        "messages": found.messages,
        "seconds": round(found.seconds, 6),
        "begin_ns": found.begin_ns,
        "clock_steps": [step._asdict() for step in found.clock_steps],
        "metadata": found.metadata,
        "damage": found.damage,
        "topics": [
            {
                "topic": topic.channel.topic,
                "type": topic.channel.type_name,
                "encoding": topic.channel.encoding,
                "robot": topic.channel.robot,
                "origin": topic.channel.origin,
                "not_exported": why_unknown(topic.channel),
                "messages": topic.messages,
                "bytes": topic.payload_bytes,
                "rate_hz": None if topic.rate_hz is None else round(topic.rate_hz, 3),
            }
            for topic in found.topics
        ],
    }
