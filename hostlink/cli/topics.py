"""`hostlink topics`: what there is to read and to write."""

import asyncio
import json as json_text
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.names import natural
from hostlink.cli.output import plain, show_progress, table, write, write_error
from hostlink.client import DEFAULT_URL, Host, TopicState

RATE_S = 1.0  # rates of -v are of this time
HEAD = ("topic", "type", "publishers", "subscribers", "messages", "rate")


def command(
    *,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="With heads, and rates of a second.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the topics: name, type, who publishes and who takes them, how many messages have passed."""
    topics = asyncio.run(_topics(url, token, with_rates=verbose))
    if json:
        write(json_text.dumps(topics))
    elif not topics:
        write_error("no topics: no device has connected yet; `hostlink doctor` finds out why")
    else:
        write(*(table(list(HEAD), [_row(topic) for topic in topics])[1:] if verbose else _lines(topics)))


async def _topics(url: str, token: str | None, *, with_rates: bool) -> list[Any]:
    async with connected(url, token) as host:
        topics = await _rated(host) if with_rates else await host.topics()
        return sorted(topics, key=lambda topic: natural(topic["name"]))


async def _rated(host: Host) -> list[Any]:
    """With `rate_hz`: of the time between two requests; null for a topic that has come in between."""
    loop = asyncio.get_running_loop()
    before_s, before = loop.time(), {topic["name"]: topic["messages"] for topic in await host.topics()}
    show_progress("measuring for a second ...")
    await asyncio.sleep(RATE_S)
    now_s, topics = loop.time(), await host.topics()
    show_progress("")

    def rate_hz(topic: TopicState) -> float | None:
        known = before.get(topic["name"])
        return None if known is None else round((topic["messages"] - known) / (now_s - before_s), 1)

    return [{**topic, "rate_hz": rate_hz(topic)} for topic in topics]


def _row(topic: dict[str, Any]) -> list[str]:
    counts = [str(topic[key]) for key in ("publishers", "subscribers", "messages")]
    rate = "-" if topic["rate_hz"] is None else f"{topic['rate_hz']:.1f} Hz"
    return [topic["name"], topic["type"] or "-", *counts, rate]


def _lines(topics: list[Any]) -> list[str]:
    names = [(plain(topic["name"]), plain(topic["type"])) for topic in topics]
    width, type_width = (max(map(len, column)) for column in zip(*names, strict=True))
    return [
        f"{name:<{width}}  {type_name:<{type_width}}  {topic['publishers']} -> {topic['subscribers']}  "
        f"{topic['messages']} messages"
        for (name, type_name), topic in zip(names, topics, strict=True)
    ]
