"""Name resolution of a node, and names of the hub in ROS."""

import pytest

from hostlink.components.ros1.names import NameMap, NameResolver, is_legal, joined, parse_arguments
from hostlink.errors import ConfigError

LAB = NameResolver("/lab/serial_node")


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("odom", "/lab/odom"),
        ("/odom", "/odom"),
        ("~odom", "/lab/serial_node/odom"),
        ("~/odom", "/lab/serial_node/odom"),
        ("arm/joint", "/lab/arm/joint"),
        ("/arm//joint/", "/arm/joint"),
    ],
)
def test_a_name_is_resolved_as_ros_does(name: str, full: str) -> None:
    assert LAB.resolve(name) == full


def test_a_node_without_a_namespace_is_in_the_global_one() -> None:
    assert NameResolver("/serial_node").namespace == "/"
    assert NameResolver("/serial_node").resolve("odom") == "/odom"
    assert joined("/", "odom") == joined("", "odom") == "/odom"


def test_a_remapping_changes_every_spelling_of_a_name() -> None:
    names = parse_arguments(["cmd_vel:=/robot_0/cmd_vel", "~log:=log"]).names("serial_node", "/lab")
    assert names.resolve("cmd_vel") == names.resolve("/lab/cmd_vel") == "/robot_0/cmd_vel"
    assert names.resolve("/cmd_vel") == "/cmd_vel"
    assert names.resolve("~log") == "/lab/log"


def test_the_arguments_of_roslaunch_are_sorted() -> None:
    arguments = parse_arguments(
        ["tcp", "__name:=base", "__ns:=/lab", "_port:=tcp", "a:=b", "11412", "__log:=/tmp/a.log"]
    )
    assert arguments.others == ("tcp", "11412")
    assert arguments.parameters == {"port": "tcp"}
    assert arguments.remappings == {"a": "b"}
    assert arguments.names("serial_node").node == "/lab/base"


def test_the_namespace_of_the_environment_is_a_default() -> None:
    assert parse_arguments([]).names("serial_node", "/lab").node == "/lab/serial_node"
    assert parse_arguments(["__ns:=hall"]).names("serial_node", "/lab").node == "/hall/serial_node"


@pytest.mark.parametrize("word", [":=a", "a:=", "_port:=", "a b:=c", "a:=1c", "__name:=a/b", "__name:=~a", "__ns:=1 2"])
def test_malformed_assignment_is_refused_and_named(word: str) -> None:
    with pytest.raises(ConfigError):
        parse_arguments([word]).names("serial_node")


@pytest.mark.parametrize(("name", "is_so"), [("/a/b_1", True), ("a", True), ("~a", True), ("/", True), ("", False)])
def test_legal_names(name: str, is_so: bool) -> None:
    assert is_legal(name) is is_so


@pytest.mark.parametrize("name", ["/1a", "/a b", "/a//b", "/ä-", "a\n", "/a\n"])
def test_illegal_names(name: str) -> None:
    assert not is_legal(name)


def test_a_relative_name_of_a_device_is_in_the_namespace_of_the_node() -> None:
    found = NameMap(LAB, [("chatter", "/chatter"), ("/tf", "/tf"), ("~imu", "/imu")])
    assert found.to_ros("/chatter") == "/lab/chatter"
    assert found.to_ros("/tf") == "/tf"
    assert found.to_ros("/imu") == "/lab/serial_node/imu"
    assert found.to_hub("/lab/chatter") == "/chatter"
    assert found.to_hub("/other") == "/other"


def test_name_that_was_made_a_robots_is_in_the_namespace() -> None:
    found = NameMap(LAB, [("odom", "/red/odom"), ("/odom", "/blue/odom")])
    assert found.to_ros("/red/odom") == "/lab/red/odom"
    assert found.to_ros("/blue/odom") == "/lab/blue/odom"
    assert found.to_hub("/lab/blue/odom") == "/blue/odom"


def test_name_of_hostlink_itself_is_in_the_namespace_unless_it_is_configured_with_a_slash() -> None:
    found = NameMap(LAB, [("/red/cmd_vel", "/red/cmd_vel")], ["red/odom", "/map/odom", "red/lock", "red/cmd_vel"])
    assert found.to_ros("/red/odom") == "/lab/red/odom"
    assert found.to_ros("/red/lock") == "/lab/red/lock"
    assert found.to_ros("/map/odom") == "/map/odom"
    assert found.to_ros("/red/cmd_vel") == "/red/cmd_vel"  # the device's own
    assert found.to_ros("/tf") == "/tf"


def test_names_of_hostlink_itself_are_remapped_by_their_names_in_the_namespace() -> None:
    names = parse_arguments(["red/odom:=odom"]).names("serial_node", "/lab")
    assert NameMap(names, (), ["red/odom"]).to_ros("/red/odom") == "/lab/odom"


def test_names_of_the_hub_are_remapped_too() -> None:
    found = NameMap(NameResolver("/hostlink", {"/robot_0/odom": "/odom"}), [("odometry", "/odometry")])
    assert found.to_ros("/robot_0/odom") == "/odom"
    assert found.to_ros("/odometry") == "/odometry"
