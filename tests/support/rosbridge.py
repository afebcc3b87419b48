"""A program that speaks rosbridge, for tests."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
import cbor2

from hostlink.core.robot.admission import LEASE_S
from tests.support.daemon import Daemon
from tests.support.fake_device import FakeDevice
from tests.support.waiting import TIMEOUT_S


class Client:
    """A program on the WebSocket."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket

    async def send(self, **request: Any) -> None:
        await self.socket.send_str(json.dumps(request))

    async def receive(self) -> dict[str, Any]:
        async with asyncio.timeout(TIMEOUT_S):
            heard: dict[str, Any] = json.loads(await self.socket.receive_str())
            return heard

    async def receive_binary(self) -> dict[str, Any]:
        async with asyncio.timeout(TIMEOUT_S):
            heard: dict[str, Any] = cbor2.loads(await self.socket.receive_bytes())
            return heard

    async def call(self, service: str, /, **arguments: Any) -> Any:
        """The values of a call that must succeed."""
        await self.send(op="call_service", id=service, service=service, args=arguments)
        answer = await self.receive()
        assert (answer["op"], answer["id"], answer["result"]) == ("service_response", service, True), answer
        return answer["values"]


@contextlib.asynccontextmanager
async def client(host: Daemon, *, level: str = "error") -> AsyncIterator[Client]:
    async with host.session.ws_connect(host.url) as socket:
        new = Client(socket)
        await new.send(op="set_level", level=level)
        yield new


async def publish_until_driven(program: Client, device: FakeDevice, linear_m_s: float) -> None:
    """Publish a velocity of robot_0 until its device receives it: a daemon that is late refuses it."""
    while True:
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": linear_m_s}})
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2 * LEASE_S):
                await device.velocity_of((linear_m_s, 0.0))
                return
