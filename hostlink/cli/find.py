"""`hostlink find`: the topics and services of a type."""

import asyncio
import json as json_text

from hostlink.cli.arguments import Json, Token, TypeName, Url
from hostlink.cli.connecting import connected
from hostlink.cli.names import unknown
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL


def command(type_name: TypeName, *, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the topics and services of a type."""
    topics, services = asyncio.run(_find(url, token, type_name))
    write(*([json_text.dumps({"topics": topics, "services": services})] if json else [*topics, *services]))


async def _find(url: str, token: str | None, type_name: str) -> tuple[list[str], list[str]]:
    async with connected(url, token) as host:
        topics: list[str] = (await host.call("/rosapi/topics_for_type", {"type": type_name}))["topics"]
        services: list[str] = (await host.call("/rosapi/services_for_type", {"type": type_name}))["services"]
        if not topics and not services:
            known = {topic["type"] for topic in await host.topics()} - {""}
            raise unknown("topic or service of type", type_name, known, command="topics")
    return topics, services
