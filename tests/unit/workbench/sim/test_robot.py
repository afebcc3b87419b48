"""The simulated robot: the firmware in real time, its faults, and what happens to its line."""

import math

import pytest

from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import COMMAND_S, FirmwareWorld, RobotKind
from hostlink.workbench.sim.robot import FAULTS, SimulatedRobot
from hostlink.workbench.sim.run import world_of
from tests.support.virtual_device import TWIST

STEP_S = 0.005
RUN_S = 4.0
ODOMETRY_ID, PLOT_ID = 125, 126
FOREVER_S = 30.0


class Track:
    """A robot on its line, a host that answers with the time, and a clock."""

    def __init__(self, robot: SimulatedRobot | None = None) -> None:
        self.robot = SimulatedRobot("robot_0") if robot is None else robot
        self.now_s = 1000.0
        self.frames: list[Frame] = []
        self._stream = FrameStream()
        self.robot.advance(self.now_s)
        self.connect()

    def connect(self) -> None:
        self.robot.send(TOPICS_REQUEST)
        self.run(1.0)

    def run(self, seconds: float, command: bytes = b"") -> None:
        for step in range(round(seconds / STEP_S)):
            if step % round(COMMAND_S / STEP_S) == 0:
                self.robot.send(command)
            self.now_s += STEP_S
            for item in self._stream.feed(self.robot.advance(self.now_s)):
                if isinstance(item, Frame):
                    self.frames.append(item)
                    if item.topic_id == Id.TIME:
                        self.robot.send(encode(Id.TIME, bytes(8)))

    def count(self, topic_id: int) -> int:
        return sum(frame.topic_id == topic_id for frame in self.frames)


def velocity(linear: float, angular: float = 0.0) -> bytes:
    return encode(100, TWIST.pack(linear, 0, 0, 0, 0, angular))


def test_robot_with_a_host_drives_publishes_and_stands_without_commands() -> None:
    track = Track()
    assert track.robot.is_configured
    track.frames.clear()
    track.run(RUN_S, velocity(0.2))
    assert track.robot.speed_m_s == pytest.approx(0.2, rel=0.1)
    assert track.robot.world.odometry.x_m == pytest.approx(track.robot.world.x_m, abs=0.01)
    assert track.count(ODOMETRY_ID) == pytest.approx(10 * RUN_S, abs=1)
    assert track.count(PLOT_ID) == pytest.approx(10 * RUN_S, abs=1)
    track.run(1.0)
    assert track.robot.speed_m_s == 0.0
    assert [wheel.pwm for wheel in track.robot.world.wheels] == [0, 0]


def test_robot_whose_process_was_late_ran_on_and_has_stopped_by_its_watchdog() -> None:
    track = Track()
    track.run(RUN_S, velocity(0.2))
    before_m = track.robot.world.x_m
    track.now_s += 5.0
    track.robot.advance(track.now_s)
    assert track.robot.speed_m_s == 0.0
    assert 0.05 < track.robot.world.x_m - before_m < 0.2


def test_quiet_robot_sends_nothing_before_its_next_turn() -> None:
    """And between its turns it is quiet, or bytes are on its line."""
    track = Track()
    track.run(3.0)
    quiet_s = []
    for _ in range(100):
        quiet_s.append(track.robot.quiet_s)
        if track.robot.quiet_s > 0.002:
            track.now_s += track.robot.quiet_s - 0.0015  # what has passed of a millisecond counts when it is over
            assert track.robot.advance(track.now_s) == b""
        track.run(STEP_S)
    assert max(quiet_s) > 0.02
    assert 0.0 in quiet_s
    assert max(quiet_s) < 0.035


def test_bytes_that_a_robot_receives_end_its_quiet() -> None:
    track = Track()
    while track.robot.quiet_s < 0.01:
        track.run(STEP_S)
    track.robot.send(velocity(0.0))
    assert track.robot.quiet_s == 0.0


def test_same_time_twice_changes_nothing() -> None:
    track = Track()
    row = track.robot.world.row
    assert track.robot.advance(track.now_s) == b""
    assert track.robot.world.row == row


