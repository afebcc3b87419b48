"""A master and a node of ROS in the test's own process, as scripts: they do what the test calls, right or wrong."""

import asyncio
import contextlib
import io
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

import aiohttp
from aiohttp import web

from hostlink.components.ros1.tcpros import MessageStream, decode_header, encode_header, encode_message
from hostlink.components.ros1.xml_rpc import decode_call, encode_answer, encode_call
from hostlink.core.messages.catalog import Catalog
from tests.support.tcp_server import end_accepting, http_server, tcp_server
from tests.support.waiting import TIMEOUT_S, expect

CATALOG = Catalog()
Answers = Callable[[str, tuple[Any, ...]], tuple[int, str, object]]


@contextlib.asynccontextmanager
async def xml_rpc_server(
    answer: Callable[[str, tuple[Any, ...]], bytes], *, encoding: str = "identity"
) -> AsyncIterator[str]:
    """Answers calls; its address."""

    async def receive(request: web.Request) -> web.Response:
        body = answer(*decode_call(await request.read()))
        return web.Response(body=body, content_type="text/xml", headers={"Content-Encoding": encoding})

    app = web.Application()
    app.router.add_post("/{path:.*}", receive)
    async with http_server(app) as url:
        yield f"{url}/"


@dataclass
class FakeMaster:
    """Master with its registrations by kind and name; the answers may be replaced."""

    url: str = ""
    registered: dict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))  # kind: name: address
    publishers: dict[str, list[str]] = field(default_factory=dict)  # others', by topic
    services: dict[str, str] = field(default_factory=dict)  # others', by name: rosrpc://
    parameters: dict[str, Any] = field(default_factory=dict)
    node_uri: str | None = None  # of the daemon, as the master has it
    other_uri: str | None = None  # of another node that has this one's name
    garbled: bytes | None = None  # instead of every answer
    calls: list[tuple[str, tuple[Any, ...]]] = field(default_factory=list)

    def answer(self, method: str, arguments: tuple[Any, ...]) -> bytes:
        self.calls.append((method, arguments))
        return self.garbled if self.garbled is not None else encode_answer(*self._answer(method, arguments))

    def _answer(self, method: str, arguments: tuple[Any, ...]) -> tuple[int, str, object]:
        for prefix, is_there in (("register", True), ("unregister", False)):
            if method.startswith(prefix):
                return self._register(method.removeprefix(prefix), arguments, is_there=is_there)
        if method == "lookupNode":
            return (1, "", self.node_uri) if self.node_uri else (-1, "unknown node", "")
        if method == "getSystemState":
            own = [[[name, [arguments[0]]] for name in self.registered[kind]] for kind in ("Publisher", "Subscriber")]
            services = [[name, [arguments[0]]] for name in self.registered["Service"]]
            return 1, "", [*own, services + [[name, ["/other"]] for name in self.services]]
        if method == "getParam":
            name = arguments[1]
            return (1, "", self.parameters[name]) if name in self.parameters else (-1, "not set", 0)
        if method == "lookupService":
            found = self.services.get(arguments[1])
            return (1, "", found) if found else (-1, "no provider", "")
        return 1, "", {}

    def _register(self, kind: str, arguments: tuple[Any, ...], *, is_there: bool) -> tuple[int, str, object]:
        name = arguments[1]
        if not is_there:
            self.registered[kind].pop(name, None)
            return 1, "", 1
        self.registered[kind][name] = arguments[2]
        self.node_uri = self.other_uri or arguments[3]
        return 1, "", self.publishers.get(name, []) if kind == "Subscriber" else []

    async def knows(self, kind: str, name: str) -> None:
        await expect(lambda: name in self.registered[kind])

    async def call(
        self, method: str, *arguments: Any, body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> Any:
        """Call the daemon's slave API; the body of the answer."""
        assert self.node_uri is not None
        body = encode_call(method, arguments) if body is None else body
        async with (
            aiohttp.ClientSession(headers=headers) as session,
            session.post(self.node_uri, data=io.BytesIO(body)) as response,
        ):
            return await response.read()


@contextlib.asynccontextmanager
async def fake_master() -> AsyncIterator[FakeMaster]:
    master = FakeMaster()
    async with xml_rpc_server(master.answer) as master.url:
        yield master


class Peer:
    """One end of a TCPROS connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self._stream = MessageStream(1 << 26)
        self._messages: list[bytes] = []

    async def send(self, data: bytes) -> None:
        self.writer.write(data)
        await self.writer.drain()

    async def send_header(self, **fields: str) -> None:
        await self.send(encode_header(fields))

    async def send_message(self, payload: bytes) -> None:
        await self.send(encode_message(payload))

    async def read(self) -> bytes:
        """The next message; EOFError at the end."""
        async with asyncio.timeout(TIMEOUT_S):
            while not self._messages:
                data = await self.reader.read(1 << 16)
                if not data:
                    raise EOFError
                self._messages += self._stream.feed(data)
        return self._messages.pop(0)

    async def read_header(self) -> dict[str, str]:
        return decode_header(await self.read())

    async def is_closed(self) -> bool:
        """Wait until the daemon has closed it."""
        with contextlib.suppress(EOFError, ConnectionError):
            while True:
                await self.read()
        return True

    def close(self) -> None:
        self.writer.transport.abort()


@contextlib.asynccontextmanager
async def connection(address: tuple[str, int], **fields: str) -> AsyncIterator[Peer]:
    """Connect to the daemon's TCPROS port, and send the fields as a header, if there are any."""
    reader, writer = await asyncio.open_connection(*address)
    peer = Peer(reader, writer)
    try:
        if fields:
            await peer.send_header(**fields)
        yield peer
    finally:
        peer.close()


class FakePublisher:
    """A node that publishes one topic: each connection of a subscriber is a Peer, after both headers."""

    def __init__(self, type_name: str, *, is_latched: bool = False, callerid: str = "/fake") -> None:
        type_ = CATALOG.message(type_name)
        assert type_ is not None
        self.header = {
            "callerid": callerid,
            "type": type_.name,
            "md5sum": type_.md5,
            "latching": str(int(is_latched)),
            "message_definition": "",
        }
        self.first: bytes = b""  # sent with the header, as what was latched
        self.uri = ""
        self.requests: list[dict[str, str]] = []
        self.peers: list[Peer] = []
        self.port = 0
        self.is_over = False
        self._open: list[Peer] = []

    def answer(self, method: str, _: tuple[Any, ...]) -> bytes:
        if method == "requestTopic":
            return encode_answer(1, "", ["TCPROS", "127.0.0.1", self.port])
        return encode_answer(-1, "unknown", 0)

    async def connected(self, count: int = 1) -> Peer:
        await expect(lambda: len(self.peers) >= count)
        return self.peers[count - 1]

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = Peer(reader, writer)
        self._open.append(peer)
        if self.is_over:
            peer.close()
        try:
            self.requests.append(await peer.read_header())
            await peer.send(encode_header(self.header) + self.first)
            self.peers.append(peer)
        except (EOFError, ConnectionError):
            peer.close()

    def close(self) -> None:
        """End the present and all later connections."""
        self.is_over = True
        for peer in self._open:
            peer.close()


@contextlib.asynccontextmanager
async def fake_publisher(
    type_name: str, *, is_latched: bool = False, first: bytes | None = None, callerid: str = "/fake"
) -> AsyncIterator[FakePublisher]:
    made = FakePublisher(type_name, is_latched=is_latched, callerid=callerid)
    made.first = b"" if first is None else encode_message(first)
    server = await asyncio.start_server(made.accept, "127.0.0.1", 0)
    made.port = server.sockets[0].getsockname()[1]
    try:
        async with xml_rpc_server(made.answer) as made.uri:
            yield made
    finally:
        await end_accepting(server)
        made.close()


class FakeService:
    """A node that answers every call with the same bytes."""

    def __init__(self, type_name: str, answer: bytes, md5: str | None) -> None:
        type_ = CATALOG.service(type_name)
        assert type_ is not None
        self.header = {"callerid": "/fake", "type": type_name, "md5sum": type_.md5 if md5 is None else md5}
        self.address = ""
        self.headers: list[dict[str, str]] = []
        self._answer = answer

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = Peer(reader, writer)
        try:
            self.headers.append(await peer.read_header())
            await peer.send(encode_header(self.header))
            if "probe" not in self.headers[-1]:
                await peer.read()
                await peer.send(self._answer)
        except (EOFError, ConnectionError):
            peer.close()


@contextlib.asynccontextmanager
async def fake_service(type_name: str, answer: bytes, *, md5: str | None = None) -> AsyncIterator[FakeService]:
    made = FakeService(type_name, answer, md5)
    async with tcp_server(made.accept) as (_, port):
        made.address = f"rosrpc://127.0.0.1:{port}"
        yield made
