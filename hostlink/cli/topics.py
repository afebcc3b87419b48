"""The commands for the graph: topics, nodes, info, type, find, echo, hz, bw, delay, pub, services, call."""

import asyncio
import contextlib
import csv
import io
import itertools
import json as json_text
import math
import re
import shlex
import struct
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import (
    Json,
    JsonLines,
    Seconds,
    ServiceName,
    Token,
    TopicName,
    TypeName,
    Url,
    field_value,
    graph_names,
    json_object,
    not_empty,
)
from hostlink.cli.connecting import PATIENCE_S, ask, connected, rosapi, run_until_interrupted, waiting, write_hint
from hostlink.cli.names import listed, natural, similar, unknown
from hostlink.cli.output import duration, is_terminal, quantity, show_progress, write, write_error, write_table
from hostlink.client import DEFAULT_URL, Host, Mailbox, RawMessage, TopicState
from hostlink.core.runtime.plain_text import csv_text
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import ConfigError, HostlinkError, WrongType, size

RATE_S = 1.0  # in which the rates of -v are measured
HEAD = ("topic", "type", "pubs", "subs", "messages", "rate")

PARTS_OF_TOPIC = 2  # "/run" has two parts

LONGEST = 32  # values of a list that a terminal shows in full

SHOWN = 8  # values of a list that is shortened

DIGITS = 6  # after the point of a number of 1 or more, and significant ones below 1: a float32 has no more

RATE_WINDOW = 10_000  # messages, rostopic's default

INTERVAL_S = 1.0

BW_WINDOW = 100  # messages, rostopic's default

PUB_RATE_HZ = 10.0
VELOCITY_HOLDS_S = 0.5  # the lease of robot/admission.py

# -- services and types -----------------------------------------------------------------------------------------------


async def service_facts(host: Host, name: str) -> dict[str, Any]:
    """Return the type and the node of a service."""
    facts = {"type": "service_type", "node": "service_node"}
    return {key: await rosapi(host, asked, key, service=name) for key, asked in facts.items()}


async def type_of(host: Host, topic: str, step: str = "`hostlink topics` lists all topics") -> str:
    """Return the type of a topic. `step` ends the error.

    Raises:
        HostlinkError: the topic does not exist, or has no type yet.
    """
    found: str = await rosapi(host, "topic_type", "type", topic=topic)
    if found:
        return found
    full = "/" + topic.lstrip("/~")
    names = {each["name"] for each in await host.topics()} - {full}
    raise HostlinkError(f"{full} has no type yet, because it has no publisher; {similar(full, names)}{step}")


# -- topics -----------------------------------------------------------------------------------------------------------


