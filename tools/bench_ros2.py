"""`make bench`: a message between a device and rclpy through `hostlink ros2`, and rclpy to rclpy in the same run.

100 messages a second each way. Writes build/bench_ros2.json; docs/performance.md holds a copy of a run.
"""

import asyncio
import contextlib
import statistics
import struct
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # tests.support has the peers

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime import logs
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, topic
from tests.support.process import serve
from tests.support.ros2 import Peer, bridge, domain, peer
from tests.support.waiting import expect
from tools.bench import Row, p99, parser, report

RATE_HZ = 100
MOST = 4.0  # times rclpy to rclpy: a message takes three hops instead of one
SKIPPED = 50  # with the first messages much is made that stays
TIMEOUT_S = 120.0
LATEST_S = 3.0
TIME_EVERY = 250  # messages
SERVO = topic(EndpointKind.SUBSCRIBER, 110, "/robot_0/servo", "std_msgs/Float64")
SENSOR = topic(EndpointKind.PUBLISHER, 126, "/robot_0/sensor", "std_msgs/Float64")
FLOAT64 = "std_msgs/msg/Float64"


def main() -> int:
    chosen = parser(__doc__, "ros2").parse_args()
    logs.configure(level="error")
    found = asyncio.run(measured(round(1500 * chosen.share)))
    yardstick_ms = 1000 * statistics.median(found["rclpy to rclpy"])
    return report((row(what, delays_s, yardstick_ms) for what, delays_s in found.items()), chosen.out)


def row(what: str, delays_s: list[float], yardstick_ms: float) -> Row:
    median_ms = 1000 * statistics.median(delays_s)
    note = f"p99 {1000 * p99(delays_s):.2f} ms"
    return Row(
        f"{what}, median", median_ms, "ms", "times rclpy to rclpy", median_ms / yardstick_ms, at_most=MOST, note=note
    )


async def measured(count: int) -> dict[str, list[float]]:
    """Seconds on the way, by name; the yardstick before and after the bridge runs."""
    with domain() as environment:
        before = await yardstick(environment, count // 2)
        async with world(environment) as (device, other):
            up = await from_device(device, other, count)
            down = await to_device(device, other, count)
        after = await yardstick(environment, count // 2)
    return {"rclpy to rclpy": before + after, "device to rclpy": up, "rclpy to device": down}


@contextlib.asynccontextmanager
async def world(environment: dict[str, str]) -> AsyncIterator[tuple[FakeDevice, Peer]]:
    """A device, the daemon as a process, the bridge, and a node."""
    async with (
        serve() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        fake_device(server.tcp, [*robot_topics(), SERVO, SENSOR]) as device,
    ):
        yield device, other


async def yardstick(environment: dict[str, str], count: int) -> list[float]:
    async with peer(environment, "one") as one, peer(environment, "two") as two:
        await two.do("subscribe", topic="/yardstick", type=FLOAT64)
        await one.do("publish", topic="/yardstick", type=FLOAT64, rate_hz=RATE_HZ, stamp="data", await_subscriber=True)
        return await received(two, "/yardstick", count)


async def from_device(device: FakeDevice, other: Peer, count: int) -> list[float]:
    await other.do("subscribe", topic=SENSOR.name, type=FLOAT64)
    while len(other.messages(SENSOR.name)) < 10:
        await device.send(encode(SENSOR.id, struct.pack("<d", time.monotonic())))
        await asyncio.sleep(1 / RATE_HZ)
    due_s, begun = time.monotonic(), len(other.messages(SENSOR.name))
    for _ in range(count):
        await device.send(encode(SENSOR.id, struct.pack("<d", time.monotonic())))
        due_s += 1 / RATE_HZ
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
    with contextlib.suppress(TimeoutError):  # those on their way; what is lost shows in the count
        async with asyncio.timeout(LATEST_S):
            while len(other.messages(SENSOR.name)) < begun + count:  # noqa: ASYNC110 - a list, filled by a reader
                await asyncio.sleep(0.05)
    return delays(other.events("message", topic=SENSOR.name)[begun:])


async def to_device(device: FakeDevice, other: Peer, count: int) -> list[float]:
    await other.do("publish", topic=SERVO.name, type=FLOAT64, rate_hz=RATE_HZ, stamp="data", await_subscriber=True)
    found: list[float] = []
    while len(found) < count + SKIPPED:
        frame = await device.next()
        if frame.topic_id == SERVO.id:
            if len(found) % TIME_EVERY == 0:  # a device that sends nothing for 11 s is gone
                await device.send(encode(Id.TIME, bytes(8)))
            found.append(time.monotonic() - struct.unpack("<d", frame.payload)[0])
    await other.do("unpublish", topic=SERVO.name)
    return found[SKIPPED:]


async def received(other: Peer, name: str, count: int) -> list[float]:
    await expect(lambda: len(other.events("message", topic=name)) >= count + SKIPPED, timeout_s=TIMEOUT_S)
    return delays(other.events("message", topic=name)[SKIPPED:])


def delays(events: list[dict[str, Any]]) -> list[float]:
    return [event["at_s"] - event["msg"]["data"] for event in events]


if __name__ == "__main__":
    sys.exit(main())
