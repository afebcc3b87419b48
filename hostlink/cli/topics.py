"""`hostlink topics`: what there is to read and to write."""

import asyncio
import json as json_text
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.output import plain, write, write_error
from hostlink.client import DEFAULT_URL, connect


def command(
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """List the topics: name, type, who publishes and who takes them, how many messages have passed."""
    asyncio.run(_topics(url, token, as_json=json))


async def _topics(url: str, token: str | None, *, as_json: bool) -> None:
    async with connect(url, token=token, reconnect=False) as host:
        topics = await host.topics()
    if as_json:
        write(json_text.dumps(topics))
    elif not topics:
        write_error("no topics: no device has connected yet")
    else:
        names = [(plain(topic["name"]), plain(topic["type"])) for topic in topics]
        width, type_width = (max(map(len, column)) for column in zip(*names, strict=True))
        for (name, type_name), topic in zip(names, topics, strict=True):
            write(
                f"{name:<{width}}  {type_name:<{type_width}}  {topic['publishers']} -> "
                f"{topic['subscribers']}  {topic['messages']} messages"
            )