def topics(
    *,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Show the rate of each topic too, measured for a second."),
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the topics: name, type, number of publishers, subscribers and messages."""
    found: list[Any] = ask(url, token, _rated if verbose else Host.topics)
    topics = sorted(found, key=lambda topic: natural(topic["name"]))
    if json:
        write(json_text.dumps(topics))
    elif not topics:
        write_error("there are no topics, because no device has connected yet; `hostlink doctor` finds out why")
    else:
        write_table(HEAD if verbose else HEAD[:-1], [_topic_row(topic) for topic in topics])


async def _rated(host: Host) -> list[Any]:
    """Return the topics with `rate_hz`, measured between two requests; null for a topic that appeared in between."""
    loop = asyncio.get_running_loop()
    before_s, before = loop.time(), {topic["name"]: topic["messages"] for topic in await host.topics()}
    show_progress("measuring for a second ...")
    await asyncio.sleep(RATE_S)
    now_s, topics = loop.time(), await host.topics()

    def rate_hz(topic: TopicState) -> float | None:
        known = before.get(topic["name"])
        return None if known is None else round((topic["messages"] - known) / (now_s - before_s), 1)

    return [{**topic, "rate_hz": rate_hz(topic)} for topic in topics]


def _topic_row(topic: dict[str, Any]) -> list[str]:
    counts = [str(topic[key]) for key in ("publishers", "subscribers", "messages")]
    row = [topic["name"], topic["type"] or "-", *counts]
    if "rate_hz" in topic:
        row.append("-" if topic["rate_hz"] is None else f"{topic['rate_hz']:.1f} Hz")
    return row


# -- nodes ------------------------------------------------------------------------------------------------------------


def nodes(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the nodes, which are devices and programs: how much each publishes, subscribes and offers."""
    nodes = ask(url, token, _nodes)
    if json:
        write(json_text.dumps(nodes))
    else:
        counts = ("publishing", "subscribing", "services")
        write_table(["node", *counts], [[each["node"], *(len(each[key]) for key in counts)] for each in nodes])


async def _nodes(host: Host) -> list[dict[str, Any]]:
    names: list[str] = await rosapi(host, "nodes", "nodes")
    return [
        {"node": name, **(await host.call("/rosapi/node_details", {"node": name}))}
        for name in sorted(names, key=natural)
    ]


# -- graph info -------------------------------------------------------------------------------------------------------


def show_name(name: str, url: str, token: str | None, *, as_json: bool) -> None:
    """Write the facts of a topic, a node or a service.

    Raises:
        HostlinkError: the graph has no such name, or no daemon answers.
    """
    found = ask(url, token, lambda host: _find_name(host, "/" + name.lstrip("/~")))
    write(*([json_text.dumps(found)] if as_json else _fact_lines(found)))


async def _find_name(host: Host, name: str) -> dict[str, Any]:
    topics = {topic["name"]: topic for topic in await host.topics()}
    if name in topics:
        both = {each: await rosapi(host, each, each, topic=name) for each in ("publishers", "subscribers")}
        return {"topic": name, "type": topics[name]["type"], **both, "messages": topics[name]["messages"]}
    nodes: list[str] = await rosapi(host, "nodes", "nodes")
    if name in nodes:
        details: dict[str, Any] = await host.call("/rosapi/node_details", {"node": name})
        return {"node": name, **details}
    services: list[str] = await rosapi(host, "services", "services")
    if name in services:
        return {"service": name, **(await service_facts(host, name))}
    raise unknown("topic, node or service", name, [*topics, *nodes, *services], command="topics")


def _fact_lines(found: dict[str, Any]) -> list[str]:
    """Lines of the facts: one for each fact, and one for each item of a list."""
    width = max(map(len, found)) + 2
    lines = []
    for key, value in found.items():
        if isinstance(value, list):
            lines += [f"{key:<{width}}{len(value) or 'none'}", *(f"  {item}" for item in value)]
        else:
            lines.append(f"{key:<{width}}{value if value != '' else '(not known yet)'}")
    return lines


# -- info -------------------------------------------------------------------------------------------------------------

_RECORDING = (".mcap", ".bag", ".bag.active", ".db3")
_IN_FOLDER = (*_RECORDING, "metadata.yaml")  # the last one is of a folder of rosbag2


def info(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="A topic, a node or a service; or a recording of `hostlink record`.",
            callback=not_empty,
            autocompletion=graph_names,
        ),
    ],
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Show the publishers and subscribers of a topic, a node or a service, or the content of a recording.

    Of a recording: topics, types, rates and damage.
    """
    if is_recording(name):
        from hostlink.cli.export import show_recording  # noqa: PLC0415 - other names do not need it

        show_recording(Path(name), as_json=json)
    else:
        show_name(name, url, token, as_json=json)


def is_recording(name: str) -> bool:
    """Whether `name` is a file or a folder of recordings, rather than a name of the graph.

    What exists here is a path: the slash of a topic, /odom, tells it from a folder odom. A topic may also have the name
    of a folder in the root, such as /run. Such a folder needs recordings in it.
    """
    try:
        path = Path(name)
        if name.endswith(_RECORDING) or path.is_file():
            return True
        is_path = not path.is_absolute() or len(path.parts) > PARTS_OF_TOPIC or name.endswith("/")
        return path.is_dir() and (is_path or any(each.name.endswith(_IN_FOLDER) for each in path.iterdir()))
    except (OSError, ValueError):  # the name is too long for a file, or has a zero byte; or the folder is private
        return False


# -- type -------------------------------------------------------------------------------------------------------------

NameOrType = Annotated[
    str,
    typer.Argument(help="A topic or a service; or a type.", callback=not_empty, autocompletion=graph_names),
]


def type_(
    name: NameOrType,
    *,
    fields: Annotated[
        bool, typer.Option("--fields", "-f", help="Show its fields too, as `pub` and `call` need them.")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Show the type of a topic or of a service, or the fields of a type."""
    found = ask(url, token, lambda host: _find_type(host, "/" + name.lstrip("/~"), with_fields=fields))
    if json:
        write(json_text.dumps(found))
    else:
        write(found["type"], *_field_list(found.get("fields", [])))
        if "response" in found:
            write("  ---", *_field_list(found["response"]))


def _field_list(fields: list[dict[str, str]]) -> list[str]:
    return [f"  {field['type']} {field['name']}" for field in fields]


async def _find_type(host: Host, name: str, *, with_fields: bool) -> dict[str, Any]:
    topics = {topic["name"]: topic["type"] for topic in await host.topics()}
    services: list[str] = [] if name in topics else await rosapi(host, "services", "services")
    if name in topics:
        type_name, details = await type_of(host, name), "message_details"
    elif name in services:
        type_name = await rosapi(host, "service_type", "type", service=name)
        details = "service_request_details"
    else:
        type_name = name.removeprefix("/").replace("/msg/", "/").replace("/srv/", "/")
        of_type = await _of_type(host, type_name)
        if of_type is None:
            is_type = type_name.count("/") == 1
            known = [*topics, *services, *(itertools.chain(*standard_types()) if is_type else ())]
            raise unknown("topic, service or type", type_name if is_type else name, known, command="topics")
        return of_type
    found: dict[str, Any] = {"name": name, "type": type_name}
    return found | {"fields": await _fields(host, details, type_name)} if with_fields else found


