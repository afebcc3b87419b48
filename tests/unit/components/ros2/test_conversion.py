"""Layouts and bytes: the daemon's messages as ROS 2 has them. rosbags' own ROS 2 definitions are the judge."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from hostlink.components.gateway.rosapi import describe
from hostlink.components.graphs.wire_layout import Layout, ros1_layout, ros2_layout
from hostlink.components.ros2.conversion import (
    Conversion,
    Fields,
    added_bytes,
    nested_types,
    ros1_fields,
    ros2_fields,
    stamped,
)
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.ros2_names import ros2_type
from hostlink.errors import BadPayload, HostlinkError
from tests.support.fake_device import message_type

CATALOG, KILTED = Catalog(), get_typestore(Stores.ROS2_KILTED)
_RCLPY = {"bool": "boolean", "byte": "octet", "float32": "float", "float64": "double", "char": "uint8"}


def rclpy_text(desc: Any) -> str:
    """A field as rclpy's classes describe it, from rosbags' definition."""
    kind, inner = desc
    if kind == Nodetype.BASE:
        name, limit = inner
        return f"{_RCLPY.get(name, name)}{f'<{limit}>' if limit else ''}"
    if kind == Nodetype.NAME:
        return str(inner.replace("/msg/", "/"))
    item, count = inner
    if kind == Nodetype.ARRAY:
        return f"{rclpy_text(item)}[{count}]"
    return f"sequence<{rclpy_text(item)}{f', {count}' if count else ''}>"


def kilted_fields(name: str) -> dict[str, str]:
    fields = KILTED.fielddefs[name][1]
    return {field: rclpy_text(desc) for field, desc in fields if not field.startswith("structure_needs")}


def definitions(name: str) -> dict[str, Fields]:
    found = {name: ros2_fields(kilted_fields(name))}
    for inner in nested_types(found[name]):
        found |= definitions(inner)
    return found


def layout(name: str) -> Layout:
    """The layout of a type of the daemon, as its rosapi describes the type."""
    type_ = message_type(name)
    return ros1_layout(ros1_fields(describe(type_)).get, name)


def is_same(name: str) -> bool:
    return layout(name) == ros2_layout(definitions(ros2_type(name)).__getitem__, ros2_type(name))


SHARED = [
    "std_msgs/Empty",
    "std_msgs/String",
    "std_msgs/Time",
    "std_msgs/Header",
    "std_msgs/Float32MultiArray",
    "geometry_msgs/Pose2D",
    "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped",
    "nav_msgs/Odometry",
    "nav_msgs/Path",
    "nav_msgs/OccupancyGrid",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "sensor_msgs/Image",
    "sensor_msgs/CompressedImage",
    "sensor_msgs/BatteryState",
    "sensor_msgs/CameraInfo",
    "sensor_msgs/PointCloud2",
    "tf2_msgs/TFMessage",
    "diagnostic_msgs/DiagnosticArray",
]


@pytest.mark.parametrize("name", SHARED)
def test_a_type_has_the_same_layout_in_both(name: str) -> None:
    assert is_same(name)


def test_a_type_that_ros_2_changed_is_noticed() -> None:
    changed = definitions("std_msgs/msg/Header")
    changed["std_msgs/msg/Header"]["more"] = (Nodetype.BASE, ("uint8", 0))
    assert layout("std_msgs/Header") != ros2_layout(changed.__getitem__, "std_msgs/msg/Header")


def test_message_with_the_values_of_a_header_is_not_one() -> None:
    own = {"a/Own": [("head", "a/Head", -1)], "a/Head": [("stamp", "time", -1), ("frame_id", "string", -1)]}
    there = definitions("std_msgs/msg/Header") | {"a/msg/Own": {"head": (Nodetype.NAME, "std_msgs/msg/Header")}}
    assert ros1_layout(own.get, "a/Own") != ros2_layout(there.__getitem__, "a/msg/Own")


def converted(name: str, fields: dict[str, Any]) -> tuple[bytes, bytes, Conversion]:
    """ROS 1's bytes, CDR, and what converts them."""
    type_ = message_type(name)
    conversion = Conversion()
    conversion.add(definitions(ros2_type(name)))
    payload = type_.encode(fields)
    return payload, conversion.to_cdr(payload, ros2_type(name)), conversion


