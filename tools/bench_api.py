"""`make bench`, second part: cost of a device's frame for many programs, compared with a bare aiohttp server.

The daemon and the yardstick each run in a process of their own, one after the other; this process is the device and
all the clients. Clients here take WebSocket frames off their sockets without decoding them, so that the server is
what is measured. Writes build/bench_api.json and prints a table; docs/performance.md holds a copy of a run.
"""

import asyncio
import base64
import contextlib
import json
import os
import re
import statistics
import struct
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from tools.bench import Row, memory_mib, p99, parser, report

POSE_MD5 = "938fa65709584ad8e77d238529be13b8"
IMAGE_MD5 = "82373f1612381bb6ee473b5cd6f5d89c"  # std_msgs/UInt8MultiArray
POSE = struct.Struct("<3d")
READ_BYTES = 1 << 16
BURST = 256  # a quarter of what a client's queue holds: nothing is dropped
SETTLE_S = 0.3
REPEATS = 5
RATE_HZ = 100
IMAGE_BYTES = 400
PING, PONG = 0x89, 0x8A
TIME = encode(Id.TIME, bytes(8))
TIME_INTERVAL_S = 2.5  # a device that requests no time for 11 s is ended
PROBE_S = 0.5

# A server that does nothing but pass a frame of a fixed size on to everybody, as aiohttp does it by itself.
YARDSTICK = """
import asyncio, sys
from aiohttp import web
FRAME = int(sys.argv[1]); sockets = set()
async def root(request):
    socket = web.WebSocketResponse(compress=False); await socket.prepare(request); sockets.add(socket)
    async for _ in socket: pass
    return socket
async def device(reader, writer):
    while True:
        frame = await reader.readexactly(FRAME)
        for socket in sockets: await socket.send_bytes(frame)
async def main():
    app = web.Application(); app.router.add_get('/', root)
    runner = web.AppRunner(app, access_log=None); await runner.setup()
    site = web.TCPSite(runner, '127.0.0.1', 0); await site.start()
    server = await asyncio.start_server(device, '127.0.0.1', 0)
    print('{"tcp": "127.0.0.1:%d", "api": "http://127.0.0.1:%d", "event": "daemon.started"}'
          % (server.sockets[0].getsockname()[1], runner.addresses[0][1]), file=sys.stderr, flush=True)
    await asyncio.Event().wait()
asyncio.run(main())
"""


def main() -> int:
    arguments = parser(__doc__, "api")
    arguments.add_argument("--loop", default="auto", help="event loop of the daemon: auto, asyncio or uvloop")
    chosen = arguments.parse_args()
    return report(asyncio.run(measure(chosen.share, chosen.loop)), chosen.out)


# -- a server in a process of its own ---------------------------------------------------------------------------------


class Server:
    """A daemon, or the yardstick."""

    def __init__(self, process: asyncio.subprocess.Process, device: tuple[str, int], api: tuple[str, int]) -> None:
        self.process, self.device, self.api = process, device, api

    def memory_kib(self) -> float:
        return 1024 * memory_mib(self.process.pid)


@contextlib.asynccontextmanager
async def server(*command: str) -> AsyncIterator[Server]:
    """Started with this command of Python's, and killed at the end."""
    process = await asyncio.create_subprocess_exec(sys.executable, *command, stderr=asyncio.subprocess.PIPE)
    log = process.stderr
    if log is None:
        raise AssertionError("a pipe was asked for")

    async def drain() -> None:
        while await log.readline():
            continue

    try:
        started: dict[str, Any] = {}
        while started.get("event") != "daemon.started":
            started = json.loads(await log.readline())
        async with asyncio.TaskGroup() as tasks:
            draining = tasks.create_task(drain())
            yield Server(process, _address(started["tcp"]), _address(started["api"]))
            draining.cancel()
    finally:
        process.kill()
        await process.wait()


def daemon(loop: str) -> contextlib.AbstractAsyncContextManager[Server]:
    serve = "import sys; from hostlink.cli.main import main; sys.argv[0] = 'hostlink'; main()"
    return server("-c", serve, "serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", "--loop", loop)


