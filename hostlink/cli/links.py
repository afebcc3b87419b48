"""`hostlink links`: the connections of devices, and those that ended."""

import asyncio
import json as json_text
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.figures import LINK_COLUMNS, Sample, advice, figures, link_rows
from hostlink.cli.output import table, write, write_error
from hostlink.client import DEFAULT_URL


def command(
    *,
    ended: Annotated[bool, typer.Option("--ended", help="The last that ended, too.")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the connections of devices: rates since they opened, losses, silence, what is wrong."""
    view, robots = asyncio.run(_links(url, token))
    if json:
        write(json_text.dumps(view))
        return
    shown = figures(Sample(0.0, {"links": []}, []), Sample(0.0, view, robots))
    if not shown["links"]:
        write_error("no device is connected; `hostlink doctor` finds out why")
    write(*table(list(LINK_COLUMNS), [list(row) for row in link_rows(shown)])[1:])
    if ended:
        write(*table(["ended", "peer", "why", "after s", "s ago", "diagnosis"], _ended_rows(view)))
    write(*advice({**shown, "ended": []}))


async def _links(url: str, token: str | None) -> tuple[dict[str, Any], list[Any]]:
    async with connected(url, token) as host:
        return await host.get("/api/links"), await host.robots()


def _ended_rows(view: dict[str, Any]) -> list[list[str]]:
    return [
        [
            str(link["number"]),
            link["peer"],
            link["end"],
            f"{link['seconds']:.1f}",
            f"{link['ended_ago_s']:.0f}",
            ", ".join(each["code"] for each in link["diagnosis"]) or "nothing was wrong",
        ]
        for link in view["ended"]
    ]
