"""TcpAcceptor in virtual time: a refused device may reconnect, but not at once."""

import asyncio

from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.listeners.accepting import PAUSE_S, TcpAcceptor
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime.log_budget import LOG_INTERVAL_S
from tests.support.fake_device import robot_topics
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.virtual_loop import run_virtual

OWNER, OTHER = "192.168.4.2", "192.168.4.3"
TIME = encode(Id.TIME, bytes(8))


def announcement(name: str) -> bytes:
    infos = [encode(info.kind, encode_topic_info(info)) for info in robot_topics(name)]
    return b"".join([TIME, *infos, TIME])


async def come(hub: Hub, acceptor: TcpAcceptor, address: str, name: str) -> MemoryTransport:
    """Connect a device that announces the robot of that name."""
    host, device = memory_pair(address=address)
    acceptor.accept(host)
    try:
        await device.send(announcement(name))
    except ConnectionResetError:
        assert hub.counts.refused  # the device was refused
    await asyncio.sleep(0.1)
    return device


def connected(hub: Hub) -> list[str]:
    return [link.address for link in hub.links.all()]


async def one_too_many() -> Hub:
    hub = Hub(Config(), Catalog(), reraises=True)
    acceptor = TcpAcceptor(hub, Config().tcp)
    hub.robots.max_robots = 1
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run())
        await hub.is_running.wait()
        owner = await come(hub, acceptor, OWNER, "robot_0")
        hub.robots.find("robot_0").lock("a person is near")
        await owner.aclose()
        for _ in range(10):
            await come(hub, acceptor, OTHER, "robot_1")
        assert connected(hub) == []
        hub.robots.find("robot_0").unlock()
        await asyncio.sleep(PAUSE_S)
        await come(hub, acceptor, OTHER, "robot_1")
        assert connected(hub) == [OTHER]
        assert [robot.name for robot in hub.robots.all()] == ["robot_1"]
        running.cancel()
    return hub


def test_refused_robot_is_paused_before_it_may_reconnect() -> None:
    with capture_logs() as lines:
        hub = run_virtual(one_too_many())
    assert hub.counts.refused == {"too_many_robots": 9}
    reported = [line["event"] for line in lines]
    assert (reported.count("link.refused"), reported.count("connection.refused")) == (1, 1)


def test_lack_of_descriptors_is_counted_and_logged_once_an_interval() -> None:
    async def run() -> Hub:
        hub = Hub(Config(), Catalog(), reraises=True)
        acceptor = TcpAcceptor(hub, Config().tcp)
        for _ in range(1000):
            acceptor.note_exhausted()
        await asyncio.sleep(LOG_INTERVAL_S)
        acceptor.note_exhausted()
        return hub

    with capture_logs() as lines:
        hub = run_virtual(run())
    assert hub.counts.refused == {"no_descriptors": 1001}
    assert lines == [
        {"event": "descriptors.exhausted", "log_level": "error", "tries": 1},
        {"event": "descriptors.exhausted", "log_level": "error", "tries": 1000},
    ]
