"""`make bench`: a message between a device and rclpy through `hostlink ros2`, and rclpy to rclpy in the same run.

100 messages a second each way. Writes build/bench_ros2.json; docs/performance.md holds a copy of a run.
"""

import argparse
import asyncio
import contextlib
import json
import statistics
import struct
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # tests.support has the peers

from hostlink import logs
from hostlink.protocol.frame import Id, encode
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, topic
from tests.support.process import serve
from tests.support.ros2 import Peer, bridge, domain, peer
from tests.support.waiting import expect

RATE_HZ = 100
AT_MOST_MS = 1.5
SKIPPED = 50  # with the first messages much is made that stays
TIMEOUT_S = 120.0
LATEST_S = 3.0
TIME_EVERY = 250  # messages
SERVO = topic(Id.SUBSCRIBER, 110, "/robot_0/servo", "std_msgs/Float64")
SENSOR = topic(Id.PUBLISHER, 126, "/robot_0/sensor", "std_msgs/Float64")
FLOAT64 = "std_msgs/msg/Float64"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/bench_ros2.json"))
    parser.add_argument("--messages", type=int, default=1500)
    parser.add_argument("--strict", action="store_true", help=f"fail where a median is over {AT_MOST_MS} ms")
    arguments = parser.parse_args()
    logs.configure(level="error")
    rows = asyncio.run(measured(arguments.messages))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(rows, indent=1) + "\n")
    yardstick_ms = rows["rclpy to rclpy"]["median_ms"]
    for name, row in rows.items():
        ratio = row["median_ms"] / yardstick_ms
        print(f"{name:<24} median {row['median_ms']:.2f} ms, 99th percentile {row['p99_ms']:.2f} ms, {ratio:.1f} times")
    slow = [name for name, row in rows.items() if row["median_ms"] > AT_MOST_MS]
    if arguments.strict and slow:
        sys.exit("not fast enough: " + ", ".join(slow))


async def measured(count: int) -> dict[str, dict[str, float]]:
    """Seconds on the way, by name; the yardstick before and after the bridge runs."""
    with domain() as environment:
        before = await yardstick(environment, count // 2)
        async with world(environment) as (device, other):
            up = await from_device(device, other, count)
            down = await to_device(device, other, count)
        after = await yardstick(environment, count // 2)
    both = before + after
    return {"rclpy to rclpy": figures(both), "device to rclpy": figures(up), "rclpy to device": figures(down)}


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
        await device.send(encode(SENSOR.topic_id, struct.pack("<d", time.monotonic())))
        await asyncio.sleep(1 / RATE_HZ)
    due_s, begun = time.monotonic(), len(other.messages(SENSOR.name))
    for _ in range(count):
        await device.send(encode(SENSOR.topic_id, struct.pack("<d", time.monotonic())))
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
        if frame.topic_id == SERVO.topic_id:
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


def figures(delays_s: list[float]) -> dict[str, float]:
    ordered = sorted(delays_s)
    p99 = ordered[int(0.99 * len(ordered))]
    return {"median_ms": 1e3 * statistics.median(ordered), "p99_ms": 1e3 * p99, "count": len(ordered)}


if __name__ == "__main__":
    main()
