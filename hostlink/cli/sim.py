"""`hostlink sim`: simulated robots that connect to a host."""

import asyncio
from pathlib import Path
from typing import Annotated, Literal

import typer

from hostlink.cli.addresses import DEFAULT_HOST, HostAddress, parse_address
from hostlink.cli.output import end_line, write_error
from hostlink.core.runtime.text_file import read_text
from hostlink.errors import ConfigError
from hostlink.workbench.sim.firmware_module import WorldParameters, read, require_wasmtime
from hostlink.workbench.sim.firmware_world import RobotKind
from hostlink.workbench.sim.robot import FAULTS, HEALTHY, WHEEL_FAULTS
from hostlink.workbench.sim.run import run_fleet

Kind = Annotated[
    RobotKind, typer.Option(help="nimble: reaches a new speed in 0.3 s; paper: the paper's robot, in two seconds.")
]


def command(
    *,
    connect: HostAddress = DEFAULT_HOST,
    robots: Annotated[
        int, typer.Option(min=1, max=200, help="Number of robots, for tests of a fleet: robot_0, robot_1, ...")
    ] = 1,
    udp: Annotated[bool, typer.Option("--udp", help="Connect over UDP, to test a host that serves UDP.")] = False,
    first: Annotated[
        int, typer.Option(min=0, help="Number of the first robot, if another simulator has the lower ones.")
    ] = 0,
    world: Annotated[
        Path | None,
        typer.Option(help="File of lines name=value, for other motors, wheels and floors than the default."),
    ] = None,
    robot: Kind = RobotKind.PAPER,
    kinematics: Annotated[
        Literal["skid_steer", "mecanum", "omni3", "omni4", "ackermann"] | None,
        typer.Option(help="Another drive than the firmware's two wheels: a robot whose wheels turn as they are told."),
    ] = None,
    fault: Annotated[
        str | None, typer.Option(help=f"Fault of the robots, to see how it is reported: {', '.join(FAULTS)}.")
    ] = None,
) -> None:
    """Run simulated robots: the paper's firmware in a simulated world, on a 38400 baud UART.

    With --kinematics: a robot of another drive, without motors and without a UART.
    """
    if kinematics is None:
        require_wasmtime("hostlink sim")
    elif world is not None:
        raise ConfigError("--world", "a robot of --kinematics has no motors and no floor; leave out one of the two")
    elif fault in WHEEL_FAULTS:
        raise ConfigError("--fault", f"{fault} is a fault of a motor, which a robot of --kinematics does not have")
    if fault is not None and fault not in FAULTS:
        raise ConfigError("--fault", f"unknown fault {fault!r}; choose one of {', '.join(FAULTS)}")
    chosen = HEALTHY if fault is None else FAULTS[fault]
    host, port = parse_address("--connect", connect, "127.0.0.1")
    parameters = WorldParameters() if world is None else read_world(world)
    fleet = run_fleet(
        host,
        port,
        robots=robots,
        first=first,
        is_udp=udp,
        fault=chosen,
        world=parameters,
        kind=robot,
        kinematics=kinematics,
        log=write_error,
    )
    try:
        asyncio.run(fleet)
    except KeyboardInterrupt:
        end_line()


def read_world(file: Path) -> WorldParameters:
    """Read the file of `--world`.

    Raises:
        ConfigError: the file cannot be read, or does not describe a world.
    """
    try:
        return read(read_text(file))
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError("--world", f"{file}: {reason}") from None
