"""The API server: rosbridge on the WebSocket at `/`, the page for a browser there, REST beside it."""

import asyncio
import contextlib
import errno
import itertools
from collections.abc import AsyncIterator
from importlib.resources import files

import structlog
from aiohttp import WSCloseCode, WSMsgType, web
from structlog.contextvars import bound_contextvars

from hostlink.api.client_queue import ClientQueue
from hostlink.api.request import MAX_MESSAGE_BYTES
from hostlink.api.rest import Rest, explain_errors
from hostlink.api.rosapi import RosApi
from hostlink.api.rosbridge import RosbridgeClient
from hostlink.config import ApiConfig
from hostlink.errors import ConfigError
from hostlink.hub.hub import Hub

log = structlog.get_logger()

PING_INTERVAL_S = 10.0  # a client that is gone without a word is noticed within one and a half of it
SHUTDOWN_TIMEOUT_S = 0.3
SEND_TIMEOUT_S = 5.0  # a client whose socket takes nothing for so long is gone
PAGE_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'",
}


class ApiServer:
    """The HTTP server and its WebSocket clients."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._numbers = itertools.count(1)
        self._sockets: set[web.WebSocketResponse] = set()
        RosApi(hub).offer()

    def application(self) -> web.Application:
        """Everything that is served."""
        app = web.Application(middlewares=[explain_errors], client_max_size=MAX_MESSAGE_BYTES)
        app.add_routes([web.get("/", self._root), *Rest(self._hub).routes()])
        app.router.add_static("/web", str(files("hostlink.api") / "web"))
        app.on_shutdown.append(self._close_sockets)
        return app

    async def _root(self, request: web.Request) -> web.StreamResponse:
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return await self._serve_client(request)
        page = (files("hostlink.api") / "web" / "index.html").read_bytes()
        return web.Response(body=page, content_type="text/html", charset="utf-8", headers=PAGE_HEADERS)

    async def _serve_client(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(heartbeat=PING_INTERVAL_S, max_msg_size=MAX_MESSAGE_BYTES, compress=False)
        await socket.prepare(request)
        self._sockets.add(socket)
        name = f"client {next(self._numbers)}"
        queue = ClientQueue()
        with bound_contextvars(client=name, peer=request.remote):
            log.info("client.connected")
            try:
                await self._talk(socket, name, queue)
            except* OSError as broken:
                log.debug("client.broken", reason=str(broken.exceptions[0]))
            finally:
                self._sockets.discard(socket)
                log.info("client.closed", code=socket.close_code, dropped=queue.dropped)
        return socket

    async def _talk(self, socket: web.WebSocketResponse, name: str, queue: ClientQueue) -> None:
        async with asyncio.TaskGroup() as tasks:
            client = RosbridgeClient(name, self._hub, queue, spawn=tasks.create_task)
            sender = tasks.create_task(_send(socket, client, queue), name=f"{name} sender")
            try:
                async for message in socket:
                    if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                        client.receive(message.data)
                        await client.settle()
            finally:
                client.close()
                sender.cancel()

    async def _close_sockets(self, _: web.Application) -> None:
        for socket in list(self._sockets):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                    await socket.close(code=WSCloseCode.GOING_AWAY, message=b"hostlink stops")


async def _send(socket: web.WebSocketResponse, client: RosbridgeClient, queue: ClientQueue) -> None:
    """Send what is queued; a client that cannot keep up with its answers is told, and closed."""
    loop = asyncio.get_running_loop()
    while True:
        due_s = client.flush(loop.time())
        while (outgoing := queue.take()) is not None:
            async with asyncio.timeout(SEND_TIMEOUT_S):
                if outgoing.is_binary:
                    await socket.send_bytes(outgoing.data)
                else:
                    await socket.send_str(outgoing.data.decode())
        if queue.is_too_slow:
            log.warning("client.too_slow", dropped=queue.dropped)
            await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"too slow: answers pile up")
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(due_s):
                await queue.wait()


@contextlib.asynccontextmanager
async def serve_api(config: ApiConfig, hub: Hub) -> AsyncIterator[str]:
    """Serve until the block is left; yields the address as a URL. ConfigError when the port is taken."""
    runner = web.AppRunner(
        ApiServer(hub).application(), access_log=None, handle_signals=False, shutdown_timeout=SHUTDOWN_TIMEOUT_S
    )
    await runner.setup()
    try:
        site = web.TCPSite(runner, config.host, config.port)
        try:
            await site.start()
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            problem = (
                "is in use: another hostlink or rosbridge runs; stop it, or choose another port with --api HOST:PORT"
            )
            raise ConfigError(f"API port {config.port}", problem) from error
        host, port = runner.addresses[0][:2]
        yield f"http://{host}:{port}"
    finally:
        await runner.cleanup()
