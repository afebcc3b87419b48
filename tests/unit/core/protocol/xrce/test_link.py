"""A stock board and a session over a link that loses, doubles and overtakes, and restarts of either side. Virtual time.

The board publishes an Odometry and an Imu at 50 Hz reliably, each publish blocks until it is acknowledged, and the host
sends a velocity at 20 Hz. Measured with a host that only acknowledges: 60 publishes in 12 s at a loss of 5 %, the
longest 1.2 s, and velocities of 0.9 s of age.
"""

import contextlib
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL, MICRO_ROS_TCP, MICRO_ROS_UDP, Xrce
from hostlink.core.protocol.xrce.session import XrceSession
from hostlink.errors import HostlinkError
from tests.support.xrce_board import TWIST, Client, Datagrams, Lengths, Link, Program, Published, Serial, Stock, World

CATALOG = Catalog()
COMMAND_S = 0.05
KEY = (0x01020304).to_bytes(4)


def cdr(name: str, message: dict[str, object]) -> bytes:
    type_ = CATALOG.message(name)
    assert type_ is not None
    return cdr_of(type_).from_ros1(type_.encode(message))


ODOMETRY = cdr("nav_msgs/Odometry", {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"})
IMU = cdr("sensor_msgs/Imu", {"header": {"frame_id": "imu_link"}})


class Drive:
    """A board that drives: each velocity has the time at which it was commanded."""

    def __init__(
        self,
        link: Link,
        *,
        has_reconnect: bool = False,
        turn_s: float = 0.0,
        period_s: float = 0.02,
        session: XrceSession | None = None,
        transport: Datagrams | None = None,
        damage: float = 0.0,
    ) -> None:
        self.client = Client(key=KEY)
        self.board = Stock(self.client, ODOMETRY, IMU, restarts=has_reconnect, turn_s=turn_s, period_s=period_s)
        session = session or MICRO_ROS_UDP.session(CATALOG)
        self.world = World(session, self.board.run(), self.client, link, transport, damage)
        self.world.at(0.0, self._command)

    def _command(self) -> None:
        world = self.world
        if world.is_host_there and world.session.topics:
            with contextlib.suppress(HostlinkError):
                world.session.publish("/cmd_vel", TWIST.pack(world.now_s, 0, 0, 0, 0, 0), is_urgent=True)
            world.write()
        world.at(world.now_s + COMMAND_S, self._command)

    @property
    def ages_s(self) -> list[float]:
        """Ages of the velocities when the board took them, sorted."""
        return sorted(at_s - commanded_s for at_s, commanded_s in self.board.taken)

    def published(self, since_s: float = 0.0) -> list[Published]:
        return [each for each in self.board.published if each.at_s >= since_s]

    def taken_since(self, since_s: float) -> int:
        return sum(at_s >= since_s for at_s, _ in self.board.taken)


def played(seed: int, seconds: float = 8.0, *, turn_s: float = 0.0, period_s: float = 0.02, **faults: float) -> Drive:
    drive = Drive(Link(Random(seed), **faults), turn_s=turn_s, period_s=period_s)  # type: ignore[arg-type]
    drive.world.run(seconds)
    assert drive.board.is_running, drive.board.failed_at
    return drive


def test_without_loss_nothing_is_sent_twice_and_no_publish_waits() -> None:
    drive = played(1)
    assert drive.client.resent == 0
    assert drive.world.session.resent == 0
    assert max(each.took_s for each in drive.published()) < 0.01
    assert len(drive.published()) > 750


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_at_a_loss_of_5_percent_no_publish_blocks_and_no_velocity_is_old(seed: int) -> None:
    drive = played(seed, loss=0.05)
    assert all(each.is_done for each in drive.published())
    assert max(each.took_s for each in drive.published()) <= 0.3
    assert len(drive.published()) > 400
    assert drive.ages_s[int(len(drive.ages_s) * 0.99)] < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_at_a_loss_of_20_percent_publishes_go_on_and_no_velocity_is_old(seed: int) -> None:
    drive = played(seed, loss=0.2)
    published = drive.published()
    assert sum(not each.is_done for each in published) <= 0.02 * len(published)
    assert len(published) > 120
    assert drive.ages_s[int(len(drive.ages_s) * 0.99)] < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_doubled_and_overtaken_datagrams_cost_no_more_than_the_publish_that_the_client_forgets(seed: int) -> None:
    drive = played(seed, loss=0.05, doubles=0.05, overtakes=0.05)
    published = drive.published()
    assert sum(not each.is_done for each in published) <= drive.client.old_acknacks
    assert len(published) > 300
    assert drive.ages_s[int(len(drive.ages_s) * 0.99)] < 0.25


@pytest.mark.slow
def test_board_with_a_slow_loop_gets_velocities_that_are_at_most_two_turns_old() -> None:
    drive = played(1, 12.0, turn_s=0.1, period_s=0.1)
    assert all(each.is_done for each in drive.published())
    assert drive.ages_s[int(len(drive.ages_s) * 0.99)] < 0.25
    assert drive.world.session.round_trip_s is not None


@pytest.mark.parametrize(
    ("protocol", "transport"),
    [(MICRO_ROS_UDP, Datagrams), (MICRO_ROS_TCP, Lengths), (MICRO_ROS_SERIAL, Serial)],
    ids=["udp", "tcp", "serial"],
)
def test_board_drives_over_each_transport(protocol: Xrce, transport: type[Datagrams]) -> None:
    drive = Drive(Link(Random(1)), session=protocol.session(CATALOG), transport=transport())
    drive.world.run(3.0)
    assert len(drive.published()) > 200
    assert all(each.is_done for each in drive.published())
    assert drive.taken_since(1.0) > 30
    counts = drive.world.session.counts
    assert (counts.skipped_bytes, counts.malformed, drive.world.session.rejected) == (0, 0, {})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_damaged_serial_line_costs_frames_and_no_publish(seed: int) -> None:
    drive = Drive(Link(Random(seed)), session=MICRO_ROS_SERIAL.session(CATALOG), transport=Serial(), damage=0.05)
    drive.world.run(8.0)
    assert drive.board.is_running, drive.board.failed_at
    assert all(each.is_done for each in drive.published())
    assert len(drive.published()) > 400
    assert drive.world.session.bad_checksums > 0
    assert drive.ages_s[int(len(drive.ages_s) * 0.99)] < 0.25


def usable(drive: Drive, within_s: float) -> None:
    """Let both sides live until the board publishes and takes velocities again, on all of its topics."""
    world, since_s = drive.world, drive.world.now_s

    def is_usable() -> bool:
        names = {each.name for each in world.session.topics}
        is_publishing = any(each.is_done for each in drive.published(since_s))
        return (
            is_publishing and drive.taken_since(since_s) > 0 and names == {"/odom/unfiltered", "/imu/data", "/cmd_vel"}
        )

    while not is_usable():
        assert world.now_s < since_s + within_s, (drive.board.failed_at, world.session.topics)
        world.run(world.now_s + 0.2)


def resumed(session: XrceSession) -> XrceSession:
    """A session that continues from what the earlier one had stored."""
    return MICRO_ROS_UDP.resumed(CATALOG, session.memory())


@pytest.mark.slow
@given(st.integers(0, 1000), st.floats(0.0, 2.0), st.sampled_from([0.0, 0.05, 0.2]), st.floats(0.0, 2.0))
def test_board_that_restarts_at_any_time_is_usable(seed: int, at_s: float, loss: float, away_s: float) -> None:
    drive = Drive(Link(Random(seed), loss), has_reconnect=True)
    world = drive.world

    def restart() -> None:
        before = drive.board
        client = Client(key=b"boot")
        drive.board = Stock(client, ODOMETRY, IMU, restarts=True, begun=0x0A0B0C0D, taken=before.taken)
        world.restart_board(client, drive.board.run())

    world.at(at_s, lambda: world.restart_board(Client(key=KEY), off()))
    world.at(at_s + away_s, restart)
    world.run(at_s + away_s + 0.1)
    usable(drive, 20.0)


def off() -> Program:
    """The program of a board that is off."""
    while True:
        yield -1e9


@pytest.mark.slow
@example(seed=767, at_s=0.375, loss=0.0, away_s=3.0, has_state=True)  # its history is full, and commands go on
@given(st.integers(0, 1000), st.floats(0.0, 2.0), st.sampled_from([0.0, 0.05, 0.2]), st.floats(0.0, 3.0), st.booleans())
def test_host_that_restarts_at_any_time_drives_the_board_again(
    seed: int, at_s: float, loss: float, away_s: float, has_state: bool
) -> None:
    drive = Drive(Link(Random(seed), loss), has_reconnect=True)
    world = drive.world

    def restart() -> None:
        session = resumed(world.session) if has_state else MICRO_ROS_UDP.session(CATALOG)
        world.restart_host(session, away_s=away_s)

    world.at(at_s, restart)
    world.run(at_s + away_s + 0.1)
    usable(drive, 25.0)


@pytest.mark.parametrize("seed", range(2))
def test_board_without_code_to_reconnect_drives_again_within_two_seconds(seed: int) -> None:
    drive = Drive(Link(Random(seed), 0.02))
    world = drive.world
    world.run(3.0)
    assert drive.board.is_running
    world.restart_host(resumed(world.session), away_s=1.0)
    world.run(8.0)
    back_s = 4.0
    assert min(at_s for at_s, _ in drive.board.taken if at_s > back_s) < back_s + 2.0
    assert sum(not each.is_done for each in drive.published(2.9)) <= 2
    usable(drive, 1.0)
