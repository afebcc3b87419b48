"""Names of topics and parameters in the node of ROS 2."""

import pytest

from hostlink.components.ros2.plan import parameter_name, ros2_name


@pytest.mark.parametrize(
    ("name", "expected"),
    [("/robot_0/odom", "robot_0/odom"), ("/tf", "/tf"), ("/tf_static", "/tf_static"), ("/map", "map")],
)
def test_a_topic_is_relative_so_that_namespace_and_remaps_count(name: str, expected: str) -> None:
    assert ros2_name(name) == expected


def test_a_parameter_is_named_with_dots() -> None:
    assert parameter_name("/robot_0/pid/kp") == "robot_0.pid.kp"
