"""The `hostlink` command.

The module of a command has its function in COMMANDS, as `command`, or as an `app` of subcommands. Only the module of
the command that runs is imported.
"""

import contextlib
import functools
import importlib
import math
import os
import shlex
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

import typer

from hostlink.cli.output import allow_any_text, write, write_error
from hostlink.cli.start import import_fast
from hostlink.errors import ConfigError, HostlinkError

# -- words of ROS and of other programs -------------------------------------------------------------------------------

HABITS = {  # words that newcomers type, and the command that has their meaning
    "drive": "teleop",
    "joy": "teleop",
    "go": "teleop",
    "list": "robots",
    "ls": "robots",
    "nodes": "robots",
    "rosout": "echo /rosout",
    "monitor": "top",
    "status": "doctor",
    "roswtf": "doctor",
    "start": "serve",
    "run": "serve",
    "help": "--help",
    "version": "--version",
}
_SAME = {name: name for name in ("echo", "hz", "bw", "delay", "pub", "info", "type", "find", "call")}
ROS_GROUPS = {  # rostopic, ros2 topic and similar programs: the word behind them, and the command of hostlink
    "topic": _SAME | {"list": "topics"},
    "node": {"list": "robots", "info": "info"},
    "service": _SAME | {"list": "services"},
    "param": {name: f"params {name}" for name in ("list", "get", "set", "delete", "dump", "load")},
    "bag": {name: name for name in ("record", "play", "info")},
    "msg": {"show": "type"},
    "srv": {"show": "type"},
    "interface": {"show": "type"},
}
_ALONE = {"topic": "topics", "node": "robots", "service": "services", "param": "params", "bag": "record"}
ROS_OPTIONS = {  # option of a command of ROS, and the one of hostlink
    ("echo", "-n"): "--count NUMBER",
    ("echo", "-p"): "--csv",
    ("pub", "-1"): "nothing: one message is sent without --count",
    ("pub", "--once"): "nothing: one message is sent without --count",
    ("pub", "-r"): "--rate HZ --count 0",
    ("hz", "-w"): "--window NUMBER",
    ("bw", "-w"): "--window NUMBER",
    ("record", "-a"): "nothing: everything is recorded unless a topic is named",
    ("record", "-O"): "-o FILE",
    ("play", "-l"): "--loop",
    ("play", "-r"): "--rate FACTOR",
    ("play", "-s"): "--start SECONDS",
}


def meant(words: Sequence[str]) -> str | None:
    """Return the words that hostlink has for a habit or a command of ROS; None if the words may be right."""
    first = words[0] if words else ""
    if first in HABITS:
        return _with_rest(HABITS[first], words[1:]) if first != "help" else _help(words[1:])
    if first == "ros2" and len(words) > 1 and words[1] in ROS_GROUPS:
        return meant(words[1:])
    group = first.removeprefix("ros").removesuffix("s")
    second = words[1] if len(words) > 1 else ""
    if first == "params" or group not in ROS_GROUPS:
        return None
    if second in ROS_GROUPS[group]:
        return _with_rest(ROS_GROUPS[group][second], words[2:])
    is_command = first in ("topics", "services")
    return None if is_command else _ALONE.get(group)


def _with_rest(command: str, rest: Sequence[str]) -> str:
    return f"{command} {shlex.join(rest)}".rstrip()


def _help(rest: Sequence[str]) -> str:
    return f"{rest[0]} --help" if rest else "--help"


# -- command line -----------------------------------------------------------------------------------------------------

