"""Suggestions for unknown names."""

import pytest

from hostlink.cli.names import natural, near, only_connected, unknown, unknown_robot
from hostlink.errors import HostlinkError

TOPICS = ["/robot_0/odometry", "/robot_0/odom", "/robot_0/velocity_commands", "/robot_1/odometry", "/rosout", "/tf"]


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("/robot_0/odometrie", ["/robot_0/odometry", "/robot_1/odometry"]),
        ("/robot_0/velocity_comands", ["/robot_0/velocity_commands"]),
        ("/odom", ["/robot_0/odom", "/robot_0/odometry", "/robot_1/odometry"]),
        ("/nonsense", []),
        ("/", []),
        ("", []),
    ],
)
def test_similar_names_are_suggested(name: str, found: list[str]) -> None:
    assert near(name, TOPICS)[: len(found) or None] == found


def test_names_are_in_the_order_of_their_numbers() -> None:
    names = ["", "/a/odom", "robot", "robot_0", "robot_2", "robot_10", "robot_10_2", "robot_x", "x" + "1" * 5000]
    names.reverse()
    assert sorted(names, key=natural) == names[::-1]


def test_error_names_similar_names_else_known_ones() -> None:
    assert str(unknown("robot", "robt_0", ["robot_0", "mule"], command="robots")) == (
        "there is no robot named robt_0; similar names: robot_0; `hostlink robots` lists them"
    )
    assert str(unknown("robot", "xyz", ["robot_0", "mule"], command="robots")) == (
        "there is no robot named xyz; known are: mule, robot_0; `hostlink robots` lists them"
    )
    assert str(unknown("robot", "xyz", [], command="robots")) == ("there is no robot named xyz; there are none yet")


@pytest.mark.parametrize("name", ["robot_0", None])
def test_error_of_a_robot_without_any_robot_says_how_to_find_the_cause(name: str | None) -> None:
    assert str(unknown_robot(name, [])) == "no robot has connected yet; `hostlink doctor` finds out why"


def test_error_of_an_unknown_robot_lists_the_known_ones() -> None:
    assert str(unknown_robot("xyz", ["mule"])) == str(unknown("robot", "xyz", ["mule"], command="robots"))


def test_the_only_robot_that_is_connected_needs_no_name() -> None:
    assert only_connected({"robot_0": False, "mule": True}, example="hostlink teleop {}") == "mule"


@pytest.mark.parametrize(
    ("robots", "text"),
    [
        ({}, "no robot has connected yet; `hostlink doctor` finds out why"),
        (
            {"robot_10": False, "robot_2": False},
            "no robot is connected; known are: robot_2, robot_10; `hostlink doctor` finds out why",
        ),
        (
            {"robot_10": True, "robot_2": True, "mule": False},
            "2 robots are connected: robot_2, robot_10; name one, as in `hostlink teleop robot_2`",
        ),
        (
            {f"robot_{number}": True for number in range(9)},
            "9 robots are connected: robot_0, robot_1, robot_2, robot_3, robot_4, robot_5, robot_6, robot_7, ...; "
            "name one, as in `hostlink teleop robot_0`",
        ),
    ],
)
def test_without_one_connected_robot_the_error_says_what_to_do(robots: dict[str, bool], text: str) -> None:
    with pytest.raises(HostlinkError) as caught:
        only_connected(robots, example="hostlink teleop {}")
    assert str(caught.value) == text
