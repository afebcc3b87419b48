"""`hostlink services`: the services of devices and programs; those of the daemon itself with --all."""

import asyncio
import json as json_text
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.names import natural
from hostlink.cli.output import table, write, write_error
from hostlink.client import DEFAULT_URL

_OWN = "/rosapi/"


def command(
    *,
    everything: Annotated[bool, typer.Option("--all", "-a", help="The daemon's own too: /rosapi/...")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the services: name, type, who provides it."""
    services = asyncio.run(_services(url, token, with_own=everything))
    if json:
        write(json_text.dumps(services))
    elif services:
        write(*table(["service", "type", "node"], [list(each.values()) for each in services])[1:])
    else:
        write_error("no device or program offers a service; --all lists the daemon's own")


async def _services(url: str, token: str | None, *, with_own: bool) -> list[dict[str, Any]]:
    async with connected(url, token) as host:
        names: list[str] = (await host.call("/rosapi/services", {}))["services"]
        return [
            {
                "name": name,
                "type": (await host.call("/rosapi/service_type", {"service": name}))["type"],
                "node": (await host.call("/rosapi/service_node", {"service": name}))["node"],
            }
            for name in sorted(names, key=natural)
            if with_own or not name.startswith(_OWN)
        ]
