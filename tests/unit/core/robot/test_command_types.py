"""Ways to command a robot: what each encodes is read with the catalog's type, and decoded again."""

import math
import re
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.command_types import (
    ACKERMANN_STAMPED_TYPE,
    ACKERMANN_TYPE,
    ARRAY_TYPES,
    JOINT_STATE_TYPE,
    JOY_TYPE,
    NUMBER_TYPES,
    STRING_TYPE,
    VECTOR_TYPE,
    AckermannCommand,
    CommandType,
    FixedZero,
    JoyCommand,
    ThrottleCommand,
    TopicType,
    TwistCommand,
    VectorCommand,
    WheelCommand,
    WheelScale,
    WordCommand,
    Words,
    decode_twist,
    zero_of,
)
from hostlink.core.robot.kinematics import PLANAR, AckermannDrive, DifferentialDrive, MecanumDrive
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, ZERO, PlanarVelocity, Twist
from hostlink.errors import BadPayload, ConfigError, WrongType
from tests.support.fake_device import message_type

CATALOG = Catalog()
STAMP_NS = 1_700_000_000_123_456_789
STAMP = {"secs": 1_700_000_000, "nsecs": 123_456_789}
CAR = AckermannDrive(wheelbase_m=0.5, max_steering_rad=0.4)
TWO_WHEELS = DifferentialDrive(wheel_separation_m=0.5)
SPEED = WheelScale(1.0)
PWM = WheelScale(255.0, lowest=-255.0, highest=255.0)
WORDS = Words("F", "B", "L", "R", "S")
FULL = PlanarVelocity(0.5, 0.25, 2.0)
HUGE = (
    PlanarVelocity(1e308, 1e308, 1e308), PlanarVelocity(-1e308, 0.0, 1e308), PlanarVelocity(5e-324, 0.0, -1e308),
    PlanarVelocity(math.inf), PlanarVelocity(yaw_rad_s=-math.inf), PlanarVelocity(math.inf, yaw_rad_s=math.inf),
    PlanarVelocity(math.nan), PlanarVelocity(0.1, math.nan, 0.1),
)  # fmt: skip


def topic(type_name: str, name: str = "/car/drive") -> TopicType:
    return TopicType(name, type_name)


def fields(type_name: str, payload: bytes) -> Mapping[str, Any]:
    """Decode with the type of the catalog, which takes exactly these bytes."""
    decoded = message_type(type_name).decode(payload)
    assert message_type(type_name).encode(decoded) == payload
    return decoded


def wheels(type_name: str, *scales: WheelScale) -> WheelCommand:
    return WheelCommand([topic(type_name, "/left"), topic(type_name, "/right")], TWO_WHEELS, scales)


def values(command: CommandType, velocity: PlanarVelocity) -> list[Any]:
    """Numbers that the wheels get."""
    payloads = command.encode(velocity, STAMP_NS)
    numbers = []
    for each, payload in zip(command.topics, payloads, strict=True):
        decoded = fields(each.type_name, payload)
        data = decoded["velocity"] if each.type_name == JOINT_STATE_TYPE else decoded["data"]
        numbers += list(data) if isinstance(data, (Sequence, memoryview)) or hasattr(data, "__iter__") else [data]
    return numbers


# -- Twist ------------------------------------------------------------------------------------------------------------


