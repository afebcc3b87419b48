"""The REST API without a socket: routes, handlers and the statuses of errors, on a hub with a robot in memory."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Sequence
from typing import Any

from aiohttp import web
from aiohttp.test_utils import make_mocked_request

from hostlink.components.gateway.access import GRANT, Grant
from hostlink.components.gateway.clients import Clients
from hostlink.components.gateway.rest import Owners, Rest
from hostlink.components.gateway.routes import BODY, CAME, Route, explain_errors
from hostlink.components.gateway.settings import ApiConfig, GatewaySettings
from hostlink.components.recorder.drives import DriveLog
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Role
from hostlink.core.hub.reloader import Read
from hostlink.core.protocol.endpoint import DeviceEndpoint
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.hosts import host_of
from tests.support.memory_hub import running
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT
from tests.support.scripted_device import ScriptedDevice
from tests.support.waiting import expect


class RestCalls:
    """Requests of the REST API of a hub."""

    def __init__(self, hub: Hub, drives: Any = None) -> None:
        self.hub, host = hub, host_of(hub)
        self.host, self.owners = host, Owners(host)
        self._app = web.Application()
        if drives is not None:
            hub.offers[DriveLog] = drives
        config = hub.config
        settings = GatewaySettings(
            api=config.table("api", ApiConfig), tcp=config.tcp, udp=config.udp, serial=config.serial
        )
        self.add(Rest(host, settings, Clients(4, max_per_address=4), self.owners).routes())

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


class RestMemory(RestCalls):
    """A daemon's REST API, and the device of its robot."""

    def __init__(self, topics: Sequence[DeviceEndpoint], drives: Any, read: Read | None) -> None:
        super().__init__(Hub(Config(), CATALOG, reraises=True, read=read), drives)
        self._topics = topics
        self.device: ScriptedDevice

    async def begin(self, settle_s: float) -> None:
        self.device = ScriptedDevice(self.hub, self._topics, address="10.0.0.1")
        await asyncio.sleep(settle_s)
        await expect(self._is_known)  # on a busy machine, in real time, that takes longer

    def _is_known(self) -> bool:
        """Whether the device has announced its topics, and the hub has decided which robot it is."""
        known = self.hub.robots.device(self.device.link)
        return known is not None and bool(known.link.session.counts.negotiations) and not known.is_undecided

    async def move_to(self, x_m: float, y_m: float, theta_rad: float) -> None:
        """Publish a pose of the robot."""
        await self.device.send(ODOMETRY_ID, POSE.pack(x_m, y_m, theta_rad))
        await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def rest_memory(
    topics: Sequence[DeviceEndpoint] | None = None,
    *,
    settle_s: float = 0.5,
    drives: Any = None,
    read: Read | None = None,
) -> AsyncIterator[RestMemory]:
    """A running hub with one robot, for virtual time. `settle_s`: time in which the device announces its topics.

    `drives` is the log of drives; `read` returns the settings of a reload.
    """
    made = RestMemory(robot_topics(ROBOT) if topics is None else topics, drives, read)
    async with running(made.hub):
        await made.begin(settle_s)
        yield made
