"""The hostlink command. Each subcommand is a module with a `command`; only the one that runs is imported."""

import importlib
import os
import sys
from typing import Annotated

import typer

from hostlink.cli.output import write_error
from hostlink.errors import ConfigError, HostlinkError

COMMANDS = {
    "serve": "Run the daemon: devices on TCP port 11411 and serial ports, programs on port 9090.",
    "demo": "Run the daemon with a simulated robot.",
    "sim": "Run simulated robots that connect to a host.",
    "teleop": "Drive a robot with the keyboard.",
    "calibrate": "Find a robot's wheels with a tape measure.",
    "step": "Drive a step of speed and show how the robot follows; tune its PID.",
    "topics": "List the topics.",
    "echo": "Print the messages of a topic.",
    "pub": "Publish messages on a topic.",
    "call": "Call a service.",
    "doctor": "Find what is wrong with the devices, and what to do next.",
    "top": "Watch links and robots, live.",
    "record": "Record robots into an MCAP file; repair one that was never finished.",
    "play": "Play a recording as the robots that are in it.",
    "info": "Show what is in a recording.",
    "plot": "Draw fields or paths of a recording.",
    "export": "Write a recording as CSV, or as a bag of ROS.",
    "incidents": "List what happened to robots, and fetch their last minutes.",
    "capture": "Save the raw bytes of a link.",
    "inspect": "Decode a recording of a link.",
    "lab": "Drive the paper's measurements again, in a world that is known.",
}
FAILED, MISUSED = 1, 2


def build_app(wanted: str | None) -> typer.Typer:
    """The command line; the commands other than `wanted` are there by name only."""
    app = typer.Typer(
        help="The host for rosserial robots: no ROS needed, every ROS habit kept.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    for name, text in COMMANDS.items():
        function = importlib.import_module(f"hostlink.cli.{name}").command if name == wanted else _name_only
        app.command(name=name, short_help=text, help=function.__doc__ or text)(function)
    return app


def main() -> None:
    """Run; an error of hostlink's own is one line, and 2 means that the arguments or the configuration are wrong."""
    _open_standard_descriptors()
    arguments = sys.argv[1:]
    try:
        build_app(next((word for word in arguments if word in COMMANDS), None))()
    except HostlinkError as error:
        if "--debug" in arguments:
            raise
        write_error(f"hostlink: {error}")
        sys.exit(MISUSED if isinstance(error, ConfigError) else FAILED)
    except BrokenPipeError:  # the reader of our output is gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(FAILED)
    except KeyboardInterrupt:
        sys.exit(128 + 2)


def _open_standard_descriptors() -> None:
    """Of a process that was started without some (`2>&-`): else a robot's connection gets the number of stderr."""
    for name, descriptor in (("stdin", 0), ("stdout", 1), ("stderr", 2)):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one
            setattr(sys, name, open(descriptor, "r" if name == "stdin" else "w", closefd=False))  # noqa: SIM115


def _options(
    *, debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False
) -> None:
    del debug  # `main` reads it: it must work for errors of the arguments too


def _name_only() -> None:
    raise AssertionError("only the wanted command is imported")
