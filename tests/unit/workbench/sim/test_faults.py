"""The faults spoil what a device says in the way that their name says, and nothing else."""

import pytest

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import decode_topic_info, encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.session import NonRosserialBytes
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.workbench.sim.robot import FAULTS, HEALTHY, FaultyLine

POSE = DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/odometry", "geometry_msgs/Pose2D", "m" * 32, 512)
TWIST = DeviceEndpoint(EndpointKind.SUBSCRIBER, 100, "/velocity", "geometry_msgs/Twist", "m" * 32, 512)
TIME = encode(Id.TIME, bytes(8))
MESSAGE = encode(125, bytes(24))
ANNOUNCED = TIME + b"".join(encode(info.kind, encode_topic_info(info)) for info in (POSE, TWIST)) + MESSAGE


def frames(fault: str) -> dict[int, bytes]:
    """Id -> payload of what the host can read."""
    heard = FaultyLine(FAULTS[fault]).pass_on(ANNOUNCED)
    return {item.topic_id: item.payload for item in FrameStream().feed(heard) if isinstance(item, Frame)}


def test_a_healthy_line_changes_nothing() -> None:
    assert FaultyLine(HEALTHY).pass_on(ANNOUNCED[:30]) == ANNOUNCED[:30]


@pytest.mark.parametrize(
    ("fault", "ids"),
    [
        ("silence", []),
        ("wrong_baud", []),
        ("protocol_1", []),
        ("text", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
        ("no_topics", [Id.TIME, 125]),
        ("wrong_md5", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
        ("time_stops", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
        ("small_buffer", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
        ("boot_noise", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
        ("reboots", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
        ("clock", [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, 125]),
    ],
)
def test_fault_removes_or_keeps_frames(fault: str, ids: list[int]) -> None:
    assert list(frames(fault)) == ids


def test_fault_changes_topic_infos() -> None:
    assert decode_topic_info(EndpointKind.PUBLISHER, frames("wrong_md5")[Id.PUBLISHER]) == POSE._replace(md5="0" * 32)
    assert decode_topic_info(EndpointKind.SUBSCRIBER, frames("small_buffer")[Id.SUBSCRIBER]) == TWIST._replace(
        buffer_bytes=48
    )


def test_protocol_1_is_what_a_session_recognises() -> None:
    assert NonRosserialBytes().add(FaultyLine(FAULTS["protocol_1"]).pass_on(ANNOUNCED))


def test_boot_message_is_sent_once_and_first() -> None:
    line = FaultyLine(FAULTS["boot_noise"])
    assert len(line.pass_on(b"")) > 100
    assert line.pass_on(TIME) == TIME
