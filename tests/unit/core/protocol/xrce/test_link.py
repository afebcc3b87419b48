"""A stock board and a session over a link that loses, doubles and overtakes, and restarts of either side. Virtual time.

The board publishes an Odometry and an Imu at 50 Hz reliably, each publish blocks until it is acknowledged, and the host
sends a velocity at 20 Hz. Measured with a host that only acknowledges: 60 publishes in 12 s at a loss of 5 %, the
longest 1.2 s, and velocities of 0.9 s of age.
"""

import math
from dataclasses import dataclass
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL, MICRO_ROS_TCP, MICRO_ROS_UDP, Xrce
from tests.support.xrce_board import Datagrams, Lengths, Link, Serial, Stock
from tests.support.xrce_drive import CATALOG, Drive, played, resumed


def test_without_loss_nothing_is_sent_twice_and_no_publish_waits() -> None:
    drive = played(1)
    assert drive.client.resent == 0
    assert drive.world.session.quality.resent == 0
    assert max(each.took_s for each in drive.published()) < 0.01
    assert len(drive.published()) > 750


@pytest.mark.slow
def test_at_a_loss_of_20_percent_a_board_creates_its_objects() -> None:
    """A board without code to reconnect ends in an error loop after one status that did not come within a second."""
    failed = []
    for seed in range(60):
        drive = Drive(Link(Random(seed), loss=0.2))
        while not (drive.board.is_running or drive.board.failed_at):
            drive.world.run(drive.world.now_s + 0.5)
        failed += [drive.board.failed_at] if drive.board.failed_at else []
    assert failed == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_at_a_loss_of_5_percent_no_publish_blocks_and_no_velocity_is_old(seed: int) -> None:
    drive = played(seed, loss=0.05)
    assert all(each.is_done for each in drive.published())
    assert max(each.took_s for each in drive.published()) <= 0.3
    assert len(drive.published()) > 400
    assert drive.ages_s[int(len(drive.ages_s) * 0.99)] < 0.25


@pytest.mark.slow
def test_at_a_loss_of_20_percent_publishes_go_on_and_no_velocity_is_old() -> None:
    """One drive has 150 velocities, of which two decide its 99th percentile: it is that of ten drives."""
    ages_s: list[float] = []
    for seed in range(10):
        drive = played(seed, loss=0.2)
        published = drive.published()
        assert sum(not each.is_done for each in published) <= 0.02 * len(published)
        assert len(published) > 120
        ages_s += drive.ages_s
    assert sorted(ages_s)[int(len(ages_s) * 0.99)] < 0.6  # the middleware keeps four while a publish waits


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


@pytest.mark.parametrize("loss", [0.0, 0.05])
@pytest.mark.parametrize("hang_s", [0.3, 1.0, 2.2, 4.0])
def test_board_whose_loop_hung_takes_the_zero_that_was_sent_meanwhile(hang_s: float, loss: float) -> None:
    """After the hang the board reads all at once, and its middleware drops what finds no place."""
    drive = Drive(Link(Random(7), loss=loss))
    drive.board.hangs_at_s, drive.board.hangs_for_s = 2.0, hang_s
    drive.stop_at(2.0 + 0.7 * hang_s)
    drive.world.run(12.0)
    assert drive.stood_s < 0.3 * hang_s + 0.5


@pytest.mark.parametrize("turn_s", [0.05, 0.1, 0.15, 0.25, 0.4])
@pytest.mark.parametrize("stops_at_s", [4.0, 4.13, 4.29])
def test_board_with_a_slow_loop_stops(turn_s: float, stops_at_s: float) -> None:
    drive = Drive(Link(Random(3)), turn_s=turn_s, period_s=turn_s)
    drive.stop_at(stops_at_s)
    drive.world.run(12.0)
    assert drive.stood_s < 6 * turn_s + 0.1


@dataclass
class BestEffort(Stock):
    """A board that publishes without acknowledgements: it waits in no publish, and reads a message a turn."""

    is_reliable: bool = False


TURNS = ((0.0, 0), (0.05, 10), (0.1, 3), (0.15, 3), (0.2, 3), (0.3, 3), (0.5, 6))  # seconds, and how many after a stop


@pytest.mark.parametrize("command_s", [0.02, 0.05])
@pytest.mark.parametrize(
    ("kind", "period_s", "stops_at_s", "turn_s", "turns"),
    [
        *(pytest.param(BestEffort, 0.02, 8.0, *turn, id=f"best effort-{turn[0]}") for turn in TURNS),
        *(pytest.param(BestEffort, math.inf, 8.0, *turn, id=f"silent-{turn[0]}") for turn in TURNS),
        # The velocities that wait after a board's only publish take twenty turns.
        *(
            pytest.param(Stock, math.inf, 20.0, *turn, id=f"published once-{turn[0]}")
            for turn in TURNS
            if turn[0] < 0.3
        ),
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_board_without_acknowledgements_and_with_a_slow_loop_stops(
    seed: int, kind: type[Stock], period_s: float, stops_at_s: float, turn_s: float, turns: int, command_s: float
) -> None:
    """Velocities that wait on the board move it after a stop: few of them wait."""
    link = Link(Random(seed), delay_s=(0.0005, 0.003))
    drive = Drive(link, turn_s=turn_s, period_s=period_s, command_s=command_s, kind=kind)
    drive.stop_at(stops_at_s)
    drive.world.run(stops_at_s + 6.0)
    assert drive.stood_s <= turns * turn_s + 0.1
    taken = drive.taken_since(stops_at_s - 6.0) - drive.taken_since(stops_at_s)
    assert taken >= 6.0 * 0.6 * min(1 / command_s, 1 / max(turn_s, 0.02))


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


@pytest.mark.slow
@given(st.integers(0, 1000), st.floats(0.0, 2.0), st.sampled_from([0.0, 0.05, 0.2]), st.floats(0.0, 2.0))
def test_board_that_restarts_at_any_time_is_usable(seed: int, at_s: float, loss: float, away_s: float) -> None:
    drive = Drive(Link(Random(seed), loss), has_reconnect=True)
    drive.restart_board(at_s, away_s)
    drive.world.run(at_s + away_s + 0.1)
    drive.run_until_usable(20.0)


@pytest.mark.slow
@example(seed=767, at_s=0.375, loss=0.0, away_s=3.0, has_state=True)  # its history is full, and commands go on
@given(st.integers(0, 1000), st.floats(0.0, 2.0), st.sampled_from([0.0, 0.05, 0.2]), st.floats(0.0, 3.0), st.booleans())
def test_host_that_restarts_at_any_time_drives_the_board_again(
    seed: int, at_s: float, loss: float, away_s: float, has_state: bool
) -> None:
    drive = Drive(Link(Random(seed), loss), has_reconnect=True)
    drive.restart_host(at_s, away_s, has_state=has_state)
    drive.world.run(at_s + away_s + 0.1)
    drive.run_until_usable(25.0)


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
    drive.run_until_usable(1.0)