def standard_types() -> tuple[list[str], list[str]]:
    """List the types of messages and of services that every daemon knows."""
    from hostlink.core.messages.catalog import Catalog  # noqa: PLC0415 - only for an error

    catalog = Catalog()
    return catalog.message_names(), catalog.service_names()


async def _of_type(host: Host, type_name: str) -> dict[str, Any] | None:
    """Return the fields of a message type, as `rosmsg show` does; None if the type is unknown."""
    found: dict[str, Any] = {"name": type_name, "type": type_name}
    with contextlib.suppress(HostlinkError):
        return found | {"fields": await _fields(host, "message_details", type_name)}
    with contextlib.suppress(HostlinkError):
        request = await _fields(host, "service_request_details", type_name)
        return found | {"fields": request, "response": await _fields(host, "service_response_details", type_name)}
    return None


async def _fields(host: Host, details: str, type_name: str) -> list[dict[str, str]]:
    """Return the fields of the type and of the types that it contains, by their paths."""
    typedefs = await rosapi(host, details, "typedefs", type=type_name)
    known = {each["type"]: each for each in typedefs}

    def walk(typedef: dict[str, Any], prefix: str) -> list[dict[str, str]]:
        found = []
        for name, type_, length in zip(
            typedef["fieldnames"], typedef["fieldtypes"], typedef["fieldarraylen"], strict=True
        ):
            suffix = {-1: "", 0: "[]"}.get(length, f"[{length}]")
            found.append({"name": prefix + name, "type": type_ + suffix})
            if type_ in known and length < 0:
                found += walk(known[type_], f"{prefix}{name}.")
        return found

    return walk(typedefs[0], "") if typedefs else []


# -- find -------------------------------------------------------------------------------------------------------------


