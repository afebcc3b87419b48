"""A daemon that is stopped and continues, as in a debugger, a paused virtual machine, a computer that slept."""

import asyncio
import signal

import aiohttp
import pytest

from hostlink.diagnosis.link_monitor import SAMPLE_INTERVAL_S
from hostlink.host_pauses import RECOVERY_S
from hostlink.protocol.frame import Id, encode
from hostlink.protocol.negotiation import SILENCE_S
from tests.support.fake_device import FakeDevice, fake_device, robot_topics
from tests.support.process import serve
from tests.support.rosbridge import Client

pytestmark = pytest.mark.quiet

STILL, MOVING = (0.0, 0.0), (0.2, 0.0)
TIME, TIME_PERIOD_S = encode(Id.TIME, bytes(8)), 2.5
PAUSE_S = 7.0
TWIST = {"linear": {"x": 0.2}}


async def test_velocities_that_waited_meanwhile_move_no_robot() -> None:
    async with (
        serve() as daemon,
        fake_device(daemon.tcp, robot_topics()) as device,
        aiohttp.ClientSession() as session,
        session.ws_connect(daemon.url) as socket,
    ):
        program = Client(socket)
        await daemon.read_log("robot.appeared")
        topic = "/robot_0/velocity_commands"
        await program.send(op="advertise", topic=topic, type="geometry_msgs/Twist")
        await program.send(op="publish", topic=topic, msg=TWIST)
        await device.velocity_of(MOVING)
        daemon.child.send_signal(signal.SIGSTOP)
        for _ in range(20):
            await program.send(op="publish", topic=topic, msg=TWIST)
            await asyncio.sleep(0.05)
        await velocities(device, for_s=0.1)  # what was sent before
        daemon.child.send_signal(signal.SIGCONT)
        assert await velocities(device, for_s=1.0) <= {STILL}
        await program.send(op="publish", topic=topic, msg=TWIST)
        await device.velocity_of(MOVING)


async def velocities(device: FakeDevice, *, for_s: float) -> set[tuple[float, float]]:
    """Return the velocities that a device receives."""
    found = set[tuple[float, float]]()
    try:
        async with asyncio.timeout(for_s):
            while True:
                found.add(await device.velocity())
    except TimeoutError:
        return found


@pytest.mark.long  # tests/property/test_host_pauses.py has the rule in virtual time
async def test_pause_of_the_daemon_causes_no_finding_and_ends_no_link() -> None:
    """The pause is longer than a device may be silent; the device continues meanwhile."""
    async with serve() as daemon, fake_device(daemon.tcp, robot_topics()) as device, aiohttp.ClientSession() as session:
        await daemon.read_log("robot.appeared")
        async with asyncio.TaskGroup() as tasks:
            requesting = tasks.create_task(request_the_time(device))
            await asyncio.sleep(2 * TIME_PERIOD_S + 0.5)  # the daemon knows by then that it requests the time
            daemon.child.send_signal(signal.SIGSTOP)
            await asyncio.sleep(PAUSE_S)
            daemon.child.send_signal(signal.SIGCONT)
            stalled = await daemon.read_log("daemon.stalled")
            assert stalled["seconds"] > SILENCE_S
            await asyncio.sleep(RECOVERY_S + 3 * SAMPLE_INTERVAL_S)
            async with session.get(f"{http_of(daemon.url)}/api/links") as answer:
                view = await answer.json()
            requesting.cancel()
    assert [link["diagnosis"] for link in view["links"]] == [[]]
    assert view["ended"] == []


@pytest.mark.long
async def test_restart_of_the_daemon_causes_no_finding_about_a_device_whose_requests_had_waited() -> None:
    async with serve() as daemon, aiohttp.ClientSession() as session:
        reader, writer = await asyncio.open_connection(*daemon.tcp)
        writer.write(TIME * 6)  # in its WiFi module, while there was no host
        device = FakeDevice(reader, writer)
        await device.announce(robot_topics())
        async with asyncio.TaskGroup() as tasks:
            requesting = tasks.create_task(request_the_time(device))
            await asyncio.sleep(2 * TIME_PERIOD_S + 3 * SAMPLE_INTERVAL_S)
            async with session.get(f"{http_of(daemon.url)}/api/links") as answer:
                view = await answer.json()
            requesting.cancel()
        writer.close()
    assert [link["diagnosis"] for link in view["links"]] == [[]]


async def request_the_time(device: FakeDevice) -> None:
    """Request the time like a configured device."""
    while True:
        await asyncio.sleep(TIME_PERIOD_S)
        await device.send(TIME)


def http_of(url: str) -> str:
    return url.replace("ws://", "http://").rstrip("/")
