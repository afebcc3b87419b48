"""Who publishes and who subscribes, of a topic; what a node does; who provides a service."""

import asyncio
import json as json_text
from typing import Any

from hostlink.cli.connecting import connected
from hostlink.cli.names import unknown
from hostlink.cli.output import write
from hostlink.client import Host


def show_name(name: str, url: str, token: str | None, *, as_json: bool) -> None:
    """Write what is known of a topic, a node or a service.

    Raises:
        HostlinkError: there is none of that name, or no daemon.
    """
    found = asyncio.run(_find(url, token, "/" + name.lstrip("/~")))
    write(*([json_text.dumps(found)] if as_json else _lines(found)))


async def _find(url: str, token: str | None, name: str) -> dict[str, Any]:
    async with connected(url, token) as host:
        topics = {topic["name"]: topic for topic in await host.topics()}
        if name in topics:
            return await _topic(host, name, topics[name]["type"], topics[name]["messages"])
        nodes: list[str] = (await host.call("/rosapi/nodes", {}))["nodes"]
        if name in nodes:
            details: dict[str, Any] = await host.call("/rosapi/node_details", {"node": name})
            return {"node": name, **details}
        services: list[str] = (await host.call("/rosapi/services", {}))["services"]
        if name in services:
            return await _service(host, name)
    raise unknown("topic, node or service", name, [*topics, *nodes, *services], command="topics")


async def _topic(host: Host, name: str, type_name: str, messages: int) -> dict[str, Any]:
    publishers = (await host.call("/rosapi/publishers", {"topic": name}))["publishers"]
    subscribers = (await host.call("/rosapi/subscribers", {"topic": name}))["subscribers"]
    return {
        "topic": name,
        "type": type_name,
        "publishers": publishers,
        "subscribers": subscribers,
        "messages": messages,
    }


async def _service(host: Host, name: str) -> dict[str, Any]:
    type_name = (await host.call("/rosapi/service_type", {"service": name}))["type"]
    return {
        "service": name,
        "type": type_name,
        "node": (await host.call("/rosapi/service_node", {"service": name}))["node"],
    }


def _lines(found: dict[str, Any]) -> list[str]:
    """A line for each fact; a list is a line an item."""
    width = max(map(len, found)) + 2
    lines = []
    for key, value in found.items():
        if isinstance(value, list):
            lines += [f"{key:<{width}}{len(value) or 'none'}", *(f"  {item}" for item in value)]
        else:
            lines.append(f"{key:<{width}}{value if value != '' else '(nobody has named it)'}")
    return lines
