"""TypeDefs like those of rosbridge, which reads them from the classes that ROS generates."""

from hostlink.components.gateway.rosapi import describe
from tests.support.fake_device import message_type


def described(name: str) -> list[dict[str, object]]:
    return describe(message_type(name))


def test_typedefs_list_root_first_then_each_type_once() -> None:
    assert [typedef["type"] for typedef in described("nav_msgs/Odometry")] == [
        "nav_msgs/Odometry", "std_msgs/Header", "time", "geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose",
        "geometry_msgs/Point", "geometry_msgs/Quaternion", "geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist",
        "geometry_msgs/Vector3",
    ]  # fmt: skip


def test_typedefs_have_fields_lengths_and_examples() -> None:
    assert described("sensor_msgs/PointCloud2")[0] == {
        "type": "sensor_msgs/PointCloud2",
        "fieldnames": ["header", "height", "width", "fields", "is_bigendian", "point_step", "row_step", "data",
                       "is_dense"],
        "fieldtypes": ["std_msgs/Header", "uint32", "uint32", "sensor_msgs/PointField", "bool", "uint32", "uint32",
                       "uint8", "bool"],
        "fieldarraylen": [-1, -1, -1, 0, -1, -1, -1, 0, -1],
        "examples": ["{}", "0", "0", "[]", "False", "0", "0", "[]", "False"],
        "constnames": [],
        "constvalues": [],
    }  # fmt: skip
    odometry = described("nav_msgs/Odometry")
    assert odometry[3]["fieldarraylen"] == [-1, 36]
    assert odometry[5]["examples"] == ["0.0", "0.0", "0.0"]
    assert odometry[1]["examples"] == ["0", "{}", ""]


def test_typedef_of_time_has_fields_and_constants_are_sorted() -> None:
    assert described("std_msgs/Header")[1] == {
        "type": "time", "fieldnames": ["secs", "nsecs"], "fieldtypes": ["int32", "int32"], "fieldarraylen": [-1, -1],
        "examples": ["0", "0"], "constnames": [], "constvalues": [],
    }  # fmt: skip
    log = described("rosgraph_msgs/Log")[0]
    assert (log["constnames"], log["constvalues"]) == (
        ["DEBUG", "ERROR", "FATAL", "INFO", "WARN"],
        ["1", "8", "16", "2", "4"],
    )
