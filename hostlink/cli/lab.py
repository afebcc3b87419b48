"""`hostlink lab`: repeat the paper's measurements in a simulated world."""

from pathlib import Path
from typing import Annotated, Literal, assert_never

import typer

from hostlink.cli.files import check_folder, check_picture
from hostlink.cli.output import show_progress, write
from hostlink.cli.sim import read_world
from hostlink.errors import ConfigError, size
from hostlink.workbench.lab import reports
from hostlink.workbench.lab.experiment import Laboratory
from hostlink.workbench.lab.tables import CASTER_WORLD
from hostlink.workbench.sim.firmware_module import WorldParameters, require_wasmtime

Report = Literal["causes", "tables", "claims", "pictures"]


def command(
    what: Annotated[Report, typer.Argument(help="Report to make: causes, tables, claims or pictures.")],
    *,
    runs: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=1000,
            help="Runs of each pattern: more for narrower intervals.",
            show_default="12; causes 4",
        ),
    ] = None,
    world: Annotated[
        Path | None,
        typer.Option(help="tables, pictures: file of lines name=value, for another world than the paper's."),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="pictures: PNG file to write.")] = Path(
        "laboratory.png"
    ),
) -> None:
    """Repeat the paper's measurements in a simulated world, with the paper's software and with hostlink.

    causes: the effect of each cause alone on each of the paper's patterns. tables: tables 2-5 with the paper's numbers.
    claims: which numbers the paper's tables need, with intervals. pictures: each path, true and by odometry.
    """
    if world is not None and what not in ("tables", "pictures"):
        raise ConfigError(
            "--world",
            f"is an option of `hostlink lab tables` and `hostlink lab pictures`, not of `hostlink lab {what}`",
        )
    if what == "pictures":
        check_picture("--output", output, needs="hostlink lab", extra="lab", suffixes=[".png"])
        check_folder("--output", output)
    require_wasmtime("hostlink lab")
    chosen = CASTER_WORLD if world is None else read_world(world)
    with Laboratory() as laboratory:
        write(*_report(laboratory, what, runs, chosen, output))


def _report(laboratory: Laboratory, what: Report, runs: int | None, world: WorldParameters, output: Path) -> list[str]:
    match what:
        case "causes":
            return reports.causes(laboratory, runs or reports.CAUSE_RUNS, show_progress)
        case "tables":
            return reports.tables(laboratory, world, runs or reports.TABLE_RUNS, show_progress)
        case "claims":
            return reports.claims(laboratory, runs or reports.TABLE_RUNS, show_progress)
        case "pictures":
            return _draw(world, runs or reports.PICTURE_RUNS, output)
        case _:
            assert_never(what)


def _draw(world: WorldParameters, runs: int, output: Path) -> list[str]:
    from hostlink.workbench.lab.pictures import draw_software  # noqa: PLC0415 - needs matplotlib

    show_progress("drawing")
    try:
        draw_software(world, runs, output)
    except OSError as error:
        raise ConfigError(str(output), error.strerror or str(error)) from None
    return [f"{output}: {size(output.stat().st_size)}"]
