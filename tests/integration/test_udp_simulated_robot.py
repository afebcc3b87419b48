"""The simulated robot over UDP: its UART's bytes cut into datagrams anywhere, as a passthrough would send them."""

import asyncio
import socket
from contextlib import AbstractAsyncContextManager

from hostlink.core.config import Config, UdpConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.standstill import StandstillState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.workbench.sim.run import GREETING_S, run_fleet
from tests.support.background import meanwhile
from tests.support.daemon import daemon
from tests.support.waiting import TIMEOUT_S, expect

HOST = "127.0.0.1"
FORWARD = PlanarVelocity(x_m_s=0.2)


def fleet(port: int, robots: int = 1) -> AbstractAsyncContextManager[None]:
    return meanwhile(run_fleet(HOST, port, robots=robots, is_udp=True))


def x_m(hub: Hub) -> float:
    known = hub.robots.find("robot_0").odometry.snapshot(asyncio.get_running_loop().time())
    return 0.0 if known is None else known.pose.x_m


async def drive_until(hub: Hub, wanted_m: float) -> None:
    robot, program = hub.robots.find("robot_0"), hub.join("a program")
    while x_m(hub) < wanted_m:
        program.drive(robot, FORWARD)
        await asyncio.sleep(0.1)
    program.leave()


async def test_robot_over_udp_is_driven_and_stops_when_its_driver_leaves() -> None:
    config = Config(udp=UdpConfig(host=HOST, port=0))
    async with daemon(config) as host, fleet(host.udp[1]):
        await expect(lambda: host.hub.robots.all() and x_m(host.hub) == 0.0)
        await drive_until(host.hub, 0.1)
        now_s, robot = asyncio.get_running_loop().time(), host.hub.robots.find("robot_0")
        (found,) = await host.hub.standstills.measure([robot], now_s, wait_s=TIMEOUT_S)
        assert found.state is StandstillState.STOPPED
        link = host.hub.links.all()[0]
        assert link.session.counts.skipped_bytes == 0
        assert link.session.counts.negotiations == 2  # the second one confirmed the first


async def test_a_daemon_that_starts_again_finds_the_robots_again() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((HOST, 0))
        port = free.getsockname()[1]
    config = Config(udp=UdpConfig(host=HOST, port=port, trusted=("127.0.0.0/8",)))
    async with fleet(port, robots=3):
        for _ in range(2):
            async with daemon(config) as host:
                await expect(lambda: len(host.hub.robots.all()) == 3)
                await drive_until(host.hub, x_m(host.hub) + 0.05)


async def test_robots_without_an_answer_say_once_what_they_wait_for_and_what_to_do() -> None:
    said: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind((HOST, 0))
        port = silent.getsockname()[1]
        async with meanwhile(run_fleet(HOST, port, robots=2, is_udp=True, log=said.append)):
            await expect(lambda: said)
            await asyncio.sleep(2 * GREETING_S)  # the other robot has waited as long, and both wait on
    assert said == [
        f"no answer from {HOST}:{port} over UDP for 2 s, waiting; `hostlink serve --udp {port}` starts a host with UDP"
    ]
