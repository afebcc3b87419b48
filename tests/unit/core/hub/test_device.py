"""Device: the endpoints of one link in the graph."""

import asyncio
import struct

from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.fake_device import robot_topics
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, velocities


def test_device_that_uses_one_id_in_both_directions_is_read_and_driven() -> None:
    async def test(made: MemoryHub) -> None:
        infos = [info._replace(id=125 if info.id == 100 else info.id) for info in robot_topics()]
        device = await made.connect(infos)
        await device.send(125, struct.pack("<3d", 1.0, 2.0, 0.5))
        await asyncio.sleep(0.05)
        found = made.robot().odometry.snapshot(made.now_s)
        assert found is not None
        assert found.pose == (1.0, 2.0, 0.5)
        drive_gate(made.robot(), PlanarVelocity(0.1))
        await asyncio.sleep(0.05)
        assert velocities(device, 125)[-1] == (0.1, 0.0)

    in_hub(test)
