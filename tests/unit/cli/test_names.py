"""Suggestions for unknown names."""

import pytest

from hostlink.cli.names import natural, near, unknown

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
    assert str(unknown("robot", "xyz", [], command="robots")) == (
        "there is no robot named xyz; there are none yet; `hostlink robots` lists them"
    )
