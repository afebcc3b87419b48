"""Device port among connections that are not robots: robots are admitted, and the others are counted."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from structlog.testing import capture_logs

from hostlink.core.config import Config, TcpConfig
from hostlink.core.runtime.log_budget import LOG_INTERVAL_S
from hostlink.core.runtime.loop_time import loop_time_s
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.waiting import expect

ROBOT, CROWD = "127.0.0.2", "127.0.0.3"


@contextlib.asynccontextmanager
async def silent_connections(address: tuple[str, int], count: int, *, local_host: str) -> AsyncIterator[None]:
    """Open this many connections that never send a byte."""
    writers = []
    for _ in range(count):
        _, writer = await asyncio.open_connection(*address, local_addr=(local_host, 0))
        writers.append(writer)
    try:
        yield
    finally:
        for writer in writers:
            writer.transport.abort()


async def test_an_address_that_is_not_allowed_receives_nothing_and_is_counted() -> None:
    config = Config(tcp=TcpConfig(allow=(f"{ROBOT}/32",)))
    async with daemon(config) as host:
        async with fake_device(host.tcp, local_host=CROWD) as refused:
            await refused.closed()
        async with fake_device(host.tcp, robot_topics(), local_host=ROBOT):
            links = await host.get("/api/links")
    assert [link["peer"].split(":")[0] for link in links["links"]] == [ROBOT]
    assert links["refused"] == {"not_allowed": 1}


async def test_a_silent_crowd_does_not_keep_a_robot_out() -> None:
    """The crowd connects from a single address, or from many."""
    config = Config(tcp=TcpConfig(max_connections=20, max_connections_per_address=15))
    with capture_logs() as lines:
        began_s = loop_time_s()
        async with daemon(config) as host, silent_connections(host.tcp, 300, local_host=CROWD):
            await expect(lambda: host.hub.counts.refused["too_many_of_address"] == 285)
            async with silent_connections(host.tcp, 15, local_host="127.0.0.4"):
                await expect(lambda: host.hub.counts.refused["too_many"] == 5)
                async with fake_device(host.tcp, robot_topics(), local_host=ROBOT) as device:
                    await device.send(pose(1.0))
                    await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
                    await expect(lambda: len(host.hub.links.all()) == 20)
                    assert host.hub.counts.refused == {"too_many_of_address": 285, "too_many": 5, "evicted": 6}
                    assert host.hub.robots.find("robot_0").link is not None
    reported = [line for line in lines if line["event"] == "connection.refused"]
    assert 1 <= len(reported) <= 1 + (loop_time_s() - began_s) / LOG_INTERVAL_S  # not one for each
    assert reported[0]["cause"] == "too_many_of_address"


async def test_a_device_that_announced_its_topics_is_not_evicted_for_another() -> None:
    config = Config(tcp=TcpConfig(max_connections=2))
    async with (
        daemon(config) as host,
        fake_device(host.tcp, robot_topics("a")) as first,
        fake_device(host.tcp, robot_topics("b")) as second,
    ):
        async with fake_device(host.tcp, local_host=CROWD) as late:
            await late.closed()
        await first.send(pose(1.0))
        await second.send(pose(1.0))
        for name in ("/a/odometry", "/b/odometry"):
            await expect(lambda name=name: host.hub.topics.find(name).messages == 1)
        assert host.hub.counts.refused == {"too_many": 1}
