"""Words of ROS and other programs, and the command line that they are translated to."""

from dataclasses import dataclass

import pytest

from hostlink.cli import main
from hostlink.cli.main import COMMANDS, FIRST_DAY, LACKING, ROS_GROUPS, complaint, in_words, translated
from hostlink.errors import ConfigError
from tests.support.documented import Documented


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("ls", "robots"),
        ("drive robot_0", "teleop robot_0"),
        ("list topics -v", "topics -v"),
        ("estop", "lock"),
        ("-V", "--version"),
        ("move robot_0 -0.3 --speed 0.1", "move robot_0 --speed 0.1 -- -0.3"),
        ("turn -90deg", "turn -- -90deg"),
        ("turn --json -90deg", "turn --json -- -90deg"),
        ("turn --speed -1 robot_0 -.5turn", "turn --speed -1 robot_0 -- -.5turn"),
        ("move robot_0 -- -0.3", "move robot_0 -- -0.3"),
        ("move robot_0 0.3", "move robot_0 0.3"),
        ("start --serial /dev/ttyUSB0", "serve --serial /dev/ttyUSB0"),
        ("roscore", "serve"),
        ("teleop_twist_keyboard robot_0", "teleop --layout twist robot_0"),
        ("ros2 param dump", "params dump"),
        ("rosparam dump file", "params dump file"),
        ("rosout --once", "echo /rosout --once"),
        ("help", "--help"),
        ("help echo", "echo --help"),
        ("help topic echo", "echo --help"),
        ("help drive -- x", "teleop x --help"),
        ("help -- robots", "robots --help"),
        ("help --", "--help"),
        ("help teleop --linear", "teleop --help"),
        ("help --linear", "--help"),
        ("topic list", "topics"),
        ("ros2 bag record --topics=/a", "record /a"),
        ("ros2 bag record --topics /a /b", "record /a /b"),
        ("ros2 bag play run.mcap --topics=/a", "play run.mcap --as-program /a"),
        ("topic list -t", "topics"),
        ("topic echo -n 2 /t", "echo -n 2 /t"),
        ("topic hz -w 10 /t", "hz -w 10 /t"),
        ("topic pub -r 10 /t std_msgs/Bool true", "pub -r 10 /t std_msgs/Bool true"),
        ("ros2 topic pub -t 3 /t std_msgs/msg/Bool", "pub --count 3 /t std_msgs/msg/Bool"),
        ("rostopic pub -1 /t std_msgs/Int8 -- -t", "pub -1 /t std_msgs/Int8 -- -t"),
        ("topics list", "topics"),
        ("rostopic hz --wall-time /x", "hz /x"),
        ("ros2 topic echo /x --once", "echo /x --once"),
        ("rostopic echo --noarr /x", "echo --no-arr /x"),
        ("ros2 topic info -v /x", "info /x"),
        ("topic list --help", "topics --help"),
        ("node list", "nodes"),
        ("nodes info /robot_0", "info /robot_0"),
        ("rosnode info /robot_0", "info /robot_0"),
        ("ros2 service list -t", "services"),
        ("service call /x", "call /x"),
        ("services call /x", "call /x"),
        ("rosservice args /x", "type --fields /x"),
        ("rosparam get /x", "params get /x"),
        ("param load file", "params load file"),
        ("bag record -a -O run.mcap --duration=5", "record -a -O run.mcap --seconds=5"),
        ("rosbag play -l -r 2 -s 1 run.mcap", "play -l -r 2 -s 1 run.mcap"),
        ("ros2 bag play run.mcap --start-offset 3", "play run.mcap --start 3"),
        ("rosbag info --yaml run.mcap", "info --json run.mcap"),
        ("rosbag reindex run.mcap", "record --repair run.mcap"),
        ("rosmsg show std_msgs/Bool", "type std_msgs/Bool"),
        ("ros2 interface show std_msgs/msg/Bool", "type std_msgs/msg/Bool"),
        ("ros2 doctor", "doctor"),
        ("--debug topic list", "--debug topics"),
        ("topics", "topics"),
        ("topics -v", "topics -v"),
        ("services --all", "services --all"),
        ("params list", "params list"),
        ("params", "params"),
        ("ros2 --domain 3", "ros2 --domain 3"),
        ("echo /topic", "echo /topic"),
        ("pub /x -- topic list", "pub /x -- topic list"),
        ("", ""),
    ],
)
def test_command_lines_of_ros_become_those_of_hostlink(line: str, wanted: str) -> None:
    assert translated(line.split()) == wanted.split()


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("topic", "topic: add a command: list, echo, hz"),
        ("rostopic --help", "rostopic: add a command: list, echo, hz"),
        ("topic lst", "topic lst: there is no such command; `topic` has: list, echo, hz"),
        ("rosnode kill /x", "rosnode kill: hostlink has no such command; `hostlink stop` stops the robots"),
        ("ros2 interface list", "ros2 interface list: hostlink has no such command; `hostlink type TYPE` shows"),
        ("ros2 param dump /robot_0", "ros2 param dump: a parameter belongs to no node; leave the node out"),
        ("ros2 multicast", "ros2 multicast: hostlink has no such command; `hostlink --help` lists all commands"),
        ("ros2 run demo_nodes_cpp talker", "ros2 run: hostlink has no such command; `hostlink serve` starts the dae"),
        ("roslaunch robot.launch", "roslaunch: hostlink has no such command; `hostlink serve` starts the daemon, and"),
        ("rosrun", "rosrun: hostlink has no such command; `hostlink serve` starts the daemon, and `hostlink ros1`"),
        ("rosrun rosserial_python serial_node.py", "rosrun: hostlink has no such command; use `hostlink ros1`"),
        (
            "ros2 run teleop_twist_keyboard teleop_twist_keyboard",
            "ros2 run: hostlink has no such command; use `hostlin",
        ),
        ("rosrun teleop_twist_keyboard x", "rosrun: hostlink has no such command; use `hostlink teleop --layout twis"),
        ("ros2 action list", "ros2 action: rosserial has no actions; `hostlink services` lists the services"),
    ],
)
def test_commands_of_ros_that_hostlink_lacks_name_the_next_step(line: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as found:
        translated(line.split())
    assert str(found.value).startswith(complaint)


def test_translations_exist() -> None:
    commands = {*main.HABITS.values(), *(text for group in ROS_GROUPS.values() for text in group.values())}
    assert {text.split()[0] for text in commands} <= {*COMMANDS, "--version"}
    assert not set(main.HABITS) & set(COMMANDS)
    for (command, _), option in main.ROS_OPTIONS.items():
        found = Documented("a table", (command, *([option] if option else [])), is_complete=False).complaint()
        assert found == ""


def test_options_that_hostlink_lacks_do_not_exist() -> None:
    assert {subject for subject, _ in LACKING} <= {"", *ROS_GROUPS, *COMMANDS}
    for subject, option in LACKING:
        if not subject:
            assert option not in {*COMMANDS, *main.HABITS}
        elif subject in COMMANDS:
            assert "No such option" in Documented("a table", (subject, option), is_complete=False).complaint()
        else:
            assert option not in ROS_GROUPS[subject]
            assert " " not in option


@pytest.mark.parametrize(
    ("command", "text", "wanted"),
    [
        ("hz", "Got unexpected extra argument (/b)", "hz: one topic is measured at a time; run the command once for"),
        (
            "",
            "No such command 'upload'.",
            "upload: there is no such command; the Arduino IDE, arduino-cli or PlatformIO",
        ),
        ("", "No such option: -v", "-v: there is no such option; --version shows the version"),
        ("serve", "No such option: --port", "serve: there is no option --port; a serial port is --serial /dev/ttyUSB0"),
        ("robots", "No such option: --watch", "robots: there is no option --watch; `hostlink top` shows robots"),
        ("teleop", "Got unexpected extra argument (0.2)", "teleop: the keys drive, and the speeds are options"),
        ("", "No such command 'topc'.", "topc: there is no such command; `hostlink --help` lists the commands"),
        (
            "",
            "No such command 'a'. Did you mean 'b', 'c', 'd'?",
            "a: there is no such command; did you mean `b`, `c` or",
        ),
        (
            "params",
            "No such command 'a'.",
            "a: there is no such command of `hostlink params`; `hostlink params --help`",
        ),
        ("echo", "No such option: -x", "echo: there is no option -x; `hostlink echo --help` lists the options"),
        (
            "echo",
            "No such option: --onc (Possible options: --json, --once)",
            "echo: there is no option --onc; did you m",
        ),
        (
            "echo",
            "No such option: --qos-depth",
            "echo: there is no option --qos-depth; rosserial has no quality of ser",
        ),
        (
            "sim",
            "Invalid value for '--world': Path 'x' is not readable.",
            "--world: x cannot be read; check who may read it",
        ),
        ("pub", "No such option: -5", "pub: there is no option -5; write -- before a negative number, as in `hostli"),
        (
            "lab",
            "Missing argument 'what'. Choose from: causes, tables",
            "lab: the argument what is missing; choose causes, tables; `hostlink lab --help` lists the options",
        ),
        ("hz", "No such option: --filter", "hz: there is no option --filter; `hostlink echo TOPIC --json` gives every"),
        ("", "No such option: --url", "--url: there is no such option; write options behind the command, as in"),
        (
            "params set",
            "Got unexpected extra argument (0.4)",
            "params set: a parameter belongs to no node; leave the node out, as in `hostlink params set gain 0.4`",
        ),
        (
            "params load",
            "Got unexpected extra argument (b)",
            "params load: a parameter belongs to no node; leave the node out, as in `hostlink params load FILE`",
        ),
        (
            "topics",
            "Got unexpected extra argument(s) (a b)",
            "topics: there is an argument too many: a b; `hostlink to",
        ),
        ("hz", "Option '--seconds' requires an argument.", "hz: the option --seconds needs a value; `hostlink hz --he"),
        ("x", "Something else.", "x: something else; `hostlink x --help` lists the options"),
    ],
)
def test_complaints_of_the_parser_are_sentences_with_the_next_step(command: str, text: str, wanted: str) -> None:
    assert ": ".join(complaint(command, text)).startswith(wanted)


def test_first_screen_fits_a_terminal_and_names_ten_commands() -> None:
    lines = FIRST_DAY.splitlines()
    assert len(lines) <= 24
    assert all(len(line) <= 80 for line in lines)
    named = [
        line.split()[1] for line in lines if line.startswith("  hostlink ") and not line.split()[1].startswith("-")
    ]
    assert len([name for name in named if name in COMMANDS]) == 10


@dataclass(frozen=True)
class Kind:
    """Type of an option, as each version of the parser has it."""

    name: str
    min: float | None = None
    max: float | None = None


@pytest.mark.parametrize(
    ("text", "kind", "wanted"),
    [
        (
            "--x: 'fast' is not a valid float range.",
            Kind("float range", 0.01, 1.0),
            "--x: 'fast' is not a number from 0.01 to 1",
        ),
        (
            "--x: 0.0 is not in the range 0.01<=x<=1.0.",
            Kind("float range", 0.01, 1.0),
            "--x: 0.0 is not a number from 0.01 to 1",
        ),
        (
            "--x: 'a' is not a valid integer range.",
            Kind("integer range", min=1),
            "--x: 'a' is not a whole number of at least 1",
        ),
        ("--x: 9 is not in the range x<=5.", Kind("int range", max=5), "--x: 9 is not a whole number of at most 5"),
        ("--x: 'a' is not a valid int.", Kind("integer"), "--x: 'a' is not a whole number"),
        ("--x: 'a' is not a valid float.", Kind("float"), "--x: 'a' is not a number"),
        ("No such option: --x", None, "No such option: --x"),
    ],
)
def test_numbers_that_are_not_accepted_are_complained_of_with_their_range_in_words(
    text: str, kind: Kind | None, wanted: str
) -> None:
    assert in_words(text, kind) == wanted
