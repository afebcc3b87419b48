"""The API server: rosbridge and Foxglove on the WebSocket at `/`, the page at `/`, and all other routes."""

import asyncio
import contextlib
import errno
import mimetypes
import socket as sockets
from collections.abc import AsyncIterator, Callable
from http import HTTPStatus
from importlib.resources import files
from typing import TypedDict

import structlog
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from structlog.contextvars import bound_contextvars

from hostlink.components.gateway.access import GRANT, Access, Grant, Grants, check_role, tls_context, token_of
from hostlink.components.gateway.captures import Captures
from hostlink.components.gateway.clients import Client, ClientQueue, Clients
from hostlink.components.gateway.events import Events
from hostlink.components.gateway.foxglove import FoxgloveClient, FoxgloveDirectory
from hostlink.components.gateway.history import HistoryRoutes
from hostlink.components.gateway.listener import ApiConnections, ApiListener, MakeProtocol, reading_of
from hostlink.components.gateway.metrics import Metrics
from hostlink.components.gateway.recordings import RecordingRoutes
from hostlink.components.gateway.rest import Owners, Rest
from hostlink.components.gateway.rosapi import RosApi
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.components.gateway.routes import (
    BODY,
    CAME,
    FILE,
    FOXGLOVE,
    MAX_BODY_BYTES,
    SMALL_BODY_BYTES,
    Handler,
    Route,
    explain_errors,
    is_foxglove,
    openapi,
    refuse_unreadable,
    reply,
)
from hostlink.components.gateway.settings import KEPT_FOR_REQUESTS, ApiConfig, GatewaySettings
from hostlink.components.gateway.web_socket import ClientSocket, close_going_away
from hostlink.core.config import Config
from hostlink.core.host import Host, Role
from hostlink.core.runtime.acceptor import bind, why
from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.core.runtime.listening import spelled
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.rate_limit import RateLimit
from hostlink.core.transport.base import READ_BYTES
from hostlink.errors import ConfigError, without_frames

PAGE = files("hostlink.components.gateway") / "web" / "built"  # built by Vite: make web
PAGE_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "img-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}

SHUTDOWN_TIMEOUT_S = 0.3
LINGER_S = 1.0  # for an unexpected body, before its connection is closed
REQUEST_S = 0.0005  # cost of a small request
MAX_GROUP = 64  # characters of a group's name
ALLOWED_HEADERS = "Authorization, Content-Type, Range"
EXPOSED_HEADERS = "Accept-Ranges, Content-Length, Content-Range, ETag, Last-Modified"  # for readers of recordings


async def page_file(request: web.Request) -> web.StreamResponse:
    """Serve a file of the page. It needs no token, because it names no robot."""
    name = request.match_info.get("file")
    folder = PAGE if name is None else PAGE / "web"
    found = next((each for each in folder.iterdir() if each.name == (name or "index.html")), None)
    if found is None:  # a name is matched against the folder, so ..%2F.. leads nowhere
        raise web.HTTPNotFound
    kind, _ = mimetypes.guess_type(found.name)
    answer = web.Response(body=found.read_bytes(), headers=PAGE_HEADERS | {"Content-Type": kind or "text/plain"})
    answer.enable_compression()
    return answer


log = structlog.get_logger()


class OpenApiView(TypedDict):
    """An OpenAPI 3.1 document."""

    openapi: str


