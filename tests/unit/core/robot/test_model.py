"""Model of robots: every row of the tables in its docstrings, with topics of public board programs."""

import tomllib

import pytest

from hostlink.core.robot.command_types import ARRAY_TYPES, JOINT_STATE_TYPE, JOY_TYPE, NUMBER_TYPES, STRING_TYPE
from hostlink.core.robot.model import (
    CommandKind,
    CommandSettings,
    Endpoint,
    RobotTopicNames,
    Role,
    Suggestion,
    actuators,
    find_robot,
    is_velocity,
    leaf_of,
    matched,
    misfit,
    motion_of,
    name_of,
    namespace_of,
    roles,
    select,
    suggest,
    suggestion,
    unannounced,
    unguarded,
)
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE

TWIST, STAMPED, ACKERMANN = TWIST_TYPE, TWIST_STAMPED_TYPE, "ackermann_msgs/AckermannDrive"
ACKERMANN_STAMPED = "ackermann_msgs/AckermannDriveStamped"
POSE, ODOMETRY, EMPTY = "geometry_msgs/Pose2D", "nav_msgs/Odometry", "std_msgs/Empty"
INT16, FLOAT32, CHAR = "std_msgs/Int16", "std_msgs/Float32", "std_msgs/Char"


def to(name: str, type_name: str = TWIST) -> Endpoint:
    return Endpoint(name, type_name, is_to_device=True)


def sent(name: str, type_name: str = POSE) -> Endpoint:
    return Endpoint(name, type_name, is_to_device=False)


def found(*endpoints: Endpoint, settings: CommandSettings | None = None) -> RobotTopicNames:
    robot = find_robot(endpoints, settings or CommandSettings())
    assert robot is not None
    return robot


def names(endpoints: list[Endpoint]) -> list[str]:
    return [each.name for each in endpoints]


# -- commands ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("type_name", [TWIST, STAMPED])
@pytest.mark.parametrize("name", [
    "cmd_vel", "/cmd_vel_mux/input/teleop", "drive", "my_twist", "cmd", "command", "motion", "movement", "base_mov",
    "control", "omni_cart/cmd_vel", "odomspeed", "cmdvel_toSTM", "/wheels/cmd_velocity", "Velocity", "turtle1/cmd_vel",
])  # fmt: skip
def test_a_twist_whose_name_tells_of_motion_is_a_command(name: str, type_name: str) -> None:
    robot = found(to(name, type_name))
    assert (robot.velocity, robot.velocity_type, robot.kind) == (name, type_name, CommandKind.TWIST)
    assert is_velocity(to(name, type_name))


@pytest.mark.parametrize("type_name", [ACKERMANN, ACKERMANN_STAMPED])
@pytest.mark.parametrize("name", ["ackermann_cmd", "a", "desired_state", "/pwm_radio/driver_pwm"])
def test_an_ackermann_message_is_a_command_by_its_type(name: str, type_name: str) -> None:
    robot = found(to(name, type_name))
    assert (robot.velocity_type, robot.kind) == (type_name, CommandKind.ACKERMANN)


@pytest.mark.parametrize(
    "endpoint", [sent("cmd_vel", TWIST), sent("ackermann", ACKERMANN), to("target"), to("cmd_vel", STRING_TYPE)]
)
def test_topic_from_device_or_of_another_name_or_type_does_not_drive(endpoint: Endpoint) -> None:
    assert not is_velocity(endpoint)
    assert find_robot([endpoint]) is None


def test_a_pose_makes_a_robot_of_a_twist_with_any_name() -> None:
    assert found(to("target"), sent("pose")).velocity == "target"
    ignored = CommandSettings(ignored=frozenset({"target"}))
    assert find_robot([to("target"), sent("pose")], ignored) is None


def test_ignored_topics_command_nothing() -> None:
    settings = CommandSettings(ignored=frozenset({"cmd_vel", "motor"}))
    endpoints = [to("cmd_vel"), to("motor", INT16)]
    assert find_robot(endpoints, settings) is None
    assert unguarded(endpoints, settings) == []


def test_a_spatial_command_belongs_to_no_robot() -> None:
    assert find_robot([to("cmd_vel")], CommandSettings(is_spatial=True)) is None


