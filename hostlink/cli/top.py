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
from hostlink.cli.teleop_screen import QUIT_KEY
from hostlink.cli.top_screen import TopScreen
from hostlink.client import DEFAULT_URL
from hostlink.errors import ConfigError


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
    """Watch robots and links: drivers, speeds, rates, losses, ages and findings. Ends with q or Ctrl-C.

    Red: locked. Yellow: silent. Arrows, space and b scroll; s orders by name, state, speed or age.
    """
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
            top = _Top(terminal, TopScreen(url))
            async for shown in live_figures(host, interval_s):
                top.show(shown)


class _Top:
    """Terminal of top: keys change the screen at once, and a quit key or a signal cancels this task.

    So the terminal is restored. Ctrl-Z does nothing.
    """

    def __init__(self, terminal: Terminal, screen: TopScreen) -> None:
        self._terminal, self._screen, self._keys = terminal, screen, KeyReader()
        self._shown: dict[str, Any] | None = None
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        assert task is not None  # noqa: S101 - a task runs this
        self._end = task.cancel
        loop.add_reader(terminal.input, self._read)
        for number in QUIT_SIGNALS:
            loop.add_signal_handler(number, self._end)
        loop.add_signal_handler(signal.SIGTSTP, lambda: None)

    def show(self, shown: dict[str, Any]) -> None:
        """Draw these figures, now and after each key."""
        self._shown = shown
        draw(self._screen.lines(shown, *terminal_size()))

    def _read(self) -> None:
        data = os.read(self._terminal.input, 1024)
        keys = self._keys.feed(data)
        if not data or any(key.name in (*QUIT_KEYS, QUIT_KEY) for key in keys):
            self._end()
            return
        for key in keys:
            self._screen.press(key)
        if self._shown is not None:
            self.show(self._shown)


def _lines(shown: dict[str, Any]) -> list[str]:
    columns = terminal_size()[0] - 1 if is_terminal() else 0
    links = table(LINK_COLUMNS, link_rows(shown), columns=columns)
    heads, rows = robot_table(shown)
    robots = table(heads, rows, columns=columns)
    links = ["", *(links[1:] or ["no device is connected"])] if robots else links[1:] or ["no device is connected"]
    return [*robots[1:], *links, *(["", *advice(shown)] if advice(shown) else [])]
