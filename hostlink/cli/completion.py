"""Names that a shell completes: what the daemon knows at this moment. Without a daemon there are none, and no error.

A device chooses its names, and a shell runs what stands on its line: only names without a meaning for a shell are
completed.
"""

import asyncio
import contextlib
import re
from collections.abc import Awaitable, Callable, Iterable

import typer

from hostlink.client import DEFAULT_URL, Host, connect
from hostlink.errors import HostlinkError

TIMEOUT_S = 1.0  # a person has pressed a key and waits
_SAFE = re.compile(r"[A-Za-z0-9_/.-]+")


def topic_names(context: typer.Context, incomplete: str) -> list[str]:
    """The topics that begin so."""

    async def read(host: Host) -> Iterable[str]:
        return [topic["name"] for topic in await host.topics()]

    return _complete(context, incomplete, read)


def type_names(context: typer.Context, incomplete: str) -> list[str]:
    """The types of topics that begin so."""

    async def read(host: Host) -> Iterable[str]:
        return {topic["type"] for topic in await host.topics()}

    return _complete(context, incomplete, read)


def robot_names(context: typer.Context, incomplete: str) -> list[str]:
    """The robots that begin so."""

    async def read(host: Host) -> Iterable[str]:
        return [robot["name"] for robot in await host.robots()]

    return _complete(context, incomplete, read)


def service_names(context: typer.Context, incomplete: str) -> list[str]:
    """The services that begin so."""

    async def read(host: Host) -> Iterable[str]:
        return [str(name) for name in (await host.call("/rosapi/services", {}))["services"]]

    return _complete(context, incomplete, read)


def graph_names(context: typer.Context, incomplete: str) -> list[str]:
    """The topics, nodes and services that begin so."""

    async def read(host: Host) -> Iterable[str]:
        topics = [topic["name"] for topic in await host.topics()]
        nodes, services = await host.call("/rosapi/nodes", {}), await host.call("/rosapi/services", {})
        return {*topics, *nodes["nodes"], *services["services"]}

    return _complete(context, incomplete, read)


def parameter_names(context: typer.Context, incomplete: str) -> list[str]:
    """The parameters that begin so."""

    async def read(host: Host) -> Iterable[str]:
        return [str(name) for name in (await host.call("/rosapi/get_param_names", {}))["names"]]

    return _complete(context, incomplete, read)


def _complete(context: typer.Context, incomplete: str, read: Callable[[Host], Awaitable[Iterable[str]]]) -> list[str]:
    url, token = context.params.get("url"), context.params.get("token")

    async def request() -> Iterable[str]:
        async with asyncio.timeout(TIMEOUT_S), connect(url or DEFAULT_URL, token=token, reconnect=False) as host:
            return await read(host)

    with contextlib.suppress(HostlinkError, TimeoutError):
        return [
            name for name in sorted(asyncio.run(request())) if name.startswith(incomplete) and _SAFE.fullmatch(name)
        ]
    return []
