"""`make bench`, last part: how long a message takes between a device and a rospy program, compared with rospy to rospy.

A master, the daemon, rospy programs of Debian's packages; this process is the device. All at 100 Hz, by the wall clock
of one machine, in turns that alternate. Writes build/bench_ros1.json and prints a table; docs/performance.md holds a
copy of a run.
"""

import asyncio
import contextlib
import socket
import statistics
import struct
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.fake_device import topic
from tests.support.ros1.debian import Graph, graph
from tools.bench import Row, p99, parser, report

RATE_HZ = 100
FLOAT = "std_msgs/Float64"
DATA = struct.Struct("<d")
TIME = encode(Id.TIME, bytes(8))
UP, DOWN, BETWEEN = "/device/up", "/device/down", "/between"
SETTLE_S = 1.0
MOST = 3.0  # times rospy to rospy: a message takes two hops instead of one
TIMES_S = 60.0


def main() -> int:
    chosen = parser(__doc__, "ros1").parse_args()
    found = asyncio.run(measure(round(500 * chosen.share), 2))
    yardstick_ms = statistics.median(found["rospy to rospy"])
    return report((row(what, ms, yardstick_ms) for what, ms in found.items()), chosen.out)


def row(what: str, ms: list[float], yardstick_ms: float) -> Row:
    received = [each for each in ms if each >= 0]
    median_ms = statistics.median(received)
    note = f"p99 {p99(received):.2f} ms, {len(ms) - len(received)} lost"
    return Row(
        f"{what}, median", median_ms, "ms", "times rospy to rospy", median_ms / yardstick_ms, at_most=MOST, note=note
    )


async def measure(count: int, rounds: int) -> dict[str, list[float]]:
    """Milliseconds of each message, by what it went through; -1 for one that was lost."""
    found: dict[str, list[float]] = {"rospy to rospy": [], "device to rospy": [], "rospy to device": []}
    with tempfile.TemporaryDirectory() as folder:
        async with graph(Path(folder)) as ros, ros.daemon() as daemon:
            for _ in range(rounds):
                found["rospy to rospy"] += await between(ros, count)
                with Device(daemon.tcp) as device:  # one that requests nothing for long is dropped
                    found["device to rospy"] += await up(ros, device, count)
                with Device(daemon.tcp) as device:
                    found["rospy to device"] += await down(ros, device, count)
    return found


async def between(ros: Graph, count: int) -> list[float]:
    async with (
        ros.node("receive", BETWEEN, str(count)) as receiver,
        ros.node("send", BETWEEN, str(RATE_HZ), str(count)),
    ):
        return list((await receiver.read("measured", TIMES_S))["ms"])


async def up(ros: Graph, device: "Device", count: int) -> list[float]:
    async with ros.node("receive", UP, str(count)) as receiver:
        await asyncio.sleep(SETTLE_S)
        await asyncio.to_thread(device.send_times, count)
        return list((await receiver.read("measured", TIMES_S))["ms"])


async def down(ros: Graph, device: "Device", count: int) -> list[float]:
    async with ros.node("send", DOWN, str(RATE_HZ), str(count)):
        found = await asyncio.to_thread(device.receive_times, count)
    return found + [-1.0] * (count - len(found))


class Device:
    """The device side of rosserial on a blocking socket: nothing of its own in the figures."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.create_connection(address)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream = FrameStream()
        infos = [topic(EndpointKind.PUBLISHER, 125, UP, FLOAT), topic(EndpointKind.SUBSCRIBER, 100, DOWN, FLOAT)]
        self._hello = b"".join(encode(info.kind, encode_topic_info(info)) for info in infos) + TIME
        self._read()

    def __enter__(self) -> "Device":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send_times(self, count: int) -> None:
        for number in range(count):
            if number % RATE_HZ == 0:
                self._socket.sendall(TIME)
            self._socket.sendall(encode(125, DATA.pack(time.time())))
            time.sleep(1 / RATE_HZ)

    def receive_times(self, count: int) -> list[float]:
        """Wait until all have arrived, or no more arrive."""
        found: list[float] = []
        silent_at_s = time.monotonic() + 5 * SETTLE_S
        while len(found) < count and time.monotonic() < silent_at_s:
            for frame in self._read():
                if frame.topic_id == 100:
                    found.append((time.time() - DATA.unpack(frame.payload)[0]) * 1000)
                    silent_at_s = time.monotonic() + 5 * SETTLE_S
        return found

    def _read(self) -> list[Frame]:
        self._socket.settimeout(SETTLE_S)
        with contextlib.suppress(TimeoutError):
            frames = [each for each in self._stream.feed(self._socket.recv(4096)) if isinstance(each, Frame)]
            if any(frame.topic_id == Id.PUBLISHER for frame in frames):
                self._socket.sendall(self._hello)
            return frames
        self._socket.sendall(TIME)
        return []


if __name__ == "__main__":
    sys.exit(main())
