"""Directory: which device is which robot, who came back, and who is refused."""

import itertools
from collections.abc import Mapping

import pytest

from hostlink.robot.directory import Accepted, Directory, Refused, RobotTopics, TopicClaim, find_robot

TWIST, POSE, ODOMETRY, EMPTY = "geometry_msgs/Twist", "geometry_msgs/Pose2D", "nav_msgs/Odometry", "std_msgs/Empty"
HOME, AWAY = "192.168.4.2", "192.168.4.3"
SENSOR: list[TopicClaim] = [("/range", "sensor_msgs/Range", False)]


def to_device(name: str, type_name: str = TWIST) -> TopicClaim:
    return name, type_name, True


def from_device(name: str, type_name: str = POSE) -> TopicClaim:
    return name, type_name, False


def paper_robot(name: str = "robot_0") -> list[TopicClaim]:
    return [
        to_device(f"/{name}/velocity_commands"),
        to_device(f"/{name}/reset_odometry", EMPTY),
        to_device(f"/{name}/pid_tune_l", "geometry_msgs/Vector3"),
        from_device(f"/{name}/odometry"),
        from_device(f"/{name}/plot_data", TWIST),
    ]


def plain_robot() -> list[TopicClaim]:
    return [to_device("cmd_vel"), from_device("odom", ODOMETRY)]


def accepted(directory: Directory, link: int, address: str, topics: list[TopicClaim]) -> tuple[str | None, int | None]:
    claim = directory.claim(link, address, topics)
    assert isinstance(claim, Accepted)
    return None if claim.robot is None else claim.robot.name, claim.replaces


def refused(directory: Directory, link: int, address: str, topics: list[TopicClaim]) -> str:
    claim = directory.claim(link, address, topics)
    assert isinstance(claim, Refused)
    return claim.reason


def directory(addresses: Mapping[str, str | None] | None = None) -> Directory:
    return Directory(addresses or {})


# -- what is a robot --------------------------------------------------------------------------------------------------


def test_the_robot_of_the_paper() -> None:
    assert find_robot(paper_robot()) == RobotTopics(
        name="robot_0",
        velocity="/robot_0/velocity_commands",
        odometry="/robot_0/odometry",
        odometry_type=POSE,
        reset="/robot_0/reset_odometry",
    )


def test_a_robot_without_a_namespace_has_a_name_too() -> None:
    assert find_robot(plain_robot()) == RobotTopics("robot", "cmd_vel", "odom", ODOMETRY, None)


@pytest.mark.parametrize(
    "topics",
    [
        [],
        SENSOR,
        [to_device("/a/cmd_vel")],
        [from_device("/a/odometry")],
        [from_device("/a/plot_data", TWIST), from_device("/a/odometry")],  # a Twist that it tells is no way to drive it
        [to_device("/a/cmd_vel"), to_device("/a/goal", POSE)],  # a pose that it takes is not where it is
        [to_device("/a/cmd_vel", "geometry_msgs/TwistStamped"), from_device("/a/odometry")],
    ],
)
def test_what_is_no_robot(topics: list[TopicClaim]) -> None:
    assert find_robot(topics) is None


@pytest.mark.parametrize(
    ("velocity", "odometry", "name"),
    [
        ("/r/cmd_vel", "/r/odom", "r"),
        ("r/cmd_vel", "/r/odom", "r"),
        ("~cmd_vel", "~odom", "robot"),
        ("~/r/cmd_vel", "~r/odom", "r"),
        ("/fleet/r/cmd_vel", "/fleet/r/odom", "fleet_r"),
        ("/r/base/cmd_vel", "/r/odom", "r"),
        ("/r/drive/cmd_vel", "/r/state/odom", "r"),
        ("/cmd_vel", "/r/odom", "r"),
        ("/r/cmd_vel", "/odom", "r"),
        ("/left/cmd_vel", "/right/odom", "left"),
        ("/", "", "robot"),
        ("//r//cmd_vel", "/r/odom", "r"),
        ("/r\x1b[2J é/cmd_vel", "/r\x1b[2J é/odom", "r__2J__"),
        (f"/{'r' * 80}/cmd_vel", "/odom", "r" * 64),
    ],
)
def test_the_name_is_the_common_namespace(velocity: str, odometry: str, name: str) -> None:
    robot = find_robot([to_device(velocity), from_device(odometry)])
    assert robot is not None
    assert (robot.name, robot.velocity, robot.odometry) == (name, velocity, odometry)


