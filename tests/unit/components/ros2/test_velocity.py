"""Velocities of ROS 2 at the daemon, their connections and the ends of these, in virtual time."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from hostlink.client import Refusal
from hostlink.components.ros2.plan import TWIST, VelocityInput
from hostlink.components.ros2.velocity import (
    HELD_S,
    MATCH_S,
    MAX_COMMANDS_S,
    MAX_OWNERS,
    STALL_S,
    Sent,
    VelocityDriver,
)
from hostlink.core.robot.admission import EARLIER_EPOCH, LEASE_S
from hostlink.core.robot.velocity import Twist
from hostlink.core.runtime.log_budget import LOG_INTERVAL_S
from hostlink.errors import HostlinkError
from tests.support.virtual_loop import VirtualLoop, virtual

ROUTE = VelocityInput("/robot_0/cmd_vel", "robot_0", TWIST)
FORWARD, STANDING = Twist(0.2), Twist()


def burn(seconds: float) -> None:
    """Simulate a pause of this process."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.burn(seconds)


class FakeRobot:
    """Robot of a fake client, which notes commands."""

    def __init__(self, name: str, daemon: "FakeDaemon") -> None:
        self.name, self.daemon = name, daemon

    @property
    def refusal(self) -> Refusal | None:
        return self.daemon.refusal

    async def command(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        epoch: int | None = None,
        is_planar: bool = True,
    ) -> None:
        await asyncio.sleep(self.daemon.sending_s)
        if self.daemon.is_lost:
            raise HostlinkError("the connection is lost")
        if not is_planar:
            self.daemon.not_planar.append(epoch)
            return
        self.daemon.commands.append((self.name, Twist(linear_m_s, linear_y_m_s, angular_z_rad_s=angular_rad_s), epoch))


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
        self.commands: list[tuple[str, Twist, int | None]] = []
        self.not_planar: list[int | None] = []  # epochs of commands that are not planar
        self.hosts: list[FakeHost] = []
        self.ended = 0
        self.is_lost = False
        self.connecting_s, self.sending_s = 0.01, 0.0
        self.refusal: Refusal | None = None

    @contextlib.asynccontextmanager
    async def connect(self) -> AsyncIterator[Any]:
        await asyncio.sleep(self.connecting_s)
        host = FakeHost(self)
        self.hosts.append(host)
        try:
            yield host
        finally:
            self.ended += 1


class World:
    """A driver whose robot is there."""

    def __init__(self, *, is_updated: bool = True) -> None:
        self.daemon, self.reports, self.warnings = FakeDaemon(), list[str](), list[str]()
        self.driver = VelocityDriver(self.daemon.connect, 50, self.reports.append, self.warnings.append)
        if is_updated:
            self.driver.update(["robot_0"], frozenset())

    def epochs(self, begin: int = 0) -> list[int | None]:
        """Epochs of the commands from this one on."""
        return [epoch for _, _, epoch in self.daemon.commands[begin:]]

    async def stream(self, velocity: Twist, *, key: bytes = b"a", for_s: float = 1.0) -> None:
        for _ in range(round(for_s / 0.1)):
            self.driver.receive(ROUTE, velocity, key)
            await asyncio.sleep(0.1)


@virtual
async def test_stream_of_a_new_publisher_is_commanded_without_an_epoch() -> None:
    world = World()
    async with world.driver.running():
        await world.stream(FORWARD)
    assert world.daemon.commands == [("robot_0", FORWARD, None)] * 10


@pytest.mark.parametrize("x_m_s", [0.0, 0.2])
@virtual
async def test_sideways_velocity_and_one_out_of_the_plane_are_commanded(x_m_s: float) -> None:
    world = World()
    async with world.driver.running():
        sideways = Twist(linear_y_m_s=0.3)
        await world.stream(sideways, for_s=0.2)
        await world.stream(Twist(x_m_s, angular_x_rad_s=0.1), for_s=0.2)
    assert world.daemon.commands == [("robot_0", sideways, None)] * 2
    assert world.daemon.not_planar == [None] * 2


@virtual
async def test_velocity_out_of_the_plane_replaces_no_zero_that_waits() -> None:
    world = World()
    async with world.driver.running():
        await world.stream(FORWARD, for_s=0.3)
        world.driver.receive(ROUTE, Twist(), b"a")
        world.driver.receive(ROUTE, Twist(angular_x_rad_s=0.1), b"a")
        await asyncio.sleep(0.1)
    assert [twist for _, twist, _ in world.daemon.commands] == [FORWARD] * 3 + [Twist()]


