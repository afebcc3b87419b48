"""The daemon on uvloop, for those who want it: its transports answer differently once a connection is gone."""

import asyncio
import signal
import sys

import aiohttp
import pytest

from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.process import serve
from tests.support.pty_pair import pty_pair

ON_UVLOOP = (sys.executable, "-c", "import uvloop; uvloop.install(); from hostlink.cli.main import main; main()")
ZERO = (0.0, 0.0)

pytestmark = pytest.mark.filterwarnings("default::DeprecationWarning")


async def test_devices_come_and_go_and_a_robot_is_driven() -> None:
    with pty_pair() as (_, path):
        async with serve("--serial", path, program=ON_UVLOOP) as daemon, aiohttp.ClientSession() as session:
            for _ in range(3):
                async with fake_device(daemon.tcp, robot_topics()) as device:
                    await device.send(pose(1.0))
                    url = f"{daemon.url}/api/robots/robot_0/velocity"
                    async with session.put(url, json={"linear": 0.2, "angular": 0.0}) as response:
                        assert response.status == 200
                    assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
                    async with session.get(f"{daemon.url}/api/links") as response:
                        assert response.status == 200
                await daemon.read_log("robot.gone")
                await daemon.read_log("link.closed")
                async with session.get(f"{daemon.url}/api/links") as response:
                    assert response.status == 200
            async with fake_device(daemon.tcp, robot_topics()) as device:
                assert await device.velocity() == ZERO
                daemon.child.send_signal(signal.SIGTERM)
                async with asyncio.timeout(5):
                    assert await daemon.child.wait() == 0
        assert not [line for line in daemon.log if str(line["event"]).endswith(".crashed")]
