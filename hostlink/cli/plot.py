"""`hostlink plot`: fields of a recording over time, or the paths on the floor, as a picture."""

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.output import show_progress, write, write_error
from hostlink.errors import ConfigError, HostlinkError, LibraryMissing

SUFFIXES = (".pdf", ".png", ".svg")


def command(
    file: Annotated[Path, typer.Argument(help="As `hostlink record` made it.", show_default=False)],
    fields: Annotated[list[str] | None, typer.Argument(help="As /robot_0/odometry.x; may be several.")] = None,
    *,
    map_: Annotated[bool, typer.Option("--map", help="Draw the paths instead.")] = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="A .png, .svg or .pdf; else beside it.")] = None,
) -> None:
    """Draw fields of a recording over time, or with --map where the robots drove."""
    target = output or file.with_suffix(".png")
    if bool(fields) == map_:
        raise ConfigError("plot", "name fields, as /robot_0/odometry.x, or say --map")
    if target.suffix not in SUFFIXES:
        raise ConfigError("--output", f"{target} must end in one of {', '.join(SUFFIXES)}")
    if importlib.util.find_spec("matplotlib") is None:
        raise LibraryMissing("plot", "matplotlib", "plot")
    # matplotlib and the codec, after what can be refused at once
    from hostlink.recording.plot import draw_fields, draw_map, read_lines, read_paths  # noqa: PLC0415
    from hostlink.recording.source import open_source  # noqa: PLC0415

    source = open_source(file)
    show_progress(f"reading {file}")
    try:
        if map_:
            paths = read_paths(source)
        else:
            lines = read_lines(source, fields or [])
    finally:
        show_progress("")
    for damage in source.damage:
        write_error(f"{file}: {damage}")
    try:
        if map_:
            draw_map(paths, target)
        else:
            draw_fields(lines, target)
    except OSError as error:
        raise HostlinkError(f"{target}: {error.strerror or error}") from error
    write(str(target))
