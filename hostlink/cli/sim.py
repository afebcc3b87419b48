"""`hostlink sim`: robots without hardware that connect to a host."""

import asyncio
import contextlib
from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.addresses import parse_address
from hostlink.cli.output import write_error
from hostlink.errors import ConfigError
from hostlink.sim.firmware_module import WorldParameters, read, require_wasmtime
from hostlink.sim.firmware_world import RobotKind
from hostlink.sim.robot import FAULTS, HEALTHY
from hostlink.sim.run import run_fleet


def command(
    *,
    connect: Annotated[str, typer.Option(help="The host's address for devices: HOST:PORT.")] = "127.0.0.1:11411",
    robots: Annotated[int, typer.Option(min=1, max=200, help="How many: robot_0, robot_1, ...")] = 1,
    udp: Annotated[bool, typer.Option("--udp", help="Over UDP, not TCP.")] = False,
    first: Annotated[int, typer.Option(min=0, help="The number of the first one.")] = 0,
    world: Annotated[
        Path | None, typer.Option(help="A file of lines name=value: what their motors, wheels and floor are like.")
    ] = None,
    robot: Annotated[
        RobotKind, typer.Option(help="nimble: at a new speed within 0.3 s; paper: the paper's, in two seconds.")
    ] = RobotKind.PAPER,
    fault: Annotated[str | None, typer.Option(help=f"What is wrong with them: {', '.join(FAULTS)}.")] = None,
) -> None:
    """Run simulated robots: the firmware of the paper's, in a simulated world and on a 38400 baud UART."""
    require_wasmtime("hostlink sim")
    if fault is not None and fault not in FAULTS:
        raise ConfigError("--fault", f"{fault} is none of {', '.join(FAULTS)}")
    chosen = HEALTHY if fault is None else FAULTS[fault]
    host, port = parse_address("--connect", connect, "127.0.0.1")
    parameters = WorldParameters() if world is None else _read(world)
    fleet = run_fleet(
        host, port, robots=robots, first=first, is_udp=udp, fault=chosen, world=parameters, kind=robot, log=write_error
    )
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(fleet)


def _read(file: Path) -> WorldParameters:
    try:
        return read(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError("--world", f"{file}: {reason}") from None
