"""Crowds for a daemon on this machine, in a process of their own: many devices, visitors that vanish, connections that
say nothing.

    python tools/crowd.py devices 1000 HOST:PORT SECONDS     # each with 10 poses a second, and driven if anybody drives
    python tools/crowd.py fleet 30 HOST:PORT SECONDS         # the same, each with 10 voltages a second, too
    python tools/crowd.py vanish 200 HOST:PORT SECONDS       # so many a second connect, and reset at once
    python tools/crowd.py silent 10000 HOST:PORT SECONDS     # so many connections, kept open as long as the host does
    python tools/crowd.py flood 1 HOST:PORT SECONDS          # so many devices that publish poses as fast as they can
    python tools/crowd.py mixed 16 HOST:PORT SECONDS         # the same, each with frames of another kind
    python tools/crowd.py steady 10 HOST:PORT SECONDS        # so many devices, each with 1,000 poses a second
    python tools/crowd.py boards 1000 HOST:PORT SECONDS      # so many micro-ROS boards, each with 1 message a second

They come from addresses of their own (127.0.0.2 and up), so that each has the bounds of one address. Prints
"ready" when all are there, and a JSON object at the end.
"""

import asyncio
import contextlib
import json
import resource
import socket
import struct
import sys
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Id, encode
from tests.support import xrce_board as board

RATE_HZ = 10
TURNS_A_PERIOD = 50  # the devices speak in so many groups, one after another
TIME_INTERVAL_S = 2.5
ARRIVAL_S = 0.002
ARRIVALS_A_TIME = 200
AT_ONCE = 50  # connections that are being opened
TIME = encode(Id.TIME, bytes(8))
POSE = encode(125, struct.pack("<3d", 1.0, 2.0, 0.5))
VOLTAGE = encode(126, struct.pack("<f", 12.1))
CONNECT_TIMEOUT_S = 10.0
STEADY_HZ = 1000
FLOOD_BYTES = 65536  # of one write
NODE, TOPIC, PUBLISHER, WRITER = 0x01, 0x02, 0x03, 0x05  # objects of a micro-ROS board
LATE_S = 0.3  # of an acknowledgement


class Device(asyncio.Protocol):
    """Announces its topics when they are requested."""

    def __init__(self, hello: bytes, counts: Counter[str]) -> None:
        self._hello, self._counts = hello, counts
        self.transport: asyncio.Transport | None = None
        self.is_known = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - of a TCP connection
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        if TOPICS_REQUEST in data and self.transport is not None:
            self.is_known = True
            self.transport.write(self._hello)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        self.is_known = False
        self._counts["lost"] += 1

    def send(self, data: bytes) -> None:
        if self.is_known and self.transport is not None:
            self.transport.write(data)
            self._counts["sent"] += 1


def hello(name: str, *, has_battery: bool = False) -> bytes:
    """Return the answer of a robot of this name to a topic request."""
    topics = [
        (Id.PUBLISHER, 125, "odometry", "geometry_msgs/Pose2D"),
        (Id.PUBLISHER, 126, "battery", "std_msgs/Float32"),
        (Id.SUBSCRIBER, 100, "velocity_commands", "geometry_msgs/Twist"),
    ]
    if not has_battery:
        del topics[1]
    infos = []
    for kind, topic_id, topic, type_name in topics:
        found = CATALOG.message(type_name)
        assert found is not None  # noqa: S101 - of the store that the project is built on
        infos.append(
            encode(
                kind, encode_topic_info(DeviceEndpoint(kind, topic_id, f"/{name}/{topic}", type_name, found.md5, 512))
            )
        )
    return TIME + b"".join(infos) + TIME


