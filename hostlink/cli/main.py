"""The `hostlink` command.

The module of a command has a function of the command's name or `command`, or an `app` of subcommands. Only the module
of the command that runs is imported.
"""

import contextlib
import errno
import functools
import importlib
import itertools
import math
import os
import re
import shlex
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

import typer

from hostlink.cli.output import allow_any_text, clear_progress, end_line, write, write_error
from hostlink.cli.start import import_fast
from hostlink.errors import ConfigError, HostlinkError

# -- words of ROS and of other programs -------------------------------------------------------------------------------

PROGRAMS = {  # programs and packages of ROS, as rosrun takes them, and the command that does their work
    "teleop_twist_keyboard": "teleop --layout twist",
    "rosserial_python": "ros1",
    "rosserial_server": "ros1",
    "rosbridge_server": "serve",
}
HABITS = PROGRAMS | {  # words that newcomers type, and the command that has their meaning
    "drive": "teleop",
    "joy": "teleop",
    "go": "teleop",
    "list": "robots",
    "ls": "robots",
    "rosout": "echo /rosout",
    "monitor": "top",
    "status": "doctor",
    "roswtf": "doctor",
    "start": "serve",
    "run": "serve",
    "roscore": "serve",
    "version": "--version",
    "-V": "--version",
    "halt": "stop",
    "estop": "lock",
    "e-stop": "lock",
    "devices": "links",
    "boards": "links",
    "watch": "top",
}
LISTS = ("list", "ls", "show")  # words before what is listed: `hostlink list topics`
_SAME = {name: name for name in ("echo", "hz", "bw", "delay", "pub", "info", "type", "find")}
ROS_GROUPS = {  # rostopic, ros2 topic and similar programs: the word behind them, and the command of hostlink
    "topic": {"list": "topics"} | _SAME,
    "node": {"list": "nodes", "info": "info"},
    "service": {"list": "services", "args": "type --fields"}
    | {name: name for name in ("call", "info", "type", "find")},
    "param": {name: f"params {name}" for name in ("list", "get", "set", "delete", "dump", "load")},
    "bag": {"record": "record", "play": "play", "info": "info", "reindex": "record --repair"},
    "msg": {"show": "type"},
    "srv": {"show": "type"},
    "interface": {"show": "type"},
    "action": {},
}
ROS2_WORDS = {"doctor": "doctor", "wtf": "doctor"}  # programs of ros2 that are one command
ROS_OPTIONS = {  # option of a command of ROS, and the one of hostlink; empty: hostlink does so without an option
    ("topics", "-t"): "",
    ("topics", "--show-types"): "",
    ("services", "-t"): "",
    ("services", "--show-types"): "",
    ("services", "-n"): "",
    ("nodes", "-a"): "",
    ("info", "-v"): "",
    ("info", "--verbose"): "",
    ("info", "-y"): "--json",
    ("info", "--yaml"): "--json",
    ("echo", "--noarr"): "--no-arr",
    ("hz", "--wall-time"): "",
    ("pub", "-t"): "--count",
    ("pub", "--times"): "--count",
    ("record", "--topics"): "",
    ("record", "--output-name"): "--output",
    ("record", "--duration"): "--seconds",
    ("play", "--start-offset"): "--start",
    ("play", "--topics"): "--as-program",
}
LISTS_TOPICS = {("record", "--topics"), ("play", "--topics")}
SIGNED = ("move", "turn")  # commands whose argument may be negative: `hostlink turn robot_0 -90deg`
FLAGS = ("--json", "--help", "-h")  # their options without a value
_NEGATIVE_NUMBER = re.compile(r"-[.\d]")
_STARTS = "`hostlink serve` starts the daemon, and `hostlink ros1` starts it as a node of ROS 1"
_IN_A_FILE = "`hostlink export FILE --to csv` writes the messages of a recording"
_OF_TYPES = "`hostlink type TYPE` shows the fields of a type, and `hostlink topics` lists the types that are in use"
_BY_THE_IDE = (
    "the Arduino IDE, arduino-cli or PlatformIO writes a program into a board; `hostlink arduino-library` writes the "
    "library for it, and `hostlink board` reads and sets what a board stores"
)
_THE_LOG = (
    "`hostlink serve` writes the log (a service: `journalctl -u hostlink`); `hostlink echo /rosout` prints the lines "
    "of the boards, `hostlink drives` and `hostlink incidents` show what has happened"
)
_SETTINGS = (
    "`hostlink setup` writes a configuration file, `hostlink serve --config FILE` uses it, and `hostlink serve "
    "--check-config FILE` checks it"
)
_THE_PAGE = "`hostlink serve` serves the page, by default on http://127.0.0.1:9090; open it in a browser"
_THE_END = "Ctrl-C ends `hostlink serve` (a service: `systemctl stop hostlink`); `hostlink stop` stops the robots"
_A_PLACE = "`hostlink robots` shows where each robot is, and `hostlink echo /ROBOT/odometry` prints every pose"
_TO_DRIVE = (
    "`hostlink move ROBOT 0.5` moves half a metre, `hostlink turn ROBOT 90deg` turns, and `hostlink teleop ROBOT` "
    "drives by the keyboard"
)
_VERSION_OR_MORE = "--version shows the version; `hostlink serve --log-level debug` logs more"
_ADDRESSES = (
    "a serial port is --serial /dev/ttyUSB0@57600, the address for boards on the network --listen HOST:PORT, and that "
    "for programs and the page --api HOST:PORT"
)
LACKING = {  # commands and options that people type and hostlink lacks, mostly of ROS, and the next step
    **{("", word): step for words, step in {
        ("upload", "flash", "burn"): _BY_THE_IDE,
        ("log", "logs", "journal"): _THE_LOG,
        ("config", "configure", "configuration", "settings"): _SETTINGS,
        ("page", "web", "ui", "gui", "dashboard"): _THE_PAGE,
        ("quit", "exit", "kill", "shutdown", "end"): _THE_END,
        ("odom", "odometry", "pose", "position", "where"): _A_PLACE,
        ("forward", "backward", "back", "left", "right", "speed", "velocity", "cmd_vel"): _TO_DRIVE,
        ("-v", "--verbose"): _VERSION_OR_MORE,
    }.items() for word in words},
    **{("serve", option): _ADDRESSES for option in ("--port", "-p", "--host", "--tcp", "--baud", "--baudrate", "-b")},
    **{(command, option): "`hostlink top` shows robots and links, live"
       for command in ("robots", "links", "doctor") for option in ("--watch", "-w", "--follow", "-f")},
    ("node", "kill"): "`hostlink stop` stops the robots, and `hostlink clients` lists the programs that are connected",
    ("node", "ping"): "`hostlink links` shows for how long each device has been silent",
    ("node", "machine"): "`hostlink links` and `hostlink clients` list the addresses",
    ("node", "cleanup"): "the daemon removes a node when its connection ends; `hostlink nodes` lists them",
    ("service", "uri"): "`hostlink info SERVICE` shows its node",
    ("service", "echo"): "`hostlink call SERVICE` prints the answer of one call",
    ("param", "describe"): "`hostlink params get NAME` prints the value",
    ("bag", "convert"): "`hostlink export FILE --to ros1`, `ros2`, `rosbag2` or `csv` converts a recording",
    ("bag", "check"): "`hostlink info FILE` reports damage",
    ("bag", "fix"): "`hostlink record --repair FILE` repairs a recording",
    ("bag", "filter"): "`hostlink record TOPIC` records only some topics",
    **{(group, word): _OF_TYPES for group in ("msg", "srv", "interface")
       for word in ("list", "md5", "package", "packages", "proto")},
    ("topics", "-b"): "`hostlink info FILE` lists the topics of a recording",
    ("topics", "-p"): "the columns pubs and subs tell publishers from subscribers; use `hostlink topics`",
    ("topics", "-s"): "the columns pubs and subs tell publishers from subscribers; use `hostlink topics`",
    ("topics", "-c"): "`hostlink topics --json` gives every topic to a program that counts them",
    ("echo", "-b"): _IN_A_FILE,
    ("echo", "--bag"): _IN_A_FILE,
    **{(command, "--filter"): "`hostlink echo TOPIC --json` gives every message to a program that filters them"
       for command in ("echo", "hz")},
    ("pub", "-f"): "write the message itself, as in `hostlink pub /led 'data: true'`",
    ("pub", "-l"): "-r 1 sends the message again each second",
    ("pub", "--latch"): "-r 1 sends the message again each second",
    ("pub", "-w"): "`hostlink info TOPIC` lists the subscribers",
    ("call", "-r"): "call the service in a loop of the shell",
    ("record", "-e"): "name the topics by patterns, as in `hostlink record '/robot_0/*'`",
    ("record", "--regex"): "name the topics by patterns, as in `hostlink record '/robot_0/*'`",
    ("record", "-s"): "the file is always MCAP; leave the option out",
    ("play", "--clock"): "hostlink has no simulated time; leave the option out",
    ("play", "--pause"): "--step sends the next message when you press Enter",
    ("play", "-p"): "--step sends the next message when you press Enter",
    ("play", "-u"): "Ctrl-C ends the playback",
    ("play", "-d"): "the robots' topics are announced a second before the first message; leave the option out",
}  # fmt: skip
_NO_NODE = "a parameter belongs to no node; leave the node out, as in `hostlink params {}`"
SURPLUS = {  # commands that take fewer arguments than those of ROS or than people type, and what to do
    "teleop": f"the keys drive, and the speeds are options, as in `hostlink teleop ROBOT --linear 0.1`; {_TO_DRIVE}",
    "serve": _ADDRESSES,
    **{
        f"params {example.partition(' ')[0]}": _NO_NODE.format(example)
        for example in ("get gain", "set gain 0.4", "delete gain", "load FILE")
    },
    **dict.fromkeys(("hz", "bw", "delay"), "one topic is measured at a time; run the command once for each topic"),
}