def test_twist_has_all_six_numbers() -> None:
    command = TwistCommand(topic(TWIST_TYPE))
    (payload,) = command.encode(Twist(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    assert fields(TWIST_TYPE, payload) == {
        "linear": {"x": 1.0, "y": 2.0, "z": 3.0}, "angular": {"x": 4.0, "y": 5.0, "z": 6.0},
    }  # fmt: skip
    assert command.decode("/car/drive", TWIST_TYPE, payload) == (Twist(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), None)


def test_stamped_twist_has_the_time_of_the_host_and_the_frame_of_the_robot() -> None:
    command = TwistCommand(topic(TWIST_STAMPED_TYPE), "car/base_link")
    (payload,) = command.encode(PlanarVelocity(0.1, 0.2, 0.3), STAMP_NS)
    decoded = fields(TWIST_STAMPED_TYPE, payload)
    assert decoded["header"] == {"seq": 0, "stamp": STAMP, "frame_id": "car/base_link"}
    assert decoded["twist"]["linear"] == {"x": 0.1, "y": 0.2, "z": 0.0}
    assert decoded["twist"]["angular"] == {"x": 0.0, "y": 0.0, "z": 0.3}
    assert command.decode("", TWIST_STAMPED_TYPE, payload) == (PlanarVelocity(0.1, 0.2, 0.3).twist, STAMP_NS)


def test_a_stamp_after_2106_begins_anew() -> None:
    (payload,) = TwistCommand(topic(TWIST_STAMPED_TYPE)).encode(ZERO, 2**32 * 1_000_000_000 + 7)
    assert fields(TWIST_STAMPED_TYPE, payload)["header"]["stamp"] == {"secs": 0, "nsecs": 7}


@pytest.mark.parametrize(("type_name", "payload"), [(TWIST_TYPE, bytes(47)), (TWIST_STAMPED_TYPE, bytes(15)),
                                                    (TWIST_STAMPED_TYPE, bytes(16 + 47))])  # fmt: skip
def test_a_twist_of_another_size_is_refused(type_name: str, payload: bytes) -> None:
    with pytest.raises(BadPayload):
        decode_twist("/cmd_vel", type_name, payload)


@pytest.mark.parametrize("command", [
    TwistCommand(topic(TWIST_TYPE)), AckermannCommand(topic(ACKERMANN_TYPE), CAR),
    JoyCommand(topic(JOY_TYPE), axes=(1, None, 0), full=FULL), WordCommand(topic(STRING_TYPE), WORDS, FULL),
    wheels("std_msgs/Int16", PWM, PWM),
])  # fmt: skip
def test_every_robot_obeys_a_twist_and_no_unknown_type(command: CommandType) -> None:
    assert command.decode("/cmd_vel", TWIST_TYPE, PlanarVelocity(0.3).encode()).twist.linear_x_m_s == 0.3
    with pytest.raises(WrongType):
        command.decode("/cmd_vel", "std_msgs/Float32", bytes(4))


# -- Ackermann --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("type_name", [ACKERMANN_TYPE, ACKERMANN_STAMPED_TYPE])
@pytest.mark.parametrize("velocity", [
    PlanarVelocity(0.5, 0.0, 0.25), PlanarVelocity(-0.5, 0.0, 0.25), PlanarVelocity(0.5), ZERO,
])  # fmt: skip
def test_ackermann_round_trip(type_name: str, velocity: PlanarVelocity) -> None:
    command = AckermannCommand(topic(type_name), CAR, "car/base_link")
    (payload,) = command.encode(velocity, STAMP_NS)
    decoded = fields(type_name, payload)
    drive = decoded
    if type_name == ACKERMANN_STAMPED_TYPE:
        assert decoded["header"] == {"seq": 0, "stamp": STAMP, "frame_id": "car/base_link"}
        drive = decoded["drive"]
    assert drive["speed"] == velocity.x_m_s
    expected = math.atan(0.5 * velocity.yaw_rad_s / velocity.x_m_s) if velocity.x_m_s else 0.0
    assert drive["steering_angle"] == pytest.approx(expected, abs=1e-7)
    assert (drive["steering_angle_velocity"], drive["acceleration"], drive["jerk"]) == (0.0, 0.0, 0.0)
    again, stamp_ns = command.decode("", type_name, payload)
    assert tuple(again) == pytest.approx(tuple(velocity.twist), abs=1e-6)
    assert stamp_ns == (STAMP_NS if type_name == ACKERMANN_STAMPED_TYPE else None)


@pytest.mark.parametrize("type_name", [ACKERMANN_TYPE, ACKERMANN_STAMPED_TYPE])
@pytest.mark.parametrize("payload", [b"", bytes(19), bytes(35), bytes(37)])
def test_ackermann_of_another_size_is_refused(type_name: str, payload: bytes) -> None:
    with pytest.raises(BadPayload):
        AckermannCommand(topic(type_name), CAR).decode("", type_name, payload)


@pytest.mark.parametrize("angle_rad", [math.nan, math.inf, -math.inf])
def test_an_angle_that_is_not_finite_is_not_an_end_of_the_steering(angle_rad: float) -> None:
    payload = message_type(ACKERMANN_TYPE).encode({"speed": 0.5, "steering_angle": angle_rad})
    twist, _ = AckermannCommand(topic(ACKERMANN_TYPE), CAR).decode("", ACKERMANN_TYPE, payload)
    assert not twist.is_finite  # the admission refuses it


# -- wheels -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("type_name", [*NUMBER_TYPES])
def test_each_number_type_is_sent_and_saturates(type_name: str) -> None:
    command = wheels(type_name, WheelScale(10.0, rest=20.0), WheelScale(10.0, -1.0, rest=20.0))
    assert values(command, PlanarVelocity(1.0)) == [30.0, 10.0]
    assert values(command, ZERO) == [20.0, 20.0]
    low, high = values(command, PlanarVelocity(-1e300))
    assert low < 20.0 < high
    assert math.isfinite(low)
    assert math.isfinite(high)


@pytest.mark.parametrize("type_name", [*ARRAY_TYPES])
def test_an_array_has_one_number_for_each_wheel(type_name: str) -> None:
    command = WheelCommand([topic(type_name)], TWO_WHEELS, [WheelScale(100.0), WheelScale(100.0)])
    (payload,) = command.encode(PlanarVelocity(0.5, 0.0, 1.0))
    assert fields(type_name, payload)["layout"] == {"dim": [], "data_offset": 0}
    assert values(command, PlanarVelocity(0.5, 0.0, 1.0)) == pytest.approx([25.0, 75.0])
    assert values(command, ZERO) == [0, 0]


def test_a_joint_state_has_velocities_alone() -> None:
    command = WheelCommand([topic(JOINT_STATE_TYPE)], TWO_WHEELS, [SPEED, SPEED], joints=("left", "right"))
    (payload,) = command.encode(PlanarVelocity(0.5, 0.0, 1.0), STAMP_NS)
    decoded = fields(JOINT_STATE_TYPE, payload)
    assert decoded["header"]["stamp"] == STAMP
    assert (list(decoded["name"]), list(decoded["position"]), list(decoded["effort"])) == (["left", "right"], [], [])
    assert list(decoded["velocity"]) == pytest.approx([0.25, 0.75])
    assert values(command, ZERO) == [0.0, 0.0]


def test_a_single_number_is_the_speed_forwards() -> None:
    command = WheelCommand([topic("std_msgs/Float32")], PLANAR, [SPEED])
    assert values(command, PlanarVelocity(0.5, 0.25, 3.0)) == [0.5]
    assert values(command, ZERO) == [0.0]


def test_a_zero_is_rest_on_every_wheel() -> None:
    drive = MecanumDrive(wheel_separation_m=0.4, wheelbase_m=0.2)
    topics = [topic("std_msgs/UInt8", f"/wheel{number}") for number in range(4)]
    scales = [WheelScale(90.0, direction, rest=90.0, lowest=0.0, highest=180.0) for direction in (1.0, -1.0, 1.0, -1.0)]
    command = WheelCommand(topics, drive, scales)
    for zero in (ZERO, PlanarVelocity(-0.0, -0.0, -0.0), Twist(), Twist(angular_x_rad_s=1.0)):
        assert [payload[0] for payload in command.encode(zero)] == [90] * 4
    assert values(command, PlanarVelocity(1.0)) == [180, 0, 180, 0]


@pytest.mark.parametrize(
    ("types", "count", "joints", "reason"),
    [
        (("std_msgs/Int16",), 2, (), "1 topics for 2 wheels"),
        (("std_msgs/Int16",) * 3, 2, (), "3 topics for 2 wheels"),
        (("std_msgs/String",) * 2, 2, (), "std_msgs/String is not a number"),
        (("std_msgs/Int16MultiArray",) * 2, 2, (), "is not a number"),
        ((JOINT_STATE_TYPE,), 2, ("left",), "2 wheels needs as many names"),
        ((JOINT_STATE_TYPE,) * 2, 2, ("left", "right"), "is not a number"),
    ],
)
def test_topics_that_do_not_fit_the_wheels_are_refused(
    types: tuple[str, ...], count: int, joints: tuple[str, ...], reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        WheelCommand([topic(each) for each in types], TWO_WHEELS, [SPEED] * count, joints=joints)


def bounded(full: float, rest: float) -> WheelScale:
    return WheelScale(full / 0.3, 1.0, rest, rest - full, rest + full, 0.3)


@pytest.mark.parametrize(
    ("type_name", "scale", "reason"),
    [
        (
            "std_msgs/UInt8",
            bounded(500, 1500),
            "is sent 1000 to 2000, and std_msgs/UInt8 holds 0 to 255: choose a rest",
        ),
        ("std_msgs/UInt8", bounded(255, 0), "is sent -255 to 255, and std_msgs/UInt8 holds 0 to 255"),
        ("std_msgs/Int8", bounded(255, 0), "is sent -255 to 255, and std_msgs/Int8 holds -128 to 127"),
        ("std_msgs/Int16", WheelScale(1.0, rest=40000), "is sent 40000, and std_msgs/Int16 holds -32768 to 32767"),
        ("std_msgs/Int16", WheelScale(1.0, rest=0.5), "std_msgs/Int16 cannot hold rest = 0.5: choose a whole number"),
        ("std_msgs/Int16", WheelScale(1.0, top=0.5), "is sent at most 0.5, and std_msgs/Int16 holds whole numbers"),
        ("std_msgs/Int8", WheelScale(100.0, top=5.0), "is sent -500 to 500, and std_msgs/Int8 holds -128 to 127"),
        ("std_msgs/Float32", bounded(1e39, 0), "is sent -1e.39 to 1e.39, and std_msgs/Float32 holds"),
        ("std_msgs/Int16MultiArray", WheelScale(1.0, top=0.5), "is sent at most 0.5"),
        ("std_msgs/UInt8", bounded(127, 128), None),
        ("std_msgs/Int8", bounded(1, 0), None),  # a motor that only turns or does not
        ("std_msgs/Int16", WheelScale(20.0, top=0.25), None),
        ("std_msgs/Float32", WheelScale(1.0, top=0.5), None),
        ("std_msgs/Float64", bounded(1e39, 0.5), None),
    ],
)
def test_numbers_that_the_type_cannot_hold_are_refused(type_name: str, scale: WheelScale, reason: str | None) -> None:
    count = 1 if "Array" in type_name else 2
    topics = [topic(type_name, f"/wheel{number}") for number in range(count)]
    if reason is None:
        assert WheelCommand(topics, TWO_WHEELS, [scale] * 2).topics == tuple(topics)
        return
    with pytest.raises(ConfigError, match=reason):
        WheelCommand(topics, TWO_WHEELS, [scale] * 2)
    if count > 1:
        with pytest.raises(ConfigError, match=reason):
            ThrottleCommand((topic("std_msgs/Float64"), topics[1]), CAR, SPEED, scale)


@pytest.mark.parametrize(
    ("type_name", "word"),
    [
        ("std_msgs/Float32", "nan"),
        ("std_msgs/Float64", "inf"),
        ("std_msgs/Float32", "1e39"),
        ("std_msgs/UInt8", "256"),
        ("std_msgs/UInt8", "-1"),
        ("std_msgs/Int16", "0.5"),
    ],
)
def test_word_that_a_number_cannot_hold_is_refused(type_name: str, word: str) -> None:
    with pytest.raises(ConfigError, match=f"'{re.escape(word)}' is not a value of {type_name}"):
        WordCommand(topic(type_name), Words("1", "2", "3", word, "0"), FULL)


def test_wheels_that_differ_in_type_get_one_number_each() -> None:
    topics = [topic("std_msgs/Int16", "/left"), topic("std_msgs/Float32", "/right")]
    assert values(WheelCommand(topics, TWO_WHEELS, [SPEED, SPEED]), PlanarVelocity(2.0)) == [2, 2.0]


# -- Joy --------------------------------------------------------------------------------------------------------------


def joy(*, button: int | None = None, axes: tuple[int, int | None, int | None] = (1, None, 0)) -> JoyCommand:
    return JoyCommand(topic(JOY_TYPE), axes=axes, full=FULL, axis_count=2, button_count=1, button=button)


CAR_TOPICS = (TopicType("throttle", "std_msgs/Int16"), TopicType("steering", "std_msgs/Float32"))


def test_throttle_and_steering_of_a_car() -> None:
    throttle, steering = WheelScale(100.0, rest=1500.0, lowest=1000.0, highest=2000.0), WheelScale(-1000.0, rest=1500.0)
    command = ThrottleCommand(CAR_TOPICS, CAR, throttle, steering)
    assert command.encode(ZERO) == (struct.pack("<h", 1500), struct.pack("<f", 1500.0))
    assert command.encode(PlanarVelocity(math.nan)) == command.encode(ZERO)
    yaw_rad_s = 2.0 * math.tan(0.2) / CAR.wheelbase_m
    ahead, left = command.encode(PlanarVelocity(2.0, 0.0, yaw_rad_s))
    assert struct.unpack("<h", ahead) == (1700,)
    assert struct.unpack("<f", left) == pytest.approx((1300.0,))
    ahead, _ = command.encode(PlanarVelocity(-9.0))
    assert struct.unpack("<h", ahead) == (1000,)


def test_throttle_that_is_not_a_number_is_refused() -> None:
    topics = (CAR_TOPICS[0], TopicType("steering", STRING_TYPE))
    with pytest.raises(ConfigError, match="std_msgs/String is not a number"):
        ThrottleCommand(topics, CAR, WheelScale(1.0), WheelScale(1.0))


@pytest.mark.parametrize(
    ("fields", "sent"),
    [
        (("x", "y", "yaw"), (0.1, 0.2, 0.3)),
        (("x", "yaw"), (0.1, 0.3, 0.0)),
        (("x", "", "yaw"), (0.1, 0.0, 0.3)),
        (("yaw",), (0.3, 0.0, 0.0)),
    ],
)
def test_vector_has_the_components_of_its_fields(fields: tuple[str, ...], sent: tuple[float, ...]) -> None:
    command = VectorCommand(TopicType("cmd", VECTOR_TYPE), fields)
    velocity = PlanarVelocity(0.1, 0.2, 0.3)
    (payload,) = command.encode(velocity)
    assert struct.unpack("<3d", payload) == sent
    again = command.decode("cmd", VECTOR_TYPE, payload).twist.planar
    assert again == PlanarVelocity(
        *(each if name in fields else 0.0 for name, each in zip(("x", "y", "yaw"), velocity, strict=True))
    )
    assert command.encode(ZERO) == (bytes(24),)
    assert command.decode("cmd", TWIST_TYPE, Twist().encode()).twist.is_zero


def test_vector_of_another_type_or_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="is not a geometry_msgs/Vector3"):
        VectorCommand(TopicType("cmd", TWIST_TYPE), ("x",))
    with pytest.raises(BadPayload):
        VectorCommand(TopicType("cmd", VECTOR_TYPE), ("x",)).decode("cmd", VECTOR_TYPE, bytes(23))


def test_joy_round_trip() -> None:
    command = joy(axes=(1, 4, 0), button=3)
    velocity = PlanarVelocity(0.25, -0.25, 1.0)
    (payload,) = command.encode(velocity, STAMP_NS)
    decoded = fields(JOY_TYPE, payload)
    assert list(decoded["axes"]) == [0.5, 0.5, 0.0, 0.0, -1.0]
    assert list(decoded["buttons"]) == [0, 0, 0, 1]
    assert command.decode("", JOY_TYPE, payload) == (velocity.twist, STAMP_NS)


def test_joy_at_rest_has_all_axes_at_rest_and_no_button_pressed() -> None:
    (payload,) = joy(button=3).encode(ZERO)
    decoded = fields(JOY_TYPE, payload)
    assert (any(decoded["axes"]), any(decoded["buttons"])) == (False, False)


def test_joy_is_a_zero_without_its_button_or_its_axes() -> None:
    command, type_ = joy(button=3), message_type(JOY_TYPE)
    for buttons in ([], [1], [0, 0, 0, 0]):
        payload = type_.encode({"axes": [1.0, 1.0], "buttons": buttons})
        assert command.decode("", JOY_TYPE, payload).twist.is_zero
    assert joy().decode("", JOY_TYPE, type_.encode({"axes": [0.5]})).twist == PlanarVelocity(yaw_rad_s=1.0).twist
    assert joy().decode("", JOY_TYPE, type_.encode({"axes": [0.0, math.nan]})).twist.is_finite is False


def test_joy_without_a_full_speed_does_not_move_that_axis() -> None:
    command = JoyCommand(topic(JOY_TYPE), axes=(1, None, 0), full=PlanarVelocity(0.5), axis_count=2)
    assert list(fields(JOY_TYPE, command.encode(PlanarVelocity(0.5, 0.0, 1.0))[0])["axes"]) == [0.0, 1.0]


@pytest.mark.parametrize("payload", [
    b"", bytes(15), bytes(16), bytes(16) + b"\xff\xff\xff\xff", bytes(20), bytes(16) + b"\x01\0\0\0" + bytes(4),
    bytes(20) + b"\x02\0\0\0" + bytes(4), b"\0" * 12 + b"\xff\xff\xff\xff",
])  # fmt: skip
def test_joy_that_is_cut_is_refused(payload: bytes) -> None:
    with pytest.raises(BadPayload):
        joy().decode("", JOY_TYPE, payload)


# -- words ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("velocity", "word", "again"),
    [
        (ZERO, "S", ZERO),
        (PlanarVelocity(0.1), "F", PlanarVelocity(0.5)),
        (PlanarVelocity(-0.1), "B", PlanarVelocity(-0.5)),
        (PlanarVelocity(0.1, 0.0, 0.5), "L", PlanarVelocity(yaw_rad_s=2.0)),
        (PlanarVelocity(0.1, 0.0, -0.5), "R", PlanarVelocity(yaw_rad_s=-2.0)),
        (PlanarVelocity(0.2, 0.0, 0.5), "F", PlanarVelocity(0.5)),
        (PlanarVelocity(0.0, 0.4), "S", ZERO),  # no word for it
    ],
)
def test_words_of_a_velocity(velocity: PlanarVelocity, word: str, again: PlanarVelocity) -> None:
    command = WordCommand(topic(STRING_TYPE), WORDS, FULL)
    (payload,) = command.encode(velocity)
    assert fields(STRING_TYPE, payload) == {"data": word}
    assert command.decode("", STRING_TYPE, payload) == (again.twist, None)


@pytest.mark.parametrize(
    ("type_name", "words", "data"),
    [
        ("std_msgs/Char", WORDS, ord("F")),
        ("std_msgs/Int16", Words("1", "2", "3", "4", "0"), 1),
        ("std_msgs/Float32", Words("1", "-1", "2", "3", "0.5"), 1.0),
    ],
)
def test_words_of_a_board_that_reads_letters_or_numbers(type_name: str, words: Words[str], data: float) -> None:
    command = WordCommand(topic(type_name), words, FULL)
    (payload,) = command.encode(PlanarVelocity(0.1))
    assert fields(type_name, payload) == {"data": data}
    assert command.decode("", type_name, payload).twist == PlanarVelocity(0.5).twist
    assert command.decode("", type_name, command.encode(ZERO)[0]).twist.is_zero
    with pytest.raises(BadPayload, match="is not a word"):
        command.decode("", type_name, message_type(type_name).encode({"data": 77}))


@pytest.mark.parametrize(("type_name", "word"), [("std_msgs/Char", "FF"), ("std_msgs/Int16", "F"), (TWIST_TYPE, "1")])
def test_words_that_do_not_fit_the_type_are_refused(type_name: str, word: str) -> None:
    with pytest.raises(ConfigError, match="is not a value of"):
        WordCommand(topic(type_name), Words(word, "1", "1", "1", "1"), FULL)


def test_words_that_are_one_number_are_refused() -> None:
    with pytest.raises(ConfigError, match="are one value of std_msgs/Int16"):
        WordCommand(topic("std_msgs/Int16"), Words("1", "2", "3", "0.0", "0"), FULL)


def test_words_without_limits_compare_as_they_are() -> None:
    (payload,) = WordCommand(topic(STRING_TYPE), WORDS, ZERO).encode(PlanarVelocity(0.1, 0.0, 0.2))
    assert fields(STRING_TYPE, payload) == {"data": "L"}


@pytest.mark.parametrize("data", ["", "X", "FF", "\xff" * 40])
def test_another_word_is_refused(data: str) -> None:
    with pytest.raises(BadPayload, match="is not a word of the robot"):
        WordCommand(topic(STRING_TYPE), WORDS, FULL).decode(
            "", STRING_TYPE, message_type(STRING_TYPE).encode({"data": data})
        )


# -- all --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [
    AckermannCommand(topic(ACKERMANN_TYPE), CAR), AckermannCommand(topic(ACKERMANN_STAMPED_TYPE), CAR),
    *(wheels(each, PWM, PWM) for each in NUMBER_TYPES),
    *(wheels(each, WheelScale(1e300), SPEED) for each in NUMBER_TYPES),
    *(WheelCommand([topic(each)], TWO_WHEELS, [SPEED, PWM]) for each in ARRAY_TYPES),
    WheelCommand([topic("std_msgs/Float64")], PLANAR, [WheelScale(math.inf)]),
    WheelCommand([topic(JOINT_STATE_TYPE)], TWO_WHEELS, [SPEED, SPEED], joints=("left", "right")),
    joy(button=3, axes=(1, 4, 0)), WordCommand(topic(STRING_TYPE), WORDS, FULL),
])  # fmt: skip
def test_every_velocity_has_a_message_and_one_that_is_not_finite_is_rest(command: CommandType) -> None:
    for velocity in HUGE:
        payloads = command.encode(velocity, STAMP_NS)
        for each, payload in zip(command.topics, payloads, strict=True):
            assert "nan" not in repr(fields(each.type_name, payload))
        if not velocity.is_finite and not isinstance(command, JoyCommand):
            assert payloads == command.encode(ZERO, STAMP_NS)
    assert len(command.encode(Twist(0.1, 0.0, 0.3, 0.0, 0.0, 0.1))) == len(command.topics)


