"""`hostlink clients`: the programs that are connected, and how well each keeps up."""

import asyncio
import json as json_text
from typing import Any

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.measuring import duration, size
from hostlink.cli.output import table, write
from hostlink.client import DEFAULT_URL

COLUMNS = ("client", "kind", "peer", "role", "for s", "from", "to", "bytes to", "waiting", "lag", "dropped", "program")


def command(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the programs that are connected: who they are, what they receive, what they are too slow for."""
    view = asyncio.run(_clients(url, token))
    if json:
        write(json_text.dumps(view))
    else:
        write(*table(list(COLUMNS), [_row(client) for client in view["clients"]])[1:])
        if view["refused"]:
            write(f"{view['refused']} were refused, because there were too many")


async def _clients(url: str, token: str | None) -> dict[str, Any]:
    async with connected(url, token) as host:
        return await host.get("/api/clients")


def _row(client: dict[str, Any]) -> list[str]:
    return [
        client["name"],
        client["kind"],
        client["peer"],
        client["role"],
        f"{client['seconds']:.0f}",
        str(client["messages_from_client"]),
        str(client["messages_to_client"]),
        size(client["bytes_to_client"]),
        str(client["waiting_messages"]),
        duration(client["lag_s"]),
        str(client["dropped"]),
        client["program"],
    ]