@pytest.mark.parametrize(
    ("settings", "endpoints", "text"),
    [
        (CommandSettings(), [to("cmd_vel")], ""),
        (CommandSettings(topics=("/cmd_vel",)), [to("cmd_vel")], ""),
        (
            CommandSettings(topics=("cmd_vle",)),
            [to("cmd_vel"), sent("cmd_vle")],
            "command_topic names cmd_vle, which the board does not announce (did you mean cmd_vel?); "
            "its topics are cmd_vel (geometry_msgs/Twist)",
        ),
        (
            CommandSettings(CommandKind.WHEELS, ("/left", "rigth")),
            [to("left", INT16), to("right", INT16)],
            "wheels.topics names rigth, which the board does not announce (did you mean right?); "
            "its topics are left (std_msgs/Int16), right (std_msgs/Int16)",
        ),
        (
            CommandSettings(CommandKind.JOY, ("joy",)),
            [],
            "joy.topic names joy, which the board does not announce; it takes no topic",
        ),
    ],
)
def test_topics_of_the_settings_that_a_board_lacks_are_named_with_the_nearest(
    settings: CommandSettings, endpoints: list[Endpoint], text: str
) -> None:
    assert misfit(settings, endpoints) == text


def test_other_names_of_the_settings_that_no_board_announces_are_named_with_the_nearest() -> None:
    settings = CommandSettings(
        odometry="ododm", ignored=frozenset({"x", "/led"}), locked=frozenset({"grippper", "/arm"}), stop_service="hlt"
    )
    endpoints = [to("gripper"), to("arm"), to("led"), sent("odom")]
    assert unannounced(settings, endpoints, ["halt"]) == (
        "locked_topics names grippper, which the board does not announce (did you mean gripper?); "
        "not_commands names x, which the board does not announce; "
        "feedback.topic names ododm, which the board does not announce (did you mean odom?); "
        "stop_service names hlt, which the board does not announce (did you mean halt?)"
    )
    assert unannounced(CommandSettings(odometry=""), endpoints, []) == ""


def test_settings_get_the_names_that_the_board_announces() -> None:
    settings = CommandSettings(
        topics=("/go", "b"), odometry="/odom", ignored=frozenset({"/x"}), locked=frozenset({"arm", "none"})
    )
    endpoints = [to("go"), to("b"), to("/b"), to("x"), to("/arm"), sent("odom"), sent("/none")]
    ours = matched(settings, endpoints)
    assert (ours.topics, ours.odometry) == (("go", "b"), "odom")
    assert (ours.ignored, ours.locked) == ({"/x", "x"}, {"arm", "/arm", "none"})
    assert matched(CommandSettings(odometry=""), endpoints) == CommandSettings(odometry="")


@pytest.mark.parametrize(
    ("settings", "topics", "kind"),
    [
        (CommandSettings(topics=("go",)), ("go",), CommandKind.TWIST),
        (CommandSettings(topics=("steer",)), ("steer",), CommandKind.ACKERMANN),
        (CommandSettings(CommandKind.WHEELS, ("l", "r")), ("l", "r"), CommandKind.WHEELS),
        (CommandSettings(CommandKind.WHEELS, ("r", "l")), ("r", "l"), CommandKind.WHEELS),
    ],
)
def test_settings_name_the_command(settings: CommandSettings, topics: tuple[str, ...], kind: CommandKind) -> None:
    endpoints = [to("go"), to("steer", ACKERMANN), to("l", INT16), to("r", INT16), to("cmd_vel")]
    robot = found(*endpoints, settings=settings)
    assert (tuple(each.name for each in robot.commands), robot.kind) == (topics, kind)


def test_settings_whose_topics_the_device_lacks_leave_it_what_it_is_by_itself() -> None:
    settings = CommandSettings(CommandKind.WHEELS, ("left", "right"))
    wheels = [to("left", INT16), sent("right", INT16)]
    assert find_robot(wheels, settings) is None
    robot = found(*wheels, to("cmd_vel"), settings=settings)
    assert (robot.velocity, robot.kind) == ("cmd_vel", CommandKind.TWIST)
    of_several = settings._replace(devices=("here", "there"))  # another board may have the wheels
    assert find_robot([*wheels, to("cmd_vel")], of_several) is None


def test_select_returns_the_settings_whose_topics_the_device_has() -> None:
    settings = {"a": CommandSettings(), "b": CommandSettings(topics=("x", "y")), "c": CommandSettings(topics=("x",))}
    assert select(settings, [to("x")]) == "c"
    assert select(settings, [to("x"), to("y")]) == "b"
    assert select(settings, [sent("x")]) is None


