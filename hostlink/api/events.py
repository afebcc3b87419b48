"""Server-sent events: the state of robots and links as it changes, for a page or `curl -N`.

Nothing queues up: who is slow gets the newest state, and fewer of them.
"""

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from http import HTTPStatus

import msgspec
from aiohttp import web

from hostlink.api.access import GRANT
from hostlink.api.clients import Client, Clients
from hostlink.api.routes import Route
from hostlink.api.views import links_view, odometry_view, robot_view
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role

ROBOTS_INTERVAL_S = 0.2  # quicker than people see
LINKS_EVERY = 5  # of those
HEARTBEAT_S = 5.0  # a stream whose reader is gone is noticed by writing to it
SEND_TIMEOUT_S = 5.0
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no", "Content-Type": "text/event-stream"}

Send = Callable[[str, Mapping[str, object]], Awaitable[None]]


class Events:
    """The event streams."""

    def __init__(self, hub: Hub, clients: Clients) -> None:
        self._hub = hub
        self._clients = clients

    def routes(self) -> list[Route]:
        """Both streams."""
        return [
            Route(
                "/api/events",
                self._state,
                "Events `robots`, five a second, and `links`, one a second: the JSON of their GETs",
                response=None,
                media_type="text/event-stream",
                fails=(HTTPStatus.SERVICE_UNAVAILABLE,),
            ),
            Route(
                "/api/robots/{name}/odometry/events",
                self._odometry,
                "An event `odometry` for each new pose: the JSON of its GET",
                response=None,
                media_type="text/event-stream",
                fails=(HTTPStatus.NOT_FOUND, HTTPStatus.SERVICE_UNAVAILABLE),
            ),
        ]

    async def _state(self, request: web.Request) -> web.StreamResponse:
        async with self._stream(request) as (response, send, _):
            for number in itertools.count():
                await send("robots", {"robots": [robot_view(robot) for robot in self._hub.robots.all()]})
                if number % LINKS_EVERY == 0:
                    await send("links", await links_view(self._hub))
                await asyncio.sleep(ROBOTS_INTERVAL_S)
        return response

    async def _odometry(self, request: web.Request) -> web.StreamResponse:
        robot = self._hub.robots.find(request.match_info["name"])
        news = asyncio.Event()
        async with self._stream(request) as (response, send, client):
            participant = self._hub.join(client.name, role=Role.READ, on_end=news.set)
            try:
                participant.subscribe(robot.shown.odometry, lambda _: news.set())
                while self._hub.robots.is_known(robot) and not participant.has_left:  # one that is back is another
                    odometry = odometry_view(robot)
                    if odometry is not None:
                        await send("odometry", odometry)
                    await _wait(news, response)
            finally:
                participant.leave()
        return response

    @contextlib.asynccontextmanager
    async def _stream(self, request: web.Request) -> AsyncIterator[tuple[web.StreamResponse, Send, Client]]:
        """A response that is written until its reader is gone, which ends the block."""
        response = web.StreamResponse(headers=HEADERS)
        client = self._clients.enter("events", request, request[GRANT])

        async def send(event: str, data: Mapping[str, object]) -> None:
            wire = b"event: " + event.encode() + b"\ndata: " + msgspec.json.encode(data) + b"\n\n"
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await response.write(wire)
            client.sent(len(wire))

        try:
            try:
                await response.prepare(request)
            except OSError as error:
                raise web.HTTPBadRequest(reason="it broke off before the first event") from error
            with contextlib.suppress(OSError):  # the reader is gone, or takes nothing (TimeoutError is one too)
                yield response, send, client
        finally:
            self._clients.leave(client)


async def _wait(news: asyncio.Event, response: web.StreamResponse) -> None:
    """Wait for news; in the silence send a comment now and then, so that a reader that is gone is noticed."""
    while not news.is_set():
        try:
            async with asyncio.timeout(HEARTBEAT_S):
                await news.wait()
        except TimeoutError:
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await response.write(b": alive\n\n")
    news.clear()
