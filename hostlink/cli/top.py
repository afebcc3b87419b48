"""`hostlink top`: live figures of links and robots, or once, or as JSON."""

import asyncio
import json as json_text
import os
import signal
import sys
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected, run_until_interrupted
from hostlink.cli.driving import KeyReader
from hostlink.cli.figures import LINK_COLUMNS, advice, link_rows, live_figures, robot_table
from hostlink.cli.output import draw, is_terminal, table, terminal_size, write
from hostlink.cli.teleop import QUIT_KEYS, QUIT_SIGNALS, Terminal, key_terminal
from hostlink.cli.teleop_screen import QUIT_KEY, folded
from hostlink.client import DEFAULT_URL
from hostlink.errors import ConfigError
from hostlink.plain_text import plain

_BOLD = "1"


def command(
    *,
    once: Annotated[bool, typer.Option("--once", help="Print the figures once and end, for scripts.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON object each interval, for programs.")] = False,
    interval: Annotated[
        float,
        typer.Option(
            min=0.1, help="Seconds between updates: longer on a slow connection. Rates are of a second at least."
        ),
    ] = 1.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Watch links and robots: rates, losses, ages and findings. Ends with q or Ctrl-C."""
    if once or json:
        asyncio.run(_print(url, token, interval, is_once=once, as_json=json))
    elif not (sys.stdin.isatty() and is_terminal()):
        raise ConfigError("top", "standard input or output is not a terminal; use --once or --json")
    else:
        run_until_interrupted(_show(url, token, interval))


async def _print(url: str, token: str | None, interval_s: float, *, is_once: bool, as_json: bool) -> None:
    async with connected(url, token) as host:
        async for shown in live_figures(host, interval_s):
            write(*([json_text.dumps(shown)] if as_json else _lines(shown)))
            if is_once:
                return


async def _show(url: str, token: str | None, interval_s: float) -> None:
    async with connected(url, token) as host:
        with key_terminal() as terminal:
            _end_in_order(terminal)
            async for shown in live_figures(host, interval_s):
                draw(
                    [(f"hostlink top   {url}   q or Ctrl-C ends", _BOLD), *((line, "") for line in screen_lines(shown))]
                )


def _end_in_order(terminal: Terminal) -> None:
    """Cancel this task at a quit key or a signal, so that the terminal is restored. Ctrl-Z does nothing."""
    loop, task, keys = asyncio.get_running_loop(), asyncio.current_task(), KeyReader()
    assert task is not None  # noqa: S101 - a task runs this

    def read() -> None:
        data = os.read(terminal.input, 1024)
        if not data or any(key.name in (*QUIT_KEYS, QUIT_KEY) for key in keys.feed(data)):
            task.cancel()

    loop.add_reader(terminal.input, read)
    for number in QUIT_SIGNALS:
        loop.add_signal_handler(number, task.cancel)
    loop.add_signal_handler(signal.SIGTSTP, lambda: None)


def screen_lines(shown: dict[str, Any]) -> list[str]:
    """Lines of the screen below its title. The last one says how many do not fit."""
    columns, room = terminal_size()[0] - 1, terminal_size()[1] - 1
    whole = ["", *_lines(shown), *([] if advice(shown) else ["", "no findings"])]
    lines = [part for line in whole for part in folded(plain(line), columns)]
    if len(lines) <= room:
        return lines
    return [*lines[: room - 1], f"{len(lines) - room + 1} more lines; `hostlink top --once` prints them"]


def _lines(shown: dict[str, Any]) -> list[str]:
    columns = terminal_size()[0] - 1 if is_terminal() else 0
    links = table(LINK_COLUMNS, link_rows(shown), columns=columns)
    heads, rows = robot_table(shown)
    robots = table(heads, rows, columns=columns)
    return [*(links[1:] or ["no device is connected"]), *robots, *(["", *advice(shown)] if advice(shown) else [])]