@pytest.mark.parametrize(
    ("velocities", "odometries", "chosen"),
    [
        (["/r/arm", "/r/cmd_vel", "/r/velocity_commands"], ["/r/odom"], ("/r/velocity_commands", "/r/odom")),
        (["/r/arm", "/cmd_vel"], ["/r/odom"], ("/cmd_vel", "/r/odom")),
        (["/arm/speed", "/base/speed"], ["/base/odom"], ("/base/speed", "/base/odom")),
        (["/arm/cmd_vel", "/base/cmd_vel"], ["/base/odom"], ("/base/cmd_vel", "/base/odom")),
        (["/r/b", "/r/a"], ["/r/odom"], ("/r/a", "/r/odom")),
        (["/r/cmd_vel"], ["/r/goal_reached", "/r/odometry"], ("/r/cmd_vel", "/r/odometry")),
        (["/r/cmd_vel"], ["/other/odom", "/r/pose"], ("/r/cmd_vel", "/r/pose")),
        (["/r/cmd_vel"], ["/r/pose_b", "/r/pose_a"], ("/r/cmd_vel", "/r/pose_a")),
    ],
)
def test_the_likeliest_pair_is_chosen_in_whatever_order_they_come(
    velocities: list[str], odometries: list[str], chosen: tuple[str, str]
) -> None:
    topics = [*map(to_device, velocities), *map(from_device, odometries)]
    for order in itertools.permutations(topics):
        robot = find_robot(order)
        assert robot is not None
        assert (robot.velocity, robot.odometry) == chosen


@pytest.mark.parametrize(
    ("topics", "reset"),
    [
        ([], None),
        ([to_device("/reset_bot/beep", EMPTY)], None),
        ([to_device("/reset_bot/reset", "std_msgs/Bool")], None),
        ([from_device("/reset_bot/was_reset", EMPTY)], None),
        ([to_device("/elsewhere/reset_odometry", EMPTY)], None),
        ([to_device("/", EMPTY)], None),
        ([to_device("/reset_bot/reset", EMPTY)], "/reset_bot/reset"),
        ([to_device("/reset_bot/a_reset", EMPTY), to_device("/reset_bot/odom_reset", EMPTY)], "/reset_bot/odom_reset"),
        ([to_device("/reset_bot/reset_b", EMPTY), to_device("/reset_bot/reset_a", EMPTY)], "/reset_bot/reset_a"),
    ],
)
def test_the_reset_topic(topics: list[TopicClaim], reset: str | None) -> None:
    robot = find_robot([to_device("/reset_bot/cmd_vel"), from_device("/reset_bot/odom"), *topics])
    assert robot is not None
    assert robot.reset == reset


# -- who came back ----------------------------------------------------------------------------------------------------


def test_a_robot_from_the_same_address_replaces_its_older_link() -> None:
    ours = directory()
    assert accepted(ours, 1, HOME, paper_robot()) == ("robot_0", None)
    assert accepted(ours, 2, HOME, paper_robot()[:4]) == ("robot_0", 1)
    assert accepted(ours, 3, HOME, paper_robot()) == ("robot_0", 2)


def test_a_device_that_tells_its_topics_again_replaces_nobody() -> None:
    ours = directory()
    for _ in range(2):
        assert accepted(ours, 1, HOME, paper_robot()) == ("robot_0", None)


def test_a_device_may_become_another() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot("robot_0"))
    assert accepted(ours, 1, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 2, AWAY, paper_robot("robot_0")) == ("robot_0", None)
    assert accepted(ours, 1, HOME, SENSOR) == (None, None)