@virtual
async def test_velocity_out_of_the_plane_has_the_earlier_epoch_of_its_motion() -> None:
    world = World(is_updated=False)
    world.driver.update(["robot_0"], frozenset({b"a"}))
    async with world.driver.running():
        await world.stream(Twist(angular_x_rad_s=0.1), for_s=0.2)
    assert world.daemon.not_planar == [EARLIER_EPOCH, None]


@virtual
async def test_a_publisher_that_leaves_ends_its_connection_and_no_other() -> None:
    world = World()
    async with world.driver.running():
        for key in (b"a", b"b"):
            world.driver.receive(ROUTE, FORWARD, key)
        await asyncio.sleep(0.1)
        world.driver.update(["robot_0"], frozenset({b"a", b"b"}))
        world.driver.update(["robot_0"], frozenset({b"a"}))
        await asyncio.sleep(0.1)
        assert (len(world.daemon.hosts), world.daemon.ended) == (2, 1)
    assert world.daemon.ended == 2


@virtual
async def test_a_publisher_that_ros_2_never_showed_is_forgotten_after_a_while_and_not_before() -> None:
    world = World()
    async with world.driver.running():
        world.driver.receive(ROUTE, FORWARD, b"a")
        await asyncio.sleep(0.5)
        world.driver.update(["robot_0"], frozenset())
        await asyncio.sleep(0.1)
        assert world.daemon.ended == 0
        await asyncio.sleep(1.0)
        world.driver.update(["robot_0"], frozenset())
        await asyncio.sleep(0.1)
        assert world.daemon.ended == 1


@virtual
async def test_the_end_of_a_topic_is_a_zero() -> None:
    world = World()
    async with world.driver.running():
        with world.driver.driving(ROUTE):
            await world.stream(FORWARD, for_s=0.2)
        await asyncio.sleep(0.1)
    assert world.daemon.commands[-1] == ("robot_0", STANDING, None)


@virtual
async def test_stream_through_a_loss_of_the_connection_continues_with_an_earlier_epoch() -> None:
    world = World()
    async with world.driver.running():
        await world.stream(FORWARD, for_s=0.3)
        world.daemon.hosts[0].changes.append("lost")
        before = len(world.daemon.commands)
        await world.stream(FORWARD, for_s=0.4)
        assert world.epochs(before) == [EARLIER_EPOCH, None, None]  # what waited at the loss is void


@virtual
async def test_first_velocity_on_a_new_connection_has_an_earlier_epoch_before_its_news_come() -> None:
    world = World()
    async with world.driver.running():
        await world.stream(FORWARD, for_s=0.3)
        world.daemon.is_lost = True
        await world.stream(FORWARD, for_s=0.3)
        world.daemon.is_lost = False
        before = len(world.daemon.commands)
        await world.stream(FORWARD, for_s=0.3)
        assert world.epochs(before) == [EARLIER_EPOCH, None, None]


@virtual
async def test_velocity_without_a_connection_keeps_its_earlier_epoch_until_it_is_sent() -> None:
    world = World()
    world.driver.update([], frozenset({b"a"}))
    world.driver.update(["robot_0"], frozenset({b"a"}))
    world.daemon.connecting_s = 1.0
    async with world.driver.running():
        await world.stream(FORWARD, for_s=1.3)
        assert world.epochs() == [EARLIER_EPOCH, None, None]


@pytest.mark.parametrize(("connecting_s", "count"), [(0.4, 1), (2.0, 0)])
@virtual
async def test_velocity_that_waited_a_lease_for_its_connection_is_not_sent(connecting_s: float, count: int) -> None:
    world = World()
    world.daemon.connecting_s = connecting_s
    async with world.driver.running():
        world.driver.receive(ROUTE, FORWARD, b"a")
        await asyncio.sleep(connecting_s + 0.5)
        assert len(world.daemon.commands) == count


@virtual
async def test_zero_that_waits_before_a_velocity_is_sent_and_ends_the_earlier_motion() -> None:
    world = World()
    world.driver.update([], frozenset({b"a"}))
    world.driver.update(["robot_0"], frozenset({b"a"}))
    async with world.driver.running():
        for velocity in (FORWARD, STANDING, FORWARD):
            world.driver.receive(ROUTE, velocity, b"a")
        await asyncio.sleep(0.1)
        assert world.daemon.commands == [("robot_0", STANDING, None), ("robot_0", FORWARD, None)]


