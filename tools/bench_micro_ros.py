"""`make bench`: cost of a micro-ROS board, compared with a rosserial board that sends the same in the same run.

Boards in another process send samples over UDP at 50 Hz each; the figure is the daemon's CPU time for a message. Then
one board sends best effort as fast as TCP takes it. Both protocols are measured in turn ROUNDS times, because a virtual
machine has minutes in which everything costs twice as much; a row has the median of the ratios, and in its note the
aim. A board that publishes reliably waits for the acknowledgement of each message; here it does not wait, so that both
protocols carry as many. Over UDP each acknowledgement is a datagram, and an Odometry is two: of these the daemon
handles two and three for one of rosserial.
"""

import asyncio
import json
import socket
import statistics
import struct
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.cli.serve import Addresses, running
from hostlink.cli.serve_command import loop_factory
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config, MicroRosConfig, MicroRosTcpConfig, MicroRosUdpConfig, TcpConfig, UdpConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime import logs
from tests.support import xrce_board as board
from tools.bench import Row, parser, report
from tools.bench_link import is_ready, until

BOARDS, RATE_HZ = 20, 50
ROUNDS = 3
FLOOD = 20_000  # messages
FLOODED = "sensor_msgs/Imu"  # a board waits for the acknowledgement of an Odometry
AIM = 1.5  # times the cost of rosserial
SETTLE_S = 0.5
SENT = {"sensor_msgs/Imu": "imu", "nav_msgs/Odometry": "odom"}
NODE, TOPIC, PUBLISHER, WRITER = 0x01, 0x02, 0x03, 0x05


@dataclass(frozen=True)
class Way:
    """Protocol of the boards, and whether micro-ROS publishes reliably. `at_most`: bound of the cost."""

    name: str
    is_micro_ros: bool = True
    is_reliable: bool = False
    at_most: float = AIM


ROSSERIAL = Way("rosserial", is_micro_ros=False)
WAYS = (Way("micro-ROS, best effort"), Way("micro-ROS, reliable", is_reliable=True, at_most=3.0))


@dataclass(frozen=True)
class Order:
    """Work of the process of the boards. `rate_hz`: 0 is as fast as possible."""

    host: str
    port: int
    way: dict[str, Any]
    type: str
    topics: list[str]
    rate_hz: int
    samples: int  # of each board


def main() -> int:
    arguments = parser(__doc__, "micro_ros")
    arguments.add_argument("--loop", default="auto", help="event loop of the daemon: auto, asyncio or uvloop")
    chosen = arguments.parse_args()
    logs.configure(level="error")
    with asyncio.Runner(loop_factory=loop_factory(chosen.loop)) as runner:
        return report(runner.run(rows(chosen.share)), chosen.out)


# -- the boards, in a process of their own ----------------------------------------------------------------------------


def play(order: Order) -> None:
    """Announce every board, wait for a byte, and send."""
    way, is_udp = Way(**order.way), order.rate_hz > 0
    boards = [Board(order, way, topic, is_udp=is_udp) for topic in order.topics]
    sys.stdin.read(1)
    if not is_udp:
        (one,) = boards
        one.connection.sendall(one.wire)
    else:
        began_s = time.monotonic()
        for number in range(order.samples):
            for place, each in enumerate(boards):  # spread over the period, as boards are
                for message in each.samples[number]:
                    each.connection.send(message)
                due_s = began_s + (number + (place + 1) / len(boards)) / order.rate_hz
                time.sleep(max(0.0, due_s - time.monotonic()))
    sys.stdin.read(1)


class Board:
    """One board, with everything that it will send."""

    def __init__(self, order: Order, way: Way, topic: str, *, is_udp: bool) -> None:
        self.connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if is_udp else socket.SOCK_STREAM)
        self.connection.connect((order.host, order.port))
        codec = board.Datagrams() if is_udp else board.Lengths()
        made = of_micro_ros(order, way, topic) if way.is_micro_ros else of_rosserial(order, topic)
        *announced, self.samples = [*made]
        if way.is_micro_ros:
            announced = [codec.encode(each) for each in announced]
            self.samples = [[codec.encode(each) for each in sample] for sample in self.samples]
        for each in announced:
            self.connection.send(each)
            time.sleep(0.002)
        self.wire = b"".join(each for sample in self.samples for each in sample)
        threading.Thread(target=self._drop, daemon=True).start()

    def _drop(self) -> None:
        while self.connection.recv(65536):
            pass