def test_robots_behind_one_address_live_side_by_side() -> None:
    ours = directory()
    assert accepted(ours, 1, HOME, paper_robot("robot_0")) == ("robot_0", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 3, HOME, paper_robot("robot_0")) == ("robot_0", 1)


def test_a_device_that_is_no_robot_is_known_by_its_topics() -> None:
    ours = directory()
    assert accepted(ours, 1, HOME, SENSOR) == (None, None)
    assert accepted(ours, 2, HOME, [*SENSOR, from_device("/light", "std_msgs/Int16")]) == (None, None)
    assert accepted(ours, 3, AWAY, SENSOR) == (None, None)
    assert accepted(ours, 4, HOME, SENSOR) == (None, 1)
    assert accepted(ours, 5, HOME, paper_robot()) == ("robot_0", None)


def test_who_left_is_not_replaced() -> None:
    ours = directory()
    accepted(ours, 1, HOME, paper_robot())
    ours.leave(1)
    ours.leave(1)
    assert accepted(ours, 2, AWAY, paper_robot()) == ("robot_0", None)


# -- who is refused ---------------------------------------------------------------------------------------------------


def test_a_name_that_lives_at_another_address_is_refused_with_what_to_do() -> None:
    ours = directory()
    accepted(ours, 1, HOME, plain_robot())
    assert refused(ours, 2, AWAY, plain_robot()) == (
        "two devices claim the robot name robot: 192.168.4.2 has it, 192.168.4.3 wants it; "
        'name one of them in hostlink.toml: [robots.OTHER_NAME] address = "192.168.4.3"'
    )
    assert accepted(ours, 3, HOME, plain_robot()) == ("robot", 1)


def test_a_name_that_is_configured_for_another_address_is_refused_even_when_nobody_is_there() -> None:
    ours = directory({"robot_0": HOME})
    assert refused(ours, 1, AWAY, paper_robot("robot_0")) == (
        "the robot name robot_0 belongs to 192.168.4.2 in hostlink.toml, but 192.168.4.3 wants it; "
        'correct the address, or name this one: [robots.OTHER_NAME] address = "192.168.4.3"'
    )
    assert accepted(ours, 2, HOME, paper_robot("robot_0")) == ("robot_0", None)


# -- configured names -------------------------------------------------------------------------------------------------


def test_the_configuration_names_a_robot_by_its_address() -> None:
    ours = directory({"left": HOME, "right": AWAY, "spare": None})
    assert accepted(ours, 1, HOME, plain_robot()) == ("left", None)
    assert accepted(ours, 2, AWAY, plain_robot()) == ("right", None)
    assert accepted(ours, 3, HOME, plain_robot()) == ("left", 1)
    assert accepted(ours, 4, "192.168.4.9", plain_robot()) == ("robot", None)


def test_a_configured_serial_port_is_an_address() -> None:
    ours = directory({"due": "/dev/ttyACM0"})
    assert accepted(ours, 1, "/dev/ttyACM0", plain_robot()) == ("due", None)


def test_a_configured_name_does_not_make_a_robot_of_a_sensor() -> None:
    assert accepted(directory({"left": HOME}), 1, HOME, SENSOR) == (None, None)


def test_a_robot_without_a_configured_address_keeps_its_name() -> None:
    assert accepted(directory({"robot_0": None}), 1, HOME, paper_robot()) == ("robot_0", None)


def test_one_configured_name_does_not_make_one_robot_of_two() -> None:
    ours = directory({"left": HOME})
    assert accepted(ours, 1, HOME, paper_robot("robot_0")) == ("left", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 3, HOME, paper_robot("robot_0")) == ("left", 1)
    assert accepted(ours, 4, HOME, paper_robot("robot_1")) == ("robot_1", 2)


def test_several_names_at_one_address_go_to_those_who_have_them() -> None:
    ours = directory({"robot_0": HOME, "robot_1": HOME, "third": HOME})
    assert accepted(ours, 1, HOME, paper_robot("robot_1")) == ("robot_1", None)
    assert accepted(ours, 2, HOME, paper_robot("robot_0")) == ("robot_0", None)
    assert accepted(ours, 3, HOME, plain_robot()) == ("third", None)
