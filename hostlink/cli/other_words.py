"""What people type by habit, of ROS and of other programs, and what it is here."""

import shlex
from collections.abc import Sequence

COMMANDS = {  # that a newcomer types, and what he means
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
GROUPS = {  # rostopic, ros2 topic and their kind: the word behind it, and what is meant
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
OPTIONS = {  # of a command, as ROS has it
    ("echo", "-n"): "--count NUMBER",
    ("echo", "-p"): "--csv",
    ("pub", "-1"): "nothing: one message is sent without --count",
    ("pub", "--once"): "nothing: one message is sent without --count",
    ("pub", "-r"): "--rate HZ --count 0",
    ("hz", "-w"): "--window NUMBER",
    ("bw", "-w"): "--window NUMBER",
    ("record", "-a"): "nothing: everything is recorded where no topic is named",
    ("record", "-O"): "-o FILE",
    ("play", "-l"): "--loop",
    ("play", "-r"): "--rate FACTOR",
    ("play", "-s"): "--start SECONDS",
}


def meant(words: Sequence[str]) -> str | None:
    """The words behind `hostlink` that are meant by these; None: they may be right as they are."""
    first = words[0] if words else ""
    if first in COMMANDS:
        return _with_rest(COMMANDS[first], words[1:]) if first != "help" else _help(words[1:])
    if first == "ros2" and len(words) > 1 and words[1] in GROUPS:
        return meant(words[1:])
    group = first.removeprefix("ros").removesuffix("s")
    second = words[1] if len(words) > 1 else ""
    if first == "params" or group not in GROUPS:
        return None
    if second in GROUPS[group]:
        return _with_rest(GROUPS[group][second], words[2:])
    is_command = first in ("topics", "services")
    return None if is_command else _ALONE.get(group)


def _with_rest(command: str, rest: Sequence[str]) -> str:
    return f"{command} {shlex.join(rest)}".rstrip()


def _help(rest: Sequence[str]) -> str:
    return f"{rest[0]} --help" if rest else "--help"
