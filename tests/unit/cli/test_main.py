"""Command of a line that is typed or to be completed."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.main import COMMANDS, _run, completed_words, module_of, own_completion, wanted_command, with_next_step
from hostlink.errors import ConfigError
from tests.support.documented import parser


@pytest.mark.parametrize(
    ("words", "wanted"),
    [(["echo", "/type"], "echo"), (["--debug", "params", "list"], "params"), (["--help"], None), ([], None)],
)
def test_the_first_name_of_a_command_is_meant(words: list[str], wanted: str | None) -> None:
    assert wanted_command(words) == wanted


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({}, []),
        ({"COMP_WORDS": "hostlink echo /rob"}, []),
        ({"_HOSTLINK_COMPLETE": "complete_bash", "COMP_WORDS": "hostlink echo /rob"}, ["echo", "/rob"]),
        ({"_HOSTLINK_COMPLETE": "complete_zsh", "_TYPER_COMPLETE_ARGS": "hostlink pub /x '{"}, ["pub", "/x", "'{"]),
        ({"_HOSTLINK_COMPLETE": "complete_fish", "_TYPER_COMPLETE_ARGS": "hostlink ec"}, ["ec"]),
    ],
)
def test_the_words_that_a_shell_completes(environment: dict[str, str], words: list[str]) -> None:
    assert completed_words(environment) == words


BASH = {"_HOSTLINK_COMPLETE": "complete_bash"}
ZSH = {"_HOSTLINK_COMPLETE": "complete_zsh"}


@pytest.mark.parametrize(
    ("environment", "own"),
    [
        ({}, {}),
        (BASH | {"COMP_WORDS": "hostlink echo /rob", "COMP_CWORD": "2"}, {}),
        (BASH | {"COMP_WORDS": "hostlink topic", "COMP_CWORD": "1"}, {}),
        (BASH | {"COMP_WORDS": "hostlink topic ec", "COMP_CWORD": "2"}, {}),
        (
            BASH | {"COMP_WORDS": "hostlink ros2 topic echo /rob", "COMP_CWORD": "4"},
            {"COMP_WORDS": "hostlink echo /rob", "COMP_CWORD": "2"},
        ),
        (
            BASH | {"COMP_WORDS": "hostlink param get ", "COMP_CWORD": "3"},
            {"COMP_WORDS": "hostlink params get ", "COMP_CWORD": "3"},
        ),
        (ZSH | {"_TYPER_COMPLETE_ARGS": "hostlink rostopic hz "}, {"_TYPER_COMPLETE_ARGS": "hostlink hz "}),
        (ZSH | {"_TYPER_COMPLETE_ARGS": "hostlink rostopic hz /r"}, {"_TYPER_COMPLETE_ARGS": "hostlink hz /r"}),
        (ZSH | {"_TYPER_COMPLETE_ARGS": "hostlink rostopic hz"}, {}),
    ],
)
def test_completion_of_a_command_of_ros_is_that_of_hostlink(environment: dict[str, str], own: dict[str, str]) -> None:
    assert own_completion(environment) == own


def test_every_command_has_a_line_that_fits_a_terminal() -> None:
    assert len(COMMANDS) > 20
    assert all(text.endswith(".") and len(text) <= 86 for text in COMMANDS.values())


def commands_of(found: Any, name: str) -> Iterator[tuple[str, Any]]:
    inner = getattr(found, "commands", {})
    yield from ([] if inner else [(name, found)])
    for each, command in inner.items():
        yield from commands_of(command, f"{name} {each}")


def test_every_argument_and_option_has_a_help_text() -> None:
    commands = [each for name in COMMANDS for each in commands_of(parser(name), name)]
    bare = [f"{name}: {part.name}" for name, command in commands for part in command.params if not part.help]
    assert len(commands) > len(COMMANDS)
    assert bare == []


DOCUMENTS = Path(__file__).parents[3] / "docs"
NAMED = re.compile(r"(?:`|^    |^    \.venv/bin/|\$ )hostlink ([a-z][a-z-]*[a-z])\b", re.MULTILINE)


def test_every_command_is_in_the_document_of_commands() -> None:
    text = (DOCUMENTS / "commands.md").read_text()
    assert [name for name in COMMANDS if not re.search(rf"`(?:hostlink )?{name}\b", text)] == []


QUICK = (
    "robots",
    "teleop",
    "stop",
    "lock",
    "unlock",
    "topics",
    "echo",
    "hz",
    "pub",
    "find",
    "record",
    "drives",
    "doctor",
    "top",
)


@pytest.mark.slow
def test_a_command_that_queries_a_daemon_imports_no_daemon() -> None:
    modules = sorted({module_of(name) for name in QUICK})
    slow = ("hostlink.core.hub.hub", "aiohttp.web", "structlog", "numpy")
    text = f"import sys, importlib; [*map(importlib.import_module, {modules})]; print({{*{slow}}} & {{*sys.modules}})"
    found = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert found.stdout == "set()\n"


@pytest.mark.parametrize(
    ("kind", "text", "wanted"),
    [
        ("UnknownTopic", "no topic named /x; known: /y", "no topic named /x; known: /y; `hostlink topics` lists them"),
        ("HostlinkError", "no service named /x", "no service named /x; `hostlink services` lists them"),
        ("UnknownTopic", "no link named 9; known: 1", "no link named 9; known: 1; `hostlink links --ended` lists them"),
        ("WrongType", "/x: wanted a/B, got c/D", "/x: wanted a/B, got c/D; `hostlink type /x` shows its type"),
        (
            "BadRequest",
            "a/B.c: wanted text, got 5",
            "a/B.c: wanted text, got 5; `hostlink type TYPE` shows the fields of a",
        ),
        ("FrameTooLarge", "/x: frame of 9 bytes", "/x: frame of 9 bytes; send less in one message; `hostlink doctor`"),
        ("RecordingFailed", "/x: No such file or directory", "/x: No such file or directory; check its name"),
        ("RecordingFailed", "/x: Permission denied", "/x: Permission denied; check who may read and write it"),
        (
            "ConfigError",
            "port 80: cannot be listened on: Permission denied",
            "port 80: cannot be listened on: Permission denied; choose a port above 1023",
        ),
        ("RecordingFailed", "/x: Is a directory", "/x: Is a directory; name a file"),
        ("DeviceGone", "r: its device is gone", "r: its device is gone; `hostlink doctor` finds out why"),
    ],
)
def test_errors_of_the_daemon_get_the_command_that_helps(kind: str, text: str, wanted: str) -> None:
    assert with_next_step(kind, text).startswith(wanted)


@pytest.mark.parametrize(
    "text", ["there is no robot named x; `hostlink robots` lists them", "no time named x", "ended"]
)
def test_other_errors_stay_as_they_are(text: str) -> None:
    assert with_next_step("HostlinkError", text) == text


@pytest.mark.parametrize(
    "words",
    [
        "play x.mcap --drive",
        "unlock",
        "unlock robot_0",
        "drive",
        "step",
        "calibrate",
        "drives",
        "echo",
        "hz",
        "info",
        "params get",
        "type",
    ],
)
def test_empty_name_is_refused_before_anything_is_connected(words: str) -> None:
    with pytest.raises(ConfigError, match="the name is empty; give one, "):
        _run([*words.split(), "", "--url", "http://127.0.0.1:9"])