def test_the_usual_name_and_the_namespace_of_the_pose_precede() -> None:
    assert found(to("/a/drive"), to("/b/cmd_vel"), to("/c/velocity_commands")).velocity == "/c/velocity_commands"
    assert found(to("/a/cmd_vel"), to("/b/cmd_vel"), sent("/b/pose")).velocity == "/b/cmd_vel"
    assert found(to("/a/cmd_vel"), to("/b/cmd_vel"), sent("/a/pose"), sent("/b/odom")).velocity == "/b/cmd_vel"
    assert found(to("cmd_vel", STAMPED), to("cmd_vel", TWIST)).velocity_type == TWIST


# -- pose and reset ---------------------------------------------------------------------------------------------------


def test_the_pose_that_a_person_would_choose_precedes() -> None:
    poses = [
        sent("/a/other", "geometry_msgs/PoseStamped"),
        sent("/b/odom", ODOMETRY),
        sent("/a/pose"),
        sent("/a/odom", ODOMETRY),
    ]
    assert found(to("/a/cmd_vel"), *poses).odometry == "/a/odom"
    assert found(to("/a/cmd_vel"), *poses[:3]).odometry == "/a/pose"
    assert found(to("/a/cmd_vel"), *poses[:2]).odometry == "/b/odom"
    assert found(to("/a/cmd_vel"), poses[0]).odometry_type == "geometry_msgs/PoseStamped"


def test_a_measured_velocity_is_read_without_a_pose() -> None:
    robot = found(to("cmd_vel"), sent("sensor_velocity", TWIST), sent("x", STRING_TYPE))
    assert (robot.odometry, robot.odometry_type) == ("sensor_velocity", TWIST)
    assert found(to("cmd_vel")).odometry is None
    assert found(to("cmd_vel"), sent("cmd_vel_echo", TWIST)).odometry is None


@pytest.mark.parametrize(("wanted", "odometry"), [("", None), ("b", "b"), ("text", None), ("missing", None)])
def test_settings_name_the_pose(wanted: str, odometry: str | None) -> None:
    endpoints = [to("cmd_vel"), sent("a", ODOMETRY), sent("b"), sent("text", STRING_TYPE)]
    assert found(*endpoints, settings=CommandSettings(odometry=wanted)).odometry == odometry


def test_the_reset_is_in_the_namespace_of_command_or_pose() -> None:
    resets = [
        to("/c/reset", EMPTY),
        to("/a/reset", EMPTY),
        to("/b/reset_odom", EMPTY),
        to("/a/reset_x", STRING_TYPE),
        to("/a/go", EMPTY),
    ]
    assert found(to("/a/cmd_vel"), sent("/b/odom"), *resets).reset == "/b/reset_odom"
    assert found(to("/a/cmd_vel"), *resets).reset == "/a/reset"
    assert found(to("/a/cmd_vel"), resets[0], sent("/a/reset", EMPTY)).reset is None


def test_own_topics_are_the_commands_and_the_others_in_the_namespace() -> None:
    robot = found(to("/a/cmd_vel"), sent("/a/odom"), to("/a/reset_odom", EMPTY))
    assert robot.own == {"/a/cmd_vel": TWIST, "/a/odom": POSE, "/a/reset_odom": EMPTY}
    assert found(to("/a/cmd_vel"), sent("/b/odom")).own == {"/a/cmd_vel": TWIST}
    assert found(to("cmd_vel"), sent("/a/odom")).namespace == ("a",)
    assert found(to("/a/cmd_vel")).own == {"/a/cmd_vel": TWIST}


# -- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "odometry", "name"),
    [
        ("cmd_vel", "", ""), ("/cmd_vel", "/robot_7/odom", ""), ("/a/cmd_vel", "/b/odom", "a"), ("~cmd_vel", "", ""),
        ("/a/base/cmd_vel", "/a/odom", "a"), ("/a/base/cmd_vel", "", "a_base"), ("/rover_cmd_vel", "", "rover"),
        ("cmdvel_toSTM", "", ""), ("drive_b2", "", ""), ("", "", ""), ("/über/cmd_vel", "", "_ber"),
        ("/" + "x" * 99 + "/cmd_vel", "", "x" * 64), ("TurtleCmd_vel", "", "TurtleCmd"),
    ],
)  # fmt: skip
def test_name_of(command: str, odometry: str, name: str) -> None:
    assert name_of(command, odometry) == name