PANELS = {
    "The daemon": {
        "serve": "Run the daemon: devices on TCP port 11411 and serial ports, programs on port 9090.",
        "demo": "Run the daemon with a simulated robot.",
        "sim": "Run simulated robots that connect to a host.",
        "ros1": "Run the daemon as a node of ROS 1, started as rosserial_python is.",
        "ros2": "Show the robots in ROS 2, and let ROS 2 drive them.",
        "setup": "Ask ten questions and write a configuration file.",
        "reload": "Let the daemon read its configuration again.",
    },
    "Robots": {
        "robots": "List the robots.",
        "teleop": "Drive a robot with the keyboard.",
        "stop": "Stop a robot, or all of them, now.",
        "lock": "Emergency stop: no robot moves until it is unlocked.",
        "unlock": "Let a robot be driven again.",
        "calibrate": "Find a robot's wheel radii and separation with a tape measure.",
        "step": "Drive a step of speed and show how the robot follows; tune its PID.",
        "lab": "Repeat the paper's measurements in a simulated world.",
    },
    "Topics, services, parameters": {
        "topics": "List the topics.",
        "info": "Show publishers and subscribers of a topic or a node, or the content of a recording.",
        "type": "Show the type of a topic or a service.",
        "find": "List the topics and services of a type.",
        "echo": "Print the messages of a topic.",
        "hz": "Measure the rate of a topic.",
        "bw": "Measure the bandwidth of a topic.",
        "delay": "Measure the age of a topic's messages when they arrive.",
        "pub": "Publish messages on a topic.",
        "services": "List the services.",
        "call": "Call a service.",
        "params": "List, get, set, dump and load the parameters of the devices.",
    },
    "Recordings": {
        "record": "Record robots into an MCAP file; repair an unfinished one.",
        "play": "Play a recording: as robots, as a program, or to drive a robot.",
        "plot": "Draw fields or paths of a recording as a picture.",
        "export": "Write a recording as CSV, or as a bag of ROS.",
        "drives": "List who drove which robot and when.",
        "incidents": "List incidents of robots, and fetch the recording of each.",
    },
    "Boards": {
        "arduino-library": "Write the rosserial library for boards, with headers of all messages, as a ZIP.",
        "board": "Read and set the settings that a board stores: host, name, WiFi and keys.",
    },
    "Diagnosis": {
        "doctor": "Find what is wrong with the devices, and what to do next.",
        "top": "Watch links and robots, live.",
        "links": "List the connections of devices.",
        "clients": "List the programs that are connected.",
        "capture": "Save the raw bytes of a link.",
        "inspect": "Decode a recording of a link.",
    },
}
MODULES = {  # modules whose name is not that of the command
    "serve": "serve_command",
    **dict.fromkeys(("info", "type", "find", "echo", "hz", "bw", "delay", "pub", "services", "call"), "topics"),
    **dict.fromkeys(("drives", "incidents"), "record"),
    "plot": "export",
    **dict.fromkeys(("stop", "lock", "unlock"), "robots"),
    "reload": "setup",
    "arduino-library": "board",
    **dict.fromkeys(("clients", "capture"), "links"),
}
COMMANDS = {name: text for panel in PANELS.values() for name, text in panel.items()}
FAILED, MISUSED = 1, 2
UsageError: Any = typer.BadParameter.__base__  # click's class, which newer versions of typer contain