def of_rosserial(order: Order, topic: str) -> Iterator[Any]:
    """Yield what announces the topic, and last the frames of each sample."""
    type_ = Catalog().message(order.type)
    if type_ is None:
        raise AssertionError(order.type)
    info = DeviceEndpoint(EndpointKind.PUBLISHER, 125, topic, type_.name, type_.md5, 1024)
    yield encode(Id.TIME, bytes(8))
    yield encode(Id.PUBLISHER, encode_topic_info(info))
    yield encode(Id.TIME, bytes(8))
    yield [[encode(125, type_.encode(message(order.type)))]] * order.samples


def of_micro_ros(order: Order, way: Way, topic: str) -> Iterator[Any]:
    """Yield what creates the writer, and last the messages of each sample: an Odometry has two."""
    type_ = Catalog().message(order.type)
    if type_ is None:
        raise AssertionError(order.type)
    client = board.Client(key=struct.pack(">I", hash(topic) & 0xFFFFFFFF), history=1 << 30)
    yield client.creation()
    package, name = order.type.split("/")
    for id_, content, parent in (
        (NODE, board.participant("bench"), 0),
        (TOPIC, board.topic(f"rt{topic}", f"{package}::msg::dds_::{name}_"), NODE),
        (PUBLISHER, b"\0\0", NODE),
        (WRITER, board.endpoint(TOPIC, is_reader=False, is_reliable=way.is_reliable), PUBLISHER),
    ):
        client.put(client.creating(id_, content, parent)[1])
    yield from client.sent
    payload, samples = cdr_of(type_).from_ros1(type_.encode(message(order.type))), []
    for _ in range(order.samples):
        client.sent = []
        if way.is_reliable:
            client.put(board.sub(board.WRITE, struct.pack(">HH", client.request() & 0xFFFF, WRITER) + payload))
            client.slots.clear()
        else:
            client.put_best_effort(board.sub(board.WRITE, struct.pack(">HH", 9, WRITER) + payload))
        samples.append(client.sent)
    yield samples


def message(type_: str) -> dict[str, Any]:
    """A sample with the texts that boards set."""
    pose = {"pose": {"pose": {"orientation": {"w": 1.0}}}, "child_frame_id": "base_link"}
    return {"header": {"frame_id": "odom"}} | (pose if type_ == "nav_msgs/Odometry" else {"orientation": {"w": 1.0}})


# -- the daemon -------------------------------------------------------------------------------------------------------


async def rows(share: float) -> list[Row]:
    """Measure the cost of a message of many boards, and of one that floods."""
    local = "127.0.0.1"
    config = Config(
        tcp=TcpConfig(host=local, port=0),
        udp=UdpConfig(host=local, port=0, trusted=("127.0.0.0/8",)),
        micro_ros=MicroRosConfig(udp=MicroRosUdpConfig(port=0), tcp=MicroRosTcpConfig(port=0)),
    ).with_tables(api=ApiConfig(port=0))
    found = []
    async with running(config) as (hub, addresses):
        for type_, topic in SENT.items():
            ways = [way for way in WAYS if way.is_reliable or type_ != "nav_msgs/Odometry"]  # it fits no datagram
            costs = {way: list[float]() for way in (ROSSERIAL, *ways)}
            for _ in range(ROUNDS):
                for way, values in costs.items():
                    values.append(await cost_us(hub, addresses, way, type_, topic, seconds=3.0 * share))
            found += compared(f"{type_} of {BOARDS} boards at {RATE_HZ} Hz over UDP", costs, "us of CPU")
            if type_ == FLOODED:
                rates = {way: list[float]() for way in costs if not way.is_reliable}
                for _ in range(ROUNDS):
                    for way, values in rates.items():
                        values.append(await flood(hub, addresses, way, type_, topic, round(FLOOD * share)))
                found += compared(f"{type_} of one board, flood over TCP", rates, "us of CPU")
    return found


