"""Every end or pause of a driver in ROS 2 stops the robot within the lease."""

import asyncio
import contextlib
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from hostlink.core.config import Config
from hostlink.core.robot.velocity_gate import VelocityGate
from tests.support.daemon import Daemon, daemon
from tests.support.process import free_port, serve
from tests.support.proxy import Line, proxy
from tests.support.ros2 import DISCOVERY_S, Bridge, Peer, bridge, domain, peer
from tests.support.simulated import simulated_robot
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect, expect_never, is_true_within

pytestmark = [pytest.mark.quiet, pytest.mark.timeout(200)]

TWIST = "geometry_msgs/msg/Twist"
LEASE_S = 0.5
LATE_S = 0.6  # a tick of the gate, and what a busy machine needs to notice
CMD_VEL = "/robot_0/cmd_vel"
MISSED_S = 20.0  # a stream that does not drive within this time was taken for one of before


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with domain() as found:
        yield found


@dataclass
class World:
    """A daemon, a robot that drives by a ROS 2 publisher, and the bridge between them."""

    server: Daemon
    bridge: Bridge
    driver: Peer

    @property
    def gate(self) -> VelocityGate:
        return self.server.hub.robots.find("robot_0").gate

    async def until_stopped(self) -> float:
        """Return the seconds until the robot has no driver or its commanded velocity is zero."""
        watch = Stopwatch()
        await expect(lambda: self.gate.owner is None or self.gate.target.is_zero)
        return watch.seconds

    async def drives_after_a_zero_and_not_for(self, seconds: float, watch: Stopwatch) -> None:
        """Check that a continued stream does not drive, and that one that begins after a zero does."""
        await drives_nothing(lambda: self.gate.owner is not None, seconds, watch)
        await self.driver.do("silence", topic=CMD_VEL)
        admitted = self.gate.counts.commands
        await drive(self.driver, linear_m_s=0.0)
        await expect(lambda: self.gate.counts.commands > admitted)
        await self.driver.do("silence", topic=CMD_VEL)
        await drive_anew(self.driver, self.bridge, lambda: self.gate.owner is not None and not self.gate.target.is_zero)


async def drive(other: Peer, topic: str = CMD_VEL, *, type_name: str = TWIST, linear_m_s: float = 0.2) -> None:
    velocity: dict[str, Any] = {"linear": {"x": linear_m_s}}
    message = {"twist": velocity} if type_name.endswith("Stamped") else velocity
    await other.do("publish", topic=topic, type=type_name, msg=message, rate_hz=20, await_subscriber=True)


async def drive_anew(driver: Peer, process: Bridge, is_driven: Callable[[], object]) -> None:
    """Begin a stream after a pause, and again if the bridge did not run meanwhile: the middleware keeps the newest
    message only, so the bridge cannot know whether the stream began before.
    """
    await drive(driver)
    while not await is_true_within(is_driven, MISSED_S):
        assert process.has_reported("did not run for"), "a stream that begins after a pause does not drive"
        await driver.do("silence", topic=CMD_VEL)
        await asyncio.sleep(LEASE_S + 3.0)
        await drive(driver)


def watched(*programs: Bridge | Peer) -> Stopwatch:
    """Return a stopwatch of the programs that a stream passes, from now on."""
    return Stopwatch(*(program.child.pid for program in programs))


async def drives_nothing(is_driven: Callable[[], object], for_s: float, watch: Stopwatch) -> None:
    """Check that a continued stream does not drive, unless it paused for a lease because it waited for a core."""
    if await is_true_within(is_driven, for_s):
        assert watch.kept_s > LEASE_S, "the stream from before drives"


@contextlib.asynccontextmanager
async def driven(environment: dict[str, str]) -> AsyncIterator[World]:
    """A robot that drives."""
    async with (
        daemon(Config()) as server,
        simulated_robot(server.tcp),
        bridge(environment, server.url) as process,
        peer(environment, "driver") as driver,
    ):
        await expect(lambda: server.hub.robots.find("robot_0").link is not None)
        await drive(driver)
        world = World(server, process, driver)
        await expect(lambda: world.gate.owner is not None, timeout_s=DISCOVERY_S)
        yield world


@pytest.mark.parametrize("how", [pytest.param("leaves", marks=pytest.mark.long), "is killed"])
async def test_robot_whose_publisher_is_gone_is_stopped(environment: dict[str, str], how: str) -> None:
    async with driven(environment) as world:
        if how == "leaves":
            await world.driver.do("unpublish", topic=CMD_VEL)
        else:
            world.driver.child.kill()
        assert await world.until_stopped() < LEASE_S + LATE_S


