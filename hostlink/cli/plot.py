"""`hostlink plot`: fields of a recording over time, or the paths on the floor, as a picture."""

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.output import show_progress, write, write_error
from hostlink.errors import ConfigError, HostlinkError

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
        raise ConfigError("plot", "needs matplotlib: pip install 'hostlink[plot]'")
    from hostlink.recording.plot import draw_fields, draw_map  # noqa: PLC0415 - after what can be refused at once
    from hostlink.recording.tables import read  # noqa: PLC0415

    show_progress(f"reading {file}")
    tables = read(file)
    show_progress("")
    for damage in tables.damage:
        write_error(f"{file}: {damage}")
    try:
        if map_:
            draw_map(tables, target)
        else:
            draw_fields(tables, fields or [], target)
    except OSError as error:
        raise HostlinkError(f"{target}: {error.strerror or error}") from error
    write(str(target))