def test_parts_of_a_name() -> None:
    assert (leaf_of("/a//b"), namespace_of("/a//b")) == ("b", ("a",))
    assert (leaf_of("/"), namespace_of("~x")) == ("", ())


# -- topics that need a setting ---------------------------------------------------------------------------------------

#: Topics to the device of public programs, each of which moves something.
SUSPECTS = [
    ("/linear/angular", TWIST),
    ("set_vel", "geometry_msgs/Vector3"),
    ("motor1", INT16),
    ("lspd", INT16),
    ("throttle", FLOAT32),
    ("motor1_cmd", FLOAT32),
    ("/space1/move_zumo", FLOAT32),
    ("/arduino/motor_1", FLOAT32),
    ("wheel_power_right", FLOAT32),
    ("rotate", FLOAT32),
    ("joyinputx", FLOAT32),
    ("robot_command", STRING_TYPE),
    ("/user_input", STRING_TYPE),
    ("ard_in", STRING_TYPE),
    ("to_arduino", STRING_TYPE),
    ("/move_cmds", CHAR),
    ("/cmd_vel", CHAR),
    ("arduino", CHAR),
    ("/input", CHAR),
    ("mcu/velocity", "std_msgs/UInt8"),
    ("motor", "std_msgs/UInt8"),
    ("lwheel_motor_cmd_pub", "std_msgs/Int32"),
    ("RIGHT_PWM", "std_msgs/Int32"),
    ("speed_L", "std_msgs/Int8"),
    ("/axo/hardware/motor_speeds", "std_msgs/Float32MultiArray"),
    ("vel_curvature", "std_msgs/Float32MultiArray"),
    ("input_duties", "std_msgs/Float32MultiArray"),
    ("motor_cmds", "std_msgs/Int16MultiArray"),
    ("PWMs", "std_msgs/Int16MultiArray"),
    ("/right_wheel/command", "std_msgs/Float64"),
    ("rightMotor", "std_msgs/Float64"),
    ("/base_mov", "std_msgs/UInt16"),
    ("/ros_car_master/command", INT16),
    ("joy", JOY_TYPE),
    ("JoyCommandMotor", JOY_TYPE),
    ("/wheels/cmd_move", "geometry_msgs/Pose"),
    ("thruster_speed", "bbauv_msgs/thruster"),
    ("/arm/wheel", INT16),
    ("/swarm_1/left_wheel", INT16),
    ("left_wheel_joint_velocity", "std_msgs/Float64"),
    ("wheel_joint_cmd", "std_msgs/Float64"),
    ("joint1_vel", FLOAT32),
    ("following_speed", FLOAT32),
    ("drawing_vel", FLOAT32),
    ("swing_motor", INT16),
    ("arm_motor_pwm", INT16),
    ("lift_motor", INT16),
    ("stepper_motor_speed", INT16),
    ("servo_speed", FLOAT32),
]
ACTUATORS = [
    ("servo1", "std_msgs/UInt16"),
    ("/servo_neck_pan", "std_msgs/UInt16"),
    ("steering_angle", FLOAT32),
    ("joint_states", JOINT_STATE_TYPE),
    ("/manipulator/joint_1_controller/command", "std_msgs/Float64"),
    ("niryo/stepper_actuate", "std_msgs/Int16MultiArray"),
    ("arduino/arm_actuate", "std_msgs/UInt16"),
    ("robotic_arm", INT16),
    ("/gripper/command/x", INT16),
    ("open_gripper", EMPTY),
    ("on_off_gripper", "std_msgs/Bool"),
    ("launch_torpedo1", EMPTY),
    ("servo_pwm", INT16),
    ("stepper_motor", INT16),
    ("motor_angle", FLOAT32),
    ("left_wheel_position", FLOAT32),
    ("left_wing", INT16),
    ("lift_level", FLOAT32),
]
DATA = [
    ("/chatter", STRING_TYPE),
    ("toggle_led", EMPTY),
    ("led0", "std_msgs/UInt8"),
    ("rgb_leds", "std_msgs/UInt8MultiArray"),
    ("motor_power", "std_msgs/Bool"),
    ("set_pid", "geometry_msgs/Vector3"),
    ("reset", EMPTY),
    ("cmd_color", "std_msgs/ColorRGBA"),
    ("set_pose", POSE),
    ("display", STRING_TYPE),
    ("/alarm", INT16),
    ("emotion", CHAR),
    ("warmth", INT16),
]


