"""Which velocities of ROS 2 reach the daemon, by whose connection, and when that ends; in virtual time."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from hostlink.client import Refusal
from hostlink.errors import HostlinkError
from hostlink.graphs.ros2.plan import TWIST, VelocityInput
from hostlink.graphs.ros2.velocity import MATCH_S, MAX_COMMANDS_S, MAX_OWNERS, STALL_S, VelocityDriver
from tests.support.virtual_loop import VirtualLoop, run_virtual

ROUTE = VelocityInput("/robot_0/cmd_vel", "robot_0", TWIST)
FORWARD, ZERO = (0.2, 0.0), (0.0, 0.0)


def burn(seconds: float) -> None:
    """As if this process did not run."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.burn(seconds)


class FakeRobot:
    """What the client has of a robot: it notes what is commanded."""

    def __init__(self, name: str, daemon: "FakeDaemon") -> None:
        self.name, self.daemon = name, daemon

    @property
    def refusal(self) -> Refusal | None:
        return self.daemon.refusal

    async def command(self, linear_m_s: float, angular_rad_s: float, *, link: int | None = None) -> None:
        if self.daemon.is_lost:
            raise HostlinkError("the connection is lost")
        self.daemon.commands.append((self.name, (linear_m_s, angular_rad_s), link))


class FakeHost:
    """One connection."""

    def __init__(self, daemon: "FakeDaemon") -> None:
        self.daemon = daemon
        self.changes: list[object] = []

    def robot(self, name: str, *, priority: int) -> FakeRobot:
        assert priority == 50
        return FakeRobot(name, self.daemon)

    def connection(self) -> "FakeHost":
        return self

    def pop_all(self) -> list[object]:
        found, self.changes = self.changes, []
        return found


class FakeDaemon:
    """Notes connections, and what is commanded by them."""

    def __init__(self) -> None:
        self.commands: list[tuple[str, tuple[float, float], int | None]] = []
        self.hosts: list[FakeHost] = []
        self.ended = 0
        self.is_lost = False
        self.refusal: Refusal | None = None

    @contextlib.asynccontextmanager
    async def connect(self) -> AsyncIterator[Any]:
        await asyncio.sleep(0.01)
        host = FakeHost(self)
        self.hosts.append(host)
        try:
            yield host
        finally:
            self.ended += 1


class World:
    """A driver whose robot is there."""

    def __init__(self) -> None:
        self.daemon, self.reports = FakeDaemon(), list[str]()
        self.driver = VelocityDriver(self.daemon.connect, 50, self.reports.append)
        self.driver.update({"robot_0": 1}, frozenset())

    async def stream(self, velocity: tuple[float, float], *, key: bytes = b"a", for_s: float = 1.0) -> None:
        for _ in range(round(for_s / 0.1)):
            self.driver.receive(ROUTE, velocity, key)
            await asyncio.sleep(0.1)


def test_a_stream_is_commanded_for_the_link_that_the_robot_has() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            await world.stream(FORWARD)
        assert world.daemon.commands == [("robot_0", FORWARD, 1)] * 10

    run_virtual(check())


def test_a_publisher_that_leaves_ends_its_connection_and_no_other() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            for key in (b"a", b"b"):
                world.driver.receive(ROUTE, FORWARD, key)
            await asyncio.sleep(0.1)
            world.driver.update({"robot_0": 1}, frozenset({b"a", b"b"}))
            world.driver.update({"robot_0": 1}, frozenset({b"a"}))
            await asyncio.sleep(0.1)
            assert (len(world.daemon.hosts), world.daemon.ended) == (2, 1)
        assert world.daemon.ended == 2

    run_virtual(check())


def test_a_publisher_that_ros_2_never_showed_is_forgotten_after_a_while_and_not_before() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            world.driver.receive(ROUTE, FORWARD, b"a")
            await asyncio.sleep(0.5)
            world.driver.update({"robot_0": 1}, frozenset())
            await asyncio.sleep(0.1)
            assert world.daemon.ended == 0
            await asyncio.sleep(1.0)
            world.driver.update({"robot_0": 1}, frozenset())
            await asyncio.sleep(0.1)
            assert world.daemon.ended == 1

    run_virtual(check())


def test_the_end_of_a_topic_is_a_zero() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            with world.driver.driving(ROUTE):
                await world.stream(FORWARD, for_s=0.2)
            await asyncio.sleep(0.1)
        assert world.daemon.commands[-1] == ("robot_0", ZERO, None)

    run_virtual(check())


