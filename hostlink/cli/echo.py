"""`hostlink echo`: the messages of a topic, as they come."""

import asyncio
import json as json_text
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import JsonLines, Token, TopicName, Url
from hostlink.cli.connecting import connected
from hostlink.cli.fields import csv_line, field_of, flat, readable
from hostlink.cli.following import run_until_interrupted, write_hint
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL
from hostlink.errors import ConfigError, HostlinkError


@dataclass(frozen=True, slots=True, kw_only=True)
class Echo:
    """What is printed, and how."""

    topic: str
    field: str
    count: int  # 0: until Ctrl-C
    throttle_ms: int
    timeout_s: float  # 0: none
    as_json: bool
    as_csv: bool


def command(
    topic: TopicName,
    *,
    count: Annotated[int, typer.Option(min=0, help="Stop after so many messages; 0: never.")] = 0,
    once: Annotated[bool, typer.Option("--once", help="Stop after the first message.")] = False,
    field: Annotated[
        str, typer.Option(help="Only this field, as pose.position.x or ranges[0].", show_default=False)
    ] = "",
    csv: Annotated[bool, typer.Option("--csv", help="A table: the time, and a column a field.")] = False,
    throttle_ms: Annotated[int, typer.Option(min=0, help="At most one message in so many milliseconds.")] = 0,
    timeout: Annotated[
        float, typer.Option(min=0.0, help="Seconds to wait for a message, else it fails; 0: for ever.")
    ] = 0.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonLines = False,
) -> None:
    """Print the messages of a topic until Ctrl-C."""
    if csv and json:
        raise ConfigError("--csv", "is no JSON: give one of the two")
    echo = Echo(
        topic=topic,
        field=field,
        count=1 if once else count,
        throttle_ms=throttle_ms,
        timeout_s=timeout,
        as_json=json,
        as_csv=csv,
    )
    run_until_interrupted(_echo(url, token, echo))


async def _echo(url: str, token: str | None, echo: Echo) -> None:
    async with (
        connected(url, token) as host,
        host.subscribe(echo.topic, throttle_rate_ms=echo.throttle_ms) as messages,
    ):
        if not echo.as_json:
            await write_hint(host, echo.topic)
        printed = 0
        async for message in _within(messages, echo):
            write(*_lines(message, echo, is_first=not printed))
            printed += 1
            if printed == echo.count:
                return


def _lines(message: dict[str, Any], echo: Echo, *, is_first: bool) -> list[str]:
    value = field_of(message, echo.field) if echo.field else message
    if not echo.as_csv:
        text = json_text.dumps(value if echo.as_json else readable(value), ensure_ascii=False)
        return [text if echo.as_json or echo.field else f"{echo.topic}  {text}"]
    names, values = zip(*flat(value, echo.field), strict=True) if value != {} else ((), ())
    lines = [csv_line([f"{time.time():.6f}", *values])]
    return [csv_line(["time", *names]), *lines] if is_first else lines


async def _within(messages: AsyncIterator[dict[str, Any]], echo: Echo) -> AsyncIterator[dict[str, Any]]:
    """Every message.

    Raises:
        HostlinkError: none came for so long.
    """
    while True:
        try:
            async with asyncio.timeout(echo.timeout_s or None):
                message = await anext(messages)
        except TimeoutError:
            raise HostlinkError(f"{echo.topic}: no message came within {echo.timeout_s:g} s") from None
        yield message
