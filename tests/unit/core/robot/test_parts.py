"""Parts of a robot: which of several devices commands it, which tell how it moves, what is missing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.model import CommandKind, CommandSettings, Endpoint
from hostlink.core.robot.parts import parts_of, place_in

MOTORS, WHEELS = "10.0.0.2", "/dev/ttyUSB0"
COMMAND = Endpoint("cmd_vel", "geometry_msgs/Twist", is_to_device=True)
POSE = Endpoint("odom", "nav_msgs/Odometry", is_to_device=False)
SPEED = Endpoint("speed", "geometry_msgs/Twist", is_to_device=False)
RANGE = Endpoint("range", "sensor_msgs/Range", is_to_device=False)
BOTH = CommandSettings(devices=(MOTORS, WHEELS))


def test_command_is_one_devices_and_odometry_is_the_others() -> None:
    parts = parts_of("r", BOTH, {MOTORS: [COMMAND, RANGE], WHEELS: [POSE]})
    assert (parts.command, parts.why_not, parts.odometry()) == (MOTORS, "", "odom")
    assert parts.place_of(("odom", "nav_msgs/Odometry")) == WHEELS


def test_odometry_of_the_other_device_precedes_the_commands_own() -> None:
    parts = parts_of("r", BOTH, {MOTORS: [COMMAND, POSE], WHEELS: [POSE]})
    assert parts.place_of(("odom", "nav_msgs/Odometry")) == WHEELS


@pytest.mark.parametrize(
    ("of_motors", "of_wheels", "topic"),
    [
        ([POSE], [SPEED], "speed"),
        ([POSE], [RANGE], "odom"),
        ([POSE], [], "odom"),
        ([], [RANGE, POSE, SPEED], "odom"),
        ([RANGE], [RANGE], None),
    ],
)
def test_topic_of_the_motion_is_the_best_of_the_other_devices_before_the_commands_own(
    of_motors: list[Endpoint], of_wheels: list[Endpoint], topic: str | None
) -> None:
    assert parts_of("r", BOTH, {MOTORS: [COMMAND, *of_motors], WHEELS: of_wheels}).odometry() == topic


@pytest.mark.parametrize(
    ("connected", "why_not"),
    [
        ({MOTORS: [COMMAND]}, f"its device {WHEELS} is not connected"),
        ({WHEELS: [POSE]}, f"its device {MOTORS} is not connected"),
        ({}, f"its device {MOTORS} and {WHEELS} are not connected"),
        ({MOTORS: [RANGE], WHEELS: [POSE]}, "none of its devices takes a velocity"),
        (
            {MOTORS: [COMMAND], WHEELS: [COMMAND, POSE]},
            f"{MOTORS} and {WHEELS} take a velocity: choose one, with command_device in [robots.r], and reload",
        ),
    ],
)
def test_robot_that_lacks_a_device_or_has_two_commands_says_so(
    connected: dict[str, list[Endpoint]], why_not: str
) -> None:
    assert parts_of("r", BOTH, connected).why_not == why_not


LEFT, RIGHT = (Endpoint(f"{side}_motor", "std_msgs/Float32", is_to_device=True) for side in ("left", "right"))
WHEELS_ON_TWO = BOTH._replace(kind=CommandKind.WHEELS, topics=("left_motor", "right_motor"))


@pytest.mark.parametrize(
    ("settings", "connected", "why_not"),
    [
        (
            WHEELS_ON_TWO,
            {MOTORS: [LEFT], WHEELS: [RIGHT]},
            "its command topics must be on one device, and they are on several: "
            f"left_motor on {MOTORS}, right_motor on {WHEELS}",
        ),
        (
            WHEELS_ON_TWO,
            {MOTORS: [RANGE], WHEELS: [RIGHT]},
            "wheels.topics names left_motor, which none of its boards announces (did you mean right_motor?); "
            "its topics are right_motor (std_msgs/Float32)",
        ),
        (
            WHEELS_ON_TWO._replace(command_device=MOTORS),
            {MOTORS: [RANGE], WHEELS: [LEFT, RIGHT]},
            f"command_device in [robots.r] is {MOTORS}, which takes no velocity",
        ),
        (
            BOTH._replace(command_device=WHEELS),
            {MOTORS: [COMMAND], WHEELS: [POSE]},
            f"command_device in [robots.r] is {WHEELS}, which takes no velocity",
        ),
        (BOTH._replace(is_spatial=True), {MOTORS: [COMMAND], WHEELS: [POSE]}, "none of its devices takes a velocity"),
    ],
)
def test_robot_whose_command_is_on_no_single_device_says_where_it_is(
    settings: CommandSettings, connected: dict[str, list[Endpoint]], why_not: str
) -> None:
    assert parts_of("r", settings, connected).why_not == why_not


def test_settings_choose_the_device_of_two_that_take_a_velocity() -> None:
    chosen = BOTH._replace(command_device=WHEELS)
    parts = parts_of("r", chosen, {MOTORS: [COMMAND, POSE], WHEELS: [COMMAND]})
    assert (parts.command, parts.why_not, parts.place_of(("odom", "nav_msgs/Odometry"))) == (WHEELS, "", MOTORS)


def test_device_is_found_by_its_address_with_port_then_address_then_name() -> None:
    devices = ("10.0.0.2:4000", "10.0.0.2", "base")
    named = [Endpoint("/base/odom", "nav_msgs/Odometry", is_to_device=False)]
    assert place_in(devices, named, peer="10.0.0.2:4000", address="10.0.0.2") == "10.0.0.2:4000"
    assert place_in(devices, named, peer="10.0.0.2:4001", address="10.0.0.2") == "10.0.0.2"
    assert place_in(devices, named, peer="10.0.0.3:4001", address="10.0.0.3") == "base"
    assert place_in(devices, [POSE], peer="10.0.0.3:4001", address="10.0.0.3") is None
    for slashed in ("/base", "base/"):
        assert place_in((slashed, "enc"), named, peer="10.0.0.3:4001", address="10.0.0.3") == slashed


@given(st.dictionaries(st.sampled_from([MOTORS, WHEELS, "base"]), st.lists(st.sampled_from([COMMAND, POSE, RANGE]))))
def test_robot_can_be_driven_only_with_every_device_and_one_command(connected: dict[str, list[Endpoint]]) -> None:
    settings = CommandSettings(devices=(MOTORS, WHEELS, "base"))
    parts = parts_of("r", settings, connected)
    commands = [place for place, endpoints in connected.items() if COMMAND in endpoints]
    assert (not parts.why_not) is (len(connected) == 3 and len(commands) == 1)
    if not parts.why_not:
        assert parts.command == commands[0]
