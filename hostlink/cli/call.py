"""`hostlink call`: call a service of a device or of another program."""

import asyncio
import json as json_text
from typing import Annotated

import typer

from hostlink.cli.arguments import ServiceName, Token, Url, json_object
from hostlink.cli.connecting import connected
from hostlink.cli.output import write
from hostlink.cli.waiting import waiting
from hostlink.client import DEFAULT_URL


def command(
    service: ServiceName,
    request: Annotated[str, typer.Argument(help='JSON, as {"data": true}.')] = "{}",
    *,
    timeout: Annotated[float, typer.Option(min=0.01, max=3600.0, help="Seconds to wait for the answer.")] = 5.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Call a service and print its answer as JSON."""
    answer = asyncio.run(_call(url, token, service, json_object("REQUEST", request), timeout))
    write(json_text.dumps(answer, ensure_ascii=False))


async def _call(url: str, token: str | None, service: str, request: dict[str, object], timeout_s: float) -> object:
    async with connected(url, token) as host:
        with waiting(f"waiting for {service}"):
            return await host.call(service, request, timeout_s=timeout_s)
