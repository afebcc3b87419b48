"""`hostlink topics`: what there is to read and to write."""

import asyncio
import json as json_text
import sys
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, Url
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
        sys.stdout.write(json_text.dumps(topics) + "\n")
    elif not topics:
        sys.stderr.write("no topics: no device has connected yet\n")
    else:
        width = max(len(topic["name"]) for topic in topics)
        type_width = max(len(topic["type"]) for topic in topics)
        for topic in topics:
            sys.stdout.write(
                f"{topic['name']:<{width}}  {topic['type']:<{type_width}}  {topic['publishers']} -> "
                f"{topic['subscribers']}  {topic['messages']} messages\n"
            )