def compared(what: str, figures: dict[Way, list[float]], unit: str) -> Iterator[Row]:
    """Yield the row of each way, with its ratio to rosserial."""
    usual = figures[ROSSERIAL]
    yield Row(f"{what}: rosserial", statistics.median(usual), unit)
    for way, values in figures.items():
        if way is not ROSSERIAL:
            ratios = [value / other for value, other in zip(values, usual, strict=True)]
            ratio = statistics.median(ratios)
            missed = "missed" if ratio > AIM else "met"
            note = f"{min(ratios):.2f} to {max(ratios):.2f}; aim {AIM:g}: {missed}"
            yield Row(
                f"{what}: {way.name}", statistics.median(values), unit,
                "of rosserial", ratio, at_most=way.at_most, note=note,
            )  # fmt: skip


async def cost_us(hub: Hub, addresses: Addresses, way: Way, type_: str, topic: str, *, seconds: float) -> float:
    """CPU time of this process for a message, in microseconds."""
    topics = [f"/{topic}_{number}" for number in range(BOARDS)]
    samples = round((seconds + 4 * SETTLE_S) * RATE_HZ)
    order = Order(*address_of(addresses, way, "udp"), asdict(way), type_, topics, RATE_HZ, samples)
    count = 0

    def deliver(_: Any) -> None:
        nonlocal count
        count += 1

    async def measured(go: Callable[[], Awaitable[None]]) -> float:
        await asyncio.sleep(SETTLE_S)
        began_s = time.process_time()
        await asyncio.sleep(seconds)
        idle_s = time.process_time() - began_s
        await go()
        await asyncio.sleep(2 * SETTLE_S)
        before, began_s = count, time.process_time()
        await asyncio.sleep(seconds)
        return (time.process_time() - began_s - idle_s) / (count - before) * 1e6

    return await with_boards(hub, order, deliver, measured)


async def flood(hub: Hub, addresses: Addresses, way: Way, type_: str, topic: str, samples: int) -> float:
    """CPU time of this process for a message of one board that sends as fast as it can, in microseconds."""
    order = Order(*address_of(addresses, way, "tcp"), asdict(way), type_, [f"/{topic}_flood"], 0, samples)
    times, done = list[float](), asyncio.Event()

    def deliver(_: Any) -> None:
        times.append(time.process_time())
        if len(times) == samples:
            done.set()

    async def measured(go: Callable[[], Awaitable[None]]) -> float:
        await go()
        async with asyncio.timeout(120):
            await done.wait()
        return (times[-1] - times[0]) / (samples - 1) * 1e6

    return await with_boards(hub, order, deliver, measured)


async def with_boards(
    hub: Hub,
    order: Order,
    deliver: Callable[[Any], None],
    measured: Callable[[Callable[[], Awaitable[None]]], Awaitable[float]],
) -> float:
    """Start the boards, subscribe to what they announce, measure, and wait until they are gone."""
    participant = hub.join("bench")
    process = await asyncio.create_subprocess_exec(
        sys.executable, __file__, "boards", json.dumps(asdict(order)), stdin=asyncio.subprocess.PIPE
    )
    stdin = process.stdin
    if stdin is None:
        raise AssertionError("a pipe was asked for")

    async def go() -> None:
        stdin.write(b"g")
        await stdin.drain()

    try:
        for each in order.topics:
            await until(lambda each=each: is_ready(hub, each))  # type: ignore[misc]
            participant.subscribe(each, deliver)
        return await measured(go)
    finally:
        participant.leave()
        stdin.close()
        await process.wait()
        await until(lambda: not hub.links.all())


def address_of(addresses: Addresses, way: Way, transport: str) -> tuple[str, int]:
    """Return where boards connect."""
    if not way.is_micro_ros:
        found = addresses.udp if transport == "udp" else addresses.tcp
        if found is None:
            raise AssertionError("a port was asked for")
        return found
    (url,) = [each for each in addresses.micro_ros if each.startswith(transport)]
    host, _, port = url.removeprefix(f"{transport}://").rpartition(":")
    return host, int(port)


if __name__ == "__main__":
    if sys.argv[1:2] == ["boards"]:
        play(Order(**json.loads(sys.argv[2])))
        sys.exit(0)
    sys.exit(main())
