"""`hostlink type`: the type of a topic or of a service, and its fields."""

import asyncio
import json as json_text
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.completion import graph_names
from hostlink.cli.connecting import connected
from hostlink.cli.names import unknown
from hostlink.cli.output import write
from hostlink.client import DEFAULT_URL, Host
from hostlink.errors import HostlinkError

Name = Annotated[
    str,
    typer.Argument(help="Of a topic or a service; or a type.", autocompletion=graph_names),
]


def command(
    name: Name,
    *,
    fields: Annotated[
        bool, typer.Option("--fields", "-f", help="Its fields too, as `pub` and `call` want them.")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Show the type of a topic or of a service; of a type its fields."""
    found = asyncio.run(_find(url, token, "/" + name.lstrip("/~"), with_fields=fields))
    if json:
        write(json_text.dumps(found))
    else:
        write(found["type"], *(f"  {field['type']} {field['name']}" for field in found.get("fields", [])))


async def _find(url: str, token: str | None, name: str, *, with_fields: bool) -> dict[str, Any]:
    async with connected(url, token) as host:
        topics = {topic["name"]: topic["type"] for topic in await host.topics()}
        services: list[str] = [] if name in topics else (await host.call("/rosapi/services", {}))["services"]
        if name in topics:
            type_name, details = topics[name], "message_details"
        elif name in services:
            type_name = (await host.call("/rosapi/service_type", {"service": name}))["type"]
            details = "service_request_details"
        else:
            of_type = await _of_type(host, name.removeprefix("/").replace("/msg/", "/"))
            if of_type is None:
                raise unknown("topic or service", name, [*topics, *services], command="topics")
            return of_type
        if not type_name:
            raise HostlinkError(f"{name} has no type yet: it has subscribers, and nobody publishes it")
        found: dict[str, Any] = {"name": name, "type": type_name}
        return found | {"fields": await _fields(host, details, type_name)} if with_fields else found


async def _of_type(host: Host, type_name: str) -> dict[str, Any] | None:
    """What `rosmsg show` has: the fields of a type of messages; None: there is none of that name."""
    try:
        fields = await _fields(host, "message_details", type_name)
    except HostlinkError:
        return None
    return {"name": type_name, "type": type_name, "fields": fields} if fields else None


async def _fields(host: Host, details: str, type_name: str) -> list[dict[str, str]]:
    """Of the type and of those that it contains, by their paths."""
    typedefs = (await host.call(f"/rosapi/{details}", {"type": type_name}))["typedefs"]
    known = {each["type"]: each for each in typedefs}

    def walk(typedef: dict[str, Any], prefix: str) -> list[dict[str, str]]:
        found = []
        for name, type_, length in zip(
            typedef["fieldnames"], typedef["fieldtypes"], typedef["fieldarraylen"], strict=True
        ):
            suffix = {-1: "", 0: "[]"}.get(length, f"[{length}]")
            found.append({"name": prefix + name, "type": type_ + suffix})
            if type_ in known and length < 0:
                found += walk(known[type_], f"{prefix}{name}.")
        return found

    return walk(typedefs[0], "") if typedefs else []
