"""`make bench`: how fast bytes become messages, each figure as a ratio to a yardstick of the same run.

Writes build/bench_link.json and prints a table; docs/performance.md holds a copy of a run.
"""

import asyncio
import contextlib
import statistics
import struct
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from hostlink.cli.serve import running
from hostlink.cli.serve_command import loop_factory
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config, TcpConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import HEADER, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.runtime import logs
from hostlink.errors import UnknownTopic
from tools.bench import Row, p99, parser, report

POSE_MD5 = "938fa65709584ad8e77d238529be13b8"
TWIST_MD5 = "9f195f881246fdfa2798d1d3eebca84a"
PAYLOAD = struct.pack("<3d", 1.0, 2.0, 0.5)  # 24 bytes, as a Pose2D
STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
LONG_BYTES = (200, 1024)  # of payload: as an Odometry or a scan
READ_BYTES = 65536
REPEATS = 5


def main() -> int:
    arguments = parser(__doc__, "link")
    arguments.add_argument("--loop", default="auto", help="event loop of the daemon: auto, asyncio or uvloop")
    chosen = arguments.parse_args()
    logs.configure(level="error")
    frames = round(200_000 * chosen.share)
    with asyncio.Runner(loop_factory=loop_factory(chosen.loop)) as runner:
        rows = [*parser_rows(frames), *runner.run(daemon_rows(frames))]
    return report(rows, chosen.out)


# -- the parser -------------------------------------------------------------------------------------------------------


def parser_rows(frames: int) -> Iterator[Row]:
    frame = encode(125, PAYLOAD)
    for cut, name, count, bound in (
        (READ_BYTES, "64 KiB reads", frames, 0.4),
        (len(frame), "single frames", frames, 0.2),
        (1, "single bytes", frames // 20, None),
    ):
        wire = frame * count
        reads = pieces(wire, cut)
        parsed = best(lambda reads=reads, count=count: parse(reads, count))
        least = best(lambda wire=wire, count=count: walk(wire, len(frame), count))
        yield Row(
            f"parser, 24-byte payloads in {name}", count / parsed, "frames/s",
            "of a loop that checks sums alone", least / parsed, at_least=bound,
        )  # fmt: skip


def pieces(data: bytes, size: int) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]


def parse(reads: list[bytes], count: int) -> None:
    stream = FrameStream()
    found = sum(1 for read in reads for _ in stream.feed(read))
    if found != count:
        raise AssertionError(f"{found} frames of {count}")


def walk(wire: bytes, size: int, count: int) -> None:
    """Do the least for each frame: read its header, copy its payload, and compare both sums."""
    found = 0
    for at in range(0, len(wire), size):
        _, length, length_check, topic_id = HEADER.unpack_from(wire, at)
        payload = wire[at + HEADER.size : at + size - 1]
        is_whole = length_check == ~(length + (length >> 8)) & 0xFF
        found += is_whole and wire[at + size - 1] == ~(topic_id + (topic_id >> 8) + sum(payload)) & 0xFF
    if found != count:
        raise AssertionError(f"{found} frames of {count}")


def best(work: Callable[[], None]) -> float:
    """The shortest CPU time of some runs, in seconds: what the machine can do when nothing else wants it."""
    times = []
    for _ in range(REPEATS):
        began_s = time.process_time()
        work()
        times.append(time.process_time() - began_s)
    return min(times)


# -- the daemon -------------------------------------------------------------------------------------------------------


