"""The Python client without a socket, in virtual time: at the other end of a rosbridge client and of REST."""

import asyncio
import contextlib
import itertools
import json
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any, cast
from weakref import WeakSet

import cbor2

from hostlink.client import Event, Host
from hostlink.client.callers import Callers, own_context
from hostlink.client.connection import HostConnection
from hostlink.client.driver import VelocitySender
from hostlink.client.http_client import HttpClient, encode, measured
from hostlink.client.services import ProvidedServices
from hostlink.client.topics import Topics
from hostlink.components.gateway.clients import ClientQueue
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Role
from hostlink.core.hub.participant import Participant
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.state_views import odometry_view
from hostlink.errors import HostlinkError, Refused
from tests.support.hosts import host_in
from tests.support.rest_memory import RestCalls

_numbers = itertools.count(1)


class MemoryConnection:
    """HostConnection to a hub. `delay_s`: delay of messages that are sent from now on."""

    is_connected = True
    keeping = HostConnection.keeping

    def __init__(self, hub: Hub, tasks: asyncio.TaskGroup, callers: Callers) -> None:
        self.delay_s = 0.0
        self.callers = callers
        self._hub = hub
        self.handlers: defaultdict[str, list[Callable[[dict[str, Any]], None]]] = defaultdict(list)
        self.on_open: list[Callable[[], Awaitable[None]]] = []  # it is never opened again
        self._kept: dict[str, Mapping[str, Any]] = {}
        self._queue = ClientQueue()
        self._queue.on_news = self._receive
        self._client = RosbridgeClient(f"program {next(_numbers)}", host_in(hub), self._queue, spawn=tasks.create_task)
        self._answers: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self._numbers = itertools.count(1)
        self._pass('{"op": "set_level", "level": "error"}')

    @property
    def participant(self) -> Participant:
        return self._client.participant

    async def send(self, request: Mapping[str, Any]) -> None:
        self.callers.note()
        text = encode(request).decode()
        if self.delay_s:
            asyncio.get_running_loop().call_later(self.delay_s, self._pass, text)
        else:
            self._pass(text)

    async def request(self, request: Mapping[str, Any], *, timeout_s: float = 5.0) -> dict[str, Any]:
        key = f"request:{next(self._numbers)}"
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[key] = answer
        try:
            async with asyncio.timeout(timeout_s):
                await self.send({**request, "id": key})
                return await answer
        except TimeoutError:
            raise HostlinkError(f"no answer within {timeout_s:g} s") from None

    async def events(self, path: str) -> AsyncIterator[Event]:
        """The odometry of a robot, as the daemon streams it."""
        name, stream = path.removeprefix("/api/robots/").split("/", 1)
        assert stream == "odometry/events"
        robot, news = self._hub.robots.find(name), asyncio.Event()
        reader = self._hub.join(f"events {next(_numbers)}", role=Role.READ)
        reader.follow(robot, news.set)
        news.set()
        try:
            while True:
                await news.wait()
                news.clear()
                if (known := robot.odometry.snapshot(asyncio.get_running_loop().time())) is not None:
                    self.callers.note()
                    yield Event("odometry", cast(dict[str, Any], odometry_view(known)))
        finally:
            reader.leave()

    def close(self) -> None:
        if not self.participant.has_left:
            self._client.close()

    def _pass(self, text: str) -> None:
        if not self.participant.has_left:
            self._client.receive(text)

    def _receive(self) -> None:
        """Pass on what the daemon has sent."""
        for waiting in iter(self._queue.pop, None):
            data = waiting.item.data
            answer = cbor2.loads(data) if waiting.item.is_binary else json.loads(data)
            future = self._answers.pop(str(answer.get("id")), None)
            if future is None:
                for receive in self.handlers[answer["op"]]:
                    receive(answer)
            elif not future.done():
                future.set_result(answer)


class MemoryHttp:
    """HttpClient, of a daemon in memory."""

    url = "memory"

    def __init__(self, hub: Hub, callers: Callers) -> None:
        self._api, self._callers = RestCalls(hub), callers

    async def request(
        self, method: str, path: str, body: Mapping[str, Any] | None = None, *, timeout_s: float = 5.0
    ) -> dict[str, Any]:
        self._callers.note()
        async with asyncio.timeout(timeout_s):
            _, answer = await self._api.call(method, path, b"" if body is None else body)
        if "error" in answer:
            raise Refused(answer["error"]["kind"], answer["error"]["reason"], answer)
        return cast(dict[str, Any], answer)

    async def measure(self, path: str, wait_s: float) -> Standstill:
        return measured(await self.request("GET", f"{path}?wait_s={wait_s:g}"))


class MemoryHost(Host):
    """A connection of the client to a hub."""

    def __init__(self, hub: Hub, tasks: asyncio.TaskGroup) -> None:
        self.url = MemoryHttp.url
        callers = Callers(asyncio.get_running_loop().time)
        self.connection_ = MemoryConnection(hub, tasks, callers)
        self._http = cast(HttpClient, MemoryHttp(hub, callers))
        self._connection = cast(HostConnection, self.connection_)
        self._topics = Topics(self._connection)
        self._services = ProvidedServices(self._connection)
        self._services.begin(tasks)
        self._driver = VelocitySender(self._connection, callers)
        self._watchers = WeakSet()
        self._repeating = tasks.create_task(self._driver.repeat(), context=own_context())

    def stop_repeating(self, robot: str) -> None:
        """Let the commands of this robot end with their lease, as in a program that hangs."""
        self._driver.stop_repeating(robot)

    def lose(self) -> None:
        """The network is cut, and is there again afterwards."""
        self._driver.break_all("the network is cut")

    def close(self) -> None:
        """The program ends."""
        self._services.end()
        self._repeating.cancel()
        self.connection_.close()

    async def _round_trip(self) -> None:
        self._topics.is_settled = True
        await asyncio.sleep(self.connection_.delay_s)


@contextlib.asynccontextmanager
async def memory_host(hub: Hub, tasks: asyncio.TaskGroup) -> AsyncIterator[MemoryHost]:
    """Connect a program for the length of the block, as `connect` does."""
    host = MemoryHost(hub, tasks)
    try:
        yield host
        await host.stop_driven()
    finally:
        host.close()
