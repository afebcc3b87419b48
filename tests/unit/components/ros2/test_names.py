"""Names and types in ROS 1 and ROS 2."""

import pytest

from hostlink.components.graphs.ros2_names import is_ros2_name, ros1_type, ros2_type
from hostlink.components.ros2.plan import parameter_name, ros2_name


@pytest.mark.parametrize(
    ("name", "expected"),
    [("/robot_0/odom", "robot_0/odom"), ("/tf", "/tf"), ("/tf_static", "/tf_static"), ("/map", "map")],
)
def test_a_topic_is_relative_so_that_namespace_and_remaps_count(name: str, expected: str) -> None:
    assert ros2_name(name) == expected


@pytest.mark.parametrize(
    ("name", "is_right"),
    [
        ("/robot_0/odom", True),
        ("/_hidden", True),
        ("/2wheels/odom", False),
        ("/robot-1/odom", False),
        ("/a//b", False),
        ("/a/", False),
        ("/", False),
        ("", False),
        ("a", False),
        ("/a*", False),
        ("/a\n", False),
        ("/" + "a" * 300, False),
        ("/ä", False),
        ("/a b", False),
    ],
)
def test_names_that_ros_2_refuses_are_known_before(name: str, is_right: bool) -> None:
    assert is_ros2_name(name) is is_right


@pytest.mark.parametrize(
    ("ros1", "ros2"),
    [
        ("geometry_msgs/Twist", "geometry_msgs/msg/Twist"),
        ("std_msgs/Time", "builtin_interfaces/msg/Time"),
        ("std_msgs/Duration", "builtin_interfaces/msg/Duration"),
    ],
)
def test_a_type_has_a_name_in_both(ros1: str, ros2: str) -> None:
    assert ros2_type(ros1) == ros2
    assert ros1_type(ros2) == ros1


def test_the_old_transforms_are_the_new_ones_in_ros_2() -> None:
    assert ros2_type("tf/tfMessage") == ros2_type("tf2_msgs/TFMessage") == "tf2_msgs/msg/TFMessage"
    assert ros1_type("tf2_msgs/msg/TFMessage") == "tf2_msgs/TFMessage"


def test_services_have_names_too() -> None:
    assert ros2_type("std_srvs/Trigger", "srv") == "std_srvs/srv/Trigger"
    assert ros1_type("std_srvs/srv/Trigger") == "std_srvs/Trigger"


def test_a_parameter_is_named_with_dots() -> None:
    assert parameter_name("/robot_0/pid/kp") == "robot_0.pid.kp"
