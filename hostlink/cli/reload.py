"""`hostlink reload`: the running daemon reads its configuration again."""

import asyncio
import json as json_text
from typing import Any

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL


def command(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """Let the daemon read its configuration again: names and limits of robots, tokens and origins.

    All of it is changed, or, where a setting is wrong, nothing. Other settings need a restart, and are listed.
    """
    reloaded = asyncio.run(_reload(url, token))
    write(*([json_text.dumps(reloaded)] if json else _lines(reloaded)))


async def _reload(url: str, token: str | None) -> dict[str, Any]:
    async with connected(url, token) as host:
        return await host.post("/api/reload")


def _lines(reloaded: dict[str, Any]) -> list[str]:
    lines = [f"changed: {name}" for name in reloaded["changed"]]
    lines += [f"renamed: {old} is {new} now" for old, new in reloaded["renamed"].items()]
    lines += [f"needs a restart: {name}" for name in reloaded["needs_restart"]]
    return lines or ["nothing has changed"]
