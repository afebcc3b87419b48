"""The feed of GET /api/events: its events, their rate, and one encoding for all readers. In virtual time."""

import asyncio
import contextlib
import json
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.components.gateway.clients import Clients
from hostlink.components.gateway.events import LINGER_S, MAX_LINES, Reader, StateFeed
from hostlink.components.recorder.incident import Incident
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Id
from tests.support.device_codec import encode_log
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.hosts import host_of, recordings_of
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual, virtual


def with_feed(test: Callable[[Hub, StateFeed], Awaitable[None]]) -> None:
    """Run the test with a hub that ends at the first crash."""

    async def run() -> None:
        hub = Hub(Config(), CATALOG, reraises=True)
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(hub.run())
            await hub.is_running.wait()
            await test(hub, StateFeed(host_of(hub), Clients(8, max_per_address=8)))
            running.cancel()

    with capture_logs():
        run_virtual(run())


def parsed(events: list[bytes]) -> list[tuple[str, Any]]:
    found = []
    for event in events:
        fields = dict(line.split(": ", 1) for line in event.decode().removesuffix("\n\n").split("\n"))
        found.append((fields["event"], json.loads(fields["data"])))
    return found


def ids(events: list[bytes]) -> list[str]:
    return [line[4:] for event in events for line in event.decode().splitlines() if line.startswith("id: ")]


async def counted(reader: Reader, seconds: float) -> Counter[str]:
    """Count the events of each kind in this time."""
    counts: Counter[str] = Counter()
    until_s = asyncio.get_running_loop().time() + seconds
    while asyncio.get_running_loop().time() < until_s:
        counts.update(name for name, _ in parsed(reader.pop()))
        await asyncio.sleep(0.02)
    return counts


async def connected(hub: Hub) -> ScriptedDevice:
    device = ScriptedDevice(hub, robot_topics(), address="10.0.0.2")
    await asyncio.sleep(0.5)
    return device


def test_states_are_encoded_once_for_all_readers() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device = await connected(hub)
        one, two = Reader(feed), Reader(feed)
        with feed.reading(one), feed.reading(two):
            await asyncio.sleep(0.05)
            first, second = one.pop(), two.pop()
        assert [name for name, _ in parsed(first)] == ["robots", "links", "clients", "recordings"]
        assert all(mine is other for mine, other in zip(first, second, strict=True))
        assert parsed(first)[0][1]["robots"][0]["name"] == "robot_0"
        assert parsed(first)[1][1]["links"][0]["peer"] == "10.0.0.2"
        await device.aclose()

    with_feed(check)


def test_feed_without_readers_encodes_nothing_and_keeps_nothing() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        reader = Reader(feed)
        with feed.reading(reader):
            await asyncio.sleep(0.05)
            assert parsed(reader.pop())[0] == ("robots", {"robots": []})
        await asyncio.sleep(LINGER_S + 0.5)
        version = feed.version
        device = await connected(hub)
        await asyncio.sleep(10.0)
        assert (feed.version, feed.is_running) == (version, False)
        rosout = hub.topics.find("/rosout")
        assert not rosout.subscribers
        later = Reader(feed)
        assert later.pop() == []
        with feed.reading(later):
            await asyncio.sleep(0.05)
            assert [robot["name"] for robot in parsed(later.pop())[0][1]["robots"]] == ["robot_0"]
        await device.aclose()

    with_feed(check)


def test_robots_are_sent_ten_times_a_second_only_while_one_moves() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, reader = await connected(hub), Reader(feed)
        await device.send(125, bytes(24))  # a robot with poses
        with feed.reading(reader):
            await asyncio.sleep(0.05)
            reader.pop()
            await asyncio.sleep(15.0)
            reader.pop()  # the findings about this device were sent at once
            assert await counted(reader, 10.0) == {"robots": 10, "links": 10, "clients": 10}
            async with asyncio.TaskGroup() as tasks:
                moving = tasks.create_task(_move(device))
                counts = await counted(reader, 10.0)
                moving.cancel()
            assert 95 <= counts["robots"] <= 101
            assert counts["links"] == counts["clients"] == 10
        await device.aclose()

    with_feed(check)


async def _move(device: ScriptedDevice) -> None:
    while True:
        await device.send(125, bytes(24))
        await asyncio.sleep(0.02)


def test_robot_without_poses_is_sent_when_its_frames_change() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, reader = await connected(hub), Reader(feed)
        with feed.reading(reader):
            await asyncio.sleep(0.15)
            before = dict(parsed(reader.pop()))["robots"]["robots"][0]["frames"]
            await device.send(Id.LOG, encode_log(Log(2, "warm")))
            await asyncio.sleep(0.15)
            assert dict(parsed(reader.pop()))["robots"]["robots"][0]["frames"] == before + 1
        await device.aclose()

    with_feed(check)


def test_change_of_a_stopped_robot_is_sent_at_once() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, reader = await connected(hub), Reader(feed)
        with feed.reading(reader):
            await asyncio.sleep(0.05)
            reader.pop()
            hub.robots.find("robot_0").lock("somebody stands there")
            await asyncio.sleep(0.15)
            name, data = parsed(reader.pop())[0]
            assert (name, data["robots"][0]["lock_reason"]) == ("robots", "somebody stands there")
        await device.aclose()

    with_feed(check)


