"""`hostlink echo`: the messages of a topic, as they come."""

import asyncio
import json as json_text
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL, connect


def command(
    topic: Annotated[str, typer.Argument(show_default=False)],
    *,
    count: Annotated[int, typer.Option(min=0, help="Stop after so many messages; 0: never.")] = 0,
    throttle_ms: Annotated[int, typer.Option(min=0, help="At most one message in so many milliseconds.")] = 0,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object a line, for programs.")] = False,
) -> None:
    """Print the messages of a topic until Ctrl-C."""
    asyncio.run(_echo(url, token, topic, count, throttle_ms, as_json=json))


async def _echo(url: str, token: str | None, topic: str, count: int, throttle_ms: int, *, as_json: bool) -> None:
    printed = 0
    async with (
        connect(url, token=token, reconnect=False) as host,
        host.subscribe(topic, throttle_rate_ms=throttle_ms) as messages,
    ):
        async for message in messages:
            text = json_text.dumps(message, ensure_ascii=False)
            write(text if as_json else f"{topic}  {text}")
            printed += 1
            if printed == count:
                return
