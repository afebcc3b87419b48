"""`hostlink lab`: the paper's measurements, driven again."""

import contextlib
import importlib.util
import json as json_text
import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated, assert_never

import typer

from hostlink.cli.output import show_progress, write
from hostlink.errors import ConfigError, LibraryMissing
from hostlink.lab import reports
from hostlink.lab.experiment import Laboratory
from hostlink.lab.tables import CASTER_WORLD
from hostlink.sim.firmware_module import WorldParameters, read, require_wasmtime


class What(StrEnum):
    """What to find out."""

    CAUSES = "causes"
    TABLES = "tables"
    CLAIMS = "claims"
    PICTURES = "pictures"


def command(
    what: Annotated[What, typer.Argument(help="causes, tables, claims or pictures.", show_default=False)],
    *,
    runs: Annotated[
        int | None, typer.Option(min=2, max=1000, help="Of each pattern.", show_default="12; causes 4; of the fit 6")
    ] = None,
    world: Annotated[
        Path | None, typer.Option(help="Lines name=value: the world of tables and pictures.", show_default=False)
    ] = None,
    fit: Annotated[bool, typer.Option("--fit", help="tables: fit the causes to the paper's numbers.")] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="pictures: the PNG.")] = Path("laboratory.png"),
    json: Annotated[bool, typer.Option("--json", help="One JSON object for programs.")] = False,
) -> None:
    """Drive the paper's measurements again, in a world that is known, with its software and with ours.

    causes: what each cause alone does to each of the paper's patterns. tables: tables 2-5 beside the paper's numbers.
    claims: which numbers the paper's tables need, with intervals. pictures: each path, true and by odometry.
    """
    if fit and what is not What.TABLES:
        raise ConfigError("--fit", "goes with: hostlink lab tables")
    if world is not None and what not in (What.TABLES, What.PICTURES):
        raise ConfigError("--world", "goes with: hostlink lab tables, hostlink lab pictures")
    if what is What.PICTURES:
        _require_picture(output)
    _require("matplotlib" if what is What.PICTURES else "scipy" if fit else None)
    require_wasmtime("hostlink lab")
    chosen = CASTER_WORLD if world is None else _read(world)
    try:
        with Laboratory() as laboratory:
            report = _report(laboratory, what, runs, chosen, output)
            report = report + _fit(laboratory, runs) if fit else report
    finally:
        with contextlib.suppress(OSError):
            show_progress("")
    write(*([json_text.dumps(report.view)] if json else report.lines))


def _report(
    laboratory: Laboratory, what: What, runs: int | None, world: WorldParameters, output: Path
) -> reports.LabReport:
    match what:
        case What.CAUSES:
            return reports.causes(laboratory, runs or reports.CAUSE_RUNS, show_progress)
        case What.TABLES:
            return reports.tables(laboratory, world, runs or reports.TABLE_RUNS, show_progress)
        case What.CLAIMS:
            return reports.claims(laboratory, runs or reports.TABLE_RUNS, show_progress)
        case What.PICTURES:
            return _draw(world, runs or reports.PICTURE_RUNS, output)
        case _:
            assert_never(what)


def _draw(world: WorldParameters, runs: int, output: Path) -> reports.LabReport:
    from hostlink.lab.pictures import draw_software  # noqa: PLC0415 - needs matplotlib

    show_progress("drawing")
    try:
        draw_software(world, runs, output)
    except OSError as error:
        raise ConfigError(str(output), error.strerror or str(error)) from None
    kibibytes = output.stat().st_size // 1024
    return reports.LabReport([f"{output}: {kibibytes} KiB"], {"file": str(output), "kibibytes": kibibytes})


def _fit(laboratory: Laboratory, runs: int | None) -> reports.LabReport:
    from hostlink.lab.fit import FIT_RUNS, report_fit  # noqa: PLC0415 - needs scipy

    return report_fit(laboratory, show_progress, runs=runs or FIT_RUNS)


def _require_picture(file: Path) -> None:
    """Refuse before anything is driven.

    Raises:
        ConfigError: no PNG can be written there.
    """
    if file.suffix != ".png":
        raise ConfigError("--output", f"{file} must end in .png")
    if not os.access(file.parent, os.W_OK):
        raise ConfigError("--output", f"there is no folder {file.parent} that can be written")


def _require(library: str | None) -> None:
    """Refuse before anything is driven.

    Raises:
        ConfigError: the library is not installed.
    """
    if library is not None and importlib.util.find_spec(library) is None:
        raise LibraryMissing("hostlink lab", library, "lab")


def _read(file: Path) -> WorldParameters:
    """A world from a file.

    Raises:
        ConfigError: it cannot be read, or is none.
    """
    try:
        return read(file.read_text())
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise ConfigError(str(file), str(error)) from None
