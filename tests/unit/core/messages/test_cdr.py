"""CDR and ROS 1's serialisation: bytes of common types, what differs, and what is refused."""

import struct

import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import ENCAPSULATION, Cdr, cdr_of
from hostlink.errors import BadPayload, WrongType

CATALOG = Catalog()


def cdr(name: str) -> Cdr:
    found = CATALOG.message(name)
    assert found is not None
    return cdr_of(found)


def test_velocity_has_the_same_bytes_in_both() -> None:
    payload = struct.pack("<6d", 0.5, 0, 0, 0, 0, -1.25)
    twist = cdr("geometry_msgs/Twist")
    assert twist.is_copy
    assert twist.to_ros1(payload) == payload == twist.from_ros1(payload)
    assert twist.from_ros1(payload, is_encapsulated=True) == ENCAPSULATION + payload
    assert twist.to_ros1(ENCAPSULATION + payload, is_encapsulated=True) == payload


def test_header_loses_its_seq_and_its_frame_gains_a_nul() -> None:
    imu = cdr("sensor_msgs/Imu")
    values = struct.pack("<37d", *range(37))
    ros2 = struct.pack("<iII", 12, 34, 4) + b"imu\0" + values
    ros1 = struct.pack("<IIII", 0, 12, 34, 3) + b"imu" + values
    assert not imu.is_copy
    assert imu.to_ros1(ros2) == ros1
    assert imu.from_ros1(ros1) == ros2
    assert imu.from_ros1(struct.pack("<I", 77) + ros1[4:]) == ros2


def test_type_that_ros2_has_changed_is_refused() -> None:
    with pytest.raises(WrongType, match=r"MarkerArray: wanted the fields that visualization_msgs/Marker has in ROS 2"):
        cdr("visualization_msgs/MarkerArray")


def test_payload_of_another_type_is_refused() -> None:
    with pytest.raises(BadPayload, match="8 bytes are missing at 0"):
        cdr("geometry_msgs/Twist").to_ros1(bytes(40))