def find(type_name: TypeName, *, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the topics and services of a type."""
    topics, services = ask(url, token, lambda host: _find_of_type(host, type_name))
    write(*([json_text.dumps({"topics": topics, "services": services})] if json else [*topics, *services]))


async def _find_of_type(host: Host, type_name: str) -> tuple[list[str], list[str]]:
    topics: list[str] = await rosapi(host, "topics_for_type", "topics", type=type_name)
    services: list[str] = await rosapi(host, "services_for_type", "services", type=type_name)
    if not topics and not services:
        known = {topic["type"] for topic in await host.topics()} - {""}
        raise unknown("topic or service of a type", type_name, known, command="topics")
    return topics, services


# -- echo -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Echo:
    """Arguments of `hostlink echo`."""

    topic: str
    field: str
    count: int  # 0: until Ctrl-C
    throttle_ms: int
    timeout_s: float  # 0: none
    as_json: bool
    as_csv: bool
    longest: float  # a list with more values, or a longer text, is shortened


def echo(
    topic: TopicName,
    type_name: Annotated[str, typer.Argument(metavar="[TYPE]", help="Its type, which may be left out.")] = "",
    *,
    count: Annotated[
        int | None,
        typer.Option(
            "--count", "-n", min=1, help="End after so many messages, for scripts.", show_default="until Ctrl-C"
        ),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="End after the first message.")] = False,
    field: Annotated[str, typer.Option(help="Print only this field, for example pose.position.x or ranges[0].")] = "",
    csv: Annotated[
        bool, typer.Option("--csv", "-p", help="Print CSV, for a spreadsheet: the time and a column for each field.")
    ] = False,
    no_arr: Annotated[
        bool, typer.Option("--no-arr", help="Print the length of each list instead of its values.")
    ] = False,
    full_length: Annotated[
        bool,
        typer.Option(
            "--full-length", "-f", help=f"Print lists of more than {LONGEST} values in full on a terminal, too."
        ),
    ] = False,
    throttle_ms: Annotated[
        int, typer.Option(min=0, help="Print at most one message in so many milliseconds, of a fast topic.")
    ] = 0,
    timeout: Annotated[
        float, typer.Option(min=0.0, help="Fail when no message arrives for so many seconds; 0: wait for ever.")
    ] = 0.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonLines = False,
) -> None:
    """Print the messages of a topic until Ctrl-C, with `---` after each."""
    if csv and json:
        raise ConfigError("--csv", "cannot be combined with --json; use one of them")
    echo = Echo(
        topic=topic,
        field=field,
        count=1 if once else count or 0,
        throttle_ms=throttle_ms,
        timeout_s=timeout,
        as_json=json,
        as_csv=csv,
        longest=0 if no_arr else LONGEST if is_terminal() and not full_length else math.inf,
    )
    run_until_interrupted(_echo(url, token, echo, type_name.replace("/msg/", "/")))


async def _echo(url: str, token: str | None, echo: Echo, type_name: str) -> None:
    async with connected(url, token) as host:
        if not echo.field:
            echo = with_field(echo, [topic["name"] for topic in await host.topics()])
        throttle_ms = echo.throttle_ms
        async with host.subscribe(echo.topic, type_name=type_name, throttle_rate_ms=throttle_ms) as messages:
            if not echo.as_json:
                await write_hint(host, echo.topic)
            printed = 0
            async for message in _within(messages, echo):
                write(*message_lines(message, echo, is_first=not printed))
                printed += 1
                if printed == echo.count:
                    return


def message_lines(message: dict[str, Any], echo: Echo, *, is_first: bool) -> list[str]:
    """Return the lines that show a message; for CSV the first message has a header line."""
    value = field_of(message, echo.field) if echo.field else message
    if echo.as_json:
        return [json_text.dumps(value, ensure_ascii=False)]
    if not echo.as_csv:
        is_single = bool(echo.field) and not isinstance(value, dict | list)
        return [*block(readable(value), echo.longest), *([] if is_single else ["---"])]
    pairs = list(flat(value, echo.field)) if value != {} else []
    lines = [csv_line([f"{time.time():.6f}", *(each for _, each in pairs)])]
    return [csv_line(["time", *(name for name, _ in pairs)]), *lines] if is_first else lines


async def _within(messages: AsyncIterator[dict[str, Any]], echo: Echo) -> AsyncIterator[dict[str, Any]]:
    """Yield every message.

    Raises:
        HostlinkError: no message arrived within `timeout_s` seconds.
    """
    while True:
        try:
            async with asyncio.timeout(echo.timeout_s or None):
                message = await anext(messages)
        except TimeoutError:
            raise HostlinkError(
                f"{echo.topic}: no message arrived within {echo.timeout_s:g} s; "
                f"`hostlink info {echo.topic}` lists its publishers"
            ) from None
        yield message


def with_field(echo: Echo, topics: Iterable[str]) -> Echo:
    """Take the end of an unknown topic as a field, as rostopic does: /robot_0/odometry/x."""
    full = "/" + echo.topic.lstrip("/~")
    found = max((name for name in topics if full == name or full.startswith(f"{name}/")), key=len, default=full)
    rest = full.removeprefix(found).strip("/")
    return replace(echo, topic=found, field=rest.replace("/", ".")) if rest else echo


# -- block ------------------------------------------------------------------------------------------------------------

_CHARS = 4  # characters of a text that count as one value of a list


def block(value: Any, longest: float = math.inf) -> list[str]:
    """Lines of a message as rostopic and ros2 print it: a field a line, indented. They are YAML.

    A list of more than `longest` values ends with its length; with `longest` 0 only the length is shown.
    """
    if isinstance(value, dict) and value:
        return [line for name, inner in value.items() for line in _field_lines(name, inner, longest)]
    if isinstance(value, list) and any(isinstance(each, dict | list) for each in value) and longest:
        shown = value if len(value) <= longest else value[:SHOWN]
        items = [block(each, longest) for each in shown]
        lines = [("- " if not number else "  ") + line for item in items for number, line in enumerate(item)]
        return lines if shown is value else [*lines, f"# the first {len(shown)} of {len(value)}"]
    return [_inline(value, longest)]


def _field_lines(name: str, value: Any, longest: float) -> list[str]:
    lines = block(value, longest)
    is_inline = len(lines) == 1 and not (isinstance(value, dict) and value) and not lines[0].startswith("- ")
    return [f"{name}: {lines[0]}"] if is_inline else [f"{name}:", *(f"  {line}" for line in lines)]


def _inline(value: Any, longest: float) -> str:
    if isinstance(value, list) and value and longest < len(value):
        if not longest:
            return f"<list of {len(value)}>"
        shown = ", ".join(json_text.dumps(each, ensure_ascii=False) for each in value[:SHOWN])
        return f"[{shown}, ...]  # the first {SHOWN} of {len(value)}"
    if isinstance(value, str) and longest and longest * _CHARS < len(value):
        shown = json_text.dumps(value[: SHOWN * _CHARS], ensure_ascii=False)
        return f"{shown}  # the first {SHOWN * _CHARS} of {len(value)} characters"
    return json_text.dumps(value, ensure_ascii=False)


# -- fields -----------------------------------------------------------------------------------------------------------

_STEP = re.compile(r"([^.\[\]]+)|\[(\d{1,9})\]")


def field_of(message: Any, path: str) -> Any:
    """Return the value at a path, for example pose.position.x or ranges[0].

    Raises:
        HostlinkError: the message has no such field; the error lists the fields that it has.
    """
    value = message
    for name, index in _STEP.findall(path):
        if isinstance(value, dict) and name in value:
            value = value[name]
        elif isinstance(value, list) and (index or name).isdecimal() and int(index or name) < len(value):
            value = value[int(index or name)]
        else:
            raise HostlinkError(f"no field {path}; at that place the message has {_known(value)}")
    return value


def _known(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(value) or "no fields"
    return f"a list of {len(value)}" if isinstance(value, list) else "a single value"


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of every field that has no fields of its own; a list counts as one value."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flat(inner, f"{name}.{key}" if name else key)
    else:
        yield name, value


def csv_line(cells: Iterable[Any]) -> str:
    """Return a line of CSV; lists are JSON."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(
        json_text.dumps(cell) if isinstance(cell, list | dict | bool) else _csv_cell(cell) for cell in cells
    )
    return line.getvalue()


