"""PlayedDevice without a host: which messages it would send, and which no device can send."""

import pytest

from hostlink.core.protocol.rosserial.frame import MAX_PAYLOAD_BYTES
from hostlink.core.protocol.rosserial.topic_table import MAX_TOPICS
from hostlink.workbench.sim.played_device import PlayedDevice, PlayedTopic

MD5 = "938fa65709584ad8e77d238529be13b8"


def topic(
    name: str, *, type_name: str = "geometry_msgs/Pose2D", md5: str = MD5, is_velocity: bool = False
) -> PlayedTopic:
    return PlayedTopic(name, type_name, md5, is_velocity=is_velocity)


def outcome(device: PlayedDevice, name: str, payload: bytes = b"") -> str:
    """Return "sendable" if only a host is missing, else "impossible"."""
    dropped, left_out = device.dropped, device.left_out
    device.publish(name, payload)
    assert (device.dropped - dropped) + (device.left_out - left_out) == 1
    return "sendable" if device.dropped > dropped else "impossible"


def test_recorded_topics_and_the_mark_are_published() -> None:
    device = PlayedDevice("robot_0", "drive.mcap", [topic("/robot_0/odometry")])
    assert outcome(device, "/robot_0/odometry") == outcome(device, "/robot_0/played") == "sendable"
    assert outcome(device, "/robot_0/other") == outcome(device, "/played") == "impossible"


def test_mark_of_a_robot_without_a_valid_name_has_no_namespace() -> None:
    device = PlayedDevice("robot 0", "drive.mcap", [])
    assert outcome(device, "/played") == "sendable"
    assert outcome(device, "/robot 0/played") == "impossible"


@pytest.mark.parametrize(
    "impossible",
    [
        topic("/robot_0/data", is_velocity=True),
        topic("/robot 0/data"),
        topic("/robot_0/data", type_name=""),
        topic("/robot_0/data", md5="m" * 256),
    ],
    ids=["velocity", "name", "type", "md5"],
)
def test_topic_that_no_device_publishes_is_left_out(impossible: PlayedTopic) -> None:
    device = PlayedDevice("robot_0", "drive.mcap", [impossible, topic("/robot_0/odometry")])
    assert outcome(device, impossible.name) == "impossible"
    assert outcome(device, "/robot_0/odometry") == "sendable"


def test_message_over_the_longest_frame_is_left_out() -> None:
    device = PlayedDevice("robot_0", "drive.mcap", [topic("/robot_0/map")])
    assert outcome(device, "/robot_0/map", bytes(MAX_PAYLOAD_BYTES)) == "sendable"
    assert outcome(device, "/robot_0/map", bytes(MAX_PAYLOAD_BYTES + 1)) == "impossible"


def test_topics_over_the_bound_are_left_out() -> None:
    device = PlayedDevice("robot_0", "drive.mcap", [topic(f"/t{number}") for number in range(MAX_TOPICS + 1)])
    assert outcome(device, f"/t{MAX_TOPICS - 1}") == "sendable"
    assert outcome(device, f"/t{MAX_TOPICS}") == "impossible"
