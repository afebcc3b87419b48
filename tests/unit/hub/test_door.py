"""The door in virtual time: a device whose robot's name is another's may try again, but not at once."""

import asyncio

from structlog.testing import capture_logs

from hostlink.config import Config
from hostlink.hub.door import PAUSE_S, Door
from hostlink.hub.hub import Hub
from hostlink.messages.catalog import Catalog
from hostlink.protocol.control import encode_topic_info
from hostlink.protocol.frame import Id, encode
from tests.support.fake_device import robot_topics
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.virtual_loop import run_virtual

OWNER, OTHER = "192.168.4.2", "192.168.4.3"
TIME = encode(Id.TIME, bytes(8))
ANNOUNCEMENT = TIME + b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics()) + TIME


async def come(door: Door, address: str) -> MemoryTransport:
    """A device connects, and tells that it is robot_0."""
    host, device = memory_pair(address=address)
    door.enter(host)
    try:
        await device.send(ANNOUNCEMENT)
    except ConnectionResetError:
        assert door._hub.refused  # it was not let in
    await asyncio.sleep(0.1)
    return device


def connected(hub: Hub) -> list[str]:
    return [link.address for link in hub.links()]


async def two_of_one_name() -> Hub:
    hub = Hub(Config(), Catalog(), reraises=True)
    door = Door(hub, Config().tcp)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run())
        await hub.is_running.wait()
        owner = await come(door, OWNER)
        for _ in range(10):
            await come(door, OTHER)
        assert connected(hub) == [OWNER]
        await owner.aclose()
        await asyncio.sleep(PAUSE_S)
        await come(door, OTHER)
        assert connected(hub) == [OTHER]
        running.cancel()
    return hub


def test_a_second_robot_of_a_name_waits_before_it_may_try_again() -> None:
    with capture_logs() as lines:
        hub = run_virtual(two_of_one_name())
    assert hub.refused == {"name_taken": 9}
    told = [line["event"] for line in lines]
    assert (told.count("link.refused"), told.count("connection.refused")) == (1, 1)