def _csv_cell(value: Any) -> Any:
    return csv_text(value) if isinstance(value, str) else value


def readable(value: Any) -> Any:
    """Round the numbers of a value to DIGITS."""
    if isinstance(value, dict):
        return {key: readable(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [readable(inner) for inner in value]
    if isinstance(value, float):
        return round(value, DIGITS) if abs(value) >= 1 else float(f"{value:.{DIGITS}g}")
    return value


# -- measuring --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Distribution:
    """Count, mean, extremes and standard deviation of numbers."""

    count: int
    mean: float
    least: float
    most: float
    deviation: float


def distribution(numbers: Iterable[float]) -> Distribution | None:
    """Return the distribution of numbers; None without numbers."""
    known = list(numbers)
    if not known:
        return None
    mean = math.fsum(known) / len(known)
    variance = math.fsum((each - mean) ** 2 for each in known) / len(known)
    return Distribution(len(known), mean, min(known), max(known), math.sqrt(variance))


class MessageWindow:
    """Last messages of a topic: the arrival time and a measured figure of each."""

    def __init__(self, window: int) -> None:
        self.messages = 0
        self._times_s: deque[float] = deque(maxlen=window)
        self._figures: deque[float] = deque(maxlen=window)

    def add(self, time_s: float, figure: float = 0.0) -> None:
        """Add one message."""
        self.messages += 1
        self._times_s.append(time_s)
        self._figures.append(figure)

    @property
    def figures(self) -> Distribution | None:
        """Distribution of the figures; None before the first message."""
        return distribution(self._figures)

    @property
    def between_s(self) -> Distribution | None:
        """Distribution of the intervals between messages; None before the second message."""
        times_s = list(self._times_s)
        return distribution(later - earlier for earlier, later in itertools.pairwise(times_s))

    @property
    def rate_hz(self) -> float:
        """Mean rate; 0 before the second message."""
        between_s = self.between_s
        return 0.0 if between_s is None or between_s.mean <= 0 else 1 / between_s.mean


# -- topic figures ----------------------------------------------------------------------------------------------------


async def _nothing_to_check(_host: Host, _topic: str) -> None:
    """Accept every topic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Measured figure of each message, and the format of the result."""

    text: str  # the help of the command
    view: Callable[[MessageWindow], dict[str, Any]]  # for programs
    line: Callable[[MessageWindow], str]
    figure: Callable[[RawMessage], float] = lambda _: 0.0
    window: int = RATE_WINDOW
    check: Callable[[Host, str], Awaitable[None]] = _nothing_to_check  # raises HostlinkError for a topic without it


def command_of(figures: Figures) -> Callable[..., None]:
    """Build the command that measures these figures."""

    def command(
        topic: TopicName,
        *,
        window: Annotated[
            int,
            typer.Option(
                "--window",
                "-w",
                min=2,
                help="Number of last messages that the figures are of: a smaller window follows changes sooner.",
            ),
        ] = figures.window,
        seconds: Seconds = 0.0,
        url: Url = DEFAULT_URL,
        token: Token = None,
        json: JsonLines = False,
    ) -> None:
        measured = MessageWindow(window)
        began_s = time.monotonic()

        async def run() -> None:
            async with connected(url, token) as host:
                await figures.check(host, topic)
                if not json:
                    await write_hint(host, topic)
                async with host.subscribe_raw(topic) as messages:
                    await _measure(figures, measured, messages, seconds=seconds or float("inf"), as_json=json)

        run_until_interrupted(run())
        write_error(f"{quantity(measured.messages, 'message')} in {time.monotonic() - began_s:.1f} s")

    command.__doc__ = figures.text
    return command


async def _measure(
    figures: Figures, measured: MessageWindow, messages: Mailbox[RawMessage], *, seconds: float, as_json: bool
) -> None:
    """Write a line each second, until the time is over."""
    next_s = asyncio.get_running_loop().time()
    end_s = next_s + seconds
    while next_s < end_s:
        next_s, before = min(next_s + INTERVAL_S, end_s), measured.messages
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(next_s):
                async for message in messages:
                    measured.add(message.stamp_ns / NS_PER_S, figures.figure(message))
        if as_json:
            write(json_text.dumps({"messages": measured.messages} | figures.view(measured)))
        else:
            write(figures.line(measured) if measured.messages > before else "no new messages")


def _spread(seconds: Distribution) -> str:
    least, most, deviation = map(duration, (seconds.least, seconds.most, seconds.deviation))
    return f"{duration(seconds.mean)} (min {least}, max {most}, std dev {deviation})"


def _spread_view(seconds: Distribution) -> dict[str, float]:
    figures = {"min_s": seconds.least, "max_s": seconds.most, "std_dev_s": seconds.deviation}
    return {name: round(value, 6) for name, value in figures.items()}


# -- hz ---------------------------------------------------------------------------------------------------------------


def _hz_view(measured: MessageWindow) -> dict[str, Any]:
    between_s = measured.between_s
    if between_s is None:
        return {"rate_hz": None}
    return {"rate_hz": round(measured.rate_hz, 4), "window": between_s.count + 1, **_spread_view(between_s)}


def _hz_line(measured: MessageWindow) -> str:
    between_s = measured.between_s
    if between_s is None:
        return "one message"
    return f"{measured.rate_hz:8.2f} Hz   every {_spread(between_s)} of {between_s.count + 1} messages"


hz = command_of(
    Figures(text="Measure the rate of a topic; a line each second until Ctrl-C.", view=_hz_view, line=_hz_line)
)


# -- bw ---------------------------------------------------------------------------------------------------------------


def _bw_view(measured: MessageWindow) -> dict[str, Any]:
    bytes_ = measured.figures
    if bytes_ is None:
        return {"bytes_s": None}
    return {
        "bytes_s": round(measured.rate_hz * bytes_.mean, 1),
        "mean_bytes": round(bytes_.mean, 1),
        "min_bytes": int(bytes_.least),
        "max_bytes": int(bytes_.most),
        "window": bytes_.count,
    }


def _bw_line(measured: MessageWindow) -> str:
    bytes_ = measured.figures
    if bytes_ is None or measured.between_s is None:
        return "one message"
    return (
        f"{size(measured.rate_hz * bytes_.mean)}/s   {measured.rate_hz:.1f} messages a second of {size(bytes_.mean)} "
        f"(min {size(bytes_.least)}, max {size(bytes_.most)})"
    )


bw = command_of(
    Figures(
        text="Measure the bandwidth of a topic; a line each second until Ctrl-C.",
        view=_bw_view,
        line=_bw_line,
        figure=lambda message: len(message.payload),
        window=BW_WINDOW,
    )
)


# -- delay ------------------------------------------------------------------------------------------------------------

_HEADER = struct.Struct("<III")  # seq, secs, nsecs: the beginning of a std_msgs/Header


async def _check_header(host: Host, topic: str) -> None:
    """Raise HostlinkError for a topic whose type has no header."""
    type_name = await type_of(host, topic)
    fields = (await rosapi(host, "message_details", "typedefs", type=type_name))[0]["fieldtypes"]
    if fields[:1] != ["std_msgs/Header"]:
        raise HostlinkError(
            f"{topic}: {type_name} has no header, so its age cannot be measured; "
            f"`hostlink hz {topic}` measures the rate"
        )


def _age_s(message: RawMessage) -> float:
    _, secs, nsecs = _HEADER.unpack_from(message.payload)
    return float(time.time() - secs - nsecs / NS_PER_S)


def _delay_view(measured: MessageWindow) -> dict[str, Any]:
    age_s = measured.figures
    if age_s is None:
        return {"delay_s": None}
    return {"delay_s": round(age_s.mean, 6), **_spread_view(age_s), "window": age_s.count}


def _delay_line(measured: MessageWindow) -> str:
    age_s = measured.figures
    if age_s is None:
        return "no messages yet"
    return f"delay {_spread(age_s)} of {quantity(age_s.count, 'message')}"


delay = command_of(
    Figures(
        text="Measure the age of a topic's messages when they arrive; a line each second until Ctrl-C. "
        "The messages need a header with a stamp.",
        view=_delay_view,
        line=_delay_line,
        figure=_age_s,
        check=_check_header,
    )
)


# -- pub --------------------------------------------------------------------------------------------------------------

_TYPE = re.compile(r"[A-Za-z]\w*(/msg|/srv)?/[A-Za-z]\w*")


@dataclass(slots=True)
class Publishing:
    """Rate and number of the messages of `pub`, and how many were sent, which is reported also after Ctrl-C."""

    rate_hz: float
    count: int  # 0: until Ctrl-C
    sent: int = 0


def pub(
    topic: TopicName,
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TYPE] [MESSAGE]",
            help="The message in JSON or YAML, for example '{linear: {x: 0.1}}', where missing fields are zero; "
            "or the values of all fields in their order.",
        ),
    ] = None,
    *,
    type_name: Annotated[
        str,
        typer.Option("--type", help="Type, for example geometry_msgs/Twist: only for a topic that does not exist yet."),
    ] = "",
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            "-r",
            min=0.01,
            max=1000.0,
            help="Messages a second, until Ctrl-C or --count: a robot stops after 0.5 s without one.",
            show_default="10, with --count",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(min=0, help="Number of messages; 0: until Ctrl-C.", show_default="1, or until Ctrl-C with --rate"),
    ] = None,
    once: Annotated[bool, typer.Option("--once", "-1", help="Send one message, also with --rate.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Publish a message once, or at a rate. A robot that it drives stops when this command ends."""
    named_type, message = type_and_message("MESSAGE", words or [])
    publishing = Publishing(rate or PUB_RATE_HZ, message_count(rate, count, once=once))
    run_until_interrupted(_pub(connected(url, token), topic, message, type_name or named_type, publishing))
    write_error(f"{publishing.sent} sent")


def message_count(rate_hz: float | None, count: int | None, *, once: bool) -> int:
    """Return the number of messages, 0 until Ctrl-C: a rate without a number means until Ctrl-C, as in rostopic.

    Raises:
        ConfigError: --once and --count are given.
    """
    if once and count is not None:
        raise ConfigError("--once", "cannot be combined with --count; use one of them")
    if once:
        return 1
    return count if count is not None else 1 if rate_hz is None else 0


Message = dict[str, object] | list[object]  # an object, or the values of the fields in their order


def type_and_message(name: str, words: Sequence[str]) -> tuple[str, Message]:
    """Return the type and the message of `[TYPE] [MESSAGE]`, as rostopic and ros2 have them; a missing type is empty.

    Args:
        name: name of the message in an error.
        words: a type, then an object in one word, or a word for each field.

    Raises:
        ConfigError: the message is neither.
    """
    is_typed = bool(words) and _TYPE.fullmatch(words[0]) is not None
    type_name, rest = (words[0].replace("/msg/", "/").replace("/srv/", "/"), words[1:]) if is_typed else ("", words)
    if any(word.endswith(":") for word in rest):
        raise ConfigError(
            name, f"{len(rest)} arguments were given; put the message in quotes: {shlex.quote('{linear: {x: 0.1}}')}"
        )
    if not rest or (len(rest) == 1 and (":" in rest[0] or rest[0].lstrip()[:1] in ("", "{"))):
        return type_name, json_object(name, rest[0] if rest else "{}")
    return type_name, [field_value(name, word) for word in rest]


async def _object(host: Host, details: str, type_name: str, message: Message) -> dict[str, object]:
    """Return the message as an object. Without the name of a type it must be one.

    Raises:
        HostlinkError: the type is unknown, or the values do not match its fields.
    """
    if not type_name and isinstance(message, dict):
        return message
    try:
        typedefs = await rosapi(host, details, "typedefs", type=type_name)
    except HostlinkError as error:
        if f"type named {type_name}" not in str(error):
            raise
        raise unknown_type(details, type_name) from error
    if isinstance(message, dict):
        return message
    return filled({each["type"]: each for each in typedefs}, typedefs[0], message)


def unknown_type(details: str, name: str) -> HostlinkError:
    """Error of a type of messages or of services that the daemon does not know."""
    messages, services = standard_types()
    kind, known = ("message", messages) if details == "message_details" else ("service", services)
    return HostlinkError(
        f"there is no {kind} type named {name}; {similar(name, known)}for a type of your own, start the "
        "daemon with `hostlink serve --messages FOLDER`"
    )


def filled(known: dict[str, Any], typedef: dict[str, Any], values: list[object]) -> dict[str, object]:
    """Return the object with these values in the order of the fields; a list is the values of a field's fields.

    Raises:
        HostlinkError: the number of values is not that of the fields.
    """
    names = typedef["fieldnames"]
    if len(values) != len(names):
        found = f"{quantity(len(values), 'value was', 'values were')} given"
        if not names:
            raise HostlinkError(f"{found}, but {typedef['type']} has no fields; leave the values out")
        raise HostlinkError(
            f"{found}, but {typedef['type']} needs one for each of: {', '.join(names)}; a field that may be zero can "
            f"be left out of an object, as in {shlex.quote('{' + names[0] + ': VALUE}')}"
        )
    return {
        name: filled(known, known[type_name], value)
        if isinstance(value, list) and length < 0 and type_name in known
        else value
        for name, type_name, length, value in zip(
            names, typedef["fieldtypes"], typedef["fieldarraylen"], values, strict=True
        )
    }


async def _pub(
    daemon: AbstractAsyncContextManager[Host],
    topic: str,
    words: Message,
    type_name: str,
    publishing: Publishing,
) -> None:
    async with daemon as host:
        type_name = type_name or await type_of(
            host, topic, f"name the type of a new topic, as in `hostlink pub {topic} std_msgs/String 'data: hello'`"
        )
        message = await _object(host, "message_details", type_name, words)
        await _write_if_unheard(host, "/" + topic.lstrip("/~"), type_name)
        while not publishing.count or publishing.sent < publishing.count:
            if publishing.sent:
                await asyncio.sleep(1 / publishing.rate_hz)
            await host.publish(topic, message, type_name=type_name)
            publishing.sent += 1
            sent, rate_hz = publishing.sent, publishing.rate_hz
            if sent > rate_hz * PATIENCE_S and not sent % max(1, round(rate_hz)):
                show_progress(f"{sent} sent{f' of {publishing.count}' if publishing.count else ''}; Ctrl-C ends")
        await host.settle()
        if publishing.count > 1:  # the last velocity lasts as long as the others: ten at 10 Hz drive for a second
            await asyncio.sleep(min(1 / publishing.rate_hz, VELOCITY_HOLDS_S))


async def _write_if_unheard(host: Host, topic: str, type_name: str) -> None:
    """Write one line about a topic that has no subscriber: a message there moves no robot and is lost."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            graph = await anext(await host.watch_graph())
    except TimeoutError:  # the line is not worth a longer wait
        return
    if line := unheard(topic, type_name, graph["topics"]):
        write_error(line)


def unheard(topic: str, type_name: str, topics: Iterable[dict[str, Any]]) -> str:
    """Return a line about a topic without a subscriber, with the topics on which robots, or others, listen. Pure.

    Args:
        topic: name of the topic.
        type_name: type of the messages.
        topics: those of the graph, as `watch_graph` shows them; the daemon's own recorder does not count.
    """
    heard = [each for each in topics if each["subscribed"] or each["velocity"]]
    if any(each["name"] == topic for each in heard):
        return ""
    ways = sorted((each["name"] for each in heard if each["velocity"] and each["type"] == type_name), key=natural)
    if ways:
        step = f"robots listen on: {listed(ways)}; `hostlink robots` lists the robots"
    elif type_name in ("geometry_msgs/Twist", "geometry_msgs/TwistStamped"):
        step = f"no robot listens to a {type_name} now; `hostlink robots` lists the robots"
    else:
        names = similar(topic, (each["name"] for each in heard))
        step = f"{names}`hostlink topics` lists all topics"
    return f"{topic} has no subscriber, so that no robot and no program receives this; {step}"


# -- services ---------------------------------------------------------------------------------------------------------

_OWN = "/rosapi/"


def services(
    *,
    everything: Annotated[
        bool, typer.Option("--all", "-a", help="List the daemon's own services too: /rosapi/...")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the services: name, type and node."""
    services = ask(url, token, lambda host: _services(host, with_own=everything))
    if json:
        write(json_text.dumps(services))
    elif services:
        write_table(["service", "type", "node"], [list(each.values()) for each in services])
    else:
        write_error("no device or program offers a service; --all lists the daemon's own services")


async def _services(host: Host, *, with_own: bool) -> list[dict[str, Any]]:
    names: list[str] = await rosapi(host, "services", "services")
    shown = [name for name in sorted(names, key=natural) if with_own or not name.startswith(_OWN)]
    return [{"name": name, **(await service_facts(host, name))} for name in shown]


# -- call -------------------------------------------------------------------------------------------------------------


def call(
    service: ServiceName,
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TYPE] [REQUEST]",
            help="The request in JSON or YAML, for example '{data: true}', where missing fields are zero; "
            "or the values of all fields in their order.",
        ),
    ] = None,
    *,
    timeout: Annotated[
        float, typer.Option(min=0.01, max=3600.0, help="Seconds to wait for the answer: more for a slow device.")
    ] = 5.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Call a service and print its answer as JSON.

    Exit status 0: the service has answered, also with `success: false`, as in ROS.
    """
    type_name, request = type_and_message("REQUEST", words or [])
    answer = ask(url, token, lambda host: _call(host, service, type_name, request, timeout))
    write(json_text.dumps(answer, ensure_ascii=False))


async def _call(host: Host, service: str, type_name: str, words: Message, timeout_s: float) -> object:
    if type_name or isinstance(words, list):
        known: str = await rosapi(host, "service_type", "type", service=service)
        if type_name and known and known != type_name:
            raise WrongType(service, known, type_name)
        type_name = type_name or known
    request = await _object(host, "service_request_details", type_name, words)
    with waiting(f"waiting for {service}"):
        return await host.call(service, request, timeout_s=timeout_s)