FIRST_DAY = """\
hostlink is the host for rosserial robots. The ten commands of the first day:

  hostlink demo            run the daemon with a simulated robot
  hostlink serve           run the daemon: boards on TCP port 11411 and on USB,
                           programs and the page on http://127.0.0.1:9090
  hostlink doctor          find what is wrong with a board, and what to do next
  hostlink robots          list the robots: who drives them, where they are
  hostlink teleop ROBOT    drive a robot with the keyboard
  hostlink stop            stop every robot now
  hostlink lock            emergency stop, until `hostlink unlock`
  hostlink topics          list the topics
  hostlink echo TOPIC      print the messages of a topic
  hostlink record          record everything until Ctrl-C

Commands of ROS work too: `hostlink rostopic list`, `hostlink ros2 bag record`.

  hostlink --help          list all commands
  hostlink COMMAND --help  show the options of a command
"""

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
        "move": "Move a robot along a line, and stop it.",
        "turn": "Turn a robot on the spot, and stop it.",
        "stop": "Stop a robot, or all of them, now.",
        "lock": "Emergency stop: no robot moves until it is unlocked.",
        "unlock": "Let a robot be driven again.",
        "calibrate": "Find a robot's wheel radii and separation with a tape measure.",
        "step": "Drive a step of speed and show how the robot follows; tune its PID.",
        "lab": "Repeat the paper's measurements in a simulated world.",
    },
    "Topics, services, parameters": {
        "topics": "List the topics.",
        "nodes": "List the nodes: devices and programs.",
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
        "inspect": "Decode a capture of a link.",
    },
}
MODULES = {  # modules whose name is not that of the command
    "serve": "serve_command",
    **dict.fromkeys(
        ("nodes", "info", "type", "find", "echo", "hz", "bw", "delay", "pub", "services", "call"), "topics"
    ),
    **dict.fromkeys(("drives", "incidents"), "record"),
    "plot": "export",
    **dict.fromkeys(("stop", "lock", "unlock"), "robots"),
    **dict.fromkeys(("move", "turn"), "motion"),
    "reload": "setup",
    "arduino-library": "board",
    **dict.fromkeys(("clients", "capture"), "links"),
}
COMMANDS = {name: text for panel in PANELS.values() for name, text in panel.items()}


