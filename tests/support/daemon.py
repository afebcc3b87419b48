"""The daemon in the test's own process, on ports of its own."""

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from typing import Any

import aiohttp
import msgspec

from hostlink.cli.serve import running
from hostlink.config import BlackBoxConfig, Config
from hostlink.hub.hub import Hub


@dataclass
class Daemon:
    """A running daemon, and a client of its REST API."""

    hub: Hub
    tcp: tuple[str, int]
    url: str
    session: aiohttp.ClientSession
    udp: tuple[str, int] | None = None

    async def rest(self, method: str, path: str, body: bytes | None = None) -> tuple[int, Any]:
        """(status, JSON)."""
        async with self.session.request(method, self.url + path, data=body) as response:
            return response.status, msgspec.json.decode(await response.read())

    async def get(self, path: str) -> Any:
        """The JSON of a GET that must succeed."""
        status, body = await self.rest("GET", path)
        assert status == 200, body
        return body


@contextlib.asynccontextmanager
async def daemon(config: Config | None = None, *, has_black_box: bool = False) -> AsyncIterator[Daemon]:
    """Run a daemon for the length of the block; without a black box nobody but the test subscribes to anything."""
    config = Config() if config is None else config
    if not has_black_box:
        config = replace(config, black_box=BlackBoxConfig(enabled=False))
    config = replace(config, tcp=replace(config.tcp, host="127.0.0.1", port=0), api=replace(config.api, port=0))
    async with running(config) as (hub, addresses), aiohttp.ClientSession() as session:
        yield Daemon(hub, addresses.tcp, addresses.api, session, addresses.udp)
