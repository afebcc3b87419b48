"""The record of a robot, and the battery as its device sends it."""

import json
import math

import pytest

from hostlink.components.zenoh.fleet_messages import STATE, RobotMessage, State, encode
from hostlink.core.robot.feedback import FeedbackKind
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.state import BATTERY_TYPE, DEVICE_AWAY, BatteryReading, RobotState, read_battery
from hostlink.core.robot.velocity import Kinematics, PlanarVelocity
from hostlink.core.robot.views import RobotView
from tests.support.fake_device import message_type

EVERYTHING = RobotState(
    name="robot_0",
    host="desk",
    also_at=("bench",),
    link=3,
    frames=7,
    velocity_topic="/robot_0/cmd_vel",
    command_type="geometry_msgs/TwistStamped",
    feedback=FeedbackKind.VELOCITY,
    odometry_topic="/robot_0/odom",
    odometry_type="geometry_msgs/Pose2D",
    reset_topic="/robot_0/reset",
    is_played=True,
    holder="client 1",
    holder_address="10.0.0.2",
    priority=60,
    lock_reason="smoke",
    epoch=12,
    unreachable="too large",
    wheel_separation_m=0.2,
    kinematics=Kinematics.DIFFERENTIAL,
    lease_s=0.7,
    velocity=PlanarVelocity(0.1, 0.2, 0.3),
    odometry=OdometrySnapshot(
        pose=Pose(1.0, 2.0, 0.5),
        twist=PlanarVelocity(0.1, 0.2, 0.3),
        stamp_ns=5,
        age_s=0.25,
        rate_hz=10.0,
        count=9,
        restarts=1,
        ignored=2,
    ),
    battery_v=11.4,
    battery_percent=62.0,
    signal_dbm=-67,
    device_errors=("battery_low",),
    firmware="rover 1.4",
)


def battery(**fields: object) -> bytes:
    return message_type(BATTERY_TYPE).encode(fields)


@pytest.mark.parametrize(
    ("payload", "reading"),
    [
        (battery(voltage=11.42, percentage=0.625), BatteryReading(11.42, 62.5)),
        (battery(voltage=11.42, percentage=math.nan, header={"frame_id": "base"}), BatteryReading(11.42, None)),
        (battery(voltage=math.nan, percentage=0.0), BatteryReading(None, 0.0)),
        (battery(voltage=7.5, percentage=62.5), BatteryReading(7.5, None)),  # a percentage is from 0 to 1
        (battery(voltage=7.5)[:30], BatteryReading(None, None)),
        (b"", BatteryReading(None, None)),
    ],
)
def test_a_battery_is_read_from_its_bytes(payload: bytes, reading: BatteryReading) -> None:
    assert read_battery(payload) == reading


def test_every_field_has_a_value_here_that_is_not_its_default() -> None:
    """So that the tests below notice a field that is lost."""
    least = RobotState(name="a", velocity_topic="/a/b", odometry_topic="/a/c", odometry_type="d/E")
    fields: list[str] = list(RobotState.__struct_fields__)
    assert [name for name in fields if getattr(EVERYTHING, name) == getattr(least, name)] == []
    assert {name: getattr(least, name) for name in DEVICE_AWAY} == DEVICE_AWAY


def test_rest_shows_every_field() -> None:
    """The type of the odometry's topic, and the topic of a reset, are for hostlink alone."""
    names = {"is_played": "played", "odometry_type": "odometry_topic", "reset_topic": "odometry_topic"}
    fields: list[str] = list(RobotState.__struct_fields__)
    assert {names.get(name, name) for name in fields} <= RobotView.__annotations__.keys()


def test_every_field_passes_from_daemon_to_daemon() -> None:
    sent = State(sent_s=1.0, topics=2, robots=(RobotMessage.of(EVERYTHING),))
    assert [robot.state for robot in STATE.decode(encode(sent)).robots] == [EVERYTHING]


def test_an_older_daemon_understands_what_it_knows() -> None:
    fields = json.loads(encode(RobotMessage.of(EVERYTHING)))
    assert fields["velocity"] == [0.1, 0.3]
    assert fields["pose"][:5] == [1.0, 2.0, 0.5, 0.1, 0.3]