@pytest.mark.parametrize("is_restart", [False, True], ids=["device", "bridge"])
@pytest.mark.parametrize("late_s", [0.0, 0.7, MATCH_S - 0.1])
@virtual
async def test_stream_of_before_begins_with_an_earlier_epoch_however_late_ros_2_connects_it(
    late_s: float, *, is_restart: bool
) -> None:
    world = World(is_updated=not is_restart)
    async with world.driver.running():
        if not is_restart:
            world.driver.update([], frozenset({b"a"}))
        world.driver.update(["robot_0"], frozenset({b"a"}))
        await asyncio.sleep(late_s)
        await world.stream(FORWARD, for_s=0.3)
        assert world.epochs() == [EARLIER_EPOCH, None, None]
        await world.stream(FORWARD, key=b"new", for_s=0.1)
        assert world.epochs(3) == [None]


@pytest.mark.parametrize("is_first", [False, True])
@virtual
async def test_publisher_of_before_whose_motion_begins_now_has_no_earlier_epoch(*, is_first: bool) -> None:
    """Two ways to be new: a first sequence number, or silence until every earlier stream would have arrived."""
    world = World()
    async with world.driver.running():
        world.driver.update([], frozenset({b"a"}))
        world.driver.update(["robot_0"], frozenset({b"a"}))
        if not is_first:
            await asyncio.sleep(MATCH_S + 1.0)
        world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(5.0, 1 if is_first else 7))
        await asyncio.sleep(0.1)
    assert world.epochs() == [None]


@pytest.mark.parametrize(("waited_s", "sent"), [(0.3, [FORWARD, STANDING]), (0.6, [])])
@virtual
async def test_velocity_that_waited_for_a_lease_before_it_was_taken_is_dropped(
    waited_s: float, sent: list[Twist]
) -> None:
    world = World()
    async with world.driver.running():
        await asyncio.sleep(1.0)
        for twist in (FORWARD, STANDING):
            world.driver.receive(ROUTE, twist, b"a", came_s=asyncio.get_running_loop().time() - waited_s)
            await asyncio.sleep(0.1)
    assert [twist for _, twist, _ in world.daemon.commands] == sent


@pytest.mark.slow
@virtual
async def test_a_flood_stays_under_the_daemon_s_limit_and_a_stop_waits_for_none_of_it() -> None:
    world = World()
    async with world.driver.running():
        await world.stream(FORWARD, for_s=0.1)
        for number in range(30_000):
            world.driver.receive(ROUTE, Twist(0.001 * (number % 100 + 1)), b"a")
            await asyncio.sleep(0.0001)
        count = len(world.daemon.commands)
        assert count < 3.0 * MAX_COMMANDS_S + 1.1 * MAX_COMMANDS_S
        world.driver.receive(ROUTE, STANDING, b"a")
        await asyncio.sleep(2 / MAX_COMMANDS_S)
        assert world.daemon.commands[-1] == ("robot_0", STANDING, None)


@virtual
async def test_so_many_publishers_may_drive_and_more_are_reported() -> None:
    world = World()
    async with world.driver.running():
        for number in range(MAX_OWNERS + 5):
            world.driver.receive(ROUTE, FORWARD, b"%d" % number)
        await asyncio.sleep(0.1)
        assert len(world.daemon.hosts) == MAX_OWNERS
    assert f"more than {MAX_OWNERS}" in world.reports[0]


@virtual
async def test_refusals_of_a_kind_are_one_warning_at_once_and_one_in_an_interval() -> None:
    world = World()
    async with world.driver.running():
        world.daemon.refusal = Refusal("late", "robot_0: velocity is 0.8 s old")
        await world.stream(FORWARD)
        assert world.warnings == ["robot_0: velocity is 0.8 s old (velocity refused: late)"]
        world.daemon.refusal = Refusal("locked", "locked: smoke")
        await world.stream(FORWARD, for_s=LOG_INTERVAL_S + 1.0)
        assert world.warnings[1:] == ["robot_0: locked: smoke (velocity refused: locked)"] * 2


@pytest.mark.parametrize(("gap_s", "epoch"), [(STALL_S - 0.1, None), (STALL_S + 0.1, EARLIER_EPOCH)])
@virtual
async def test_velocity_after_the_bridge_stood_still_has_an_earlier_epoch(gap_s: float, epoch: int | None) -> None:
    world = World()
    async with world.driver.running():
        await world.stream(FORWARD, for_s=0.2)
        burn(gap_s)
        before = len(world.daemon.commands)
        world.driver.receive(ROUTE, FORWARD, b"a")
        await asyncio.sleep(0.05)
        assert world.epochs(before) == [epoch]


