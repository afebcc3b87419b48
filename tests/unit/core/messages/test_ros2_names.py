"""Names of topics, services and types in ROS 1, ROS 2 and on DDS."""

import pytest

from hostlink.core.messages.ros2_names import (
    DdsEndpoint,
    DdsKind,
    dds_endpoint,
    from_dds_type,
    is_ros2_name,
    ros1_type,
    ros2_type,
    to_dds_type,
)


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


@pytest.mark.parametrize("type_name", ["std_msgs/msg/String", "example_interfaces/srv/AddTwoInts", "a_b/msg/C_Request"])
def test_type_names_of_dds(type_name: str) -> None:
    assert from_dds_type(to_dds_type(type_name)) == type_name


@pytest.mark.parametrize(
    "type_name", ["String", "std_msgs/String", "std_msgs/msg/", "Std/msg/String", "std_msgs/msg/Str/ing"]
)
def test_malformed_type_name_of_ros_2_is_refused(type_name: str) -> None:
    with pytest.raises(ValueError, match="not a type name of ROS 2"):
        to_dds_type(type_name)
    assert from_dds_type(type_name) is None


ENDPOINTS = [
    (DdsKind.MESSAGES, "/cmd_vel", "geometry_msgs/Twist", "rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_"),
    (DdsKind.MESSAGES, "/odom/raw", "nav_msgs/Odometry", "rt/odom/raw", "nav_msgs::msg::dds_::Odometry_"),
    (DdsKind.MESSAGES, "/t", "std_msgs/Time", "rt/t", "builtin_interfaces::msg::dds_::Time_"),
    (
        DdsKind.REQUESTS,
        "/add",
        "example_interfaces/AddTwoInts",
        "rq/addRequest",
        "example_interfaces::srv::dds_::AddTwoInts_Request_",
    ),
    (
        DdsKind.RESPONSES,
        "/a/Reply",
        "example_interfaces/AddTwoInts",
        "rr/a/ReplyReply",
        "example_interfaces::srv::dds_::AddTwoInts_Response_",
    ),
]


@pytest.mark.parametrize(("kind", "name", "type_name", "topic", "dds_type"), ENDPOINTS)
def test_endpoint_has_names_on_dds(kind: DdsKind, name: str, type_name: str, topic: str, dds_type: str) -> None:
    endpoint = DdsEndpoint(kind, name, type_name)
    assert (endpoint.dds_topic, endpoint.dds_type) == (topic, dds_type)
    assert dds_endpoint(topic, dds_type) == endpoint


@pytest.mark.parametrize(
    ("topic", "dds_type"),
    [
        ("HelloWorldTopic", "HelloWorld"),  # eProsima's examples
        ("rt/chatter", "std_msgs/msg/String"),
        ("rt/chatter", "std_srvs::srv::dds_::Trigger_"),
        ("rtchatter", "std_msgs::msg::dds_::String_"),
        ("rt/", "std_msgs::msg::dds_::String_"),
        ("rt/2wheels", "std_msgs::msg::dds_::String_"),
        ("rt/a\n", "std_msgs::msg::dds_::String_"),
        ("rq/add", "std_srvs::srv::dds_::Trigger_Request_"),
        ("rq/Request", "std_srvs::srv::dds_::Trigger_Request_"),
        ("rq/addRequest", "std_srvs::srv::dds_::Trigger_"),
        ("rq/addRequest", "std_srvs::srv::dds_::Trigger_Response_"),
        ("rq/addRequest", "std_srvs::msg::dds_::Trigger_Request_"),
        ("rr/addRequest", "std_srvs::srv::dds_::Trigger_Response_"),
        ("rq/turn/_action/send_goalRequest", "turtlesim::action::dds_::Turn_SendGoal_Request_"),
        ("rt/turn/_action/feedback", "turtlesim::action::dds_::Turn_FeedbackMessage_"),
    ],
)
def test_other_name_on_dds_has_no_endpoint(topic: str, dds_type: str) -> None:
    assert dds_endpoint(topic, dds_type) is None


def test_type_without_a_name_in_ros_2_has_none_on_dds() -> None:
    with pytest.raises(ValueError, match="not a type name of ROS 2"):
        _ = DdsEndpoint(DdsKind.MESSAGES, "/a", "Capital_msgs/Twist").dds_type
