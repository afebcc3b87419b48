"""`hostlink pub`: publish messages on a topic."""

import asyncio
import re
import shlex
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, TopicName, Url, json_object
from hostlink.cli.connecting import connected
from hostlink.cli.following import run_until_interrupted
from hostlink.cli.output import show_progress, write_error
from hostlink.cli.waiting import PATIENCE_S
from hostlink.client import DEFAULT_URL, Host
from hostlink.errors import ConfigError

_TYPE = re.compile(r"[A-Za-z]\w*(/msg)?/[A-Za-z]\w*")


@dataclass(frozen=True, slots=True)
class Pace:
    """How often, and how many; 0: until Ctrl-C."""

    rate_hz: float
    count: int


@dataclass(slots=True)
class Sent:
    """How many were sent so far: reported also after Ctrl-C."""

    messages: int = 0


def command(
    topic: TopicName,
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TYPE] [MESSAGE]",
            help='JSON, as {"linear": {"x": 0.1}}; missing fields are zero, all of them without it.',
        ),
    ] = None,
    *,
    type_name: Annotated[
        str, typer.Option("--type", help="As geometry_msgs/Twist; that of the topic if it is known.")
    ] = "",
    rate: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Messages a second, with --count.")] = 10.0,
    count: Annotated[int, typer.Option(min=0, help="How many; 0: until Ctrl-C.")] = 1,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Publish a message once, or at a rate. A robot that is driven so stops when this command ends."""
    sent = Sent()
    named_type, message = type_and_message(words or [])
    request = json_object("MESSAGE", message)
    run_until_interrupted(_pub(connected(url, token), topic, request, type_name or named_type, Pace(rate, count), sent))
    show_progress("")
    write_error(f"{sent.messages} sent")


def type_and_message(words: list[str]) -> tuple[str, str]:
    """Of `[TYPE] [MESSAGE]`, as rostopic and ros2 have them; the type is empty where none is named.

    Raises:
        ConfigError: there are more of them.
    """
    is_typed = bool(words) and _TYPE.fullmatch(words[0]) is not None
    type_name, rest = (words[0].replace("/msg/", "/"), words[1:]) if is_typed else ("", words)
    if len(rest) > 1:
        raise ConfigError("MESSAGE", f"is one argument, in quotes: {shlex.quote('{linear: {x: 0.1}}')}")
    return type_name, rest[0] if rest else "{}"


async def _pub(
    daemon: AbstractAsyncContextManager[Host],
    topic: str,
    message: dict[str, object],
    type_name: str,
    pace: Pace,
    sent: Sent,
) -> None:
    async with daemon as host:
        while not pace.count or sent.messages < pace.count:
            if sent.messages:
                await asyncio.sleep(1 / pace.rate_hz)
            await host.publish(topic, message, type_name=type_name)
            sent.messages += 1
            if sent.messages > pace.rate_hz * PATIENCE_S and not sent.messages % max(1, round(pace.rate_hz)):
                show_progress(f"{sent.messages} sent{f' of {pace.count}' if pace.count else ''}; Ctrl-C ends")
        await host.settle()
