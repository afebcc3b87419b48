"""The commands that measure a topic: `hz`, `bw`, `delay`. They share their options; each has a figure of its own."""

import asyncio
import contextlib
import json as json_
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import JsonLines, Seconds, Token, TopicName, Url
from hostlink.cli.connecting import connected
from hostlink.cli.following import run_until_interrupted, write_hint
from hostlink.cli.measuring import WINDOW, Measured
from hostlink.cli.output import write, write_error
from hostlink.client import DEFAULT_URL, Host, Mailbox, RawMessage

INTERVAL_S = 1.0


async def _nothing_to_check(_host: Host, _topic: str) -> None:
    """Every topic can be measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What a command measures of each message, and how it shows that."""

    text: str  # the help of the command
    view: Callable[[Measured], dict[str, Any]]  # for programs
    line: Callable[[Measured], str]
    figure: Callable[[RawMessage], float] = lambda _: 0.0
    window: int = WINDOW
    check: Callable[[Host, str], Awaitable[None]] = _nothing_to_check  # raises HostlinkError for a topic without it


def command_of(figures: Figures) -> Callable[..., None]:
    """The command of these figures."""

    def command(
        topic: TopicName,
        *,
        window: Annotated[int, typer.Option(min=2, help="Of the last so many messages.")] = figures.window,
        seconds: Seconds = 0.0,
        url: Url = DEFAULT_URL,
        token: Token = None,
        json: JsonLines = False,
    ) -> None:
        measured = Measured(window)
        began_s = time.monotonic()

        async def run() -> None:
            async with connected(url, token) as host:
                await figures.check(host, topic)
                if not json:
                    await write_hint(host, topic)
                async with host.subscribe_raw(topic) as messages:
                    await _measure(figures, measured, messages, seconds=seconds or float("inf"), as_json=json)

        run_until_interrupted(run())
        write_error(f"{measured.messages} messages in {time.monotonic() - began_s:.1f} s")

    command.__doc__ = figures.text
    return command


async def _measure(
    figures: Figures, measured: Measured, messages: Mailbox[RawMessage], *, seconds: float, as_json: bool
) -> None:
    """A line each second."""
    next_s = asyncio.get_running_loop().time()
    end_s = next_s + seconds
    while next_s < end_s:
        next_s, before = min(next_s + INTERVAL_S, end_s), measured.messages
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(next_s):
                async for message in messages:
                    measured.add(message.stamp_ns / 1e9, figures.figure(message))
        if as_json:
            write(json_.dumps({"messages": measured.messages} | figures.view(measured)))
        else:
            write(figures.line(measured) if measured.messages > before else "no new messages")