@pytest.mark.long
async def test_a_publisher_that_stands_still_stops_the_robot_and_may_go_on(environment: dict[str, str]) -> None:
    async with driven(environment) as world:
        world.driver.child.send_signal(signal.SIGSTOP)
        assert await world.until_stopped() < LEASE_S + LATE_S
        world.driver.child.send_signal(signal.SIGCONT)
        await expect(lambda: world.gate.owner is not None)


async def test_a_bridge_that_is_killed_stops_the_robot(environment: dict[str, str]) -> None:
    async with driven(environment) as world:
        world.bridge.child.kill()
        assert await world.until_stopped() < LEASE_S + LATE_S


@pytest.mark.long
async def test_a_bridge_that_is_ended_stops_the_robot_and_ends_soon(environment: dict[str, str]) -> None:
    async with driven(environment) as world:
        world.bridge.child.terminate()
        assert await world.until_stopped() < LEASE_S + LATE_S
        async with asyncio.timeout(8):
            assert await world.bridge.child.wait() == 0


@pytest.mark.long
async def test_a_bridge_that_stands_still_stops_the_robot_and_what_it_held_does_not_drive(
    environment: dict[str, str],
) -> None:
    async with driven(environment) as world:
        world.bridge.child.send_signal(signal.SIGSTOP)
        assert await world.until_stopped() < LEASE_S + LATE_S
        world.driver.child.kill()  # these velocities are too old to be meant
        await asyncio.sleep(1.0)
        watch = watched(world.bridge)
        world.bridge.child.send_signal(signal.SIGCONT)
        await expect(lambda: world.bridge.has_reported("did not run"))
        await drives_nothing(lambda: world.gate.owner is not None, 1.0, watch)


@pytest.mark.long
async def test_a_stream_drives_on_after_a_zero_when_the_bridge_stood_still(environment: dict[str, str]) -> None:
    async with driven(environment) as world:
        world.bridge.child.send_signal(signal.SIGSTOP)
        await world.until_stopped()
        await asyncio.sleep(0.5)
        watch = watched(world.driver, world.bridge)
        world.bridge.child.send_signal(signal.SIGCONT)
        await expect(lambda: world.bridge.has_reported("velocity refused: disarmed") or watch.kept_s > LEASE_S)
        await world.drives_after_a_zero_and_not_for(0.5, watch)


@pytest.mark.long
async def test_a_device_that_connects_again_is_not_driven_by_the_stream_of_before(environment: dict[str, str]) -> None:
    async with (
        daemon(Config()) as server,
        bridge(environment, server.url) as process,
        peer(environment, "driver") as driver,
    ):
        async with simulated_robot(server.tcp):
            await expect(lambda: server.hub.robots.find("robot_0").link is not None)
            await drive(driver)
            await expect(lambda: server.hub.robots.find("robot_0").gate.owner is not None, timeout_s=DISCOVERY_S)
        watch = watched(driver, process)
        async with simulated_robot(server.tcp) as body:
            await expect(lambda: server.hub.robots.find("robot_0").link is not None)
            await expect(lambda: process.has_reported("velocity refused: disarmed"), timeout_s=DISCOVERY_S)
            await drives_nothing(lambda: abs(body.speed_m_s) > 0.005, 1.0, watch)
            await driver.do("silence", topic=CMD_VEL)
            await asyncio.sleep(LEASE_S + 3.0)  # on a busy machine the last one before it may be that late
            await drive_anew(driver, process, lambda: body.speed_m_s > 0.02)


async def test_a_daemon_that_is_killed_and_started_again_is_found_again_and_moves_nothing(
    environment: dict[str, str],
) -> None:
    device_port, api_port = free_port(), free_port()
    ports = ("--listen", f"127.0.0.1:{device_port}", "--api", f"127.0.0.1:{api_port}")
    async with (
        simulated_robot(("127.0.0.1", device_port)) as body,
        peer(environment, "driver") as driver,
        serve(*ports) as first,
        bridge(environment, first.url) as process,
    ):
        await first.read_log("robot.appeared")
        await drive(driver)
        await expect(lambda: body.speed_m_s > 0.02, timeout_s=DISCOVERY_S)
        first.child.kill()
        await expect(lambda: process.has_reported("is lost"))
        await expect(lambda: abs(body.speed_m_s) < 0.005)
        watch = watched(driver, process)
        async with serve(*ports) as second:
            await second.read_log("robot.appeared")
            await expect(lambda: process.has_reported(" again"), timeout_s=DISCOVERY_S)
            await drives_nothing(lambda: abs(body.speed_m_s) > 0.005, 1.5, watch)
            await driver.do("silence", topic=CMD_VEL)
            await asyncio.sleep(LEASE_S + 3.0)
            await drive_anew(driver, process, lambda: body.speed_m_s > 0.02)