def yardstick(frame_bytes: int) -> contextlib.AbstractAsyncContextManager[Server]:
    return server("-c", YARDSTICK, str(frame_bytes))


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.removeprefix("http://").rpartition(":")
    return host, int(port)


# -- the device and the clients ---------------------------------------------------------------------------------------


class Client(asyncio.Protocol):
    """A WebSocket client that counts frames, and looks into them only if it is asked to."""

    def __init__(self) -> None:
        self.count = 0
        self.frame_bytes = 0  # of the last one
        self.wanted = 0
        self.done = asyncio.Event()
        self.on_frame: Callable[[bytes], None] | None = None
        self.transport: asyncio.Transport | None = None
        self._buffer = bytearray()
        self._is_open = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if not isinstance(transport, asyncio.Transport):
            raise TypeError
        self.transport = transport
        key = base64.b64encode(os.urandom(16)).decode()
        head = ("GET / HTTP/1.1", "Host: 127.0.0.1", "Upgrade: websocket", "Connection: Upgrade")
        more = (f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", "")
        transport.write("\r\n".join((*head, *more)).encode())

    def send(self, **request: Any) -> None:
        """One text frame, masked with zeros."""
        body = json.dumps(request).encode()
        if self.transport is None:
            raise AssertionError("not connected")
        self.transport.write(b"\x81" + bytes([0xFE]) + struct.pack(">H", len(body)) + bytes(4) + body)

    def expect(self, count: int) -> None:
        self.wanted = self.count + count
        self.done.clear()

    def data_received(self, data: bytes) -> None:
        buffer = self._buffer
        buffer += data
        if not self._is_open:
            end = buffer.find(b"\r\n\r\n")
            if end < 0:
                return
            if not buffer.startswith(b"HTTP/1.1 101"):
                raise AssertionError(bytes(buffer))
            del buffer[: end + 4]
            self._is_open = True
        at = 0
        while (end := _frame_end(buffer, at)) <= len(buffer):
            if buffer[at] == PING:
                self._answer(bytes(buffer[at + 2 : end]))
                at = end
                continue
            self.count += 1
            self.frame_bytes = end - at
            if self.on_frame is not None:
                self.on_frame(bytes(buffer[at:end]))
            at = end
        del buffer[:at]
        if self.wanted and self.count >= self.wanted:
            self.done.set()

    def _answer(self, ping: bytes) -> None:
        """Send a pong. The daemon closes a client that answers none for 15 s, as long as a run on a busy machine."""
        if self.transport is not None:
            self.transport.write(bytes((PONG, 0x80 | len(ping))) + bytes(4) + ping)


def _frame_end(buffer: bytearray, at: int) -> int:
    """Return the end of the frame that begins at `at`; beyond the buffer while its length is unknown."""
    if len(buffer) < at + 10:
        return at + 2 + buffer[at + 1] if len(buffer) > at + 1 and buffer[at + 1] < 126 else len(buffer) + 1
    size = buffer[at + 1]
    if size < 126:
        return at + 2 + size
    if size == 126:
        return int(at + 4 + struct.unpack_from(">H", buffer, at + 2)[0])
    return int(at + 10 + struct.unpack_from(">Q", buffer, at + 2)[0])


@contextlib.asynccontextmanager
async def clients(to: Server, count: int, compression: str = "none") -> AsyncIterator[list[Client]]:
    """So many, subscribed to the device's poses."""
    loop = asyncio.get_running_loop()
    found = [(await loop.create_connection(Client, *to.api))[1] for _ in range(count)]
    for client in found:
        client.send(op="subscribe", topic="/bench", compression=compression)
    await asyncio.sleep(SETTLE_S)
    try:
        yield found
    finally:
        for client in found:
            if client.transport is not None:
                client.transport.abort()
        await asyncio.sleep(SETTLE_S)


@contextlib.asynccontextmanager
async def device(to: Server) -> AsyncIterator[asyncio.StreamWriter]:
    """A device with poses and images."""
    _, writer = await asyncio.open_connection(*to.device)
    infos = (
        DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/bench", "geometry_msgs/Pose2D", POSE_MD5, 512),
        DeviceEndpoint(EndpointKind.PUBLISHER, 126, "/image", "std_msgs/UInt8MultiArray", IMAGE_MD5, 512),
    )
    hello = b"".join(encode(info.kind, encode_topic_info(info)) for info in infos)
    writer.write(TIME + hello + TIME)
    try:
        async with asyncio.TaskGroup() as tasks:
            asking = tasks.create_task(_ask_for_time(writer))
            yield writer
            asking.cancel()
    finally:
        writer.close()


async def _ask_for_time(writer: asyncio.StreamWriter) -> None:
    while True:
        await asyncio.sleep(TIME_INTERVAL_S)
        writer.write(TIME)


async def heard(writer: asyncio.StreamWriter, wire: bytes, found: list[Client]) -> None:
    """Send a frame until every client has received one, and all that was sent has arrived."""
    async with asyncio.timeout(60):
        while not all(client.count for client in found):
            writer.write(wire)
            await asyncio.sleep(PROBE_S)
        counts: list[int] = []
        while counts != (counts := [client.count for client in found]):  # noqa: ASYNC110 - until all has arrived
            await asyncio.sleep(PROBE_S)


# -- what is measured -------------------------------------------------------------------------------------------------

SendTime = Callable[[float], bytes]  # the wire of one frame that carries a time
ReadTime = Callable[[bytes], float]  # the time in what arrived of it


def pose_of(time_s: float) -> bytes:
    return encode(125, POSE.pack(time_s, 2.0, 0.5))


def time_in_json(frame: bytes) -> float:
    return float(re.findall(rb'"x":([0-9.e+-]+)', frame)[0])


def time_in_cbor_raw(frame: bytes) -> float:
    return float(POSE.unpack(frame[-POSE.size :])[0])


READERS: dict[str, ReadTime] = {"none": time_in_json, "cbor-raw": time_in_cbor_raw}


async def throughput(writer: asyncio.StreamWriter, wire: bytes, found: list[Client], bursts: int) -> float:
    """Messages a second to all clients together, the best of some runs; a burst begins when the last is everywhere."""
    rates = []
    async with asyncio.timeout(120):
        for _ in range(REPEATS):
            began = time.perf_counter()
            for _ in range(bursts):
                for client in found:
                    client.expect(BURST)
                writer.write(wire * BURST)
                for client in found:
                    await client.done.wait()
            rates.append(bursts * BURST * len(found) / (time.perf_counter() - began))
    return max(rates)


async def latencies(
    writer: asyncio.StreamWriter, make: SendTime, read: ReadTime, found: list[Client], count: int
) -> list[float]:
    """From the device's write to the arrival at each client, at RATE_HZ, in seconds."""
    times: list[float] = []
    for client in found:
        client.on_frame = lambda frame: times.append(time.perf_counter() - read(frame))
    for _ in range(count):
        writer.write(make(time.perf_counter()))
        await asyncio.sleep(1 / RATE_HZ)
    await asyncio.sleep(SETTLE_S)
    for client in found:
        client.on_frame = None
    return times


async def measure(scale: float, loop: str) -> list[Row]:
    rows = []
    for compression, name in (("none", "JSON"), ("cbor-raw", "cbor-raw")):
        for count in (1, 10, 100):
            rows += await fan_out(compression, name, count, scale, loop)
    rows += [*await memory(loop), *await beside_a_stuck_client(scale, loop)]
    return [*rows, await beside_a_flood_to_many(scale, loop)]


async def fan_out(compression: str, name: str, count: int, scale: float, loop: str) -> list[Row]:
    """One device to so many clients, and the same of the yardstick."""
    bursts, samples = max(1, int(scale * 12 / count**0.5)), max(20, int(scale * 200))
    async with daemon(loop) as host, device(host) as writer, clients(host, count, compression) as found:
        await heard(writer, pose_of(1.5), found)
        rate = await throughput(writer, pose_of(1.5), found, bursts)
        times = await latencies(writer, pose_of, READERS[compression], found, samples)
        frame_bytes = found[0].frame_bytes - 2
    async with yardstick(frame_bytes) as bare, clients(bare, count) as found:
        _, writer = await asyncio.open_connection(*bare.device)
        await heard(writer, bytes(frame_bytes), found)
        bare_rate = await throughput(writer, bytes(frame_bytes), found, bursts)
        rest = bytes(frame_bytes - 8)
        bare_times = await latencies(
            writer, lambda time_s: struct.pack("<d", time_s) + rest, _time_in_bare, found, samples
        )
        writer.close()
    what, of_bare = f"a Pose2D to {count} client(s) as {name}", "of a bare aiohttp server"
    median, bare_median = statistics.median(times), statistics.median(bare_times)
    return [
        Row(f"{what}, to all", rate, "msg/s", of_bare, rate / bare_rate, at_least=0.2),
        Row(f"{what}, {RATE_HZ} Hz, median", median * 1000, "ms", of_bare, median / bare_median, at_most=4.0),
        Row(f"{what}, p99", p99(times) * 1000, "ms", of_bare, p99(times) / p99(bare_times)),
    ]


def _time_in_bare(frame: bytes) -> float:
    return float(struct.unpack_from("<d", frame, 4 if frame[1] == 126 else 2)[0])


async def memory(loop: str) -> list[Row]:
    """Measure the cost of one of a hundred listening clients."""
    async with daemon(loop) as host, device(host):
        async with clients(host, 10):
            few = host.memory_kib()
        async with clients(host, 100):
            many = host.memory_kib()
    return [Row("memory of the daemon, a client that is subscribed", (many - few) / 90, "KiB", at_most=100.0)]


async def beside_a_stuck_client(scale: float, loop: str) -> list[Row]:
    """A good client's latency while a device floods images to another, which reads them, or does not."""
    samples = max(50, int(scale * 500))
    found: dict[bool, list[float]] = {}
    for is_stuck in (False, True):
        async with daemon(loop) as host, device(host) as writer, clients(host, 1) as good, clients(host, 1) as other:
            other[0].send(op="subscribe", topic="/image")
            if is_stuck and other[0].transport is not None:
                other[0].transport.pause_reading()

            def pose_and_images(time_s: float, *, image: bytes = encode(126, _image()) * 20) -> bytes:
                return image + pose_of(time_s)

            found[is_stuck] = await latencies(writer, pose_and_images, time_in_json, good, samples)
    reads, stuck = p99(found[False]), p99(found[True])
    what = "a good client beside one that"
    return [
        Row(f"{what} reads 2,000 images a second, p99", reads * 1000, "ms"),
        Row(f"{what} is stuck, p99", stuck * 1000, "ms", "of that beside the reader", stuck / reads, at_most=4.0),
    ]


async def beside_a_flood_to_many(scale: float, loop: str) -> Row:
    """Measure the duration of an HTTP request, such as a stop, while a device floods a hundred clients."""
    seconds = max(1.0, 8.0 * scale)
    async with daemon(loop) as host, device(host) as writer, clients(host, 100):
        alone = await requests(host, seconds / 4)
        async with asyncio.TaskGroup() as tasks:
            flooding = tasks.create_task(flood(writer))
            beside = await requests(host, seconds)
            flooding.cancel()
    median = statistics.median(beside)
    alone_s = statistics.median(alone)
    what = "GET /healthz beside a flood to 100 clients, median"
    return Row(what, median * 1000, "ms", "of one without the flood", median / alone_s, at_most=50.0)


async def flood(writer: asyncio.StreamWriter) -> None:
    while True:
        writer.write(pose_of(1.5) * BURST)
        await writer.drain()
        await asyncio.sleep(0.1)  # more than the daemon passes on meanwhile, and the clients here can read


async def requests(to: Server, seconds: float) -> list[float]:
    """GET /healthz each 20 ms, and how long each took, in seconds."""
    reader, writer = await asyncio.open_connection(*to.api)
    times: list[float] = []
    end_s = time.perf_counter() + seconds
    while (began_s := time.perf_counter()) < end_s:
        writer.write(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        head = await reader.readuntil(b"\r\n\r\n")
        await reader.readexactly(int(re.findall(rb"Content-Length: (\d+)", head)[0]))
        times.append(time.perf_counter() - began_s)
        await asyncio.sleep(0.02)
    writer.close()
    return times


def _image() -> bytes:
    """A std_msgs/UInt8MultiArray without dimensions."""
    return bytes(8) + struct.pack("<I", IMAGE_BYTES) + bytes(IMAGE_BYTES)


if __name__ == "__main__":
    sys.exit(main())