def translated(words: Sequence[str]) -> list[str]:
    """Return the command line in the words of hostlink. Its own words stay as they are.

    Raises:
        ConfigError: hostlink lacks a command of ROS.
    """
    before = list(itertools.takewhile(lambda word: word == "--debug", words))
    return [*before, *_own_options(_own_command(words[len(before) :]))]


def _own_command(words: Sequence[str]) -> list[str]:
    first, *rest = words or [""]
    if first == "help":
        about = [word for word in rest if not word.startswith("-")]  # --help behind them would be a value
        return [*_own_command(about), "--help"] if about else ["--help"]
    if first in LISTS and rest and rest[0] in COMMANDS:
        return list(rest)
    if first in HABITS:
        return [*HABITS[first].split(), *rest]
    if first == "ros2" and rest and rest[0] in ROS2_WORDS:
        return [ROS2_WORDS[rest[0]], *rest[1:]]
    if first == "ros2" and rest[:2] == ["param", "dump"] and any(not word.startswith("-") for word in rest[2:]):
        raise ConfigError("ros2 param dump", _NO_NODE.format("dump FILE"))  # the node would be taken for a file
    if first == "ros2" and rest and rest[0] in ROS_GROUPS:
        return _of_group(rest[0], f"ros2 {rest[0]}", rest[1:])
    if first in ("rosrun", "roslaunch") or (first == "ros2" and rest and not rest[0].startswith("-")):
        program = f"ros2 {rest[0]}" if first == "ros2" else first
        replacement = next((PROGRAMS[word] for word in rest if word in PROGRAMS), None)
        other = _STARTS if program.endswith(("run", "launch")) else "`hostlink --help` lists all commands"
        step = f"use `hostlink {replacement}`" if replacement else other
        raise ConfigError(program, f"hostlink has no such command; {step}")
    group = first.removeprefix("ros").removesuffix("s")
    is_own = first in COMMANDS and (first == "params" or not rest or rest[0] not in ROS_GROUPS.get(group, ()))
    return list(words) if is_own or group not in ROS_GROUPS else _of_group(group, first, rest)


