"""Simulated robots of other drives than the firmware's: what they obey, how they move, and what they report."""

import math
import struct

import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import decode_topic_info, encode_time
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.workbench.sim.kinematic_robot import (
    ACKERMANN,
    ACKERMANN_ID,
    DRIVES,
    MAX_WHEEL_M_S,
    ODOMETRY_ID,
    SILENCE_S,
    TIME_INTERVAL_S,
    TWIST_ID,
    WATCHDOG_S,
    KinematicRobot,
)

Odometry = dict[str, object]


class Bench:
    """A robot and its host, with a clock."""

    def __init__(self, kinematics: str) -> None:
        self.robot = KinematicRobot("robot_0", DRIVES[kinematics])
        self.now_s = 50.0
        self.frames: list[Frame] = []
        self._stream = FrameStream(limit_bytes=2048)
        self.run(0.0)
        self.robot.send(encode(Id.PUBLISHER, b""))

    def run(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / 0.02))):
            self.now_s += 0.02 if seconds else 0.0
            self.frames += [
                found for found in self._stream.feed(self.robot.advance(self.now_s)) if isinstance(found, Frame)
            ]

    def drive(self, velocity: PlanarVelocity, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            self.robot.send(encode(TWIST_ID, velocity.encode()))
            self.run(0.1)

    def payloads(self, topic_id: int) -> list[bytes]:
        return [frame.payload for frame in self.frames if frame.topic_id == topic_id]

    @property
    def topics(self) -> dict[str, DeviceEndpoint]:
        infos = [
            decode_topic_info(EndpointKind(frame.topic_id), frame.payload)
            for frame in self.frames
            if frame.topic_id in (Id.PUBLISHER, Id.SUBSCRIBER)
        ]
        return {info.name: info for info in infos if info is not None}


def numbers(payload: bytes) -> tuple[tuple[int, ...], tuple[float, ...], tuple[float, ...]]:
    """Stamp, pose and twist of a message of odometry."""
    at = 12
    for _ in range(2):
        at += 4 + int.from_bytes(payload[at : at + 4], "little")
    pose, twist = struct.unpack_from("<7d", payload, at), struct.unpack_from("<6d", payload, at + 56 + 288)
    assert len(payload) == at + 56 + 288 + 48 + 288
    return struct.unpack_from("<3I", payload), pose, twist


@pytest.mark.parametrize("kinematics", DRIVES)
def test_topics_have_the_sums_of_their_types(kinematics: str) -> None:
    bench, catalog = Bench(kinematics), Catalog()
    bench.run(0.1)
    found = bench.topics
    car = {"robot_0/ackermann_cmd"} if kinematics == "ackermann" else set()
    assert set(found) == {"robot_0/odom", "robot_0/cmd_vel"} | car
    for name in ("robot_0/odom", "robot_0/cmd_vel"):
        message = catalog.message(found[name].type)
        assert message is not None
        assert found[name].md5 == message.md5


@pytest.mark.parametrize("kinematics", DRIVES)
def test_robot_drives_as_commanded_and_reports_it(kinematics: str) -> None:
    bench = Bench(kinematics)
    velocity = PlanarVelocity(0.2, 0.15 if DRIVES[kinematics].has_y else 0.0, 0.3)
    bench.drive(velocity, 2.0)
    _, (x_m, y_m, _, _, _, sin, cos), twist = numbers(bench.payloads(ODOMETRY_ID)[-1])
    assert twist == pytest.approx((velocity.x_m_s, velocity.y_m_s, 0, 0, 0, velocity.yaw_rad_s), abs=1e-9)
    assert 2 * math.atan2(sin, cos) == pytest.approx(0.6, abs=0.1)  # less the time in which it speeds up
    assert math.hypot(x_m, y_m) == pytest.approx(2 * velocity.speed_m_s, abs=0.1)
    assert bench.robot.pose.x_m == pytest.approx(x_m)


def test_poses_have_variances_which_a_filter_can_divide_by() -> None:
    bench = Bench("mecanum")
    bench.run(0.2)
    odometry = Catalog().message("nav_msgs/Odometry")
    assert odometry is not None
    message = odometry.decode(bench.payloads(ODOMETRY_ID)[-1])
    for part in ("pose", "twist"):
        covariance = message[part]["covariance"]
        assert min(covariance[::7]) > 0
        assert sum(map(bool, covariance)) == 6


@pytest.mark.parametrize("kinematics", DRIVES)
def test_no_wheel_is_faster_than_it_can_and_the_curve_stays(kinematics: str) -> None:
    bench = Bench(kinematics)
    bench.drive(PlanarVelocity(9.0, 0.0, 3.0), 2.0)
    assert max(map(abs, bench.robot.wheels_m_s)) == pytest.approx(MAX_WHEEL_M_S)
    moving = bench.robot.drive.velocity(bench.robot.wheels_m_s)
    assert moving.yaw_rad_s / moving.x_m_s == pytest.approx(1 / 3)


@pytest.mark.parametrize("kinematics", DRIVES)
def test_robot_without_commands_stops_by_its_watchdog(kinematics: str) -> None:
    bench = Bench(kinematics)
    bench.drive(PlanarVelocity(0.3), 1.0)
    bench.run(WATCHDOG_S - 0.2)
    assert bench.robot.wheels_m_s != (0.0,) * len(bench.robot.wheels_m_s)
    bench.run(0.6)
    assert bench.robot.drive.velocity(bench.robot.wheels_m_s).is_zero


def test_impossible_and_not_finite_velocities_do_not_move_it() -> None:
    bench = Bench("skid_steer")
    bench.drive(PlanarVelocity(0.0, 0.3), 1.0)
    bench.drive(PlanarVelocity(math.nan), 1.0)
    assert bench.robot.pose == (0.0, 0.0, 0.0)
    car = Bench("ackermann")
    car.drive(PlanarVelocity(yaw_rad_s=1.0), 1.0)
    car.robot.send(encode(ACKERMANN_ID, ACKERMANN.pack(math.nan, 0.0, 1.0, 0.0, 0.0)))
    car.run(0.3)
    assert car.robot.pose == (0.0, 0.0, 0.0)


def test_car_obeys_a_steering_angle() -> None:
    bench = Bench("ackermann")
    for _ in range(10):
        bench.robot.send(encode(ACKERMANN_ID, ACKERMANN.pack(0.3, 0.0, 0.4, 0.0, 0.0)))
        bench.run(0.1)
    moving = bench.robot.drive.velocity(bench.robot.wheels_m_s)
    assert moving == pytest.approx(PlanarVelocity(0.4, 0.0, 0.4 * math.tan(0.3) / 0.26), abs=1e-6)


def test_time_is_the_hosts_and_silence_ends_the_connection() -> None:
    bench = Bench("mecanum")
    bench.run(0.1)
    bench.robot.send(encode(Id.TIME, encode_time(1_000_000_000_123_456_789)))
    bench.run(0.1)
    (_, seconds, _), _, _ = numbers(bench.payloads(ODOMETRY_ID)[-1])
    assert seconds == 1_000_000_000
    assert bench.robot.is_configured
    asked = len(bench.payloads(Id.TIME))
    bench.run(SILENCE_S + 0.2)
    assert len(bench.payloads(Id.TIME)) - asked == math.floor((SILENCE_S + 0.2 + 0.2) / TIME_INTERVAL_S)
    assert not bench.robot.is_configured
    count = len(bench.payloads(ODOMETRY_ID))
    bench.run(1.0)
    assert len(bench.payloads(ODOMETRY_ID)) == count


def test_restart_begins_its_odometry_anew_where_it_is_and_id_11_stops() -> None:
    bench = Bench("omni4")
    bench.drive(PlanarVelocity(0.0, 0.3), 1.0)
    place = bench.robot.pose
    bench.robot.reboot()
    assert bench.robot.pose == place
    assert not bench.robot.is_configured
    bench.robot.send(encode(Id.PUBLISHER, b""))
    bench.run(2.0)
    _, pose, twist = numbers(bench.payloads(ODOMETRY_ID)[-1])
    assert pose[1] < 0.1
    assert not any(twist)
    bench.drive(PlanarVelocity(0.3), 0.2)
    bench.robot.send(encode(Id.STOP, b""))
    bench.run(0.4)
    assert bench.robot.drive.velocity(bench.robot.wheels_m_s).is_zero
    assert not bench.robot.is_configured


def test_pause_of_the_program_is_not_made_up_for_and_a_cut_line_loses_what_waits() -> None:
    bench = Bench("mecanum")
    bench.drive(PlanarVelocity(0.3), 0.5)
    before_m = bench.robot.pose.x_m
    bench.robot.advance(bench.now_s + 3600.0)
    assert bench.robot.pose.x_m - before_m < 0.3
    bench.robot.send(encode(Id.PUBLISHER, b""))
    bench.robot.cut()
    assert bench.robot.advance(bench.now_s + 3600.0) == b""