@virtual
async def test_velocities_that_the_middleware_held_meanwhile_drive_nothing_however_late_they_are_passed_on() -> None:
    """The publisher's clock differs from this one's by 1,000 s."""
    world, loop = World(), asyncio.get_running_loop()
    async with world.driver.running():
        for _ in range(3):
            world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(loop.time() + 1000.0))
            await asyncio.sleep(0.1)
        held_s = loop.time() + 1000.0
        burn(2.0)
        before = len(world.daemon.commands)
        for _ in range(3):  # the second one is taken after the lease of the first
            world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(held_s))
            await asyncio.sleep(STALL_S - 0.1)
        assert world.daemon.commands[before:] == []
        world.driver.receive(ROUTE, Twist(), b"a", sent=Sent(held_s))
        await asyncio.sleep(0.1)
        world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(loop.time() + 1000.0))
        await asyncio.sleep(0.1)
        assert [twist for _, twist, _ in world.daemon.commands[before:]] == [Twist(), FORWARD]


@pytest.mark.parametrize(
    ("silent_s", "missing", "epoch"),
    [
        pytest.param(LEASE_S + 0.2, 0, None, id="paused"),
        pytest.param(LEASE_S + 0.2, 3, EARLIER_EPOCH, id="the middleware lost what came between"),
        pytest.param(HELD_S + 0.2, 3, None, id="long after"),
    ],
)
@virtual
async def test_arrivals_show_no_pause_of_a_publisher_after_the_bridge_stood_still(
    silent_s: float, missing: int, epoch: int | None
) -> None:
    """The middleware passes on nothing for longer than a lease, and the publisher's numbers say whether it paused."""
    world, loop = World(), asyncio.get_running_loop()
    async with world.driver.running():
        world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(loop.time() + 1000.0, 1))
        await asyncio.sleep(0.1)
        burn(STALL_S + 0.1)
        await asyncio.sleep(silent_s)
        before = len(world.daemon.commands)
        world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(loop.time() + 1000.0, 2 + missing))
        await asyncio.sleep(0.1)
        assert world.epochs(before) == [epoch]


@virtual
async def test_stream_whose_held_velocities_took_a_lease_to_arrive_is_the_stream_from_before() -> None:
    world, loop = World(), asyncio.get_running_loop()
    async with world.driver.running():
        began_s = loop.time() + 1000.0
        world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(began_s, 1))
        await asyncio.sleep(0.1)
        burn(2.0)
        before = len(world.daemon.commands)
        for number in range(2, 20):  # the middleware passes them on one after another
            world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(began_s + 0.1 * number, number))
            await asyncio.sleep(0.05)
        world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(loop.time() + 1000.0, 30))
        await asyncio.sleep(0.1)
        assert world.epochs(before)[:1] == [EARLIER_EPOCH]


@virtual
async def test_stream_from_before_is_known_although_its_first_velocity_waited_too_long_to_be_sent() -> None:
    world, loop = World(), asyncio.get_running_loop()
    async with world.driver.running():
        await world.stream(FORWARD, for_s=0.2)
        world.daemon.sending_s = STALL_S + LEASE_S + 0.2
        world.driver.receive(ROUTE, FORWARD, b"a")  # the connection takes nothing meanwhile
        await asyncio.sleep(0.01)
        burn(STALL_S + 0.1)
        world.driver.receive(ROUTE, FORWARD, b"a")
        world.daemon.sending_s = 0.0
        await asyncio.sleep(LEASE_S + 0.2)
        before = len(world.daemon.commands)
        world.driver.receive(ROUTE, FORWARD, b"a", came_s=loop.time())
        await asyncio.sleep(0.1)
        assert world.epochs(before) == [EARLIER_EPOCH]


@virtual
async def test_publisher_whose_clock_is_set_back_drives_on() -> None:
    world, loop = World(), asyncio.get_running_loop()
    async with world.driver.running():
        for clock_s in (1000.0, -5000.0):
            world.driver.receive(ROUTE, FORWARD, b"a", sent=Sent(loop.time() + clock_s))
            await asyncio.sleep(0.1)
    assert world.daemon.commands == [("robot_0", FORWARD, None)] * 2
