"""A robot's last minutes, from what the black box kept."""

import math
import struct

import pytest

from hostlink.messages.catalog import Catalog
from hostlink.recording.channel import DEVICE, Channel, ros_channel
from hostlink.recording.history import MAX_SAMPLES, odometry_of, past_messages, past_poses, thinned
from hostlink.recording.ring import Entry
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry_estimator import OdometryEstimator

POSE_TYPE, TOPIC = "geometry_msgs/Pose2D", "/robot_0/odometry"
STEP_NS = 100_000_000
POSE = Catalog().message(POSE_TYPE)


def channel(topic: str = TOPIC, type_name: str = POSE_TYPE) -> Channel:
    return ros_channel(topic, type_name, POSE, is_latched=False)


def entries(*poses: tuple[float, float, float], of: Channel | None = None) -> list[Entry]:
    """One each tenth of a second."""
    at = channel() if of is None else of
    return [Entry(at, number * STEP_NS, struct.pack("<3d", *pose)) for number, pose in enumerate(poses, 1)]


def shown(kept: list[Entry], present: Pose | None = None) -> list[Pose]:
    return [each.pose for each in past_poses(kept, TOPIC, POSE_TYPE, OdometryEstimator(), present)]


def test_poses_are_those_of_the_topic_in_their_order() -> None:
    others = entries((9.0, 9.0, 0.0), of=channel("/robot_1/odometry"))
    kept = entries((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.02, 0.0, 0.0)) + others
    assert shown(kept) == [Pose(0.0), Pose(0.01), Pose(0.02)]
    assert shown(others) == []


def test_they_end_where_the_robot_is_shown_now() -> None:
    """A device that restarted, or was reset, is shown in another frame than that of its poses."""
    found = shown(entries((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)), Pose(2.0, 1.0, math.pi / 2))
    assert found[-1] == pytest.approx(Pose(2.0, 1.0, math.pi / 2))
    assert found[0] == pytest.approx(Pose(2.0, 0.95, math.pi / 2))


def test_a_restart_of_the_device_does_not_jump() -> None:
    moving = [(0.05 * number, 0.0, 0.0) for number in range(11)]
    found = shown(entries(*moving, (0.0, 0.0, 0.0), (0.05, 0.0, 0.0)))
    assert found[-1].x_m == pytest.approx(0.55)


def test_damage_is_left_out() -> None:
    kept = [*entries((0.0, 0.0, 0.0)), Entry(channel(), 2 * STEP_NS, b"short")]
    assert shown(kept) == [Pose()]
    assert POSE is not None
    assert [stamp_ns for stamp_ns, _ in past_messages(kept, TOPIC, POSE.name, POSE.decode)] == [STEP_NS]
    assert past_messages(kept, TOPIC, "std_msgs/String", POSE.decode) == []


def test_an_estimator_begins_anew_with_its_settings() -> None:
    used = OdometryEstimator(continues=False)
    used.update(Pose(1.0, 2.0, 0.0), now_s=0.0, wall_ns=0)
    moving = [(0.05 * number, 0.0, 0.0) for number in range(11)]
    again = past_poses(entries(*moving, (0.0, 0.0, 0.0)), TOPIC, POSE_TYPE, used.anew(), None)
    assert again[0].pose == Pose()
    assert again[-1].pose == Pose()  # it begins again with the device


def test_the_odometry_of_a_file_is_the_devices_topic_of_that_name() -> None:
    found = [
        entries((0.0, 0.0, 0.0), of=ros_channel(topic, POSE_TYPE, POSE, is_latched=False, origin=origin))
        for topic, origin in (("/robot_0/aim", DEVICE), (TOPIC, DEVICE), ("/a/odometry", "a program"))
    ]
    assert odometry_of(entry for kept in found for entry in kept) == (TOPIC, POSE_TYPE)
    assert odometry_of(found[2]) is None


def test_more_samples_than_are_shown_lose_every_second_one_and_never_the_last() -> None:
    assert thinned([1, 2, 3]) == [1, 2, 3]
    many = thinned(list(range(MAX_SAMPLES + 3)))
    assert (len(many), many[-1]) == (MAX_SAMPLES // 2 + 2, MAX_SAMPLES + 2)
