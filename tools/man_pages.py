"""Write the man pages: hostlink(1), and hostlink-COMMAND(1) for each command, from the parsers of the commands.

python -m tools.man_pages FOLDER
"""

import argparse
import datetime
import gzip
import inspect
import os
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import typer

from hostlink.cli.main import COMMANDS, PANELS, build_app
from tools.docs_reference import default, parser

ROOT = Path(__file__).parents[1]
SUMMARY = "host for rosserial robots, without ROS"
EXIT_STATUS = {
    "0": "The command succeeded, or Ctrl-C ended a measurement.",
    "1": "The command failed while it ran: no daemon answers, a request is refused, or `doctor` found a problem.",
    "2": "The arguments or the settings are wrong.",
}
ENVIRONMENT = {
    "HOSTLINK_URL": "Address of the daemon, as http://127.0.0.1:9090. The option `--url` has precedence.",
    "HOSTLINK_TOKEN": "Token of the API. The option `--token` has precedence.",
    "NO_COLOR": "Turn colours off.",
}
FILES = {
    "/etc/hostlink/hostlink.toml": "Settings of the service.",
    "/var/lib/hostlink": "Recordings, incidents and the state of robots of the service.",
    "~/.local/state/hostlink": "The same of a daemon that a user starts.",
}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--gzip", action="store_true", help="compress them, without a time in them")
    chosen = arguments.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        if chosen.gzip:
            (chosen.folder / f"{name}.gz").write_bytes(gzip.compress(text.encode(), 9, mtime=0))
        else:
            (chosen.folder / name).write_text(text)


def version() -> str:
    """Return the version of pyproject.toml, the one place where it is written."""
    return str(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])


def pages() -> dict[str, str]:
    """Return the text of each page by its file name."""
    found = {"hostlink.1": "\n".join(overview()) + "\n"}
    for name, summary in COMMANDS.items():
        found[f"hostlink-{name}.1"] = "\n".join(page(name, summary)) + "\n"
    return found


def overview() -> Iterator[str]:
    """Return the lines of hostlink(1)."""
    yield from head("hostlink", SUMMARY)
    yield from [".SH SYNOPSIS", ".B hostlink", r"[\fIOPTIONS\fR] \fICOMMAND\fR [\fIARGUMENTS\fR]"]
    yield ".SH DESCRIPTION"
    yield from paragraphs(
        "hostlink accepts rosserial devices (Arduino, STM32, ESP8266, ESP32) on TCP, UDP and serial ports, and offers "
        "their topics and services to programs: by rosbridge, Foxglove, REST and a web page, and as a node of ROS 1 "
        "or ROS 2. It needs no ROS.\n\n"
        "`hostlink demo` starts a daemon with a simulated robot; http://127.0.0.1:9090 is its page. "
        "`hostlink serve` starts the daemon for robots. `hostlink doctor` finds what is wrong."
    )
    yield ".SH OPTIONS"
    whole: Any = typer_command()
    yield from options(whole.params)
    yield ".SH COMMANDS"
    for panel, commands in PANELS.items():
        yield f".SS {quoted(panel)}"
        for name, text in commands.items():
            yield from [".TP", rf"\fBhostlink\-{escaped(name)}\fR(1)", escaped(text)]
    yield from tail(ENVIRONMENT)
    yield from [".SH FILES", *entries(FILES)]
    yield ".SH SEE ALSO"
    yield from references(COMMANDS)


def page(name: str, summary: str) -> Iterator[str]:
    """Return the lines of the page of one command and of the commands in it."""
    yield from head(f"hostlink-{name}", summary[:1].lower() + summary[1:].rstrip("."))
    found = parser(name)
    yield ".SH SYNOPSIS"
    inner = getattr(found, "commands", {})
    for each, of in [(f"hostlink {name} {sub}", of) for sub, of in inner.items()] or [(f"hostlink {name}", found)]:
        yield from synopsis(each, of)
    yield ".SH DESCRIPTION"
    yield from paragraphs(inspect.cleandoc(found.help or summary))
    yield from details(found, ".SH")
    for sub, of in inner.items():
        yield f".SH {quoted(f'{name} {sub}'.upper())}"
        yield from paragraphs(inspect.cleandoc(of.help or of.short_help or ""))
        yield from details(of, ".SS")
    variables = {name for of in (found, *inner.values()) for each in of.params for name in names_of_environment(each)}
    yield from tail({variable: ENVIRONMENT.get(variable, "") for variable in sorted(variables)})
    yield ".SH SEE ALSO"
    panel = next(names for names in PANELS.values() if name in names)
    yield from references(["", *(other for other in panel if other != name)])


def typer_command() -> Any:
    """Return the parser of `hostlink` itself."""
    return typer.main.get_command(build_app(None))


