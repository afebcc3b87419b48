"""Clients of rosbridge without a socket: the protocol alone on a hub without devices, for unit and property tests."""

import asyncio
import contextlib
import itertools
import json
from collections.abc import AsyncIterator
from typing import Any

import cbor2

from hostlink.components.gateway.clients import ClientQueue
from hostlink.components.gateway.rosapi import RosApi
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from tests.support.background import cancelling
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in


class Peer:
    """One client: it sends requests, and keeps all that came since the last `received`."""

    def __init__(self, name: str, hub: Hub, tasks: asyncio.TaskGroup) -> None:
        self.queue = ClientQueue()
        self.client = RosbridgeClient(name, host_in(hub), self.queue, spawn=tasks.create_task)
        self.send(op="set_level", level="info")

    def send(self, **request: Any) -> None:
        self.client.receive(json.dumps(request))

    def received(self) -> list[Any]:
        """JSON and CBOR messages, oldest first."""
        heard = []
        while (waiting := self.queue.pop()) is not None:
            data, is_binary = waiting.item.data, waiting.item.is_binary
            heard.append(cbor2.loads(data) if is_binary else json.loads(data))
        return heard

    async def answers(self) -> list[Any]:
        """Return the answers after all started work has run."""
        for _ in range(5):
            await asyncio.sleep(0)
        return self.received()


class World:
    """A hub and its clients."""

    def __init__(self, tasks: asyncio.TaskGroup) -> None:
        self.hub = Hub(Config(), CATALOG, reraises=True)
        RosApi(host_in(self.hub)).offer()
        self._tasks, self._numbers = tasks, itertools.count(1)

    def client(self) -> Peer:
        return Peer(f"client {next(self._numbers)}", self.hub, self._tasks)


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[World]:
    """Run a world within the block."""
    async with cancelling() as tasks:
        yield World(tasks)


async def call(peer: Peer, service: str, args: object = None, **more: Any) -> Any:
    """The values of a call."""
    peer.send(op="call_service", id="call", service=service, args=args, **more)
    (answer,) = [frame for frame in await peer.answers() if frame["op"] == "service_response"]
    assert (answer["id"], answer["service"]) == ("call", service)
    return answer["values"]


async def offered(here: World, type_name: str = "std_srvs/SetBool") -> Peer:
    server = here.client()
    server.send(op="advertise_service", service="switch", type=type_name)
    return server