def build_app(wanted: str | None) -> typer.Typer:
    """Build the command line. Commands other than `wanted` have a name and a help text only."""
    app = typer.Typer(
        help="The host for rosserial robots. ROS is not needed; commands and names are those that users of ROS know.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    for panel, commands in PANELS.items():
        for name, text in commands.items():
            _add(app, name, text, panel, is_wanted=name == wanted)
    return app


def _add(app: typer.Typer, name: str, text: str, panel: str, *, is_wanted: bool) -> None:
    module: Any = import_fast(module_of(name)) if is_wanted else None
    function = _function_of(module, name) if is_wanted else _name_only
    if isinstance(function, typer.Typer):
        for subcommand in function.registered_commands:
            subcommand.callback = _without_nan(subcommand.callback)
        app.add_typer(function, name=name, short_help=text, rich_help_panel=panel)
    else:
        context = getattr(module, "CONTEXT", None)
        app.command(
            name=name,
            short_help=text,
            help=function.__doc__ or text,
            rich_help_panel=panel,
            context_settings=context,
        )(_without_nan(function))


def _function_of(module: Any, command: str) -> Any:
    """Return the function of a command, or the typer app of a group of subcommands."""
    if (commands := getattr(module, "COMMANDS", None)) is not None:
        return commands[command]
    return getattr(module, "app", None) or module.command


def _without_nan(function: Any) -> Any:
    """Return the function with a check of its numbers: in older versions of typer NaN passes every bound."""

    @functools.wraps(function)
    def checked(*arguments: Any, **options: Any) -> Any:
        for name, value in options.items():
            if isinstance(value, float) and math.isnan(value):
                raise typer.BadParameter("nan is not a number.", param_hint=f"'--{name.replace('_', '-')}'")
        return function(*arguments, **options)

    return checked


def module_of(command: str) -> str:
    """Name of the module of a command."""
    return f"hostlink.cli.{MODULES.get(command, command)}"


def main() -> None:
    """Run the command line. An error is one line on stderr; exit status 2: wrong arguments or configuration."""
    _open_standard_descriptors()
    allow_any_text()
    arguments = sys.argv[1:]
    try:
        sys.exit(_run(arguments))
    except HostlinkError as error:
        if "--debug" in arguments:
            raise
        _complain(str(error))
        sys.exit(MISUSED if isinstance(error, ConfigError) else FAILED)
    except OSError as error:  # mostly: the program that read the output has ended, or the disk is full
        if "--debug" in arguments:
            raise
        _end_output()
        if not isinstance(error, BrokenPipeError):
            _complain(f"{error.filename or 'a call of the system failed'}: {error.strerror or error}")
        sys.exit(FAILED)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(128 + 2)


def _run(arguments: list[str]) -> int:
    """Run the command and return the exit status.

    Raises:
        ConfigError: the arguments are wrong.
    """
    words = meant(arguments)
    if words is not None:
        raise ConfigError(arguments[0], f"is not a command; did you mean `hostlink {words}`?")
    app = build_app(wanted_command([*arguments, *completed_words(os.environ)]))
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # hostlink.cli.start
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        status = app(prog_name="hostlink", standalone_mode=False)
    except UsageError as error:
        if not error.format_message():  # a group of commands has printed its help
            return MISUSED
        raise ConfigError(*_complaint(error)) from error
    return status if isinstance(status, int) else 0


def _complaint(error: Any) -> tuple[str, str]:
    """Return the command and its error in one line with the next step."""
    command = "" if error.ctx is None else error.ctx.command_path.removeprefix("hostlink").strip()
    text = " ".join(error.format_message().split()).replace("Value error, ", "").rstrip(".")
    option = ROS_OPTIONS.get((command, getattr(error, "option_name", "")))
    then = f"use {option}" if option else f"`hostlink {f'{command} --help'.strip()}` lists the options"
    return command or "arguments", f"{text[:1].lower()}{text[1:]}{' ' if text.endswith('?') else '; '}{then}"


def _complain(text: str) -> None:
    with contextlib.suppress(OSError):  # stderr is closed; the exit status reports the error, too
        write_error(f"hostlink: {text}")


def _end_output() -> None:
    """Discard the buffered output, which would fail again when the interpreter ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def wanted_command(words: Iterable[str]) -> str | None:
    """Return the first word that is a command's name."""
    return next((word for word in words if word in COMMANDS), None)


def completed_words(environment: Mapping[str, str]) -> list[str]:
    """Return the words of the line that a shell completes, as typer's scripts for bash, zsh and fish pass them."""
    if "_HOSTLINK_COMPLETE" not in environment:
        return []
    line = environment.get("_TYPER_COMPLETE_ARGS") or environment.get("COMP_WORDS", "")
    try:
        return shlex.split(line)[1:]
    except ValueError:  # an unclosed quotation
        return line.split()[1:]


def _open_standard_descriptors() -> None:
    """Open closed standard descriptors (`2>&-`), else a robot's connection gets the number of stderr."""
    for name, descriptor in (("stdin", 0), ("stdout", 1), ("stderr", 2)):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
            setattr(sys, name, open(descriptor, "r" if name == "stdin" else "w", closefd=False))  # noqa: SIM115


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        write(f"hostlink {importlib.import_module('importlib.metadata').version('hostlink')}")
        raise typer.Exit


def _options(
    *,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    del debug, show_version  # `main` reads --debug, because it also applies to errors of the arguments


def _name_only() -> None:
    raise AssertionError("only the wanted command is imported")
