"""Words of ROS and other programs, and the suggested commands."""

import pytest

from hostlink.cli import main
from hostlink.cli.main import meant
from hostlink.cli.topics import type_and_message
from hostlink.errors import ConfigError


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("ls", "robots"),
        ("start --serial /dev/ttyUSB0", "serve --serial /dev/ttyUSB0"),
        ("help", "--help"),
        ("help echo", "echo --help"),
        ("topic", "topics"),
        ("topic list", "topics"),
        ("topic echo /robot_0/odom", "echo /robot_0/odom"),
        ("topics list", "topics"),
        ("rostopic hz /x", "hz /x"),
        ("ros2 topic echo /x --once", "echo /x --once"),
        ("node info /robot_0", "info /robot_0"),
        ("service call /x", "call /x"),
        ("services call /x", "call /x"),
        ("rosparam get /x", "params get /x"),
        ("bag record", "record"),
        ("rosmsg show std_msgs/Bool", "type std_msgs/Bool"),
        ("topics", None),
        ("topics -v", None),
        ("params list", None),
        ("ros2 --domain 3", None),
        ("echo /topic", None),
        ("", None),
    ],
)
def test_words_typed_by_habit_have_a_command(line: str, wanted: str | None) -> None:
    assert meant(line.split()) == wanted


def test_suggested_commands_exist() -> None:
    commands = {
        *main.HABITS.values(),
        *(text for group in main.ROS_GROUPS.values() for text in group.values()),
    }
    assert {text.split()[0] for text in commands} <= {*main.COMMANDS, "--help", "--version"}
    assert not set(main.HABITS) & set(main.COMMANDS)
    assert {command for command, _ in main.ROS_OPTIONS} <= set(main.COMMANDS)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], ("", "{}")),
        (["data: hi"], ("", "data: hi")),
        (["std_msgs/Empty"], ("std_msgs/Empty", "{}")),
        (["std_msgs/msg/String", "data: a/b"], ("std_msgs/String", "data: a/b")),
    ],
)
def test_a_message_may_have_its_type_before_it(words: list[str], wanted: tuple[str, str]) -> None:
    assert type_and_message(words) == wanted


def test_a_message_without_quotes_is_told_so() -> None:
    with pytest.raises(ConfigError, match="put the message in quotes"):
        type_and_message(["data:", "hi"])