def test_cut_line_loses_what_was_on_it_both_ways() -> None:
    track = Track()
    track.run(RUN_S, velocity(0.2))
    track.robot.send(velocity(0.0))
    track.robot.cut()
    track.now_s += 0.1
    track.robot.advance(track.now_s)
    assert track.robot.speed_m_s > 0.1


def test_reboot_begins_odometry_anew_where_the_robot_stands() -> None:
    track = Track()
    track.run(RUN_S, velocity(0.2))
    track.robot.reboot()
    assert not track.robot.is_configured
    assert track.robot.world.odometry == (0.0, 0.0, 0.0)
    track.run(1.0, velocity(0.2))
    assert track.robot.speed_m_s == 0.0
    stood_m = track.robot.world.x_m
    assert stood_m > 0.2
    track.connect()
    track.run(RUN_S, velocity(0.2))
    assert track.robot.world.odometry.x_m == pytest.approx(track.robot.world.x_m - stood_m, abs=0.01)


@pytest.mark.parametrize(("rate", "messages"), [(1.0, 100), (1.25, 125)])
def test_board_with_a_fast_clock_publishes_more_often(rate: float, messages: int) -> None:
    track = Track(SimulatedRobot("robot_0", clock_rate=rate))
    track.frames.clear()
    track.run(10.0)
    assert track.count(ODOMETRY_ID) == pytest.approx(messages, abs=2)


@pytest.mark.parametrize(("fault", "number"), [("stalled_wheel", 11), ("runaway_wheel", 21)])
def test_fault_of_a_wheel_stops_the_robot_once_it_is_driven(fault: str, number: int) -> None:
    track = Track()
    FAULTS[fault].break_wheel(track.robot.world.wheels[0])
    track.run(2.0)
    track.frames.clear()
    track.run(RUN_S, velocity(0.1))
    assert [wheel.pwm for wheel in track.robot.world.wheels] == [0, 0]
    numbers = [frame.payload[-2] for frame in track.frames if frame.topic_id == 128 and frame.payload[8:]]
    assert number in numbers


def test_robots_of_a_fleet_slip_each_in_its_own_way() -> None:
    drawn = WorldParameters({"left.slip_noise_m": 0.01, "right.slip_noise_m": 0.01})
    headings = set()
    for number in (0, 1, 0):
        track = Track(SimulatedRobot("robot_0", world=world_of(number, drawn)))
        track.run(RUN_S, velocity(0.2))
        headings.add(track.robot.world.theta_rad)
    assert len(headings) == 2


def speeds(kind: RobotKind, wanted_m_s: float, *, from_m_s: float = 0.0) -> list[float]:
    """The true speed each 10 ms after the command of a new one, of a robot that had the other for a while."""
    robot = FirmwareWorld(kind=kind)
    robot.connect()
    robot.drive(from_m_s, 0.0, RUN_S)
    robot.drive(wanted_m_s, 0.0, RUN_S, sample_s=0.01)
    assert not robot.trace["left_fault"].any()
    return list(robot.trace["left_ticks_s"] * math.tau * 0.045 / 230.4)


def rise_s(measured: list[float], begin_m_s: float, end_m_s: float) -> float:
    """Until nine tenths of the way."""
    way_m_s = abs(end_m_s - begin_m_s)
    return next((0.01 * at for at, speed in enumerate(measured) if abs(speed - begin_m_s) >= 0.9 * way_m_s), FOREVER_S)


@pytest.mark.parametrize(("begin_m_s", "end_m_s", "most_s"), [(0.0, 0.15, 0.36), (0.1, 0.2, 0.36), (0.15, -0.15, 0.75)])
def test_nimble_robot_is_at_a_new_speed_soon_and_reverses_after_a_standstill(
    begin_m_s: float, end_m_s: float, most_s: float
) -> None:
    measured = speeds(RobotKind.NIMBLE, end_m_s, from_m_s=begin_m_s)
    assert rise_s(measured, begin_m_s, end_m_s) < most_s
    assert max(map(abs, measured)) < 1.05 * max(abs(begin_m_s), abs(end_m_s))
    assert all(speed == pytest.approx(end_m_s, rel=0.03) for speed in measured[-200:])


def test_paper_s_robot_takes_its_time() -> None:
    assert rise_s(speeds(RobotKind.PAPER, 0.15), 0.0, 0.15) > 1.5
