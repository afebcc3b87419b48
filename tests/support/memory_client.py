"""The Python client without a socket, in virtual time: its own driver, at the other end of a rosbridge client."""

import asyncio
import contextlib
import itertools
import json
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, cast

from hostlink.api.clients import ClientQueue
from hostlink.api.rosbridge import RosbridgeClient
from hostlink.api.views import odometry_view
from hostlink.client import Event, Host, Robot
from hostlink.client.connection import HostConnection
from hostlink.client.driver import VelocitySender
from hostlink.client.http_client import HttpClient
from hostlink.errors import HostlinkError
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.hub.participant import Participant

_numbers = itertools.count(1)


class MemoryConnection:
    """HostConnection as the client's driver uses it. `delay_s`: delay of messages that are sent from now on."""

    def __init__(self, hub: Hub, tasks: asyncio.TaskGroup) -> None:
        self.delay_s = 0.0
        self._hub = hub
        self.handlers: defaultdict[str, list[Callable[[dict[str, Any]], None]]] = defaultdict(list)
        self._queue = ClientQueue()
        self._client = RosbridgeClient(f"program {next(_numbers)}", hub, self._queue, spawn=tasks.create_task)
        self._answers: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self._numbers = itertools.count(1)
        self._pass('{"op": "set_level", "level": "error"}')

    @property
    def participant(self) -> Participant:
        return self._client.participant

    async def send(self, request: Mapping[str, Any]) -> None:
        text = json.dumps(request)
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
                    yield Event("odometry", cast(dict[str, Any], odometry_view(known)))
        finally:
            reader.leave()

    def close(self) -> None:
        if not self.participant.has_left:
            self._client.close()

    def _pass(self, text: str) -> None:
        if self.participant.has_left:
            return
        self._client.receive(text)
        for waiting in iter(self._queue.pop, None):
            answer = json.loads(waiting.item.data)
            future = self._answers.pop(str(answer.get("id")), None)
            if future is None:
                for receive in self.handlers[answer["op"]]:
                    receive(answer)
            elif not future.done():
                future.set_result(answer)


class _Rest:
    """The requests of a robot that is stopped."""

    url = "memory"

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    async def request(self, method: str, path: str, *, timeout_s: float = 5.0) -> dict[str, Any]:  # noqa: ARG002 - as HttpClient has it
        name, what = path.removeprefix("/api/robots/").split("/")
        assert (method, what) == ("POST", "stop")
        self._hub.robots.find(name).stop()
        return {}


class MemoryHost:
    """A connection of the client, as far as it drives."""

    def __init__(self, hub: Hub, tasks: asyncio.TaskGroup) -> None:
        self.connection_ = MemoryConnection(hub, tasks)
        self._rest = cast(HttpClient, _Rest(hub))
        self._driver = VelocitySender(cast(HostConnection, self.connection_), asyncio.get_running_loop().time)
        self._repeating = tasks.create_task(self._driver.repeat())

    def robot(self, name: str, *, priority: int = 50) -> Robot:
        connection = cast(HostConnection, self.connection_)
        return Robot(name, priority, http=self._rest, driver=self._driver, connection=connection)

    def connection(self) -> "MemoryHost":
        """Changes of the connection: there are none."""
        return self

    def pop_all(self) -> list[object]:
        return []

    def stop_repeating(self, robot: str) -> None:
        """Let the commands of this robot end with their lease, as in a program that hangs."""
        self._driver.stop_repeating(robot)

    def lose(self) -> None:
        """The network is cut, and is there again afterwards."""
        self._driver.break_all("the network is cut")

    async def stop_driven(self) -> None:
        """Stop the robots that this program drives."""
        await Host.stop_driven(cast(Host, self))

    def close(self) -> None:
        """The program ends."""
        self._repeating.cancel()
        self.connection_.close()


@contextlib.asynccontextmanager
async def memory_host(hub: Hub, tasks: asyncio.TaskGroup) -> AsyncIterator[MemoryHost]:
    host = MemoryHost(hub, tasks)
    try:
        yield host
    finally:
        host.close()