@pytest.mark.parametrize("line", [pytest.param(Line.SWALLOWS, marks=pytest.mark.long), Line.STALLS])
async def test_a_network_that_is_cut_stops_the_robot(environment: dict[str, str], line: Line) -> None:
    async with (
        daemon(Config()) as server,
        simulated_robot(server.tcp),
        proxy(server.url) as between,
        bridge(environment, between.url) as process,
        peer(environment, "driver") as driver,
    ):
        await expect(lambda: server.hub.robots.has("robot_0"))
        gate = server.hub.robots.find("robot_0").gate
        await drive(driver)
        await expect(lambda: gate.owner is not None, timeout_s=DISCOVERY_S)
        watch = watched(driver, process)
        between.set_line(line)
        await expect(lambda: gate.owner is None)
        assert watch.seconds < LEASE_S + LATE_S
        await expect(lambda: process.has_reported("is lost"))
        await asyncio.sleep(LEASE_S + 0.1)  # what is on its way is younger until then
        watch = watched(driver, process)
        between.set_line(Line.WORKS)
        await expect(lambda: process.has_reported(" again"), timeout_s=DISCOVERY_S)
        await drives_nothing(lambda: gate.owner is not None, 1.0, watch)


@pytest.mark.long
async def test_a_bridge_that_is_started_before_the_daemon_waits_for_it(environment: dict[str, str]) -> None:
    api_port = free_port()
    url = f"http://127.0.0.1:{api_port}"

    async with bridge(environment, url, until="trying again") as process:
        async with serve("--api", f"127.0.0.1:{api_port}"):
            await expect(lambda: process.has_reported("connected to hostlink"), timeout_s=DISCOVERY_S)
        assert len([line for line in process.reports if "trying again" in line]) == 1


@pytest.mark.long
async def test_idle_publisher_does_not_stop_what_another_publisher_drives(
    environment: dict[str, str],
) -> None:
    async with driven(environment) as world, peer(environment, "idle") as idle:
        gate, owner = world.gate, world.gate.owner
        await drive(idle, linear_m_s=0.0)
        await expect_never(lambda: gate.owner not in (owner, None), for_s=1.5)
        await expect_never(lambda: gate.owner == owner and gate.target.is_zero, for_s=1.0)
        await expect(lambda: gate.owner == owner)


async def test_cmd_vel_takes_stamped_velocities_where_ros_2_sends_them(environment: dict[str, str]) -> None:
    async with (
        daemon(Config()) as server,
        simulated_robot(server.tcp) as body,
        bridge(environment, server.url),
        peer(environment, "driver") as driver,
    ):
        await expect(lambda: server.hub.robots.find("robot_0").link is not None)
        await drive(driver, type_name="geometry_msgs/msg/TwistStamped")
        await expect(lambda: body.speed_m_s > 0.02, timeout_s=DISCOVERY_S)


async def test_a_locked_robot_is_not_driven_and_the_reason_is_reported_once(environment: dict[str, str]) -> None:
    async with driven(environment) as world:
        world.server.hub.robots.find("robot_0").lock("a person is near")
        await expect(lambda: world.bridge.has_reported("a person is near"))
        await expect_never(lambda: sum("a person is near" in line for line in world.bridge.reports) > 1, for_s=0.5)


@pytest.mark.long
async def test_a_stream_that_went_on_through_a_lock_drives_after_a_zero_and_not_before(
    environment: dict[str, str],
) -> None:
    async with driven(environment) as world:
        robot = world.server.hub.robots.find("robot_0")
        robot.lock("a person is near")
        await expect(lambda: world.bridge.has_reported("a person is near"))
        watch = watched(world.driver, world.bridge)
        robot.unlock()
        await expect(lambda: world.bridge.has_reported("velocity refused: disarmed"))
        await world.drives_after_a_zero_and_not_for(1.0, watch)