async def daemon_rows(frames: int) -> list[Row]:
    """Floods run from a process of their own, so that the daemon has a core for itself."""
    rows = []
    config = Config(tcp=TcpConfig(host="127.0.0.1", port=0)).with_tables(api=ApiConfig(port=0))
    async with running(config) as (hub, addresses):
        host, port = addresses.tcp
        received, ratio = await hub_flood(hub, host, port, PAYLOAD, frames)
        rows.append(hub_row("24", received, ratio, at_least=0.0015))
        for size in LONG_BYTES:
            payload = struct.pack("<I", size - 4) + bytes(number % 251 for number in range(size - 4))
            rate, ratio = await hub_flood(hub, host, port, payload, frames // 4)
            rows.append(hub_row(f"{size:,}", rate, ratio))
        for clients in (1, 10):
            sent = await websocket_flood(hub, addresses.api, host, port, frames // 10, clients)
            what = f"TCP to {clients} WebSocket client(s) as JSON, to all of them"
            rows.append(Row(what, sent, "msg/s", "of the hub's rate", sent / received))
        latencies = await to_device(hub, addresses.api, host, port)
        echo = await echo_latency()
    yardstick = "times a raw asyncio echo at 100 Hz"
    return [
        *rows,
        Row("program (WebSocket) to device at 100 Hz, median", statistics.median(latencies) * 1000, "ms", yardstick,
            statistics.median(latencies) / echo, at_most=8.0),
        Row("program (WebSocket) to device at 100 Hz, p99", p99(latencies) * 1000, "ms", yardstick,
            p99(latencies) / echo),
    ]  # fmt: skip


def hub_row(size: str, rate: float, ratio: float, *, at_least: float | None = None) -> Row:
    what = f"TCP to a subscriber of the hub, flood of {size}-byte payloads"
    return Row(what, rate, "frames/s", "of asyncio reading and doing nothing", ratio, at_least=at_least)


FLOOD = """
import socket, sys
wire = bytes.fromhex(sys.argv[3]) * 512
link = socket.create_connection((sys.argv[1], int(sys.argv[2])))
link.sendall(bytes.fromhex(sys.argv[4]))
sys.stdin.read(1)
for _ in range(int(sys.argv[5]) // 512): link.sendall(wire)
sys.stdin.read(1)
"""


@contextlib.asynccontextmanager
async def flooding(
    host: str, port: int, topic: str, frames: int, payload: bytes = PAYLOAD
) -> AsyncIterator[Callable[[], Awaitable[None]]]:
    """A device in another process that announces a topic and, when told, sends it as fast as TCP takes it."""
    type_name, md5 = ("geometry_msgs/Pose2D", POSE_MD5) if payload is PAYLOAD else ("std_msgs/String", STRING_MD5)
    info = DeviceEndpoint(EndpointKind.PUBLISHER, 125, topic, type_name, md5, max(512, len(payload) + 8))
    hello = encode(Id.TIME, bytes(8)) + encode(Id.PUBLISHER, encode_topic_info(info)) + encode(Id.TIME, bytes(8))
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", FLOOD, host, str(port), encode(125, payload).hex(), hello.hex(), str(frames),
        stdin=asyncio.subprocess.PIPE,
    )  # fmt: skip
    stdin = process.stdin
    if stdin is None:
        raise AssertionError("a pipe was asked for")

    async def go() -> None:
        stdin.write(b"g")
        await stdin.drain()

    try:
        yield go
    finally:
        stdin.close()
        await process.wait()


async def raw_tcp(payload: bytes, frames: int) -> float:
    """Frames a second that a bare asyncio reader takes off the same flood: the yardstick."""
    wanted = frames // 512 * 512 * (len(payload) + 8)
    done: asyncio.Future[float] = asyncio.get_running_loop().create_future()

    async def read(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        got, began = 0, 0.0
        while data := await reader.read(READ_BYTES):
            began = began or time.perf_counter()
            got += len(data)
            if got >= wanted and not done.done():
                done.set_result(frames / (time.perf_counter() - began))
        writer.close()

    server = await asyncio.start_server(read, "127.0.0.1", 0)
    async with server, flooding(*server.sockets[0].getsockname()[:2], "/raw", frames, payload) as go:
        await go()
        return await done


async def hub_flood(hub: Hub, host: str, port: int, payload: bytes, frames: int) -> tuple[float, float]:
    """Frames a second, the best of some runs; and the median of their ratios to a bare reader right before each."""
    runs = []
    for number in range(REPEATS):
        raw = await raw_tcp(payload, frames)
        rate = await hub_flood_once(hub, host, port, payload, frames, f"/flood_{len(payload)}_{number}")
        runs.append((rate, rate / raw))
    return max(rate for rate, _ in runs), statistics.median(ratio for _, ratio in runs)


async def hub_flood_once(hub: Hub, host: str, port: int, payload: bytes, frames: int, topic: str) -> float:
    wanted = frames // 512 * 512
    done = asyncio.Event()
    times = [0.0, 0.0]
    count = 0

    def deliver(_: Any) -> None:
        nonlocal count
        count += 1
        if count == 1:
            times[0] = time.perf_counter()
        if count == wanted:
            times[1] = time.perf_counter()
            done.set()

    participant = hub.join("bench")
    participant.subscribe(topic, deliver)
    async with flooding(host, port, topic, frames, payload) as go:
        await until(lambda: is_ready(hub, topic))
        await go()
        async with asyncio.timeout(60):
            await done.wait()
    participant.leave()
    return wanted / (times[1] - times[0])


async def until(is_right: Callable[[], bool]) -> None:
    """Wait for a state of the hub. On a busy machine a fixed time would not do."""
    async with asyncio.timeout(60):
        while not is_right():  # noqa: ASYNC110 - the hub has no event for it
            await asyncio.sleep(0.01)


def is_ready(hub: Hub, name: str, *, subscribers: int = 0) -> bool:
    """Whether a device has announced the topic, and so many clients have subscribed."""
    try:
        found = hub.topics.find(name)
    except UnknownTopic:
        return False
    return (found.has_device_publisher or bool(found.devices)) and len(found.subscribers) >= subscribers


async def websocket_flood(hub: Hub, api: str, host: str, port: int, frames: int, clients: int) -> float:
    """Messages a second that reach all clients; what is dropped on the way does not count."""
    async with aiohttp.ClientSession() as session, flooding(host, port, "/flood", frames) as go:
        sockets = [await session.ws_connect(api) for _ in range(clients)]
        for socket in sockets:
            await socket.send_json({"op": "subscribe", "topic": "/flood"})
        await until(lambda: is_ready(hub, "/flood", subscribers=clients))
        began = time.perf_counter()
        await go()
        counts = [0] * clients

        async def count(number: int) -> None:
            with contextlib.suppress(TimeoutError):
                while True:
                    async with asyncio.timeout(1.0):
                        await sockets[number].receive()
                    counts[number] += 1
                    ends[number] = time.perf_counter()

        ends = [began] * clients
        async with asyncio.TaskGroup() as tasks:
            for number in range(clients):
                tasks.create_task(count(number))
        for socket in sockets:
            await socket.close()
    return sum(counts) / (max(ends) - began)


async def to_device(hub: Hub, api: str, host: str, port: int) -> list[float]:
    """From a client's send to the device's read, a hundred times a second."""
    reader, writer = await asyncio.open_connection(host, port)
    info = DeviceEndpoint(EndpointKind.SUBSCRIBER, 100, "/bench_in", "geometry_msgs/Twist", TWIST_MD5, 512)
    writer.write(encode(Id.TIME, bytes(8)) + encode(Id.SUBSCRIBER, encode_topic_info(info)) + encode(Id.TIME, bytes(8)))
    latencies = []
    async with aiohttp.ClientSession() as session, session.ws_connect(api) as socket:
        await until(lambda: is_ready(hub, "/bench_in"))
        stream = FrameStream()
        async with asyncio.timeout(60):
            for number in range(200):
                await asyncio.sleep(0.01)
                began = time.perf_counter()
                message = {"linear": {"x": float(number + 1)}}
                await socket.send_json(
                    {"op": "publish", "topic": "/bench_in", "type": "geometry_msgs/Twist", "msg": message}
                )
                while not any(getattr(item, "topic_id", 0) == 100 for item in stream.feed(await reader.read(4096))):
                    continue
                latencies.append(time.perf_counter() - began)
    writer.close()
    await writer.wait_closed()
    return latencies


async def echo_latency() -> float:
    """Median of a raw asyncio echo over TCP at 100 Hz: the yardstick of the latencies."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(READ_BYTES):
            writer.write(data)
        writer.close()

    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    async with server:
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
        times = []
        for _ in range(100):
            await asyncio.sleep(0.01)
            began = time.perf_counter()
            writer.write(PAYLOAD)
            await reader.read(READ_BYTES)
            times.append(time.perf_counter() - began)
        writer.close()
        await writer.wait_closed()
    return statistics.median(times)


if __name__ == "__main__":
    sys.exit(main())
