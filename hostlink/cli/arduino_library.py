"""`hostlink arduino-library`: rosserial for boards as a ZIP for the Arduino IDE, PlatformIO and CMake."""

import os
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from hostlink.board.library import TypeSelection, known_names, library, pack, select, sources, types_needed
from hostlink.cli.arguments import Json
from hostlink.cli.files import check_new_file, replacing
from hostlink.cli.names import LISTED, near
from hostlink.cli.output import show_progress, write
from hostlink.errors import ConfigError
from hostlink.messages.catalog import Catalog, check_not_empty


def command(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The ZIP.")] = Path("hostlink_rosserial.zip"),
    messages: Annotated[
        list[Path] | None,
        typer.Option("--messages", help="A folder of packages with .msg and .srv files. May be repeated."),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Packages or types, as geometry_msgs,std_msgs/String; what they contain comes along."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    json: Json = False,
) -> None:
    """Write rosserial for boards with a header for each message and service: for the Arduino IDE, PlatformIO, CMake."""
    check_new_file("--output", output, is_forced=force, example="hostlink_rosserial.zip")
    show_progress("reading the definitions")
    catalog = Catalog(messages or ())
    for folder in messages or ():
        check_not_empty(folder)
    texts = sources()
    selection = _select(catalog, only, types_needed(texts))
    show_progress(f"writing {output}")
    packed = pack(library(texts, selection))
    with replacing("--output", output) as beside:
        beside.write_bytes(packed)
    show_progress("")
    _report(output, selection, len(packed), as_json=json)


def _select(catalog: Catalog, only: list[str] | None, needed: Collection[str]) -> TypeSelection:
    """The types of --only, and those that the library's own sources need.

    Raises:
        ConfigError: a name is not known, or a definition is wrong.
    """
    if only is None:
        return select(catalog, None)
    names = [name.strip() for names in only for name in names.split(",") if name.strip()]
    known = known_names(catalog)
    if not names:
        raise ConfigError("--only", "names nothing; name packages or types, as geometry_msgs,std_msgs/String")
    for name in names:
        if name not in known:
            raise ConfigError("--only", f"no package or type named {name}; {_hint(name, known)}")
    return select(catalog, {*names, *needed})


def _hint(name: str, known: Iterable[str]) -> str:
    found = near(name, known)
    packages = sorted({each.partition("/")[0] for each in known})
    return f"near it: {', '.join(found)}" if found else f"there is: {', '.join(packages[:LISTED])} ..."


def _report(output: Path, selection: TypeSelection, size_bytes: int, *, as_json: bool) -> None:
    if as_json:
        facts = {
            "output": os.fsencode(output).decode(errors="replace"),
            "bytes": size_bytes,
            "messages": [message.name for message in selection.messages],
            "services": [service.name for service in selection.services],
        }
        write(msgspec.json.encode(facts).decode())
        return
    counts = f"{len(selection.messages)} messages and {len(selection.services)} services"
    write(
        f"{output}: {counts} of {len(selection.packages)} packages, {size_bytes / 1000:.0f} kB. Next, one of:",
        "  Arduino IDE: Sketch > Include Library > Add .ZIP Library...",
        f"  PlatformIO:  lib_deps = file://{output.resolve()}",  # as it is: PlatformIO decodes no %20
        "  CMake:       unpack it, then add_subdirectory(hostlink_rosserial)",
    )