@pytest.mark.parametrize(("name", "type_name"), SUSPECTS)
def test_topic_that_looks_like_a_command_is_unguarded(name: str, type_name: str) -> None:
    endpoint = to(name, type_name)
    assert (unguarded([endpoint]), actuators([endpoint]), find_robot([endpoint])) == ([endpoint], [], None)


@pytest.mark.parametrize(("name", "type_name"), ACTUATORS)
def test_topic_that_sets_a_position_is_an_actuator(name: str, type_name: str) -> None:
    endpoint = to(name, type_name)
    assert (unguarded([endpoint]), actuators([endpoint]), find_robot([endpoint])) == ([], [endpoint], None)


@pytest.mark.parametrize(("name", "type_name"), DATA)
def test_everything_else_is_data(name: str, type_name: str) -> None:
    endpoint = to(name, type_name)
    assert (unguarded([endpoint]), actuators([endpoint]), find_robot([endpoint])) == ([], [], None)


@pytest.mark.parametrize(("name", "type_name"), [*SUSPECTS, *ACTUATORS])
def test_topic_from_the_device_commands_nothing(name: str, type_name: str) -> None:
    assert (unguarded([sent(name, type_name)]), actuators([sent(name, type_name)])) == ([], [])


def test_the_command_of_a_robot_is_neither_unguarded_nor_an_actuator() -> None:
    settings = CommandSettings(CommandKind.WHEELS, ("joints",))
    endpoints = [to("joints", JOINT_STATE_TYPE), to("servo", INT16), to("motor", INT16), to("arm_vel")]
    assert names(actuators(endpoints, settings)) == ["servo"]
    assert names(unguarded(endpoints, settings, guarded=["joints", "arm_vel"])) == ["motor"]


def test_every_topic_has_one_role_of_which_the_command_precedes() -> None:
    settings = CommandSettings(ignored=frozenset({"motor_debug"}), locked=frozenset({"arm_servo"}))
    endpoints = [
        to("cmd_vel"),
        to("raw_cmd_vel"),
        to("motor", INT16),
        to("motor_debug", INT16),
        to("arm_servo", INT16),
        to("gripper", INT16),
        to("led", "std_msgs/ColorRGBA"),
        sent("odom"),
        sent("motor", INT16),
    ]
    guarded = ["cmd_vel", "raw_cmd_vel"]
    found = roles(endpoints, settings, commands=["cmd_vel"], guarded=guarded, feedback=["odom"])
    assert [(each.name, role) for each, role in found] == [
        ("cmd_vel", Role.COMMAND),
        ("raw_cmd_vel", Role.VELOCITY),
        ("motor", Role.UNGUARDED),
        ("motor_debug", Role.IGNORED),
        ("arm_servo", Role.LOCKED),
        ("gripper", Role.ACTUATOR),
        ("led", Role.DATA),
        ("odom", Role.FEEDBACK),
        ("motor", Role.DATA),  # what the board sends under that name commands nothing
    ]


@pytest.mark.parametrize(
    "topics",
    [
        ("left_rpm", "right_rpm"),
        ("M1", "M2"),
        ("left", "right"),
        ("front_left", "front_right"),
        ("fl", "fr"),
        ("esc",),
        ("vl", "vr"),
        ("u_left", "u_right"),
        ("omega_left", "omega_right"),
        ("voltage_left", "voltage_right"),
        ("izquierda", "derecha"),
        ("moteurG", "moteurD"),
        ("omni/movimiento",),
        ("geschwindigkeit", "lenkung"),
        ("/actuators/steering", "/actuators/speed"),
    ],
)
def test_usual_names_of_motors_look_like_motion(topics: tuple[str, ...]) -> None:
    assert names(unguarded([to(name, INT16) for name in topics])) == list(topics)


@pytest.mark.parametrize("name", ["describe", "leftover", "m10_led", "door", "led_left", "voltmeter", "video"])
def test_other_names_of_numbers_do_not(name: str) -> None:
    assert unguarded([to(name, INT16)]) == []


