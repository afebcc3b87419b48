"""A micro-ROS board that drives while its host is killed or hangs: what it takes ends in zero, and in time.

The board publishes an Odometry and an Imu reliably at 50 Hz, and blocks in each publish. The guardian's code runs in
virtual time; tests/system has the same with processes.
"""

import contextlib
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL, MICRO_ROS_TCP, MICRO_ROS_UDP, Xrce
from hostlink.errors import HostlinkError
from tests.support.xrce_board import TWIST, Client, Datagrams, Lengths, Link, Serial, Stock
from tests.support.xrce_guarded import GuardedWorld

CATALOG = Catalog()
COMMAND_S = 0.05
LIMIT_S = 0.15
BEGUN_S = 2.0
BY_STREAM = {stream: Xrce.on("udp", velocity_stream=stream) for stream in (0x00, 0x01)}


def cdr(name: str, message: dict[str, object]) -> bytes:
    type_ = CATALOG.message(name)
    assert type_ is not None
    return cdr_of(type_).from_ros1(type_.encode(message))


ODOMETRY = cdr("nav_msgs/Odometry", {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"})
IMU = cdr("sensor_msgs/Imu", {"header": {"frame_id": "imu_link"}})


class Drive:
    """A board that is driven at 20 Hz until its host is gone."""

    def __init__(
        self, link: Link, protocol: Xrce = MICRO_ROS_UDP, transport: Datagrams | None = None, *, turn_s: float = 0.0
    ) -> None:
        self.client = Client(key=b"\1\2\3\4")
        self.board = Stock(self.client, ODOMETRY, IMU, turn_s=turn_s, keeps=4)
        session = protocol.session(CATALOG)
        self.world = GuardedWorld(session, self.board.run(), self.client, link, transport)
        self.world.at(0.0, self._command)
        self.world.run(BEGUN_S)
        assert self.board.taken
        self.stop = self.world.stop_frames()

    def _command(self) -> None:
        world = self.world
        if world.is_host_there:
            with contextlib.suppress(HostlinkError):
                world.session.publish("/cmd_vel", TWIST.pack(0.2, 0, 0, 0, 0, 0.5), is_urgent=True)
            world.write()
        world.at(world.now_s + COMMAND_S, self._command)

    def stood_after_s(self, since_s: float) -> float:
        """Return how long after that the board took its last velocity; infinite if that was no zero."""
        taken = self.board.taken
        if taken[-1][1]:
            return float("inf")
        moving = max((number for number, (_, speed) in enumerate(taken) if speed), default=-1)
        return max(0.0, taken[moving + 1][0] - since_s)


def killed(drive: Drive, after_s: float) -> float:
    """Kill the host in the middle of a drive. Return how long after that the board stood."""
    at_s = drive.world.now_s + after_s
    drive.world.run(at_s)
    drive.world.kill(drive.stop)
    drive.world.run(at_s + 5.0)
    return drive.stood_after_s(at_s)


@pytest.mark.slow
@given(st.floats(0.0, 0.1), st.integers(0, 1000))
def test_board_inside_a_reliable_publish_takes_a_zero_in_time_after_a_kill(after_s: float, seed: int) -> None:
    assert killed(Drive(Link(Random(seed))), after_s) < LIMIT_S


@pytest.mark.parametrize("after_s", [0.0, 0.0065, 0.013])
@pytest.mark.parametrize(
    ("protocol", "transport"), [(MICRO_ROS_TCP, Lengths), (MICRO_ROS_SERIAL, Serial), (BY_STREAM[1], Datagrams)]
)
def test_board_on_each_transport_and_stream_takes_a_zero_in_time_after_a_kill(
    protocol: Xrce, transport: type[Datagrams], after_s: float
) -> None:
    assert killed(Drive(Link(Random(1)), protocol, transport()), after_s) < LIMIT_S


@pytest.mark.slow
@given(st.floats(0.0, 0.1), st.integers(0, 1000))
def test_board_whose_message_was_read_and_not_acknowledged_takes_a_zero_in_time(after_s: float, seed: int) -> None:
    """The daemon is killed with the answer in its memory: the client asks for it after 100 ms without a message."""
    drive = Drive(Link(Random(seed)))
    drive.world.run(BEGUN_S + after_s)
    receive = drive.world._to_host

    def read_and_die(message: bytes) -> None:
        if drive.world.is_host_there and message[1] == 0x80:
            drive.world.session.receive(message, now_s=drive.world.now_s)
            drive.world.kill(drive.stop)
            killed_s.append(drive.world.now_s)
        else:
            receive(message)

    killed_s: list[float] = []
    drive.world._to_host = read_and_die  # type: ignore[method-assign]
    drive.world.run(BEGUN_S + after_s + 3.0)
    assert drive.stood_after_s(killed_s[0]) < LIMIT_S


@pytest.mark.slow
@given(st.floats(0.0, 0.1), st.integers(0, 10_000), st.sampled_from([0x00, 0x01]))
def test_board_with_a_bad_radio_ends_at_zero(after_s: float, seed: int, stream: int) -> None:
    """20 % are lost each way, others are doubled or overtaken."""
    drive = Drive(Link(Random(seed)), BY_STREAM[stream])
    link = drive.world.link
    link.loss, link.doubles, link.overtakes = 0.2, 0.05, 0.05
    assert killed(drive, 0.5 + after_s) < 4.2  # four publishes fail, each after a second: one of a thousand worlds


@pytest.mark.slow
@given(st.floats(0.0, 0.1), st.integers(0, 1000), st.sampled_from([0.0, 0.03, 0.1]))
def test_board_of_a_host_that_hangs_stands_in_time_and_continues_with_it(
    after_s: float, seed: int, turn_s: float
) -> None:
    """The guardian writes zeros after a second, and answers what it looks at. The host reads all of it afterwards."""
    drive = Drive(Link(Random(seed)), turn_s=turn_s)
    drive.world.run(BEGUN_S + after_s)
    drive.world.hang(drive.stop, 1.6)
    drive.world.run(BEGUN_S + after_s + 1.6)
    assert drive.stood_after_s(BEGUN_S + after_s) < 1.0 + LIMIT_S + 4 * turn_s  # it keeps four messages
    drive.world.run(BEGUN_S + after_s + 4.0)
    assert drive.board.is_running
    assert drive.board.taken[-1][1] > 0.0
    assert all(each.is_done for each in drive.board.published[-5:])