def _of_group(group: str, program: str, rest: Sequence[str]) -> list[str]:
    """Return the command of a program of ROS, for example rostopic.

    Raises:
        ConfigError: hostlink lacks the command.
    """
    known, word = ROS_GROUPS[group], rest[0] if rest else ""
    if word in known:
        return [*known[word].split(), *rest[1:]]
    if not known:
        raise ConfigError(program, "rosserial has no actions; `hostlink services` lists the services")
    if (step := LACKING.get((group, word))) is not None:
        raise ConfigError(f"{program} {word}", f"hostlink has no such command; {step}")
    if word in ("", "-h", "--help"):
        raise ConfigError(program, f"add a command: {', '.join(known)}; `hostlink --help` lists all commands")
    raise ConfigError(f"{program} {word}", f"there is no such command; `{program}` has: {', '.join(known)}")


def _own_options(words: Sequence[str]) -> list[str]:
    """Replace the options of ROS up to `--`."""
    command = words[0] if words else ""
    if command in SIGNED and "--" not in words:
        return _negative_last(words)
    end = words.index("--") if "--" in words else len(words)
    found = []
    for word in words[:end]:
        name, equals, value = word.partition("=")
        own = ROS_OPTIONS.get((command, name))
        if own is None:
            found.append(word)
        elif (command, name) in LISTS_TOPICS and equals:  # its value is an argument here
            found += [*([own] if own else []), value]
        elif own:
            found.append(f"{own}{equals}{value}")
    return [*found, *words[end:]]


def _negative_last(words: Sequence[str]) -> list[str]:
    """Put a negative number that is an argument, not the value of an option, to the end, behind `--`."""
    for place, word in enumerate(words):
        before = words[place - 1] if place else ""
        is_value = before.startswith("-") and before not in FLAGS and not _NEGATIVE_NUMBER.match(before)
        if _NEGATIVE_NUMBER.match(word) and not is_value:
            return [*words[:place], *words[place + 1 :], "--", word]
    return list(words)


# -- first screen -----------------------------------------------------------------------------------------------------


# -- command line -----------------------------------------------------------------------------------------------------

FAILED, MISUSED, INTERRUPTED = 1, 2, 128 + 2
UsageError: Any = typer.BadParameter.__base__  # click's class, which newer versions of typer contain