def test_a_trigger_that_names_a_direction_is_an_actuator() -> None:
    topics = [to(name, "std_msgs/Empty") for name in ("forward", "left", "toggle_led")]
    assert names(actuators(topics)) == ["forward", "left"]


def test_the_name_of_a_robot_does_not_tell_what_its_topics_are_for() -> None:
    gains = to("/big_wheel/gains_left", "geometry_msgs/Vector3")
    left = to("/big_wheel/left_motor", INT16)
    drive = to("/big_wheel/cmd_vel")
    assert names(unguarded([drive, gains, left], guarded=[drive.name])) == [left.name]
    assert names(unguarded([gains, left])) == [gains.name, left.name]  # not of a robot: the namespace tells of motion
    drive = to("/wheels/cmd_vel")
    assert names(unguarded([drive, to("/wheels/left", INT16)], guarded=[drive.name])) == ["/wheels/left"]


# -- suggestions ------------------------------------------------------------------------------------------------------


def suggested(*suspects: Endpoint) -> dict[str, object]:
    text = suggestion(suspects, "a", "10.0.0.1")
    robot: dict[str, object] = tomllib.loads(text)["robots"]["a"]
    assert robot.pop("address") == "10.0.0.1"
    return robot


def numbers(*topics: str, type_name: str = INT16) -> list[Endpoint]:
    return [to(topic, type_name) for topic in topics]


@pytest.mark.parametrize(
    ("topics", "wheels"),
    [
        (["motor"], ["motor"]),
        (["right_drive", "left_drive"], ["left_drive", "right_drive"]),
        (["rmotor_cmd", "lmotor_cmd", "speed"], ["lmotor_cmd", "rmotor_cmd"]),
        (["/Speed", "/Speed/lSpeed", "/Speed/rSpeed"], ["/Speed/lSpeed", "/Speed/rSpeed"]),
        (["RIGHT_PWM", "LEFT_PWM"], ["LEFT_PWM", "RIGHT_PWM"]),
        (
            ["motor_traction_left", "motor_traction_right", "control_mode"],
            ["motor_traction_left", "motor_traction_right"],
        ),
        (["steering"], ["steering"]),
        (["motor1", "motor2"], ["motor1", "motor2"]),
        (["derecha", "izquierda"], ["izquierda", "derecha"]),
        (["vr", "vl"], ["vl", "vr"]),
        (["moteurD", "moteurG"], ["moteurG", "moteurD"]),
    ],
)
def test_suggestion_of_wheels_names_them_in_order(topics: list[str], wheels: list[str]) -> None:
    assert suggested(*numbers(*topics)) == {"wheels": {"topics": wheels, "unit": "pwm"}}


@pytest.mark.parametrize(
    ("topics", "kinematics"),
    [
        (["motor1", "motor2", "motor3"], "omni3"),
        (["motor1", "motor2", "motor3", "motor4"], "skid_steer"),
        (["left_front_wheel", "left_rear_wheel", "right_front_wheel", "right_rear_wheel"], "skid_steer"),
    ],
)
def test_suggestion_of_more_wheels_names_the_drive(topics: list[str], kinematics: str) -> None:
    robot = suggested(*numbers(*topics))
    assert robot["kinematics"] == kinematics
    assert isinstance(robot["wheels"], dict)
    assert set(robot["wheels"]["topics"]) == set(topics)


def test_suggestion_for_each_type() -> None:
    assert suggested(to("target", TWIST)) == {"command_topic": "target"}
    assert suggested(to("target", STAMPED)) == {"command_topic": "target"}
    assert suggested(to("joy", JOY_TYPE)) == {"joy": {"topic": "joy", "x_axis": 1, "yaw_axis": 0}}
    for type_name in (STRING_TYPE, CHAR):
        words = {"topic": "cmd", "forward": "F", "backward": "B", "left": "L", "right": "R", "stop": "S"}
        assert suggested(to("cmd", type_name)) == {"words": words}
    for type_name in (*ARRAY_TYPES, *NUMBER_TYPES):
        wheels: dict[str, object] = {"topics": ["motors"], "unit": "pwm"}
        if "Int8" in type_name:
            wheels["full"] = 127
        robot: dict[str, object] = {"wheels": wheels}
        if "UInt" in type_name:  # the number at rest may be one in the middle, at which another motor turns
            robot = {"locked_topics": ["motors"]}
        assert suggested(to("motors", type_name)) == robot


