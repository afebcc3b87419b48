"""The daemon in the test's own process, on ports of its own."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from typing import Any

import aiohttp
import msgspec

from hostlink.cli.serve import running
from hostlink.config import BlackBoxConfig, Config
from hostlink.hub.hub import Hub
from tests.support.driving import put_velocity
from tests.support.waiting import expect

IN_TIME_S = 0.1  # of the event loop: later commands have most of their lease


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

    async def drive(self, robot: str, body: bytes) -> None:
        """Send a velocity until it is obeyed (`put_velocity`)."""
        await put_velocity(self.session, f"{self.url}/api/robots/{robot}", body)

    async def get(self, path: str) -> Any:
        """The JSON of a GET that must succeed."""
        status, body = await self.rest("GET", path)
        assert status == 200, body
        return body


@contextlib.asynccontextmanager
async def daemon(
    config: Config | None = None, *, has_black_box: bool = False, read: Callable[[], Config] | None = None
) -> AsyncIterator[Daemon]:
    """Run a daemon within the block. Without a black box, only the test subscribes to topics.

    `read`: its configuration file, which a reload reads.
    """

    def on_free_ports(config: Config) -> Config:
        black_box = config.black_box if has_black_box else BlackBoxConfig(enabled=False)
        recording = replace(config.recording, drives=config.recording.drives and has_black_box)
        tcp, api = replace(config.tcp, host="127.0.0.1", port=0), replace(config.api, port=0)
        return replace(config, black_box=black_box, recording=recording, tcp=tcp, api=api)

    read_again = None if read is None else (lambda: on_free_ports(read()))
    async with (
        running(on_free_ports(Config() if config is None else config), read=read_again) as (hub, addresses),
        aiohttp.ClientSession() as session,
    ):
        now_s = asyncio.get_running_loop().time
        await expect(lambda: now_s() - hub.gates.came_s(now_s()) < IN_TIME_S)  # a slow start counts as a pause
        yield Daemon(hub, addresses.tcp, addresses.api, session, addresses.udp)
