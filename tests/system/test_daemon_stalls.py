"""A daemon that is stopped and continues, as in a debugger, a paused virtual machine, a computer that slept.

tests/property/test_host_pauses.py has what the diagnosis makes of pauses and restarts.
"""

import asyncio
import signal

import aiohttp
import pytest

from tests.support.fake_device import FakeDevice, fake_device, robot_topics
from tests.support.process import serve
from tests.support.rosbridge import Client, publish_until_driven
from tests.support.stopwatch import Stopwatch

pytestmark = pytest.mark.quiet

STILL, MOVING = (0.0, 0.0), (0.2, 0.0)
TOPIC, TWIST = "/robot_0/velocity_commands", {"linear": {"x": 0.2}}


async def test_velocities_that_waited_meanwhile_move_no_robot() -> None:
    async with (
        serve() as daemon,
        fake_device(daemon.tcp, robot_topics()) as device,
        aiohttp.ClientSession() as session,
        session.ws_connect(daemon.url) as socket,
    ):
        program = Client(socket)
        await daemon.read_log("robot.appeared")
        await program.send(op="advertise", topic=TOPIC, type="geometry_msgs/Twist")
        await publish_until_driven(program, device, MOVING[0])
        daemon.child.send_signal(signal.SIGSTOP)
        for _ in range(20):
            await program.send(op="publish", topic=TOPIC, msg=TWIST)
            await asyncio.sleep(0.05)
        await velocities(device)  # what was sent before
        daemon.child.send_signal(signal.SIGCONT)
        await daemon.read_log("daemon.stalled")
        assert await velocities(device) <= {STILL}
        await publish_until_driven(program, device, MOVING[0])


async def velocities(device: FakeDevice) -> set[tuple[float, float]]:
    """Return the velocities that a device receives until it receives none for a second."""
    found = set[tuple[float, float]]()
    while True:
        watch = Stopwatch()
        try:
            async with asyncio.timeout(1.0):
                found.add(await device.velocity())
        except TimeoutError:
            if watch.seconds > 0.5:  # else this process did not run, and something may wait for it
                return found