def test_fixed_zero_sends_the_same_for_every_velocity() -> None:
    command = FixedZero(topic("std_msgs/Int16"), b"\x07\0")
    assert command.encode(PlanarVelocity(1.0)) == command.encode(ZERO) == (b"\x07\0",)


@pytest.mark.parametrize("type_name", [
    *NUMBER_TYPES, TWIST_TYPE, TWIST_STAMPED_TYPE, ACKERMANN_TYPE, ACKERMANN_STAMPED_TYPE,
])  # fmt: skip
def test_zero_of_a_type_is_its_message_of_zeros(type_name: str) -> None:
    assert zero_of(type_name) == message_type(type_name).encode({})


@pytest.mark.parametrize("type_name", [*ARRAY_TYPES, JOY_TYPE, JOINT_STATE_TYPE, STRING_TYPE, "custom/Speed"])
def test_a_type_whose_zeros_do_not_mean_rest_has_no_zero(type_name: str) -> None:
    assert zero_of(type_name) is None


def test_zero_of_a_number_is_its_number_at_rest_if_the_type_holds_it() -> None:
    assert zero_of("std_msgs/Int16", 1500.0) == struct.pack("<h", 1500)
    assert zero_of("std_msgs/Float32", 0.5) == struct.pack("<f", 0.5)
    assert zero_of("std_msgs/UInt8", 1500.0) is None