def head(name: str, summary: str) -> Iterator[str]:
    """Return the title and the section that whatis and apropos read."""
    yield f'.TH {quoted(name.upper())} 1 {date()} "hostlink {version()}" "User Commands"'
    yield from [".nh", ".ad l", ".SH NAME", rf"{escaped(name)} \- {escaped(summary)}"]


def date() -> str:
    """Return the day of the build, or of SOURCE_DATE_EPOCH."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    now = datetime.datetime.now(datetime.UTC)
    return str((datetime.datetime.fromtimestamp(int(seconds), datetime.UTC) if seconds else now).date())


def tail(environment: dict[str, str]) -> Iterator[str]:
    """Return the sections that all pages have."""
    yield from [".SH EXIT STATUS", *entries(EXIT_STATUS)]
    if environment:
        yield from [".SH ENVIRONMENT", *entries(environment)]


def synopsis(title: str, found: Any) -> Iterator[str]:
    """Return the usage of one command."""
    yield from [".PP", f".B {escaped(title)}"]
    words = [r"[\fIOPTIONS\fR]"] if any(is_shown_option(each) for each in found.params) else []
    for each in found.params:
        if each.param_type_name == "argument":
            dots = r"\&..." if each.nargs == -1 else ""
            word = rf"\fI{escaped(argument_name(each))}\fR{dots}"
            words.append(word if each.required else f"[{word}]")
    yield " ".join(words)


def is_shown_option(found: Any) -> bool:
    return found.param_type_name == "option" and not getattr(found, "hidden", False)


def argument_name(found: Any) -> str:
    return str(found.metavar or found.name.upper())


def details(found: Any, section: str) -> Iterator[str]:
    """Return the arguments and options of one command."""
    arguments = [each for each in found.params if each.param_type_name == "argument" and each.help]
    if arguments:
        yield f"{section} ARGUMENTS"
        for each in arguments:
            yield from [".TP", rf"\fI{escaped(argument_name(each))}\fR", *text(each)]
    if any(is_shown_option(each) for each in found.params):
        yield f"{section} OPTIONS"
        yield from options(found.params)


def options(params: Iterable[Any]) -> Iterator[str]:
    """Return a list of options with their defaults."""
    for each in filter(is_shown_option, params):
        value = "" if each.is_flag or getattr(each, "count", False) else rf" \fI{escaped(argument_name(each))}\fR"
        names = ", ".join(rf"\fB{escaped(name)}\fR{value}" for name in each.opts)
        negated = "".join(rf", \fB{escaped(name)}\fR" for name in each.secondary_opts)
        yield from [".TP", names + negated, *text(each)]


def text(found: Any) -> list[str]:
    """Return the help of an argument or option, its default and its variable."""
    sentence = " ".join((found.help or "").split())
    ended = sentence + ("." if sentence and sentence[-1] not in ".!?:" else "")
    of_default = f"Default: {default(found)}." if default(found) and found.param_type_name == "option" else ""
    variable = "".join(f"Environment: `{name}`." for name in names_of_environment(found))
    return [marked(" ".join(part for part in (ended, of_default, variable) if part))]


def names_of_environment(found: Any) -> list[str]:
    """Return the variables that set an option; typer has one name, several or none."""
    return [found.envvar] if isinstance(found.envvar, str) else list(found.envvar or ())


def entries(of: dict[str, str]) -> Iterator[str]:
    """Return a list of names with their meaning."""
    for name, meaning in of.items():
        yield from [".TP", rf"\fB{escaped(name)}\fR", marked(meaning)]


def paragraphs(words: str) -> Iterator[str]:
    """Return the paragraphs of a help text; what is indented, as an example, keeps its lines."""
    for index, paragraph in enumerate(part for part in words.split("\n\n") if part.strip()):
        if index:
            yield ".PP"
        lines = paragraph.splitlines()
        if all(line.startswith((" ", "\b")) for line in lines):
            yield from [".nf", *(marked(line) for line in lines if line != "\b"), ".fi"]
        else:
            yield marked(" ".join(line.strip() for line in lines))


def references(names: Iterable[str]) -> Iterator[str]:
    """Return other pages; the name "" is hostlink(1)."""
    pages_named = (escaped(f"hostlink-{name}" if name else "hostlink") for name in names)
    yield ",\n".join(rf"\fB{each}\fR(1)" for each in pages_named)


def marked(words: str) -> str:
    """Return text with `code` in bold."""
    return re.sub(r"`([^`]+)`", r"\\fB\1\\fR", escaped(words))


def escaped(words: str) -> str:
    """Return text in which roff finds no commands: backslashes, minus signs, and a dot or quote at the start."""
    safe = words.replace("\\", r"\e").replace("-", r"\-").replace("~", r"\(ti").replace("^", r"\(ha")
    return re.sub(r"^([.'])", r"\\&\1", safe, flags=re.MULTILINE)


def quoted(words: str) -> str:
    """Return one argument of a request."""
    return f'"{escaped(words).replace(chr(34), "")}"'


if __name__ == "__main__":
    main()