def test_suggestion_for_a_table_that_is_there_repeats_nothing_of_it() -> None:
    text = suggestion(numbers("l", "r"), "car", "", is_configured=True)
    assert text == '[robots.car.wheels]\ntopics = ["l", "r"]\nunit = "pwm"'
    four = suggestion(numbers("m1", "m2", "m3", "m4"), "car", "", is_configured=True)
    assert four.startswith('[robots.car]\nkinematics = "skid_steer"\n[robots.car.wheels]\n')
    assert suggestion([to("go", TWIST)], "car", "", is_configured=True) == '[robots.car]\ncommand_topic = "go"'


def test_suggestion_for_a_robot_lets_its_lock_refuse_the_topics_and_keeps_its_command() -> None:
    text = suggestion([to("motor", INT16), to("target", TWIST)], "a", "10.0.0.1", is_robot=True)
    assert tomllib.loads(text) == {"robots": {"a": {"locked_topics": ["motor", "target"]}}}


def test_suggestion_for_a_robot_with_any_name_is_toml() -> None:
    text = suggestion([to("motor", INT16)], "fleet/robot 0", "10.0.0.1", is_robot=True)
    assert tomllib.loads(text)["robots"] == {"fleet/robot 0": {"locked_topics": ["motor"]}}


def test_suggestions_for_several_devices_are_one_file_of_toml() -> None:
    boards = [
        ([to("foo", TWIST)], "10.0.0.1", "10.0.0.1:4001"),
        ([to("foo", TWIST), to("led", INT16)], "10.0.0.1", "10.0.0.1:4002"),  # equal: it shares the lines
        ([to("foo", TWIST)], "10.0.0.2", "10.0.0.2:4003"),
        ([to("foo", STRING_TYPE)], "10.0.0.1", "10.0.0.1:4004"),
        ([to("foo", JOY_TYPE)], "/dev/ttyUSB0", "/dev/ttyUSB0"),
    ]
    others: dict[str, Suggestion | None] = {"foo_4": None}
    for suspects, address, peer in boards:
        new = suggest(suspects, "foo", address, peer, others)
        others[new.name] = new
    lines = "\n".join(each.lines for each in others.values() if each is not None)
    assert {name: each["address"] for name, each in tomllib.loads(lines)["robots"].items()} == {
        "foo": "10.0.0.1",
        "foo_2": "10.0.0.2",
        "foo_3": "10.0.0.1:4004",
        "foo_5": "/dev/ttyUSB0",
    }


def test_suggestion_for_a_car_and_for_a_vector() -> None:
    car = {"throttle": {"topics": ["esc_speed", "steer_cmd"], "unit": "pwm"}}
    assert suggested(*numbers("steer_cmd", "esc_speed")) == car
    assert suggested(*numbers("throttle", "steering")) == {
        "throttle": {"topics": ["throttle", "steering"], "unit": "pwm"}
    }
    assert suggested(*numbers("steer_cmd", "left_motor", "right_motor")) == {
        "wheels": {"topics": ["left_motor", "right_motor"], "unit": "pwm"}
    }
    vector = {"vector": {"topic": "cmd", "fields": ["x", "y", "yaw"]}}
    assert suggested(to("cmd", "geometry_msgs/Vector3")) == vector


def test_suggestion_for_what_cannot_be_encoded_lets_a_lock_refuse_it() -> None:
    assert suggested(to("speed", "custom/Speed")) == {"locked_topics": ["speed"]}
    motors = [f"motor{number}" for number in range(5)]
    assert suggested(*numbers(*motors)) == {"locked_topics": motors}
    assert suggested(to("speed", "custom/Speed"), to("target", TWIST)) == {"command_topic": "target"}


@pytest.mark.parametrize(
    ("first", "second", "is_one"),
    [
        ("cmd_vel", "cmd_vel_stamped", True),
        ("/robot/cmd_vel", "robot/drive", True),
        ("cmd_vel", "arm_vel", False),
        ("a/cmd_vel", "b/cmd_vel", False),
    ],
)
def test_topics_whose_names_differ_in_words_of_commands_are_one_motion(
    first: str, second: str, *, is_one: bool
) -> None:
    assert (motion_of(first) == motion_of(second)) is is_one
