"""Server-sent events: the state of robots, links and clients as it changes, for the page, programs and `curl -N`.

No state queues up, in the kernel neither: who is slow gets the newest, and fewer of them.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus

import msgspec
from aiohttp import web

from hostlink.api.access import GRANT
from hostlink.api.clients import Backlog, Client, Clients
from hostlink.api.routes import Route
from hostlink.api.state_feed import Reader, StateFeed, encode_event
from hostlink.api.unread import until_read
from hostlink.api.views import odometry_view
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.recording.recordings import Recordings

HEARTBEAT_S = 0.3  # a reader that hears nothing for three of them knows that the daemon is gone
SEND_TIMEOUT_S = 5.0
ROLE_HEADER = "Hostlink-Role"  # what the reader's token allows: read or drive
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no", "Content-Type": "text/event-stream"}

Send = Callable[[bytes], Awaitable[None]]


class Events:
    """The event streams."""

    def __init__(self, hub: Hub, clients: Clients, recordings: Recordings) -> None:
        self._hub = hub
        self._clients = clients
        self._feed = StateFeed(hub, clients, recordings)

    def routes(self) -> list[Route]:
        """Both streams."""
        return [
            Route(
                "/api/events",
                self._state,
                "Events `robots`, `links` and `clients`: the JSON of their GETs; `recordings`: those under way, how"
                " often their folder has changed, how many incidents are pending, saved, missed; `log`: a log line",
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
        reader = Reader(self._feed)
        async with self._stream(request, reader) as (response, send, _):
            with self._feed.reading(reader):
                while self._feed.is_running:
                    await until_read(request.transport, SEND_TIMEOUT_S)
                    now_s = asyncio.get_running_loop().time()
                    events = reader.pop()
                    if events:
                        events[-1] += b": sent %.3f\n\n" % now_s  # shows how long they were on their way
                    for event in events:
                        await send(event)
                    await _wait(reader.news, response)
        return response

    async def _odometry(self, request: web.Request) -> web.StreamResponse:
        robot = self._hub.robots.find(request.match_info["name"])
        news = asyncio.Event()
        async with self._stream(request) as (response, send, client):
            participant = self._hub.join(client.name, role=Role.READ, on_end=news.set)
            try:
                participant.follow(robot, news.set)
                news.set()  # what is known already
                while self._hub.robots.is_known(robot) and not participant.has_left:  # one that is forgotten is over
                    is_news, now_s = await _wait(news, response), asyncio.get_running_loop().time()
                    odometry = robot.odometry.snapshot(now_s) if is_news else None
                    if odometry is not None:
                        await send(encode_event("odometry", msgspec.json.encode(odometry_view(odometry))))
            finally:
                participant.leave()
        return response

    @contextlib.asynccontextmanager
    async def _stream(
        self, request: web.Request, backlog: Backlog | None = None
    ) -> AsyncIterator[tuple[web.StreamResponse, Send, Client]]:
        """A response that is written until its reader is gone, which ends the block."""
        role = request[GRANT].role.name.lower()
        response = web.StreamResponse(headers={**HEADERS, ROLE_HEADER: role})
        client = self._clients.enter("events", request, request[GRANT], backlog)

        async def send(event: bytes) -> None:
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await response.write(event)
            client.sent(len(event))

        try:
            try:
                await response.prepare(request)
            except OSError as error:
                raise web.HTTPBadRequest(reason="it broke off before the first event") from error
            with contextlib.suppress(OSError):  # the reader is gone, or reads nothing (TimeoutError is one too)
                yield response, send, client
        finally:
            self._clients.leave(client)


async def _wait(news: asyncio.Event, response: web.StreamResponse) -> bool:
    """Wait for news, at most until a comment is due, by which both sides notice when the other is gone.

    Returns whether there are news.
    """
    try:
        async with asyncio.timeout(HEARTBEAT_S):
            await news.wait()
    except TimeoutError:
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await response.write(b": alive\n\n")
        return False
    news.clear()
    return True
