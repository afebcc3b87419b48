"""Arguments that several commands share, and the names that a shell completes for them."""

import asyncio
import contextlib
import json
import re
from collections.abc import Awaitable, Callable, Iterable
from typing import Annotated, Any

import typer

from hostlink.client import DEFAULT_URL, Host, connect
from hostlink.errors import ConfigError, HostlinkError

# -- completion -------------------------------------------------------------------------------------------------------

TIMEOUT_S = 1.0  # a person who has pressed Tab waits
_SAFE = re.compile(r"[A-Za-z0-9_/.-]+")


Read = Callable[[Host], Awaitable[Iterable[str]]]


def _completing(read: Read) -> Callable[[typer.Context, str], list[str]]:
    """Return the completion of the names that `read` reads from the daemon."""

    async def request(url: str | None, token: str | None) -> Iterable[str]:
        async with asyncio.timeout(TIMEOUT_S), connect(url or DEFAULT_URL, token=token, reconnect=False) as host:
            return await read(host)

    def complete(context: typer.Context, incomplete: str) -> list[str]:
        with contextlib.suppress(HostlinkError, TimeoutError):
            names = asyncio.run(request(context.params.get("url"), context.params.get("token")))
            return [name for name in sorted(names) if name.startswith(incomplete) and _SAFE.fullmatch(name)]
        return []

    return complete


@_completing
async def topic_names(host: Host) -> Iterable[str]:
    """Read the names of topics."""
    return [topic["name"] for topic in await host.topics()]


@_completing
async def type_names(host: Host) -> Iterable[str]:
    """Read the types of topics."""
    return {topic["type"] for topic in await host.topics()}


@_completing
async def robot_names(host: Host) -> Iterable[str]:
    """Read the names of robots."""
    return [robot["name"] for robot in await host.robots()]


@_completing
async def service_names(host: Host) -> Iterable[str]:
    """Read the names of services."""
    return [str(name) for name in (await host.call("/rosapi/services", {}))["services"]]


@_completing
async def graph_names(host: Host) -> Iterable[str]:
    """Read the names of topics, nodes and services."""
    topics = [topic["name"] for topic in await host.topics()]
    nodes, services = await host.call("/rosapi/nodes", {}), await host.call("/rosapi/services", {})
    return {*topics, *nodes["nodes"], *services["services"]}


@_completing
async def parameter_names(host: Host) -> Iterable[str]:
    """Read the names of parameters."""
    return [str(name) for name in (await host.call("/rosapi/get_param_names", {}))["names"]]


# -- arguments --------------------------------------------------------------------------------------------------------


def not_empty(name: Any) -> Any:
    """Return the name or the names that a command was given; None without one. A variable of a shell may be unset.

    Raises:
        typer.BadParameter: one is empty.
    """
    if name == "" or (not isinstance(name, str) and "" in (name or ())):
        raise typer.BadParameter("the name is empty; give one, or leave the argument out if it is optional")
    return name


