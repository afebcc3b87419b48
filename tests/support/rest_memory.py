"""The REST API without a socket: routes, handlers and the statuses of errors, on a hub with a robot in memory."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Sequence
from typing import Any

from aiohttp import web
from aiohttp.test_utils import make_mocked_request

from hostlink.api.access import GRANT, Grant
from hostlink.api.clients import Clients
from hostlink.api.rest import Owners, Rest
from hostlink.api.routes import BODY, CAME, Route, explain_errors
from hostlink.config import Config
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.hub.reloader import Read, Reloader
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.memory_hub import running
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT
from tests.support.scripted_device import ScriptedDevice


class RestMemory:
    """A daemon's REST API, and the device of its robot."""

    def __init__(self, drives: Any, read: Read | None) -> None:
        self.hub = Hub(Config(), CATALOG, reraises=True)
        self.owners = Owners(self.hub)
        self._drives, self._read = drives, read
        self._app = web.Application()
        self.device: ScriptedDevice

    async def begin(self, settle_s: float) -> None:
        clients, reloader = Clients(4, max_per_address=4), Reloader(self.hub, self._read)
        self.add(Rest(self.hub, clients, self.owners, self._drives, reloader).routes())
        self.device = ScriptedDevice(self.hub, robot_topics(ROBOT), address="10.0.0.1")
        await asyncio.sleep(settle_s)

    def add(self, routes: Sequence[Route]) -> None:
        """Offer more paths."""
        for route in routes:
            self._app.router.add_route(route.method, route.path, route.handler)

    async def call(
        self, method: str, path: str, body: object = b"", *, role: Role = Role.DRIVE, who: str = "phone"
    ) -> tuple[int, Any]:
        """Return the status and the JSON of an answer. `body` is JSON unless it is bytes."""
        status, data = await self.call_raw(method, path, body, role=role, who=who)
        return status, json.loads(data)

    async def call_raw(
        self, method: str, path: str, body: object = b"", *, role: Role = Role.DRIVE, who: str = "phone"
    ) -> tuple[int, bytes]:
        """Return the status and the body of an answer."""
        match = await self._app.router.resolve(make_mocked_request(method, path))
        request = make_mocked_request(method, path, match_info=dict(match))
        request[GRANT], request[CAME] = Grant(who, role), asyncio.get_running_loop().time()
        request[BODY] = body if isinstance(body, bytes) else json.dumps(body).encode()
        answer = await explain_errors(request, match.handler)
        assert isinstance(answer, web.Response)
        assert isinstance(answer.body, bytes)
        return answer.status, answer.body

    async def move_to(self, x_m: float, y_m: float, theta_rad: float) -> None:
        """Publish a pose of the robot."""
        await self.device.send(ODOMETRY_ID, POSE.pack(x_m, y_m, theta_rad))
        await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def rest_memory(
    *, settle_s: float = 0.5, drives: Any = None, read: Read | None = None
) -> AsyncIterator[RestMemory]:
    """A running hub with one robot, for virtual time. `settle_s`: time in which the device announces its topics.

    `drives` is the log of drives; `read` returns the settings of a reload.
    """
    made = RestMemory(drives, read)
    async with running(made.hub):
        await made.begin(settle_s)
        yield made
