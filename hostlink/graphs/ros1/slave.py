"""SlaveApi: what the master and other nodes call of this one, by XML-RPC."""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Callable
from typing import Any, Protocol

import structlog
from aiohttp import web

from hostlink.forwarding_protocol import ForwardingProtocol
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.port import MakeProtocol
from hostlink.graphs.ros1.xml_rpc import ERROR, SUCCESS, BadXml, decode_call, encode_answer, encode_fault
from hostlink.logs import printable

log = structlog.get_logger()

MAX_BODY_BYTES = 256 * 1024  # a list of a thousand publishers, or the parameters of one node
CALL_S = 0.0005  # what a call costs
MAX_AGE_S = 60.0  # of a connection: who calls again connects again
KEEPALIVE_S = 10.0  # between two calls
END_TIMEOUT_S = 0.3  # for calls that are under way
READ_TIMEOUT_S = 5.0  # for the body of a call

_Answer = tuple[int, str, object]


class Node(Protocol):
    """What of the node others may call."""

    @property
    def master_uri(self) -> str: ...

    @property
    def tcpros_address(self) -> tuple[str, int]: ...

    def publications(self) -> list[list[str]]: ...

    def subscriptions(self) -> list[list[str]]: ...

    def bus_info(self) -> list[list[object]]: ...

    def has_publication(self, topic: str) -> bool: ...

    def update_publishers(self, topic: str, uris: list[str]) -> None: ...

    def update_parameter(self, key: str, value: Any) -> None: ...

    def shut_down(self, reason: str) -> None: ...


class SlaveApi:
    """Answers the calls; a call that is none, or unknown, is counted."""

    def __init__(self, node: Node, parts: Parts) -> None:
        self._node, self._hub, self._counts = node, parts.hub, parts.counts
        self._turns, self._parser = parts.hub.turns(), parts.rpc.parser
        self._methods: dict[str, Callable[..., _Answer]] = {
            "getBusStats": self._bus_stats,
            "getBusInfo": lambda _: (SUCCESS, "bus info", node.bus_info()),
            "getMasterUri": lambda _: (SUCCESS, node.master_uri, node.master_uri),
            "getPid": lambda _: (SUCCESS, "", os.getpid()),
            "getSubscriptions": lambda _: (SUCCESS, "subscriptions", node.subscriptions()),
            "getPublications": lambda _: (SUCCESS, "publications", node.publications()),
            "shutdown": self._shut_down,
            "paramUpdate": self._update_parameter,
            "publisherUpdate": self._update_publishers,
            "requestTopic": self._request_topic,
        }

    async def receive(self, request: web.Request) -> web.Response:
        """Answer a request, in its turn."""
        try:
            async with asyncio.timeout(READ_TIMEOUT_S):
                body = await request.read()
        except TimeoutError:
            return web.Response(status=408)
        await self._turns.wait(CALL_S)
        answer = encode_fault("a fault of hostlink")
        with self._hub.isolation.around("ros1", peer=request.remote):
            answer = await self._answer(body)
        return web.Response(body=answer, content_type="text/xml")

    async def _answer(self, body: bytes) -> bytes:
        try:
            method, arguments = await self._parser.parse(decode_call, body)
            return encode_answer(*self._methods.get(method, _refuse)(*arguments))
        except (BadXml, TypeError) as error:  # of arguments that do not fit
            self._counts.refused_calls += 1
            return encode_fault(str(error))

    def _bus_stats(self, _: object) -> _Answer:
        return SUCCESS, "bus stats", [[], [], []]

    def _shut_down(self, caller: str, reason: str = "") -> _Answer:
        self._node.shut_down(f"{printable(str(caller))}: {printable(str(reason), 200) or 'shutdown'}")
        return SUCCESS, "shutdown", 0

    def _update_parameter(self, _: object, key: str, value: Any) -> _Answer:
        if not isinstance(key, str):
            raise BadXml("a key is a text")
        self._node.update_parameter(key, value)
        return SUCCESS, "", 0

    def _update_publishers(self, _: object, topic: str, uris: list[str]) -> _Answer:
        if not isinstance(topic, str) or not isinstance(uris, list) or not all(isinstance(uri, str) for uri in uris):
            raise BadXml("a topic and a list of addresses")
        self._node.update_publishers(topic, uris)
        return SUCCESS, "", 0

    def _request_topic(self, _: object, topic: str, protocols: list[list[object]]) -> _Answer:
        if not isinstance(topic, str) or not self._node.has_publication(topic):
            return ERROR, f"not a publisher of {printable(str(topic))}", 0
        if not any(isinstance(each, list) and each and each[0] == "TCPROS" for each in protocols):
            return 0, "no supported protocol implementations", []
        host, port = self._node.tcpros_address
        return SUCCESS, f"ready on {host}:{port}", ["TCPROS", host, port]


@contextlib.asynccontextmanager
async def serving_slave_api(node: Node, parts: Parts) -> AsyncIterator[MakeProtocol]:
    """What makes the protocol of a connection, for the length of the block."""
    application = web.Application(client_max_size=MAX_BODY_BYTES)
    application.router.add_post("/{path:.*}", SlaveApi(node, parts).receive)
    runner = web.AppRunner(
        application,
        access_log=None,
        keepalive_timeout=KEEPALIVE_S,
        shutdown_timeout=END_TIMEOUT_S,
        auto_decompress=False,  # a kilobyte of a body is at most a kilobyte
    )
    await runner.setup()
    server = runner.server
    try:
        if server is not None:  # as it is after `setup`
            yield lambda: _Aged(server())
    finally:
        await runner.cleanup()


def _refuse(*_: object) -> _Answer:
    raise BadXml("no such method")


class _Aged(ForwardingProtocol):
    """A connection that is closed after a while: whoever only connects keeps no place."""

    is_replaceable = True  # a call is over within milliseconds, and who calls again connects again

    def __init__(self, inner: asyncio.Protocol) -> None:
        super().__init__(inner)
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._timer = asyncio.get_running_loop().call_later(MAX_AGE_S, transport.close)
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
