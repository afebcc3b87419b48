"""A flood of datagrams, of addresses without a session and of devices, delays no stop and costs no robot its place."""

import asyncio
import contextlib
import itertools
import sys
from collections.abc import AsyncIterator

import pytest

from hostlink.core.config import Config, UdpConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.daemon import daemon
from tests.support.fake_device import pose, robot_topics
from tests.support.precedence import GOES_LAST
from tests.support.stopwatch import Stopwatch
from tests.support.udp_device import GREETING, UdpDevice, udp_device
from tests.support.waiting import expect

pytestmark = [pytest.mark.quiet, pytest.mark.timeout(60)]
ROBOT, CROWD = "127.0.0.2", "127.0.0.3"
STOPS = 20
LIMIT_S = 0.1  # of the slowest of them
MOVING = PlanarVelocity(x_m_s=0.2)
FLOOD = """
import itertools, os, socket, sys
host, port, local, data = sys.argv[1], int(sys.argv[2]), sys.argv[3], bytes.fromhex(sys.argv[4])
senders = []
for _ in range(int(sys.argv[5])):
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.bind((local, 0))
    sender.connect((host, port))
    senders.append(sender)
print("ready", flush=True)
for sender in itertools.cycle(senders):
    try:
        sender.send(data)
    except ConnectionRefusedError:
        pass
"""


@contextlib.asynccontextmanager
async def flood(to: tuple[str, int], data: bytes, *, sockets: int, local_host: str = CROWD) -> AsyncIterator[None]:
    """Send as many datagrams as one process can."""
    words = [*GOES_LAST, sys.executable, "-c", FLOOD, to[0], str(to[1]), local_host, data.hex(), str(sockets)]
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    assert process.stdout is not None
    try:
        assert await process.stdout.readline() == b"ready\n"
        yield
    finally:
        process.kill()
        await process.wait()


async def stop_again_and_again(hub: Hub, device: UdpDevice) -> list[float]:
    """Return how long each stop was on its way to the device, which sends poses meanwhile."""
    robot, participant = hub.robots.find("robot_0"), hub.join("a program")
    lasted_s = []
    for number in range(STOPS):
        await device.send(pose(float(number)))
        participant.drive(robot, MOVING, epoch=robot.gate.admission.epoch)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        watch = Stopwatch()
        robot.stop()
        assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
        lasted_s.append(watch.seconds)
        await asyncio.sleep(0.02)
    return sorted(lasted_s)


@pytest.mark.parametrize(
    ("data", "sockets"),
    [
        pytest.param(b"x" * 100, 1, marks=pytest.mark.long, id="junk"),
        pytest.param(b"\xff\xfe" * 700, 1, id="looks like frames"),
        pytest.param(GREETING, 1, marks=pytest.mark.long, id="one device"),
        pytest.param(GREETING, 200, id="many devices"),
        pytest.param(pose(1.0), 8, id="devices that speak"),
    ],
)
async def test_a_stop_is_on_time_and_the_robots_own_datagrams_arrive(data: bytes, sockets: int) -> None:
    udp = UdpConfig(host="127.0.0.1", port=0, trusted=(f"{ROBOT}/32",))
    async with daemon(Config(udp=udp)) as host, udp_device(host.udp, robot_topics(), local=(ROBOT, 0)) as device:
        await expect(lambda: host.hub.robots.all() and host.hub.robots.find("robot_0").link is not None)
        async with flood(host.udp, data, sockets=sockets):
            await asyncio.sleep(0.2)
            lasted_s = await stop_again_and_again(host.hub, device)
        print(f"median {lasted_s[STOPS // 2] * 1e3:.1f} ms, longest {lasted_s[-1] * 1e3:.1f} ms")  # noqa: T201
        assert lasted_s[-1] <= LIMIT_S
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == STOPS)


async def test_robot_connects_during_a_flood_of_greetings() -> None:
    udp = UdpConfig(host="127.0.0.1", port=0, trusted=(f"{ROBOT}/32",))
    async with daemon(Config(udp=udp)) as host, flood(host.udp, GREETING, sockets=200):
        await asyncio.sleep(0.2)
        async with contextlib.AsyncExitStack() as opened:
            for _ in itertools.count():  # datagrams that the kernel's full buffer drops are sent again
                device = await opened.enter_async_context(udp_device(host.udp, local=(ROBOT, 0)))
                for _ in range(20):
                    await device.greet()
                    await asyncio.sleep(0.01)
                if host.hub.links.all() and any(link.address == ROBOT for link in host.hub.links.all()):
                    break
