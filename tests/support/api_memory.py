"""The whole API server without a socket: bytes of HTTP and WebSocket clients go in and out of transports in memory."""

import asyncio
import contextlib
import json
import tempfile
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

from aiohttp import web

from hostlink.components.gateway.listener import MakeProtocol, PacedReading
from hostlink.components.gateway.server import ApiServer, protocols_of
from hostlink.components.gateway.settings import ApiConfig, GatewaySettings
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.hosts import host_of, recordings_of
from tests.support.memory_hub import running
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT
from tests.support.scripted_device import ScriptedDevice

MASK = b"\x0f\xf0\x55\xaa"


def text_frame(**fields: Any) -> bytes:
    """Encode a WebSocket message, masked as of a client."""
    data = json.dumps(fields).encode()
    masked = bytes(byte ^ MASK[index % 4] for index, byte in enumerate(data))
    head = bytes((0x81, 0x80 | len(data))) if len(data) < 126 else b"\x81\xfe" + len(data).to_bytes(2, "big")
    return head + MASK + masked


class FakeSocket:
    """The socket of a transport, for its options."""

    family = proto = type = 0

    def setsockopt(self, *_: int) -> None:
        """Accept any option."""


class ApiTransport(asyncio.Transport):
    """Transport that keeps what the server writes."""

    def __init__(self, peer: str) -> None:
        super().__init__({"peername": (peer, 40000), "socket": FakeSocket()})
        self.written = bytearray()
        self.has_written = asyncio.Event()
        self.is_closed = self.is_paused = False
        self.on_resumed: Callable[[], None] = lambda: None
        self.protocol: asyncio.BaseProtocol

    def get_protocol(self) -> asyncio.BaseProtocol:
        return self.protocol

    def write(self, data: Any) -> None:
        self.written += data
        self.has_written.set()

    def writelines(self, list_of_data: Any) -> None:
        self.write(b"".join(list_of_data))

    def is_closing(self) -> bool:
        return self.is_closed

    def is_reading(self) -> bool:
        return not self.is_paused

    def pause_reading(self) -> None:
        self.is_paused = True

    def resume_reading(self) -> None:
        self.is_paused = False
        self.on_resumed()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Accept any limits: nothing is buffered."""

    def get_write_buffer_size(self) -> int:
        return 0

    def close(self) -> None:
        if not self.is_closed:
            self.is_closed = True
            asyncio.get_running_loop().call_soon(self._lose)

    def _lose(self) -> None:
        self.protocol.connection_lost(None)

    abort = close


class ApiPeer:
    """One connection to the API."""

    def __init__(self, api: "ApiMemory", peer: str) -> None:
        connection, _ = api.server.listener.connections.enter(peer, asyncio.get_running_loop().time())
        assert connection is not None
        self.transport = ApiTransport(peer)
        self.reading = PacedReading(
            api.make_protocol(),
            api.host,
            api.hub.config.table("api", ApiConfig),
            api.server.listener.connections,
            connection,
        )
        self.transport.protocol = self.reading
        self.transport.on_resumed = self._expect_read
        self.unread = bytearray()  # arrived, and not read yet
        self._is_read_due = False
        self.reading.connection_made(self.transport)

    def send(self, data: bytes) -> None:
        """Let bytes arrive at once. They are read in one turn of the loop each, as far as they fit one read."""
        self.unread += data
        if not self._is_read_due:
            self._read()

    def _expect_read(self) -> None:
        if self.unread and not self._is_read_due:
            self._is_read_due = True
            asyncio.get_running_loop().call_soon(self._read)

    def _read(self) -> None:
        self._is_read_due = False
        if not self.unread or self.transport.is_paused or self.transport.is_closed:
            return
        buffer = self.reading.get_buffer(-1)
        count = min(len(buffer), len(self.unread))
        buffer[:count] = self.unread[:count]
        del self.unread[:count]
        self.reading.buffer_updated(count)
        if not self.transport.is_paused:
            self._expect_read()

    def send_head(self, method: str, path: str, headers: Mapping[str, str]) -> None:
        """Let the head of a request arrive."""
        lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items()), "", ""]
        self.send("\r\n".join(lines).encode())

    def send_text(self, **fields: Any) -> None:
        """Let a WebSocket message arrive."""
        self.send(text_frame(**fields))

    def send_close(self) -> None:
        """Let the frame arrive that ends a WebSocket."""
        code = (1000).to_bytes(2, "big")
        self.send(b"\x88\x82" + MASK + bytes(byte ^ mask for byte, mask in zip(code, MASK, strict=False)))

    def texts(self) -> list[Any]:
        """Return and remove the text messages of the server."""
        found, data = [], bytes(self.transport.written)
        self.transport.written.clear()
        while data:
            size, start = data[1], 2
            if size == 126:
                size, start = int.from_bytes(data[2:4], "big"), 4
            if data[0] == 0x81:
                found.append(json.loads(data[start : start + size]))
            data = data[start + size :]
        return found


class Answer:
    """An HTTP answer."""

    def __init__(self, data: bytes) -> None:
        head, _, self.body = data.partition(b"\r\n\r\n")
        first, *lines = head.decode().split("\r\n")
        self.status = int(first.split()[1]) if first else 0
        self.headers = dict(line.split(": ", 1) for line in lines)


class ApiMemory:
    """A daemon's API server and the device of its robot."""

    def __init__(self, config: Config, folder: Path) -> None:
        config = config.with_tables(
            recording=RecordingConfig(folder=folder, drives=False), black_box=BlackBoxConfig(enabled=False)
        )
        self.hub = Hub(config, CATALOG, reraises=True)
        self.host = host_of(self.hub)
        recordings = recordings_of(self.hub)
        for service in (recordings, recordings.black_box, recordings.drives):
            self.host.offer(service)
        self.server = ApiServer(self.host, GatewaySettings(api=config.table("api", ApiConfig)))
        self.make_protocol: MakeProtocol
        self.device: ScriptedDevice

    async def begin(self) -> None:
        runner = web.AppRunner(self.server.application(), access_log=None, handle_signals=False)
        await runner.setup()
        self.make_protocol = protocols_of(runner)
        self.device = ScriptedDevice(self.hub, robot_topics(ROBOT), address="10.0.0.1")
        await asyncio.sleep(0.5)

    def connect(self, peer: str = "127.0.0.1") -> ApiPeer:
        return ApiPeer(self, peer)

    async def request(self, method: str, path: str, body: bytes = b"", **headers: str) -> Answer:
        """Send a request on a connection of its own and return the answer."""
        peer = self.connect()
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        peer.send_head(method, path, {"Host": "localhost", "Content-Length": str(len(body))} | given)
        if body:
            peer.send(body)
        return await self.answer(peer)

    async def answer(self, peer: ApiPeer, timeout_s: float = 3.0) -> Answer:
        """Wait for the answer on this connection, and close it."""
        async with asyncio.timeout(timeout_s):
            await peer.transport.has_written.wait()
        await asyncio.sleep(0.01)  # the body follows its head
        peer.transport.close()
        return Answer(bytes(peer.transport.written))

    async def web_socket(self, path: str = "/", **headers: str) -> ApiPeer:
        """Open a WebSocket."""
        peer = self.connect()
        upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
        peer.send_head("GET", path, {"Host": "localhost"} | upgrade | key | given)
        await asyncio.sleep(0.05)
        head, _, rest = bytes(peer.transport.written).partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 101 ")
        peer.transport.written[:] = rest
        return peer

    async def move_to(self, x_m: float, y_m: float, theta_rad: float) -> None:
        """Publish a pose of the robot."""
        await self.device.send(ODOMETRY_ID, POSE.pack(x_m, y_m, theta_rad))
        await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def api_memory(folder: Path, config: Config | None = None) -> AsyncIterator[ApiMemory]:
    """A running API server with one robot, for virtual time."""
    made = ApiMemory(Config() if config is None else config, folder)
    async with running(made.hub):
        await made.begin()
        yield made


@contextlib.asynccontextmanager
async def api_in_memory(config: Config | None = None) -> AsyncIterator[ApiMemory]:
    """A running API server whose recordings are in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        async with api_memory(Path(folder), config) as made:
            yield made