@pytest.mark.slow
@given(
    st.floats(allow_nan=False), st.floats(allow_nan=False), st.text(max_size=9).filter(lambda text: "\0" not in text)
)
def test_an_odometry_is_what_ros_2_reads(x: float, angular: float, frame: str) -> None:
    fields = {
        "header": {"seq": 0, "stamp": {"secs": 7, "nsecs": 9}, "frame_id": frame},
        "pose": {"pose": {"position": {"x": x}}},
        "twist": {"twist": {"angular": {"z": angular}}},
    }
    payload, data, conversion = converted("nav_msgs/Odometry", fields)
    message: Any = KILTED.deserialize_cdr(data, "nav_msgs/msg/Odometry")
    assert (message.pose.pose.position.x, message.twist.twist.angular.z) == (x, angular)
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == (frame, 7, 9)
    assert conversion.to_ros1(data, "nav_msgs/msg/Odometry") == payload


def test_infinite_ranges_stay_infinite() -> None:
    payload, _, conversion = converted("sensor_msgs/LaserScan", {"ranges": [1.0, 2.0]})
    payload = payload.replace(b"\0\0\x80\x3f", b"\0\0\x80\x7f")  # 1.0 is infinity
    message: Any = KILTED.deserialize_cdr(
        conversion.to_cdr(payload, "sensor_msgs/msg/LaserScan"), "sensor_msgs/msg/LaserScan"
    )
    assert list(message.ranges) == [float("inf"), 2.0]


@pytest.mark.slow
@given(st.binary(max_size=60))
def test_no_bytes_do_harm(data: bytes) -> None:
    conversion = Conversion()
    conversion.add(definitions("nav_msgs/msg/Odometry"))
    for convert in (conversion.to_cdr, conversion.to_ros1):
        with pytest.raises(BadPayload):
            convert(data, "nav_msgs/msg/Odometry")


def test_an_empty_message_has_no_bytes_here_and_one_in_ros_2() -> None:
    payload, data, conversion = converted("std_msgs/Empty", {})
    assert (payload, len(data)) == (b"", 5)
    assert conversion.to_ros1(data, "std_msgs/msg/Empty") == b""


def test_another_stamp_changes_nothing_else() -> None:
    header = {"stamp": {"secs": 1}, "frame_id": "a"}
    _, data, conversion = converted("sensor_msgs/Temperature", {"header": header, "variance": 2.0})
    assert conversion.begins_with_header("sensor_msgs/msg/Temperature")
    message: Any = KILTED.deserialize_cdr(stamped(data, b"\x05\0\0\0\x06\0\0\0"), "sensor_msgs/msg/Temperature")
    stamp = message.header.stamp
    assert (stamp.sec, stamp.nanosec, message.header.frame_id, message.variance) == (5, 6, "a", 2.0)


def test_trailing_fields_of_ros_2_are_zero_and_dropped_on_the_way_back() -> None:
    range_ = message_type("sensor_msgs/Range")
    types, name = definitions("sensor_msgs/msg/Range"), "sensor_msgs/msg/Range"
    added = added_bytes(layout(range_.name), ros2_layout(types.__getitem__, name))
    assert added == 4  # the variance
    conversion = Conversion()
    conversion.add(types, name, added_bytes=added)
    payload = range_.encode({"header": {"frame_id": "sonar"}, "range": 0.5})
    message: Any = KILTED.deserialize_cdr(conversion.to_cdr(payload, name), name)
    assert (message.header.frame_id, message.range, message.variance) == ("sonar", 0.5, 0.0)
    message.variance = 3.0
    assert conversion.to_ros1(bytes(KILTED.serialize_cdr(message, name)), name) == payload


@pytest.mark.parametrize(
    ("ros1", "ros2", "added"),
    [
        (("float32",), ("float32",), 0),
        (("float32",), ("float32", "uint16", "byte"), 3),
        (("float32",), ("float64",), None),
        (("float32",), ("byte", "float32"), None),
        (("float32",), (), None),
        (("float32",), ("float32", "string"), None),
        (("float32",), ("float32", (0, ("byte",))), None),
    ],
)
def test_only_numbers_at_the_end_may_be_added(ros1: Layout, ros2: Layout, added: int | None) -> None:
    assert added_bytes(ros1, ros2) == added


def test_a_field_that_ros_1_has_not_is_named() -> None:
    with pytest.raises(HostlinkError, match="wstring, which ROS 1 has not"):
        ros2_fields({"text": "wstring"})


def test_bounded_strings_and_sequences_are_read() -> None:
    assert ros2_fields({"a": "string<10>", "b": "sequence<double, 3>", "c": "sequence<string<4>, 2>"}) == {
        "a": (Nodetype.BASE, ("string", 10)),
        "b": (Nodetype.SEQUENCE, ((Nodetype.BASE, ("float64", 0)), 3)),
        "c": (Nodetype.SEQUENCE, ((Nodetype.BASE, ("string", 4)), 2)),
    }