def test_a_loss_of_the_connection_interrupts_the_stream_until_a_zero() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            await world.stream(FORWARD, for_s=0.3)
            world.daemon.hosts[0].changes.append("lost")
            before = len(world.daemon.commands)
            await world.stream(FORWARD)
            assert len(world.daemon.commands) == before
            await world.stream(ZERO, for_s=0.1)
            await world.stream(FORWARD, for_s=0.1)
            assert [velocity for _, velocity, _ in world.daemon.commands[before:]] == [ZERO, FORWARD]

    run_virtual(check())


def test_a_device_that_comes_is_not_driven_by_who_streamed_before_however_late_ros_2_connects_them() -> None:
    async def check() -> None:
        for late_s in (0.0, 0.7, MATCH_S - 0.1):
            world = World()
            async with world.driver.running():
                world.driver.update({}, frozenset({b"a"}))
                world.driver.update({"robot_0": 2}, frozenset({b"a"}))
                await asyncio.sleep(late_s)
                await world.stream(FORWARD)
                assert world.daemon.commands == []
                await world.stream(FORWARD, key=b"new", for_s=0.1)
                assert world.daemon.commands == [("robot_0", FORWARD, 2)]
                assert len(world.reports) == 1

    run_virtual(check())


def test_who_was_there_before_and_publishes_the_first_velocity_now_drives() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            world.driver.update({}, frozenset({b"a"}))
            world.driver.update({"robot_0": 2}, frozenset({b"a"}))
            world.driver.receive(ROUTE, FORWARD, b"a", is_first=True)
            await world.stream(FORWARD, for_s=0.1)
        assert world.daemon.commands == [("robot_0", FORWARD, 2)]

    run_virtual(check())


def test_who_was_silent_when_the_device_came_drives_with_the_first_velocity() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            world.driver.update({}, frozenset({b"a"}))
            world.driver.update({"robot_0": 2}, frozenset({b"a"}))
            await asyncio.sleep(MATCH_S + 1.0)
            await world.stream(FORWARD, for_s=0.1)
        assert world.daemon.commands == [("robot_0", FORWARD, 2)]

    run_virtual(check())


def test_a_flood_stays_under_the_daemon_s_limit_and_a_stop_waits_for_none_of_it() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            await world.stream(FORWARD, for_s=0.1)
            for number in range(30_000):
                world.driver.receive(ROUTE, (0.001 * (number % 100 + 1), 0.0), b"a")
                await asyncio.sleep(0.0001)
            count = len(world.daemon.commands)
            assert count < 3.0 * MAX_COMMANDS_S + 1.1 * MAX_COMMANDS_S
            world.driver.receive(ROUTE, ZERO, b"a")
            await asyncio.sleep(2 / MAX_COMMANDS_S)
            assert world.daemon.commands[-1] == ("robot_0", ZERO, None)

    run_virtual(check())


def test_so_many_publishers_may_drive_and_more_are_reported() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            for number in range(MAX_OWNERS + 5):
                world.driver.receive(ROUTE, FORWARD, b"%d" % number)
            await asyncio.sleep(0.1)
            assert len(world.daemon.hosts) == MAX_OWNERS
        assert f"more than {MAX_OWNERS}" in world.reports[0]

    run_virtual(check())


def test_a_refusal_is_reported_once_for_each_cause() -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            world.daemon.refusal = Refusal("RobotHeld", "robot_0: it is locked")
            await world.stream(FORWARD)
            assert world.reports == ["robot_0: it is locked"]
            world.daemon.refusal = None
            await world.stream(FORWARD, for_s=0.2)
            world.daemon.refusal = Refusal("RobotHeld", "robot_0: it is locked")
            await world.stream(FORWARD, for_s=0.2)
            assert world.reports == ["robot_0: it is locked"] * 2

    run_virtual(check())


@pytest.mark.parametrize(("gap_s", "is_void"), [(STALL_S - 0.1, False), (STALL_S + 0.1, True)])
def test_velocities_of_when_the_bridge_stood_still_are_void(gap_s: float, *, is_void: bool) -> None:
    async def check() -> None:
        world = World()
        async with world.driver.running():
            await world.stream(FORWARD, for_s=0.2)
            burn(gap_s)
            before = len(world.daemon.commands)
            world.driver.receive(ROUTE, FORWARD, b"a")
            await asyncio.sleep(0.05)
            assert (len(world.daemon.commands) == before) is is_void

    run_virtual(check())
