"""Daemons that are one fleet over Zenoh, in the test's own process, on loopback and ports of their own."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config
from hostlink.core.hub.remote_robot import RemoteRobot
from tests.support.daemon import Daemon, daemon
from tests.support.driving import answered
from tests.support.process import free_port
from tests.support.waiting import expect


def zenoh(name: str, port: int, *others: int, **settings: Any) -> ZenohSettings:
    """A peer that listens on one port and connects to others."""
    return ZenohSettings(
        name=name,
        listen=(f"tcp/127.0.0.1:{port}",),
        connect=tuple(f"tcp/127.0.0.1:{other}" for other in others),
        multicast=False,
        **settings,
    )


@contextlib.asynccontextmanager
async def fleet(*names: str, config: Config | None = None, **settings: Any) -> AsyncIterator[list[Daemon]]:
    """A daemon of each name, each connected to all before it; they know each other when the block begins."""
    ports = [free_port() for _ in names]
    config = Config() if config is None else config
    async with contextlib.AsyncExitStack() as stack:
        hosts = []
        for number, name in enumerate(names):
            own = replace(config, component_settings={"zenoh": zenoh(name, ports[number], *ports[:number], **settings)})
            hosts.append(await stack.enter_async_context(daemon(own)))
        for host in hosts:
            await has_met(host, len(hosts) - 1)
        yield hosts


async def has_met(host: Daemon, others: int) -> None:
    """Wait until the daemon is a part of the fleet, and has heard as many others."""
    counts = host.hub.counts.components
    await expect(lambda: "fleet" in counts and counts["fleet"]().get("met", 0) >= others)


async def shown(host: Daemon, name: str) -> RemoteRobot:
    """A robot of another daemon, once it is shown as connected here."""
    await expect(lambda: name in host.hub.robots.remote and host.hub.robots.remote[name].link)
    return host.hub.robots.remote[name]


async def robot(host: Daemon, name: str) -> Any:
    """Return the robot as REST shows it."""
    return await host.get(f"/api/robots/{name}")


async def drive(host: Daemon, name: str, linear: float, angular: float = 0.0) -> tuple[int, Any]:
    """One command over REST, which is repeated after a pause of the daemon."""
    body = b'{"linear":%f,"angular":%f}' % (linear, angular)
    return await answered(lambda: host.rest("PUT", f"/api/robots/{name}/velocity", body))


async def subscriber_count(host: Daemon, topic: str) -> int:
    """Return the number of subscribers of a topic, with the black box if it is on."""
    await asyncio.sleep(0.3)
    return len(host.hub.topics.find(topic).subscribers)


def port_of(host: Daemon) -> int:
    """Return the port of the daemon's Zenoh session."""
    settings: ZenohSettings = host.hub.config.component_settings["zenoh"]
    return int(settings.listen[0].rpartition(":")[2])


@contextlib.asynccontextmanager
async def joined(port: int, name: str, **settings: Any) -> AsyncIterator[Daemon]:
    """One more daemon, which connects to that port, and has heard the daemon there."""
    own = Config(component_settings={"zenoh": zenoh(name, free_port(), port, **settings)})
    async with daemon(own) as host:
        await has_met(host, 1)
        yield host