async def devices(
    count: int, host: str, port: int, seconds: float, counts: Counter[str], *, has_battery: bool = False
) -> None:
    """A fleet, distributed over the period so that the host has no bursts but its own."""
    loop = asyncio.get_running_loop()
    fleet: list[Device] = []
    for number in range(count):
        made = Device(hello(f"crowd_{number}", has_battery=has_battery), counts)
        await loop.create_connection(lambda made=made: made, host, port, local_addr=(source(number), 0))  # type: ignore[misc]
        fleet.append(made)
        await asyncio.sleep(ARRIVAL_S)
        if number % ARRIVALS_A_TIME == 0:  # on a busy machine all arrivals take longer than a host waits in silence
            for earlier in fleet:
                earlier.send(TIME)
    for made in fleet:
        made.send(TIME + POSE)  # its first message ends the announcement of topics
        await asyncio.sleep(ARRIVAL_S)
    ready()
    turn, began_s = 0, loop.time()
    turns_a_second = TURNS_A_PERIOD * RATE_HZ
    time_turns = round(TIME_INTERVAL_S * turns_a_second)
    while turn < seconds * turns_a_second:
        for made in fleet[turn % TURNS_A_PERIOD :: TURNS_A_PERIOD]:
            made.send(POSE)
        for made in fleet[(turn + TURNS_A_PERIOD // 2) % TURNS_A_PERIOD :: TURNS_A_PERIOD] if has_battery else ():
            made.send(VOLTAGE)
        for made in fleet[turn % time_turns :: time_turns]:
            made.send(TIME)
        turn += 1
        await asyncio.sleep(max(0.0, began_s + turn / turns_a_second - loop.time()))
    counts["behind_ms"] = round(1000 * (loop.time() - began_s - seconds))


async def fleet(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """Robots that tell the voltage of their batteries, too."""
    await devices(count, host, port, seconds, counts, has_battery=True)


async def steady(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """Devices with STEADY_HZ poses a second each, no two of a device alike."""
    loop = asyncio.get_running_loop()
    made: list[Device] = []
    for number in range(count):
        device = Device(hello(f"crowd_{number}"), counts)
        await loop.create_connection(lambda device=device: device, host, port, local_addr=(source(number), 0))  # type: ignore[misc]
        made.append(device)
    await asyncio.sleep(1.0)
    for device in made:
        device.send(TIME)
    ready()
    began_s, sent = loop.time(), 0
    while sent < seconds * STEADY_HZ:
        sent += STEADY_HZ // 50
        numbers = range(sent, sent + STEADY_HZ // 50)
        poses = b"".join(encode(125, struct.pack("<3d", each / 1000, 2.0, 0.5)) for each in numbers)
        for device in made:
            device.send(poses + TIME if sent % (2 * STEADY_HZ) == 0 else poses)
        await asyncio.sleep(max(0.0, began_s + sent / STEADY_HZ - loop.time()))
    counts["poses"] = sent * count
    counts["behind_ms"] = round(1000 * (loop.time() - began_s - seconds))


class Board(asyncio.DatagramProtocol):
    """A micro-ROS board with one publisher, which waits for the acknowledgement of each message."""

    def __init__(self, number: int, counts: Counter[str]) -> None:
        self._client, self._counts = board.Client(key=number.to_bytes(4)), counts
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.DatagramTransport | None = None
        self._wanted = deque(
            [
                (NODE, board.participant(f"crowd_{number}"), 0),
                (TOPIC, board.topic(f"rt/crowd_{number}/value", "std_msgs::msg::dds_::Float32_"), NODE),
                (PUBLISHER, b"\0\0", NODE),
                (WRITER, board.endpoint(TOPIC, is_reader=False), PUBLISHER),
            ]
        )
        self._request = 0  # the status of this one is awaited
        self._sent_s: float | None = None
        self.is_ready = False

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def error_received(self, exc: Exception) -> None:  # noqa: ARG002 - asyncio's signature
        self._counts["unreachable"] += 1

    def datagram_received(self, data: bytes, addr: object) -> None:  # noqa: ARG002 - asyncio's signature
        client = self._client
        client.now_s = self._loop.time()
        client.read(data)
        if not self._is_acknowledged or client.agent_status != 0:
            self._flush()
            return
        if self._sent_s is not None:
            taken_s, self._sent_s = client.now_s - self._sent_s, None
            self._counts["acknowledged"] += 1
            self._counts["late"] += taken_s > LATE_S
            self._counts["longest_ms"] = max(self._counts["longest_ms"], round(1000 * taken_s))
        if not self.is_ready and (not self._request or self._request in client.statuses):
            self.is_ready = not self._wanted
            if self._wanted:
                self._request, creating = client.creating(*self._wanted.popleft())
                client.put(creating)
        self._flush()

    def again(self) -> None:
        """Send what is not answered once more."""
        client = self._client
        if client.agent_status is None:
            client.sent.append(client.creation())
        for number, body in client.slots.items():
            client.send(0x80, number, body)
        self._flush()

    def publish(self) -> None:
        """Send a number, or the one before again if it is not acknowledged."""
        if self._sent_s is not None:
            self._counts["behind"] += 1
            self.again()
            return
        self._sent_s = self._loop.time()
        head = struct.pack(">HH", self._client.request() & 0xFFFF, WRITER)
        self._client.put(board.sub(board.WRITE, head + struct.pack("<f", 1.0)))
        self._flush()

    @property
    def _is_acknowledged(self) -> bool:
        return board.ahead(self._client.last_acked, self._client.last_sent) <= 0

    def _flush(self) -> None:
        sent, self._client.sent = self._client.sent, []
        for each in sent if self._transport is not None else ():
            self._transport.sendto(each)


async def boards(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """micro-ROS boards, distributed over the period. One that is refused tries again after a second, as a stock one."""
    loop = asyncio.get_running_loop()
    made: list[Board] = []
    for number in range(count):
        _, one = await loop.create_datagram_endpoint(
            lambda number=number: Board(number + 1, counts),  # type: ignore[misc]
            local_addr=(source(number), 0),
            remote_addr=(host, port),
        )
        made.append(one)
    began_s = loop.time()
    while waiting := [each for each in made if not each.is_ready]:
        for each in waiting:
            each.again()
            await asyncio.sleep(1 / len(waiting))
    counts["admitted_ms"] = round(1000 * (loop.time() - began_s))
    ready()
    counts["longest_ms"], began_s = 0, loop.time()
    for turn in range(round(TURNS_A_PERIOD * seconds)):
        for each in made[turn % TURNS_A_PERIOD :: TURNS_A_PERIOD]:
            each.publish()
        await asyncio.sleep(max(0.0, began_s + (turn + 1) / TURNS_A_PERIOD - loop.time()))
    counts["behind_ms"] = round(1000 * (loop.time() - began_s - seconds))


async def vanish(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """So many a second connect, send a byte and reset."""
    loop = asyncio.get_running_loop()
    ready()
    began_s = loop.time()
    for number in range(round(count * seconds)):
        with contextlib.suppress(OSError), connected(number, host, port) as visitor:
            visitor.send(b"\xff")
            visitor.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            counts["visits"] += 1
        await asyncio.sleep(max(0.0, began_s + (number + 1) / count - loop.time()))


async def silent(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """Connect as fast as possible, and stay until none has connected or been sent away for `seconds`, at least ten.

    A refused device does not retry.
    """
    now_s, quiet_s = asyncio.get_running_loop().time, max(seconds, CONNECT_TIMEOUT_S)
    turns = asyncio.Semaphore(AT_ONCE)

    def note(end: asyncio.Timeout) -> None:
        if not end.expired():
            end.reschedule(now_s() + quiet_s)

    async def stay(number: int, end: asyncio.Timeout) -> None:
        writer = None
        try:
            async with turns, asyncio.timeout(CONNECT_TIMEOUT_S):
                reader, writer = await asyncio.open_connection(host, port, local_addr=(source(number // 100), 0))
            counts["opened"] += 1
            note(end)
            while await reader.read(4096):
                counts["questions"] += 1
            counts["sent_away"] += 1
            note(end)
        except (OSError, TimeoutError):
            counts["refused"] += 1
        finally:
            if writer is not None:
                writer.close()

    ready()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(quiet_s) as end, asyncio.TaskGroup() as tasks:
            for number in range(count):
                tasks.create_task(stay(number, end))


async def flood(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """Poses, without a pause."""
    await _flood([POSE] * count, host, port, seconds, counts)


async def mixed(count: int, host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    """Send one kind of expensive frame on each connection, in turn."""
    await _flood([KINDS[number % len(KINDS)] for number in range(count)], host, port, seconds, counts)


async def _flood(kinds: list[bytes], host: str, port: int, seconds: float, counts: Counter[str]) -> None:
    loop = asyncio.get_running_loop()
    end_s = loop.time() + seconds

    async def send(number: int, kind: bytes) -> None:
        block = kind * (FLOOD_BYTES // len(kind) + 1)
        while loop.time() < end_s:  # a refused device connects again
            with contextlib.suppress(OSError, TimeoutError):
                reader, writer = await asyncio.open_connection(host, port, local_addr=(source(number * 50), 0))
                writer.write(hello(f"flood_{number}"))
                async with asyncio.timeout_at(end_s), asyncio.TaskGroup() as tasks:
                    draining = tasks.create_task(_drain(reader))
                    try:
                        while not draining.done():
                            writer.write(block)
                            await writer.drain()
                            counts["bytes"] += len(block)
                    finally:
                        draining.cancel()
                        writer.close()
            counts["connections"] += 1
            await asyncio.sleep(ARRIVAL_S)

    ready()
    async with asyncio.TaskGroup() as tasks:
        for number, kind in enumerate(kinds):
            tasks.create_task(send(number, kind))


async def _drain(reader: asyncio.StreamReader) -> None:
    while await reader.read(1 << 16):
        pass


def topic_infos(count: int) -> bytes:
    """Return TopicInfos with md5 sums that no type has."""
    infos = (
        DeviceEndpoint(EndpointKind.PUBLISHER, 125 + number, f"/flood/{number}", "geometry_msgs/Pose2D", "0" * 32, 512)
        for number in range(count)
    )
    return b"".join(encode(Id.PUBLISHER, encode_topic_info(info)) for info in infos)


def parameters(count: int) -> bytes:
    """Return requests for unknown parameters."""
    names = (f"/flood/{number}".encode() for number in range(count))
    return b"".join(encode(Id.PARAMETER, struct.pack("<I", len(name)) + name) for name in names)


def logs(count: int) -> bytes:
    """So many lines of a device's log."""
    text = b"the battery is low"
    return encode(Id.LOG, struct.pack("<BI", 2, len(text)) + text) * count


@contextlib.contextmanager
def connected(number: int, host: str, port: int) -> Iterator[socket.socket]:
    """A connection that does not block for long."""
    with socket.create_connection((host, port), timeout=1.0, source_address=(source(number % 5), 0)) as visitor:
        yield visitor


def source(number: int) -> str:
    """One of this machine's own addresses; fifty connections share one."""
    at = number // 50 + 2
    return f"127.0.{at // 250}.{at % 250 + 1}"


def ready() -> None:
    print("ready", flush=True)


CATALOG = Catalog()
CROWDS = {
    "devices": devices,
    "fleet": fleet,
    "vanish": vanish,
    "silent": silent,
    "flood": flood,
    "mixed": mixed,
    "steady": steady,
    "boards": boards,
}
KINDS = (
    POSE,
    logs(1),
    parameters(500),
    topic_infos(200),
    encode(999, bytes(24)),  # an unknown id
    TIME,
    encode(125, bytes(1000)),  # of a topic whose messages have 24 bytes
    bytes(range(256)),  # no frame at all
)


def main() -> None:
    name, count, address, seconds = sys.argv[1:]
    host, _, port = address.rpartition(":")
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    counts: Counter[str] = Counter()
    asyncio.run(CROWDS[name](int(count), host, int(port), float(seconds), counts))
    print(json.dumps(dict(counts)))


if __name__ == "__main__":
    main()
