"""A crowd of devices whose connections end at once: each costs its part, in a turn of its own."""

import asyncio

from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.robot.events import EventKind, RobotEvent
from tests.support.fake_device import CATALOG, robot_topics
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.ros_lib_device import running_hub
from tests.support.virtual_loop import run_virtual

CROWD = 60
TIME = encode(Id.TIME, bytes(8))


async def connected(hub: Hub, number: int, tasks: asyncio.TaskGroup) -> MemoryTransport:
    host, device = memory_pair()
    tasks.create_task(hub.links.serve(hub.links.open(host, ROSSERIAL)))
    infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics(f"robot_{number}"))
    await device.send(TIME + infos + TIME)
    return device


def test_links_that_end_at_once_leave_the_graph_one_in_a_turn() -> None:
    async def run() -> tuple[int, int]:
        turn, ended_in = 0, list[int]()

        def observe(event: RobotEvent) -> None:
            if event.kind is EventKind.LINK_CLOSED:
                ended_in.append(turn)

        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub, asyncio.TaskGroup() as tasks:
            hub.join_daemon().observe(observe)
            devices = [await connected(hub, number, tasks) for number in range(CROWD)]
            await asyncio.sleep(5.0)
            assert len(hub.robots.here()) == CROWD
            for device in devices:
                device.break_off()
            while len(ended_in) < CROWD and turn < 100 * CROWD:
                await asyncio.sleep(0)
                turn += 1
            assert not hub.links.all()
        return max(map(ended_in.count, ended_in)), len(ended_in)

    with capture_logs():
        assert run_virtual(run()) == (1, CROWD)
