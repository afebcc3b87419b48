"""Clients of Foxglove's protocol without a socket: the protocol alone on a hub without devices."""

import asyncio
import contextlib
import itertools
import json
import struct
from collections.abc import AsyncIterator
from typing import Any

from hostlink.components.gateway.clients import ClientQueue
from hostlink.components.gateway.foxglove import FoxgloveClient, FoxgloveDirectory
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Role
from tests.support.background import cancelling
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in

TIME = 2  # opcode
Received = tuple[int, int, int, bytes]  # opcode, subscription, time, payload


class Peer:
    """One client: it sends requests, and keeps all that came since it was read last."""

    def __init__(
        self, name: str, hub: Hub, directory: FoxgloveDirectory, tasks: asyncio.TaskGroup, role: Role = Role.DRIVE
    ) -> None:
        self.queue = ClientQueue()
        self.times: list[int] = []  # in ns, oldest first
        self.client = FoxgloveClient(name, host_in(hub), directory, self.queue, spawn=tasks.create_task, role=role)

    def send(self, **request: Any) -> None:
        self.client.receive(json.dumps(request))

    def publish(self, number: int, payload: bytes) -> None:
        self.client.receive(struct.pack("<BI", 1, number) + payload)

    def received(self) -> list[Any]:
        """JSON as objects and frames as bytes, oldest first; times are kept apart."""
        return [each for each in self.received_with_times() if not isinstance(each, int)]

    def received_with_times(self) -> list[Any]:
        """Received items, with times between them as numbers of ns."""
        self.client.flush(asyncio.get_running_loop().time())
        received: list[Any] = []
        for item in (each.item for each in iter(self.queue.pop, None)):
            frames = [item.before, item.data] if item.before else [item.data]
            received += [_read(frame) if item.is_binary else json.loads(frame) for frame in frames]
        self.times += [each for each in received if isinstance(each, int)]
        return received

    def json(self) -> list[dict[str, Any]]:
        return [each for each in self.received() if isinstance(each, dict)]

    def messages(self) -> list[Received]:
        return [(*struct.unpack_from("<BIQ", each), each[13:]) for each in self.received() if isinstance(each, bytes)]

    def channels(self) -> list[dict[str, Any]]:
        """Channels that were advertised."""
        return [channel for each in self.json() if each["op"] == "advertise" for channel in each["channels"]]

    def statuses(self) -> list[str]:
        return [each["message"] for each in self.json() if each["op"] == "status"]


def _read(frame: bytes) -> bytes | int:
    return int(struct.unpack("<BQ", frame)[1]) if frame[0] == TIME else frame


class World:
    """A hub and its clients."""

    def __init__(self, tasks: asyncio.TaskGroup, config: Config) -> None:
        self.hub = Hub(config, CATALOG, reraises=True)
        self.directory = FoxgloveDirectory(host_in(self.hub))
        self._tasks, self._numbers = tasks, itertools.count(1)

    def client(self, role: Role = Role.DRIVE) -> Peer:
        return Peer(f"client {next(self._numbers)}", self.hub, self.directory, self._tasks, role)


@contextlib.asynccontextmanager
async def world(config: Config | None = None) -> AsyncIterator[World]:
    """Run a world within the block."""
    async with cancelling() as tasks:
        yield World(tasks, Config() if config is None else config)
