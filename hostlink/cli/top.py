"""`hostlink top`: live figures of links and robots, or once, or as JSON."""

import asyncio
import importlib.util
import json as json_text
import sys
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.figures import LINK_COLUMNS, advice, link_rows, live_figures, robot_table
from hostlink.cli.output import fitted_table, write
from hostlink.client import DEFAULT_URL
from hostlink.errors import ConfigError, LibraryMissing


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
    elif not sys.stdout.isatty():
        raise ConfigError("top", "standard output is not a terminal; use --once or --json")
    elif importlib.util.find_spec("textual") is None:
        raise LibraryMissing("top", "textual", "top")
    else:
        from hostlink.cli.top_screen import TopScreen  # noqa: PLC0415 - textual loads longer than everything else

        screen = TopScreen(url, token, interval)
        screen.run()
        if screen.failure is not None:
            raise screen.failure


async def _print(url: str, token: str | None, interval_s: float, *, is_once: bool, as_json: bool) -> None:
    async with connected(url, token) as host:
        async for shown in live_figures(host, interval_s):
            write(*([json_text.dumps(shown)] if as_json else _lines(shown)))
            if is_once:
                return


def _lines(shown: dict[str, Any]) -> list[str]:
    links = fitted_table(LINK_COLUMNS, link_rows(shown))
    robots = fitted_table(*robot_table(shown))
    return [*(links[1:] or ["no device is connected"]), *robots, *(["", *advice(shown)] if advice(shown) else [])]