def test_slow_reader_gets_newest_state_and_lines_and_others_are_counted() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, reader = await connected(hub), Reader(feed)
        with feed.reading(reader):
            await asyncio.sleep(0.05)
            reader.pop()
            for number in range(MAX_LINES + 3):
                await device.send(Id.LOG, encode_log(Log(2, f"line {number}")))
                await asyncio.sleep(0.1)
            assert reader.waiting_messages == MAX_LINES + 3
            events = parsed(reader.pop())
        assert Counter(name for name, _ in events) == {"robots": 1, "links": 1, "clients": 1, "log": MAX_LINES}
        assert next(line["msg"] for name, line in events if name == "log") == "line 3"
        assert (reader.dropped, reader.waiting_messages, reader.waiting_bytes) == (3, 0, 0)
        await device.aclose()

    with_feed(check)


def test_log_line_is_sent_at_once_without_other_changes() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, reader = await connected(hub), Reader(feed)
        await device.send(125, bytes(24))  # a robot with poses
        with feed.reading(reader):
            await asyncio.sleep(0.25)
            reader.pop()
            reader.news.clear()
            await device.send(Id.LOG, encode_log(Log(2, "warm")))
            async with asyncio.timeout(0.15):
                await reader.news.wait()
            assert [(name, line["msg"]) for name, line in parsed(reader.pop())] == [("log", "warm")]
        await device.aclose()

    with_feed(check)


def test_reader_that_reconnects_gets_the_lines_since_its_last_one() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, reader = await connected(hub), Reader(feed)

        async def log(*lines: str) -> None:
            for line in lines:
                await device.send(Id.LOG, encode_log(Log(2, line)))
            await asyncio.sleep(0.15)

        def lines(events: list[bytes]) -> list[str]:
            return [line["msg"] for name, line in parsed(events) if name == "log"]

        with feed.reading(reader):
            await asyncio.sleep(0.05)
            await log("a", "b")
            events = reader.pop()
            assert lines(events) == ["a", "b"]
            first, second = ids(events)
        await log("c", "d")  # without a reader
        await asyncio.sleep(LINGER_S / 2)
        for last_id, expected in ((second, ["c", "d"]), (first, ["b", "c", "d"])):
            later = Reader(feed, last_id)
            with feed.reading(later):
                await asyncio.sleep(0.15)
                events = later.pop()
                assert (lines(events), later.dropped) == (expected, 0)
                assert parsed(events)[0][0] == "robots"  # as it is now, not as the last reader left it
        await log(*map(str, range(MAX_LINES)))
        later = Reader(feed, first)
        assert (lines(later.pop()), later.dropped) == ([str(number) for number in range(MAX_LINES)], 3)
        name = first.partition("-")[0]
        for other in (
            "",
            "x",
            f"{name}-",
            f"{name}-x",
            f"{name}--1",
            f"{name}-²",
            f"0{name}-1",
            f"{name}-{'9' * 5000}",
        ):
            assert lines(Reader(feed, other).pop()) == []
        assert lines(Reader(feed, f"{name}-999999").pop()) == []
        await device.aclose()

    with_feed(check)


def test_invalid_log_message_is_counted() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        reader = Reader(feed)
        with feed.reading(reader):
            await asyncio.sleep(0.05)
            reader.pop()
            hub.topics.find("/rosout").deliver(b"\x01", source="a test", at_s=asyncio.get_running_loop().time())
            await asyncio.sleep(0.15)
            assert (reader.pop(), reader.dropped) == ([], 1)

    with_feed(check)


@pytest.mark.slow
def test_many_readers_are_sent_less_often_within_the_cpu_share() -> None:
    async def check(hub: Hub, feed: StateFeed) -> None:
        device, first = await connected(hub), Reader(feed)
        with contextlib.ExitStack() as stack:
            for reader in (first, *(Reader(feed) for _ in range(10_000))):
                stack.enter_context(feed.reading(reader))
            async with asyncio.TaskGroup() as tasks:
                moving = tasks.create_task(_move(device))
                counts = await counted(first, 10.0)
                moving.cancel()
            assert 5 < counts["robots"] < 50
        await device.aclose()

    with_feed(check)


def test_recordings_are_sent_on_change_and_to_new_readers() -> None:
    async def run() -> None:
        hub = Hub(Config(), CATALOG, reraises=True)
        recordings, host = recordings_of(hub), host_of(hub)
        host.offer(recordings)
        feed = StateFeed(host, Clients(8, max_per_address=8))
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(hub.run())
            await hub.is_running.wait()
            for _ in range(2):
                reader = Reader(feed)
                with feed.reading(reader):
                    assert (await counted(reader, 10.0))["recordings"] == 1
                    recordings.black_box.pending.append(Incident("robot_0", "requested", "", 0))
                    assert (await counted(reader, 3.0))["recordings"] == 1
                await asyncio.sleep(1.0)
            recordings.black_box.pending.clear()
            await recordings.aclose()
            running.cancel()

    with capture_logs():
        run_virtual(run())


@virtual
async def test_streams_end_with_the_hub() -> None:
    hub = Hub(Config(), CATALOG, reraises=True)
    feed = StateFeed(host_of(hub), Clients(8, max_per_address=8))
    reader = Reader(feed)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run())
        await hub.is_running.wait()
        with feed.reading(reader):
            await asyncio.sleep(0.05)
            reader.news.clear()
            running.cancel()
            await reader.news.wait()
            assert not feed.is_running