Url = Annotated[
    str,
    typer.Option(help="Address of the daemon's API: for a daemon on another computer or port.", envvar="HOSTLINK_URL"),
]
Token = Annotated[
    str | None,
    typer.Option(
        help="Token, for an API that needs one. Other users cannot read it from the environment.",
        envvar="HOSTLINK_TOKEN",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")]
JsonLines = Annotated[bool, typer.Option("--json", help="Print one JSON object a line, for programs.")]
Seconds = Annotated[float, typer.Option(min=0.0, help="End after this time, for scripts; 0: run until Ctrl-C.")]
TopicName = Annotated[str, typer.Argument(help="Name of the topic.", callback=not_empty, autocompletion=topic_names)]
ServiceName = Annotated[
    str, typer.Argument(help="Name of the service.", callback=not_empty, autocompletion=service_names)
]
RobotName = Annotated[
    str | None,
    typer.Argument(help="Name of a robot; without it: all robots.", callback=not_empty, autocompletion=robot_names),
]
RobotNames = Annotated[
    list[str] | None,
    typer.Argument(help="Names of robots; without one, or with the word all: all robots.", autocompletion=robot_names),
]
AllRobots = Annotated[bool, typer.Option("--all", help="All robots, as without a name.")]
ParameterName = Annotated[
    str, typer.Argument(help="Name of the parameter.", callback=not_empty, autocompletion=parameter_names)
]
TypeName = Annotated[
    str, typer.Argument(help="A type, for example geometry_msgs/Twist.", callback=not_empty, autocompletion=type_names)
]


def json_object(name: str, text: str) -> dict[str, object]:
    """Read the object of an argument, in JSON or in YAML's flow style.

    Raises:
        ConfigError: `text` is not an object; the exit status is 2.
    """
    try:
        value = read_message(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(name, f"cannot be read: {error}; write it as '{{linear: {{x: 0.1}}}}'") from error
    if not isinstance(value, dict):
        raise ConfigError(name, "is not an object with fields; write it as '{data: 1}'")
    return value


def field_value(name: str, text: str) -> object:
    """Read the value of one field: JSON, a list or an object in YAML's flow style, or else a string.

    Raises:
        ConfigError: a list or an object is not closed, or has other mistakes.
    """
    try:
        return _scalar(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(name, f"cannot be read: {error}; write a list as '[0.1, 0, 0]'") from error


# -- ros text ---------------------------------------------------------------------------------------------------------

_TEXT = r'"(?:[^"\\]|\\.)*"'
_SINGLE = re.compile(rf"({_TEXT})|'((?:[^']|'')*)'")
_NAME = re.compile(rf"({_TEXT})|([A-Za-z_]\w*)(?=\s*:)")
_WORD = re.compile(rf"({_TEXT})|(?<=[:\[,])(\s*)([A-Za-z_/][^,:\[\]{{}}\"]*?)(?=\s*[,\]}}])")
_MARKS = re.compile(rf"(?:{_TEXT}|(?<!\w)'(?:[^']|'')*')|([{{}}\[\]\"]|(?<!\w)')")  # outside of quoted texts
_CLOSING = {"{": "}", "[": "]"}
_CITED = 30  # characters of a text in an error
_LITERALS = {"true": "true", "false": "false", "null": "null", "yes": "true", "no": "false"}


def read_message(text: str) -> Any:
    """Read JSON, YAML in one line, with or without the braces, or the lines that `rostopic echo` prints.

    Raises:
        ValueError: `text` is neither; the error says what is wrong, or in which line.
        RecursionError: `text` is nested too deeply.
    """
    try:
        return json.loads(text)
    except ValueError:
        if "\n" in text.strip():
            return _Lines(text).value()
    try:
        return json.loads(_as_json(text.strip()))
    except json.JSONDecodeError as error:
        raise ValueError(_fault(text.strip(), error.doc[error.pos :])) from error


def _fault(text: str, rest: str) -> str:
    """Say what is wrong with a text that is neither JSON nor YAML. `rest`: what was not read of it, as JSON."""
    missing = ""
    for found in _MARKS.finditer(text):
        mark = found[1]
        if mark in ("'", '"'):
            return f"the quotation mark {mark} at {_begin(text[found.start() :])} is not closed"
        if mark in _CLOSING:
            missing = _CLOSING[mark] + missing
        elif mark and not missing.startswith(mark):
            return f"the {mark} at {_begin(text[found.start() :])} closes nothing"
        elif mark:
            missing = missing[1:]
    if missing:
        return f"{missing} is missing at the end"
    if not text.startswith(("{", "[")):
        rest = rest.removesuffix("}")  # of `_as_json`
    return f"it is wrong from {_begin(rest)} on" if rest else "a value is missing at the end"


def _begin(text: str) -> str:
    return repr(text if len(text) <= _CITED else f"{text[:_CITED]}...")


def _as_json(text: str) -> str:
    """Put strings, names and words of YAML into double quotes; a string in double quotes stays as it is."""
    text = text if text.startswith(("{", "[")) else f"{{{text}}}"
    text = _SINGLE.sub(lambda found: found[1] or json.dumps(found[2].replace("''", "'")), text)
    text = _NAME.sub(lambda found: found[1] or f'"{found[2]}"', text)
    return _WORD.sub(lambda found: found[1] or found[2] + _word(found[3]), text)


def _word(word: str) -> str:
    return _LITERALS.get(word.lower()) or json.dumps(word)


_KEY = re.compile(r"([A-Za-z_]\w*)\s*:(?:\s+(.*))?")


class _Lines:
    """YAML in lines: a field a line, indented; items of a list begin with `- `. Tab of rostopic pub completes it."""

    def __init__(self, text: str) -> None:
        lines = enumerate(text.split("\n"), 1)
        self._lines = [
            (number, len(line) - len(line.lstrip()), line.strip())
            for number, line in lines
            if line.strip() and line.strip() != "---" and not line.lstrip().startswith("#")
        ]
        self._lines.reverse()  # the next line is the last one

    def value(self) -> Any:
        """Return the value of all lines.

        Raises:
            ValueError: a line cannot be read.
        """
        if len(self._lines) == 1 and self._lines[0][2].startswith("{"):
            return _in_line(*self._lines[0][::2])
        found = self._value(self._lines[-1][1]) if self._lines else {}
        if self._lines:
            raise ValueError(f"line {self._lines[-1][0]} is not indented as the lines before it")
        return found

    def _value(self, indent: int) -> Any:
        return self._items(indent) if self._lines[-1][2].startswith("-") else self._fields(indent)

    def _fields(self, indent: int) -> dict[str, Any]:
        fields: dict[str, Any] = {}
        while self._lines and self._lines[-1][1] == indent and not self._lines[-1][2].startswith("- "):
            number, _, text = self._lines.pop()
            if (found := _KEY.fullmatch(text)) is None:
                raise ValueError(f"line {number} is not `name: value`: {text}")
            fields[found[1]] = self._inner(indent, is_item=False) if found[2] is None else _in_line(number, found[2])
        return fields

    def _items(self, indent: int) -> list[Any]:
        items: list[Any] = []
        while self._lines and self._lines[-1][1] == indent and self._lines[-1][2].startswith("-"):
            number, _, text = self._lines.pop()
            rest = text[1:].lstrip()
            if not rest:
                items.append(self._inner(indent, is_item=True))
            elif _KEY.fullmatch(rest) is not None:
                inner = indent + len(text) - len(rest)
                self._lines.append((number, inner, rest))
                items.append(self._fields(inner))
            else:
                items.append(_in_line(number, text if rest == text[1:] else rest))
        return items

    def _inner(self, indent: int, *, is_item: bool) -> Any:
        """Return the value below a name or a dash; None without one. A list below a name need not be indented."""
        if self._lines:
            _, inner, text = self._lines[-1]
            if inner > indent or (inner == indent and text.startswith("-") and not is_item):
                return self._value(inner)
        return None


def _in_line(number: int, text: str) -> Any:
    try:
        return _scalar(text)
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from error


def _scalar(text: str) -> Any:
    """Read a value of YAML in one line.

    Raises:
        ValueError: a list, an object or a quoted text is not closed.
    """
    if text.startswith(("{", "[")):
        return read_message(text)
    if text.startswith('"'):
        try:
            return json.loads(text)
        except json.JSONDecodeError as error:
            raise ValueError(_fault(text, text[error.pos :])) from error
    if text.startswith("'") and text.endswith("'") and len(text) > 1:
        return text[1:-1].replace("''", "'")
    try:
        return json.loads(_LITERALS.get(text.lower(), text))
    except ValueError:
        return text