class ApiServer:
    """The HTTP server and its WebSocket clients."""

    def __init__(self, host: Host, settings: GatewaySettings) -> None:
        self._host, self._settings = host, settings
        host.on_reload(self._prepare_access)
        self._grants = Grants()
        self._config = config = settings.api
        self._access = Access(config)
        self._limit = RateLimit(config.max_requests_s)
        connections = ApiConnections(
            config.max_connections,
            config.max_connections_per_address,
            request_timeout_s=config.request_timeout_s,
        )
        self.listener = ApiListener(connections, host, config)
        self._clients = Clients(
            min(config.max_clients, config.max_connections - KEPT_FOR_REQUESTS),
            max_per_address=config.max_connections_per_address - KEPT_FOR_REQUESTS,
        )
        self._owners = Owners(host)
        self._directory = FoxgloveDirectory(host)
        self._metrics = Metrics(host, self._clients, self._limit, connections, self._owners)
        self._sockets: set[web.WebSocketResponse] = set()
        self._turns = host.turns()  # shared by all requests
        self._by_handler: dict[Handler, Route] = {}
        RosApi(host).offer()

    def application(self) -> web.Application:
        """Return the aiohttp application with all routes."""
        app = web.Application(middlewares=[explain_errors, self._admit], client_max_size=self._config.max_message_bytes)
        routes = [
            *Rest(self._host, self._settings, self._clients, self._owners).routes(),
            *Events(self._host, self._clients).routes(),
            *Captures(self._host.devices).routes(),
            *RecordingRoutes(self._host).routes(),
            *HistoryRoutes(self._host).routes(),
            self._metrics.route(),
            Route("/api/openapi.json", self._openapi, OpenApiView, role=None),
        ]
        for route in routes:
            app.router.add_route(route.method, route.path, route.handler)
            if route.media_type == FILE:  # programs request the length before they read ranges
                app.router.add_route("HEAD", route.path, route.handler)
        self._by_handler = {route.handler: route for route in routes}
        app.router.add_get("/", self._root)
        app.router.add_get("/web/{file}", page_file)
        app.on_shutdown.append(self._close_sockets)
        return app

    def _prepare_access(self, config: Config) -> Callable[[], None]:
        """Prepare new tokens and origins. Applying them ends requests with a revoked token; what they drive stops."""
        new = Access(config.table("api", ApiConfig))

        def apply() -> None:
            revoked = self._access.revoked(new)
            self._access = new
            self._grants.end(revoked)
            self._owners.end(revoked)

        return apply

    async def _openapi(self, _: web.Request) -> web.Response:
        """The OpenAPI document."""
        return reply(openapi(self._by_handler.values()))

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Check a request before any other code reads it."""
        reading = reading_of(request)
        if reading is None:
            request[CAME] = asyncio.get_running_loop().time()
            return await self._answer(request, handler)
        reading.begin_request()
        request[CAME] = reading.request_came_s
        try:
            return await self._answer(request, handler)
        finally:
            if not request.content.is_eof() and not _has_small_body(request):
                reading.refuse_body()
            reading.end_request()

    async def _answer(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        origin = request.headers.get("Origin")
        self._access.check_place(origin=origin, host=request.host)
        if request.method == "OPTIONS" and origin is not None:  # preflight of a browser for a page of another origin
            answer: web.StreamResponse = web.Response(status=HTTPStatus.NO_CONTENT)
        else:
            grant = self._check(request)  # may be revoked within the block
            with contextlib.nullcontext() if grant is None else self._grants.using(grant):
                await self._turns.wait(REQUEST_S)
                await self._receive_body(request)
                answer = await handler(request)
        if origin is not None and not answer.prepared:
            answer.headers["Access-Control-Allow-Origin"] = origin
            answer.headers["Access-Control-Allow-Methods"] = "GET, HEAD, PUT, POST, DELETE"
            answer.headers["Access-Control-Allow-Headers"] = ALLOWED_HEADERS
            answer.headers["Access-Control-Expose-Headers"] = EXPOSED_HEADERS
            answer.headers["Vary"] = "Origin"
        return answer

    def _check(self, request: web.Request) -> Grant | None:
        """Check the rate and the token of a request. Return None if its route needs no token."""
        route = self._by_handler.get(request.match_info.handler)
        is_limited = route is None or route.is_limited
        if is_limited and not self._limit.allows(request.remote, asyncio.get_running_loop().time()):
            reason = f"more than {self._config.max_requests_s:g} requests a second"
            raise web.HTTPTooManyRequests(reason=reason, headers={"Retry-After": "1"})
        is_page = request.match_info.handler in (self._root, page_file) and not _is_websocket(request)
        role = route.role if route is not None else None if is_page else Role.READ
        if role is None:
            return None
        grant = self._access.grant(token_of(request))
        check_role(grant, role)
        request[GRANT] = grant
        return grant

    async def _receive_body(self, request: web.Request) -> None:
        """Read the body for routes that have one, before the handler runs. A stop does not wait for its body."""
        route = self._by_handler.get(request.match_info.handler)
        if route is None or route.request is None:
            return
        if route.check_head is not None:
            route.check_head(request)
        content, most_bytes = request.content, min(route.max_body_bytes, self._config.max_message_bytes)
        if route.on_head is not None and not (content.is_eof() and content.total_bytes <= most_bytes):
            route.on_head(request)
        if (request.content_length or 0) > most_bytes:
            raise _too_large(most_bytes)
        bodies, held_bytes = self._host.share("bodies"), most_bytes if most_bytes > SMALL_BODY_BYTES else 0
        if not bodies.take(held_bytes):
            raise web.HTTPServiceUnavailable(reason="too many bodies at once", headers={"Retry-After": "1"})
        timeout_s, body = self._config.request_timeout_s, bytearray()
        try:
            reading = reading_of(request)
            with contextlib.nullcontext() if reading is None else reading.receiving_body():
                async with asyncio.timeout(timeout_s):
                    while piece := await content.readany():
                        body += piece
                        if len(body) > most_bytes:
                            raise _too_large(most_bytes)
            request[BODY] = bytes(body)
        except TimeoutError:
            raise web.HTTPRequestTimeout(reason=f"the body did not arrive within {timeout_s:g} s") from None
        except (OSError, web.RequestPayloadError, HttpProcessingError) as error:
            raise web.HTTPBadRequest(reason="the body is incomplete, or does not match its head") from error
        finally:
            bodies.give(held_bytes)

    async def _root(self, request: web.Request) -> web.StreamResponse:
        return await (self._serve_client(request) if _is_websocket(request) else page_file(request))

    async def _serve_client(self, request: web.Request) -> web.StreamResponse:
        kind = "foxglove" if is_foxglove(request) else "rosbridge"
        queue = ClientQueue(self._host.share("queues"))
        client = self._clients.enter(kind, request, queue)
        socket = web.WebSocketResponse(
            autoping=False,
            max_msg_size=self._config.max_message_bytes,
            compress=False,
            protocols=FOXGLOVE,
            timeout=SHUTDOWN_TIMEOUT_S,
            writer_limit=0,  # each send waits for room, so that excess waits in the client's queue
        )
        with bound_contextvars(client=client.name, peer=request.remote):
            try:
                await _open(socket, request)
                reading = reading_of(request)
                if reading is None:
                    raise ConnectionResetError("the connection was closed during the handshake")
                self._sockets.add(socket)
                log.info("client.connected", role=client.grant.role.name.lower(), program=printable(client.program))
                async with asyncio.TaskGroup() as tasks:
                    program = self._program(client, queue, tasks, request.query.get("group", "")[:MAX_GROUP])
                    program.participant.address = client.peer
                    connection = ClientSocket(
                        socket,
                        reading,
                        client,
                        program,
                        queue,
                        self._host,
                        tasks=tasks,
                        to_client=self._metrics.to_client,
                        replaced=self._clients.velocities_replaced,
                        max_messages_s=self._config.max_requests_s,
                    )
                    tasks.create_task(connection.receive(), name=client.name)
            except* OSError as broken:
                log.debug("client.broken", reason=str(broken.exceptions[0]))
            finally:
                self._sockets.discard(socket)
                self._clients.leave(client)
                queue.release()
                if (error := socket.exception()) is not None:
                    without_frames(error)
                if request.transport is not None and request.transport.get_write_buffer_size():
                    request.transport.abort()  # closing would wait without end for a client that does not read
                log.info("client.closed", code=socket.close_code, dropped=queue.dropped)
        raise_if_cancelled()
        return socket if socket.prepared else web.Response(status=HTTPStatus.BAD_REQUEST)  # the client left before

    def _program(
        self, client: Client, queue: ClientQueue, tasks: asyncio.TaskGroup, group: str
    ) -> RosbridgeClient | FoxgloveClient:
        """Create the protocol that the client speaks."""
        name, role = client.name, client.grant.role
        if client.kind == "foxglove":
            return FoxgloveClient(name, self._host, self._directory, queue, spawn=tasks.create_task, role=role)
        return RosbridgeClient(
            name,
            self._host,
            queue,
            spawn=tasks.create_task,
            role=role,
            group=group,
            program=client.program,
            max_message_bytes=self._config.max_message_bytes,
        )

    async def _close_sockets(self, _: web.Application) -> None:
        async with asyncio.TaskGroup() as tasks:  # all at once: many stuck clients take no longer than one
            for socket in self._sockets:
                tasks.create_task(close_going_away(socket, SHUTDOWN_TIMEOUT_S))


async def _open(socket: web.WebSocketResponse, request: web.Request) -> None:
    """Answer the handshake.

    Raises:
        web.HTTPBadRequest: it is invalid.
    """
    try:
        await socket.prepare(request)
    except web.HTTPBadRequest as error:
        reason = (
            f"the WebSocket handshake is invalid: {printable(error.text or '', 120)}; use a client for WebSockets, and "
            "let a proxy pass the headers Upgrade and Connection"
        )
        raise web.HTTPBadRequest(reason=reason) from None


def _too_large(most_bytes: int) -> web.HTTPRequestEntityTooLarge:
    reason = f"the body may have {most_bytes} bytes at most"
    return web.HTTPRequestEntityTooLarge(most_bytes, 0, reason=reason)


def _has_small_body(request: web.Request) -> bool:
    """Whether the end of the body may be awaited without a handler that reads it."""
    return request.content_length is not None and request.content_length <= MAX_BODY_BYTES


def _is_websocket(request: web.Request) -> bool:
    return request.headers.get("Upgrade", "").lower() == "websocket"


def url_of(host: str, port: int, *, has_tls: bool) -> str:
    """Return the URL of an address."""
    return f"{'https' if has_tls else 'http'}://{spelled(host, port)}"


@contextlib.asynccontextmanager
async def serve_api(host: Host, settings: GatewaySettings) -> AsyncIterator[str]:
    """Serve within the block. Yields the address as a URL.

    Raises:
        ConfigError: the port is in use, or the address is invalid.
    """
    server, config = ApiServer(host, settings), settings.api
    runner = web.AppRunner(
        server.application(),
        access_log=None,
        handle_signals=False,
        shutdown_timeout=SHUTDOWN_TIMEOUT_S,
        lingering_time=LINGER_S,
        auto_decompress=False,  # a compressed body cannot expand
        read_bufsize=READ_BYTES,  # aiohttp buffers twice as much, then pauses reading
    )
    tls = tls_context(config)
    await runner.setup()
    try:
        listening = await _bind(config)
        address, port = listening[0].getsockname()[:2]
        async with server.listener.serving(listening, protocols_of(runner), tls):
            yield url_of(address, port, has_tls=tls is not None)
    finally:
        await runner.cleanup()


def protocols_of(runner: web.AppRunner) -> MakeProtocol:
    """Return the factory of HTTP protocols, which refuse unreadable heads."""
    assert runner.server is not None  # noqa: S101 - set by setup()
    runner.server.request_handler = refuse_unreadable(runner.server.request_handler)
    return runner.server


async def _bind(config: ApiConfig) -> list[sockets.socket]:
    try:
        return await bind(config.host, config.port)
    except (OSError, OverflowError, UnicodeError) as error:
        where = f"API port {config.port}"
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            problem = "is in use by another hostlink or rosbridge; stop it, or choose another port with --api HOST:PORT"
            raise ConfigError(where, problem) from error
        raise ConfigError(f"{where} of {config.host}", f"cannot be opened: {why(error)}") from error