def build_app(wanted: str | None) -> typer.Typer:
    """Build the command line. Commands other than `wanted` have a name and a help text only."""
    app = typer.Typer(
        help="The host for rosserial robots. ROS is not needed. Commands of ROS work too: `hostlink rostopic list`.",
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
    name = command.replace("-", "_")
    names = (name, f"{name}_", "app", "command")  # `type` is Python's, so that its function is type_
    return next(getattr(module, each) for each in names if hasattr(module, each))


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
        status = _run(arguments)
    except HostlinkError as error:
        if "--debug" in arguments:
            raise
        _complain(with_next_step(error.kind, str(error)))
        status = MISUSED if isinstance(error, ConfigError) else FAILED
    except OSError as error:  # mostly: the program that read the output has ended, or the disk is full
        if "--debug" in arguments:
            raise
        _end_output()
        if not isinstance(error, BrokenPipeError):
            text = f"{error.filename or 'a call of the system failed'}: {error.strerror or error}"
            _complain(with_next_step(type(error).__name__, text))
        status = FAILED
    except (KeyboardInterrupt, typer.Abort):
        status = INTERRUPTED
    finally:
        with contextlib.suppress(OSError):  # standard error is closed
            clear_progress()
    if status == INTERRUPTED:
        end_line()
    sys.exit(status)


def _run(arguments: list[str]) -> int:
    """Run the command and return the exit status.

    Raises:
        ConfigError: the arguments are wrong.
    """
    if not arguments and "_HOSTLINK_COMPLETE" not in os.environ:
        write(*FIRST_DAY.splitlines())
        return 0
    os.environ.update(own_completion(os.environ))
    words = translated(arguments)
    app = build_app(wanted_command([*words, *completed_words(os.environ)]))
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # hostlink.cli.start
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        status = app(args=words, prog_name="hostlink", standalone_mode=False)
    except UsageError as error:
        if not error.format_message():  # a group of commands has printed its help
            return MISUSED
        raise ConfigError(*_complaint(error, words)) from error
    return status if isinstance(status, int) else 0


def _complaint(error: Any, words: Sequence[str]) -> tuple[str, str]:
    """Return what is wrong, the command or its word, and a sentence with the next step."""
    path = (wanted_command(words) or "") if error.ctx is None else error.ctx.command_path
    text = in_words(" ".join(error.format_message().split()), getattr(getattr(error, "param", None), "type", None))
    return complaint(path.removeprefix("hostlink").strip(), text)


_NOT_A_NUMBER = re.compile(r"(.*) is not (?:a valid (?:int|integer|float)(?: range)?|in the range [^ ]*)\.?")


def in_words(text: str, kind: Any) -> str:
    """Return the parser's error of a number with what is allowed in words. `kind`: type of the option, of click."""
    found = _NOT_A_NUMBER.fullmatch(text)
    if found is None:
        return text
    number = "a whole number" if "int" in getattr(kind, "name", "") else "a number"
    bounds = (getattr(kind, name, None) for name in ("min", "max"))
    least, most = ("" if bound is None else f"{bound:.15g}" for bound in bounds)
    if least and most:
        number += f" from {least} to {most}"
    elif least or most:
        number += f" of at least {least}" if least else f" of at most {most}"
    return f"{found[1]} is not {number}"


_TEXTS = (  # of click, and the sentence of hostlink
    (re.compile(r"Got unexpected extra arguments? ?(?:\(s\) )?\((.*)\)\.?"), r"there is an argument too many: \1"),
    (re.compile(r"Missing argument '(.*?)'\.?"), r"the argument \1 is missing"),
    (
        re.compile(r"Missing (argument|option) '(.*?)'(?: / '.*?')*\.? ?(?:Choose from: )?(.*?)\.?"),
        r"the \1 \2 is missing; choose \3",
    ),
    (
        re.compile(r"Invalid value for '(.*?)'(?: / '.*?')*: (?:Value error, )?(.*?)\.?"),
        r"the value of \1 is wrong: \2",
    ),
    (re.compile(r"Option '(.*?)'(?: / '.*?')* requires an argument\.?"), r"the option \1 needs a value"),
)
_NO_OPTION = re.compile(r"No such option:? '?(-[^ ']*?)'?[. ]*(?:(?:Did you mean|\(?Possible options:) (.*?)[?)])?")
_NO_QOS = "rosserial has no quality of service; leave the option out"
_NEGATIVE = "write -- before a negative number, as in `hostlink pub /x std_msgs/Int8 -- -5`"
_NO_CHOICE = re.compile(r"Invalid value for '(.*?)'(?: / '.*?')*: '(.*)' is not one of (.*?)\.?")
_NOT_READABLE = re.compile(r"Invalid value for '(.*?)'(?: / '.*?')*: Path '(.*)' is not readable\.?")
_NO_COMMAND = re.compile(r"No such command '(.*?)'\.(?: Did you mean (.*)\?)?")


def complaint(command: str, text: str) -> tuple[str, str]:
    """Return the subject and the sentence for an error of the parser. Pure."""
    is_group = not command or command in ("params", "board")
    options = f"`hostlink {f'{command} --help'.strip()}` lists the {'commands' if is_group else 'options'}"
    if (found := _NO_COMMAND.fullmatch(text)) is not None:
        similar = found[2] and _listed(f"`{name.strip(chr(39))}`" for name in found[2].split(", "))
        inside = f" of `hostlink {command}`" if command else ""
        if (step := LACKING.get((command, found[1]))) is not None:
            return found[1], f"there is no such command; {step}"
        return found[1], f"there is no such command{inside}; {f'did you mean {similar}? ' if similar else ''}{options}"
    if (found := _NO_OPTION.fullmatch(text)) is not None:
        similar = found[2] and f"did you mean {_listed(found[2].split(', '))}? "
        step = LACKING.get((command, found[1])) or (_NO_QOS if found[1].startswith("--qos") else None)
        step = _NEGATIVE if _NEGATIVE_NUMBER.match(found[1]) else step
        if command:
            return command, f"there is no option {found[1]}; {step or f'{similar or str()}{options}'}"
        step = step or "write options behind the command, as in `hostlink robots --url URL`"
        return found[1], f"there is no such option; {step}"
    if (found := _NO_CHOICE.fullmatch(text)) is not None:
        return found[1], f"unknown value {found[2]!r}; choose {_listed(found[3].replace(chr(39), '').split(', '))}"
    if (found := _NOT_READABLE.fullmatch(text)) is not None:
        return found[1], f"{found[2]} cannot be read; check who may read it"
    if "unexpected extra" in text and command in SURPLUS:
        return command, SURPLUS[command]
    for pattern, sentence in _TEXTS:
        if (found := pattern.fullmatch(text)) is not None:
            return command or "arguments", f"{found.expand(sentence)}; {options}"
    return command or "arguments", f"{text[:1].lower()}{text[1:].rstrip('.')}; {options}"


def _listed(names: Iterable[str]) -> str:
    """Return the names as `a, b or c`."""
    *before, last = names
    return f"{', '.join(before)} or {last}" if before else last


_LISTS = {  # command that lists the things of a kind
    "topic": "topics",
    "service": "services",
    "robot": "robots",
    "parameter": "params list",
    "link": "links --ended",
    "client": "clients",
    "recording": "record --list",
    "incident": "incidents",
}
_UNKNOWN = re.compile(r"no (\w+) named ")


def with_next_step(kind: str, text: str) -> str:
    """Return an error of the daemon, or of its client, with the command that helps. Pure.

    The daemon does not name commands, because most of its clients have none.
    """
    if "`hostlink " in text:
        return text
    name = text.partition(": ")[0]
    step = None
    if (found := _UNKNOWN.match(text)) is not None and found[1] in _LISTS:
        step = f"`hostlink {_LISTS[found[1]]}` lists them"
    elif kind == "WrongType" and name.startswith("/"):
        step = f"`hostlink type {name}` shows its type"
    elif kind == "BadRequest" and ": wanted " in text:
        step = "`hostlink type TYPE` shows the fields of a type"
    elif text.endswith(os.strerror(errno.ENOENT)):
        step = "check its name"
    elif text.endswith(os.strerror(errno.EISDIR)):
        step = "name a file"
    elif text.endswith(os.strerror(errno.EACCES)):
        step = "choose a port above 1023" if "listened on" in text else "check who may read and write it"
    elif text.endswith(" is not an MCAP file"):
        step = "`hostlink record` writes MCAP files"
    elif kind == "FrameTooLarge":
        step = "send less in one message; `hostlink doctor` shows which buffer of the board is too small"
    elif kind in ("DeviceGone", "not_connected"):
        step = "`hostlink doctor` finds out why"
    return f"{text}; {step}" if step else text


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


def own_completion(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of a shell's completion in which words of ROS are those of hostlink. Pure."""
    if "_HOSTLINK_COMPLETE" not in environment:
        return {}
    words = completed_words(environment)
    is_bash = "COMP_CWORD" in environment
    line = environment.get("_TYPER_COMPLETE_ARGS", "")
    before = int(environment["COMP_CWORD"]) - 1 if is_bash else len(words) - (not line.endswith(" "))
    try:
        found = translated(words[:before])
    except ConfigError:  # the command is incomplete
        return {}
    if found == words[:before]:
        return {}
    typed = shlex.join(["hostlink", *found])
    rest = shlex.join(words[before:])
    if is_bash:
        return {"COMP_WORDS": f"{typed} {rest}", "COMP_CWORD": str(len(found) + 1)}
    return {"_TYPER_COMPLETE_ARGS": f"{typed} {rest}"}


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
