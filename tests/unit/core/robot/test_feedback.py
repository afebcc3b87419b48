"""Feedback: which topics tell how a robot moves, and what wheels make of them."""

import contextlib
import itertools
import math
import random
import struct
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.feedback import RECOGNISED, SENT_BACK, Feedback, FeedbackKind, FeedbackSettings, recognised
from hostlink.core.robot.kinematics import PLANAR, DifferentialDrive, Drive, Pose, SkidSteerDrive
from hostlink.core.robot.readings import ODOMETRY_TYPE, OdometryReading
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.wheel_feedback import JOINT_STATE_TYPE, WheelSettings
from hostlink.errors import BadPayload, ConfigError
from tests.support.fake_device import message_type

SEPARATION_M, RADIUS_M, TICKS = 0.21, 0.045, 230.4
M_PER_TICK = math.tau * RADIUS_M / TICKS


DRIVE = DifferentialDrive(wheel_separation_m=SEPARATION_M)
FOUR_WHEELS = SkidSteerDrive(wheel_separation_m=SEPARATION_M)
PAIR = [("left_ticks", "std_msgs/Int16"), ("right_ticks", "std_msgs/Int16")]


def encoders(**settings: object) -> FeedbackSettings:
    defaults: dict[str, object] = {"ticks_per_turn": TICKS, "wheel_radius_m": RADIUS_M}
    if not settings.keys() & {"topic", "topics"}:
        defaults["topics"] = ("left_ticks", "right_ticks")
    return FeedbackSettings(encoders=WheelSettings(**{**defaults, **settings}))  # type: ignore[arg-type]


def pair(type_name: str = "std_msgs/Int16", **settings: object) -> Feedback:
    return Feedback([(name, type_name) for name, _ in PAIR], encoders(**settings), DRIVE)


def feed(feedback: Feedback, left: int, right: int, now_s: float, code: str = "h") -> OdometryReading | None:
    """Both counts, as a counter of that width has them."""
    bits = 8 * struct.calcsize(f"<{code}")
    for (name, _), count in zip(feedback.topics, (left, right), strict=True):
        raw = (count % (1 << bits)).to_bytes(bits // 8, "little")
        found = feedback.read(name, raw, now_s=now_s)
    return found


# -- poses that the device was given ----------------------------------------------------------------------------------


def pose2d(pose: Pose) -> bytes:
    return struct.pack("<3d", *pose)


def test_pose_that_the_device_was_given_and_sends_back_is_left_out() -> None:
    feedback = Feedback([("odom", "geometry_msgs/Pose2D")], RECOGNISED, PLANAR)
    given_poses = [Pose(number / 10, 0.0, 0.1) for number in range(10)]
    found = []
    for pose in given_poses:
        feedback.note_given(pose)
        sent = struct.unpack("<3f", struct.pack("<3f", *pose))  # as a board rounds it
        found.append(feedback.read("odom", struct.pack("<3d", *sent), now_s=0.0))
    left_out = [each is not None and each.pose is None and each.flaws == ("sent_back",) for each in found]
    assert left_out == [False] * (SENT_BACK - 1) + [True] * (11 - SENT_BACK)
    again = feedback.read("odom", pose2d(given_poses[-1]), now_s=0.0)  # at rest
    assert again is not None
    assert again.is_empty
    own = feedback.read("odom", pose2d(Pose(0.95, 0.01, 0.1)), now_s=0.0)  # it counts by itself after all
    assert own is not None
    assert own.pose is not None


def test_device_that_counts_on_from_the_poses_that_it_is_given_is_believed() -> None:
    feedback = Feedback([("odom", "geometry_msgs/Pose2D")], RECOGNISED, PLANAR)
    for number in range(20):
        feedback.note_given(Pose(float(number), 0.0, 0.0))  # a localisation corrects it
        for step in range(3):
            found = feedback.read("odom", pose2d(Pose(number + step / 100, 0.0, 0.0)), now_s=0.0)
            assert found is not None
            assert found.pose is not None
        feedback.note_given(Pose(float(number), 0.0, 0.0))


# -- which topic ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("offered", "topic", "kind"),
    [
        ([("chatter", "std_msgs/String"), ("odom", ODOMETRY_TYPE)], "odom", FeedbackKind.POSE),
        ([("/sensor_velocity", "geometry_msgs/Twist")], "/sensor_velocity", FeedbackKind.VELOCITY),
        ([("v", "geometry_msgs/Twist"), ("pose", "geometry_msgs/Pose2D")], "pose", FeedbackKind.POSE),
        (
            [("/wheels/odom_velocity", "geometry_msgs/Twist"), ("/wheels/odom_position", "geometry_msgs/Pose")],
            "/wheels/odom_position",
            FeedbackKind.POSE,
        ),
        ([("cmd_vel_rc100", "geometry_msgs/Twist")], None, FeedbackKind.NONE),
        ([("actual_brake", "geometry_msgs/Twist")], None, FeedbackKind.NONE),
        ([("left_ticks", "std_msgs/Int16"), ("right_ticks", "std_msgs/Int16")], None, FeedbackKind.NONE),
        ([("joint_states", JOINT_STATE_TYPE)], None, FeedbackKind.NONE),
        ([], None, FeedbackKind.NONE),
    ],
)
def test_feedback_without_settings_is_recognised_by_type_and_name(
    offered: list[tuple[str, str]], topic: str | None, kind: FeedbackKind
) -> None:
    feedback = Feedback(offered, RECOGNISED, DRIVE)
    assert feedback.kind is kind
    assert [name for name, _ in feedback.topics] == ([] if topic is None else [topic])
    assert bool(feedback.lacks) == (kind is FeedbackKind.NONE)


def test_feedback_of_several_poses_is_the_one_named_odom() -> None:
    assert recognised([("a", ODOMETRY_TYPE), ("z/odom", ODOMETRY_TYPE)]) == ("z/odom", ODOMETRY_TYPE)


def test_feedback_is_the_best_topic_in_any_order() -> None:
    best, others = ("odom", ODOMETRY_TYPE), [("speed", "geometry_msgs/Twist"), ("pose", "geometry_msgs/Pose2D")]
    for offered in itertools.permutations([best, *others]):
        assert recognised(offered) == best


def test_feedback_named_by_the_settings_is_taken_or_its_lack_is_named() -> None:
    offered = [("odom", ODOMETRY_TYPE), ("/v", "geometry_msgs/Twist"), ("text", "std_msgs/String")]
    assert Feedback(offered, FeedbackSettings(topic="v"), DRIVE).topics == (("/v", "geometry_msgs/Twist"),)
    assert Feedback(offered, FeedbackSettings(topic=""), DRIVE).kind is FeedbackKind.NONE
    assert Feedback(offered, FeedbackSettings(topic="w"), DRIVE).lacks == "the topic w, which the settings name"
    assert "std_msgs/String does not" in Feedback(offered, FeedbackSettings(topic="text"), DRIVE).lacks


def test_feedback_of_a_heading_in_z_makes_no_pose_when_it_passes_one() -> None:
    feedback = Feedback([("p", "geometry_msgs/Pose")], RECOGNISED, DRIVE)

    def pose_of(**orientation: float) -> Pose | None:
        message = {"position": {}, "orientation": orientation}
        reading = feedback.read("p", message_type("geometry_msgs/Pose").encode(message), now_s=0.0)
        assert reading is not None
        return reading.pose

    assert pose_of(z=0.9) is None
    assert pose_of(z=1.0) is None
    assert pose_of(w=1.0) == Pose()
    assert pose_of(z=1.0) == Pose(theta_rad=math.pi)
    assert pose_of(z=0.9) is None
    feedback.restart()  # the board may have another program now
    assert pose_of(z=1.0) == Pose(theta_rad=math.pi)


def test_feedback_that_the_board_integrates_is_reset_by_the_board_alone() -> None:
    feedback = Feedback([("p", "geometry_msgs/Pose2D")], RECOGNISED, DRIVE)
    feedback.reset_pose()
    reading = feedback.read("p", struct.pack("<3d", 1.5, 0.0, 0.0), now_s=0.0)
    assert reading is not None
    assert reading.pose == Pose(1.5)
    assert feedback.restarts == 0


# -- counts -----------------------------------------------------------------------------------------------------------


@given(
    st.sampled_from(["Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"]),
    st.integers(0, 2**64 - 1),
    st.lists(st.tuples(st.integers(-60, 60), st.integers(-60, 60)), min_size=1, max_size=30),
)
def test_counts_wrap_around_at_the_width_of_their_type(name: str, start: int, steps: list[tuple[int, int]]) -> None:
    code = {"8": "b", "16": "h", "32": "i", "64": "q"}[name.lstrip("UInt")]
    feedback = pair(f"std_msgs/{name}")
    start |= 1 << 7  # away from zero, where a board starts
    left = right = start
    expected = Pose()
    assert feed(feedback, left, right, 0.0, code) is None
    for number, (dl, dr) in enumerate(steps, 1):
        left, right = left + dl, right + dr
        found = feed(feedback, left, right, number * 0.1, code)
        expected = DRIVE.integrate(expected, (dl * M_PER_TICK, dr * M_PER_TICK))
        if feedback.restarts:
            return  # near zero after a sudden reversal: as a board that has restarted
        assert found is not None
        assert found.pose == pytest.approx(expected, abs=1e-9)


def test_counts_give_a_reading_when_both_wheels_have_reported() -> None:
    feedback = pair()
    feed(feedback, 1000, 1000, 0.0)
    assert feedback.read("left_ticks", struct.pack("<h", 1010), now_s=0.1) is None
    assert feedback.read("left_ticks", struct.pack("<h", 1020), now_s=0.2) is None
    found = feedback.read("right_ticks", struct.pack("<h", 1020), now_s=0.2)
    assert found is not None
    assert found.pose == pytest.approx(Pose(20 * M_PER_TICK))


def test_counts_of_a_board_that_restarts_do_not_leap() -> None:
    feedback = pair()
    for number in range(20):
        before = feed(feedback, 1000 + 10 * number, 1000 + 10 * number, number * 0.1)
    found = feed(feedback, 0, 0, 2.0)
    assert found is not None
    assert before is not None
    assert found.pose == before.pose
    assert feedback.restarts == 1
    found = feed(feedback, 10, 10, 2.1)
    assert found is not None
    assert found.pose == pytest.approx(Pose(200 * M_PER_TICK))


def test_counts_of_a_board_that_restarts_in_silence_do_not_leap() -> None:
    feedback = pair()
    feed(feedback, 300, 300, 0.0)
    found = feed(feedback, 5, 5, 8.0)
    assert found is not None
    assert (found.pose, feedback.restarts) == (Pose(), 1)


@pytest.mark.parametrize("speed", [3, 20, -20])
def test_counts_that_roll_through_zero_are_not_a_restart(speed: int) -> None:
    feedback = pair()
    start = -6 * speed
    for number in range(13):
        found = feed(feedback, start + speed * number, start + speed * number, number * 0.1)
    assert found is not None
    assert found.pose is not None
    assert feedback.restarts == 0
    assert found.pose.x_m == pytest.approx(12 * speed * M_PER_TICK)


def test_counts_of_a_start_are_not_a_restart() -> None:
    feedback = pair()
    feed(feedback, 0, 0, 0.0)
    found = feed(feedback, 60, 60, 0.5)
    assert found is not None
    assert (found.pose, feedback.restarts) == (pytest.approx(Pose(60 * M_PER_TICK)), 0)


def test_counts_that_leap_once_are_damage_and_twice_a_restart() -> None:
    feedback = pair("std_msgs/Int32")
    feed(feedback, 1000, 1000, 0.0, "i")
    feed(feedback, 1010, 1010, 0.1, "i")
    assert feed(feedback, 900_000, 1020, 0.2, "i") is None
    found = feed(feedback, 1030, 1030, 0.3, "i")
    assert found is not None
    assert found.pose == pytest.approx(Pose(30 * M_PER_TICK))
    assert feedback.restarts == 0
    assert feed(feedback, 500_000, 500_000, 0.4, "i") is None
    found = feed(feedback, 500_010, 500_010, 0.5, "i")
    assert found is not None
    assert found.pose == pytest.approx(Pose(40 * M_PER_TICK))
    assert feedback.restarts == 1


def test_counts_after_a_new_connection_begin_anew_where_the_robot_was() -> None:
    feedback = pair()
    feed(feedback, 100, 100, 0.0)
    feed(feedback, 200, 200, 0.5)
    feedback.restart()
    assert feed(feedback, 1, 1, 0.6) is None
    found = feed(feedback, 2, 2, 0.7)
    assert found is not None
    assert found.pose == pytest.approx(Pose(101 * M_PER_TICK))
    feedback.reset_pose()
    found = feed(feedback, 2, 2, 0.8)
    assert found is not None
    assert found.pose == Pose()


def test_differences_of_each_message_are_summed_also_those_of_the_faster_wheel() -> None:
    feedback = pair(counts="differences")
    feed(feedback, 5, 5, 0.0)
    for count in (3, 4):
        assert feedback.read("left_ticks", struct.pack("<h", count), now_s=0.1) is None
    found = feedback.read("right_ticks", struct.pack("<h", 7), now_s=0.1)
    assert found is not None
    assert found.pose == pytest.approx(Pose(12 * M_PER_TICK))


def test_an_array_of_differences_and_directions() -> None:
    settings = encoders(topic="e", counts="differences", directions=(1, -1, 1, -1))
    feedback = Feedback([("/e", "std_msgs/Int32MultiArray")], settings, FOUR_WHEELS)
    payload = message_type("std_msgs/Int32MultiArray").encode(
        {"layout": {"dim": [{"label": "wheels", "size": 4, "stride": 4}]}, "data": [10, -10, 10, -10]}
    )
    for number in range(3):
        found = feedback.read("/e", payload, now_s=number * 0.1)
    assert found is not None
    assert found.pose == pytest.approx(Pose(30 * M_PER_TICK))


def test_two_encoders_of_four_wheels_are_the_sides() -> None:
    feedback = Feedback(PAIR, encoders(), FOUR_WHEELS)
    feed(feedback, 1000, 1000, 0.0)
    found = feed(feedback, 1010, 1030, 0.1)
    assert found is not None
    assert found.pose == pytest.approx(DRIVE.integrate(Pose(), (10 * M_PER_TICK, 30 * M_PER_TICK)))


@pytest.mark.parametrize(
    ("settings", "drive", "lacks"),
    [
        ({"ticks_per_turn": None}, DRIVE, "ticks_per_turn of its encoders"),
        ({"ticks_per_turn": None, "wheel_radius_m": None}, DRIVE, "ticks_per_turn and wheel_radius_m of its encoders"),
        ({}, PLANAR, "the dimensions of its drive (kinematics)"),
        ({"wheels": ("front_left", "front_right")}, FOUR_WHEELS, "the encoders of rear_left, rear_right"),
        ({"topics": ("left_ticks",)}, DRIVE, "wheels = [...] of its encoders, which names 1 of left, right"),
    ],
)
def test_counts_without_a_dimension_say_whether_the_robot_moves(
    settings: dict[str, object], drive: Drive, lacks: str
) -> None:
    feedback = Feedback(PAIR, encoders(**settings), drive)
    assert (feedback.kind, feedback.lacks) == (FeedbackKind.MOTION, lacks)
    moving = []
    for number, count in enumerate([5000, 5000, 5003, 5003, 5003, 5003, 5003, 5003, 5003]):
        for name, _ in feedback.topics:
            found = feedback.read(name, struct.pack("<h", count), now_s=number * 0.1)
        moving.append(None if found is None else found.is_moving)
    assert moving == [None, False, True, True, True, True, True, False, False]


@pytest.mark.parametrize(
    ("offered", "settings", "problem"),
    [
        (PAIR, {"wheels": ("left", "middle")}, "'middle' is not a wheel of this drive: left or right"),
        (PAIR, {"wheels": ("left",)}, "wheels has 1 entries for 2 wheels"),
        (PAIR, {"directions": (1,)}, "directions has 1 entries for 2 wheels"),
        ([("left_ticks", "std_msgs/String"), PAIR[1]], {}, "std_msgs/String has no counts or speeds of wheels"),
        ([("j", JOINT_STATE_TYPE)], {"topic": "j", "unit": "rad"}, "joints must name the wheels"),
        ([("j", JOINT_STATE_TYPE)], {"topic": "j", "joints": ("l", "r")}, "has positions"),
    ],
)
def test_settings_that_do_not_fit_are_refused_with_their_reason(
    offered: list[tuple[str, str]], settings: dict[str, object], problem: str
) -> None:
    with pytest.raises(ConfigError, match=problem.replace("[", r"\[")):
        Feedback(offered, encoders(**settings), DRIVE)


def test_a_topic_of_the_encoders_that_no_device_has_is_named() -> None:
    feedback = Feedback(PAIR[:1], encoders(), DRIVE)
    assert (feedback.kind, feedback.topics) == (FeedbackKind.NONE, ())
    assert feedback.lacks == "the topic right_ticks, which its encoders have by the settings"


# -- speeds -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "value"),
    [("m/s", 0.2), ("rad/s", 0.2 / RADIUS_M), ("ticks/s", 0.2 / M_PER_TICK), ("rpm", 60 * 0.2 / math.tau / RADIUS_M)],
)
@pytest.mark.parametrize(("type_name", "code"), [("std_msgs/Float32", "f"), ("std_msgs/Float64", "d")])
def test_wheel_speeds_are_a_velocity_and_are_integrated(unit: str, value: float, type_name: str, code: str) -> None:
    feedback = pair(type_name, unit=unit)
    for number in range(11):
        for name, _ in PAIR:
            found = feedback.read(name, struct.pack(f"<{code}", value), now_s=number * 0.1)
    assert found is not None
    assert found.twist == pytest.approx(PlanarVelocity(0.2), abs=1e-6)
    assert found.pose == pytest.approx(Pose(0.2), abs=1e-6)


def test_wheel_speeds_over_a_silence_are_not_integrated() -> None:
    feedback = pair("std_msgs/Float32", unit="m/s")
    for now_s in (0.0, 60.0):
        for name, _ in PAIR:
            found = feedback.read(name, struct.pack("<f", 0.2), now_s=now_s)
    assert found is not None
    assert found.pose == Pose()


def test_wheel_speeds_without_a_radius_say_whether_the_robot_moves() -> None:
    feedback = pair("std_msgs/Float32", unit="rpm", wheel_radius_m=None)
    assert feedback.kind is FeedbackKind.MOTION
    found = []
    for speed in (0.4, 20.0):
        for name, _ in PAIR:
            reading = feedback.read(name, struct.pack("<f", speed), now_s=0.0)
        found.append(reading and reading.is_moving)
    assert found == [False, True]


def joints(names: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()) -> bytes:
    return message_type(JOINT_STATE_TYPE).encode(
        {"header": {"stamp": {"secs": 3}}, "name": names, "position": positions, "velocity": velocities}
    )


def test_joints_are_read_by_name_as_positions_or_velocities() -> None:
    offered = [("joint_states", JOINT_STATE_TYPE)]
    settings = {"topic": "joint_states", "joints": ("wheel_l", "wheel_r")}
    feedback = Feedback(offered, encoders(**settings, unit="rad"), DRIVE)
    feedback.read("joint_states", joints(["arm", "wheel_r", "wheel_l"], [9.0, 1.0, 1.0]), now_s=0.0)
    found = feedback.read("joint_states", joints(["arm", "wheel_r", "wheel_l"], [9.5, 2.0, 2.0]), now_s=0.1)
    assert found is not None
    assert (found.pose, found.stamp_ns) == (pytest.approx(Pose(RADIUS_M)), 3_000_000_000)
    feedback = Feedback(offered, encoders(**settings, unit="rad/s"), DRIVE)
    found = feedback.read("joint_states", joints(["wheel_l", "wheel_r"], [0.0, 0.0], [2.0, 2.0]), now_s=0.0)
    assert found is not None
    assert found.twist == pytest.approx(PlanarVelocity(2.0 * RADIUS_M))
    with pytest.raises(BadPayload, match="'wheel_r' has no velocity"):
        feedback.read("joint_states", joints(["wheel_l"], [0.0], [2.0]), now_s=0.0)


# -- damage -----------------------------------------------------------------------------------------------------------


@given(st.binary(max_size=200))
def test_damaged_payloads_raise_nothing_but_bad_payload(data: bytes) -> None:
    for type_name, settings in [
        ("std_msgs/Int16", {"topics": ("t",), "wheels": ("left",)}),
        ("std_msgs/Float32", {"topics": ("t",), "wheels": ("left",)}),
        ("std_msgs/Int32MultiArray", {"topic": "t"}),
        ("std_msgs/Float64MultiArray", {"topic": "t", "unit": "m/s"}),
        (JOINT_STATE_TYPE, {"topic": "t", "unit": "rad", "joints": ("a", "b")}),
    ]:
        feedback = Feedback([("t", type_name)], encoders(**settings), DRIVE)
        is_message = True
        try:
            message_type(type_name).decode(data)
        except BadPayload:
            is_message = False
        with contextlib.suppress(BadPayload) if is_message else pytest.raises(BadPayload):
            feedback.read("t", data, now_s=0.0)  # a message may have too few wheels


@pytest.mark.parametrize(
    ("type_name", "payload", "problem"),
    [
        ("std_msgs/Float32", struct.pack("<f", math.nan), "a value that is not finite"),
        ("std_msgs/Float32", struct.pack("<f", math.inf), "a value that is not finite"),
        ("std_msgs/Float32MultiArray", struct.pack("<3If", 0, 0, 1, 0.5), "1 values for 2 wheels"),
        ("std_msgs/Float32MultiArray", struct.pack("<3I2f", 0, 0, 3, 0.5, 0.5), "3 elements need 24"),
        ("std_msgs/Float32MultiArray", struct.pack("<2I", 65, 0), "65 elements; at most 64 are read"),
        (JOINT_STATE_TYPE, joints(["a", "b"], [1.0, 1.0], [1.0, 1.0]) + b"x", "the message ends after 74"),
        (JOINT_STATE_TYPE, joints(["a", "b"], [], [math.nan, 1.0]), "a value that is not finite"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_damaged_wheels_are_named_and_leave_the_pose_as_it_was(type_name: str, payload: bytes, problem: str) -> None:
    is_scalar = type_name == "std_msgs/Float32"
    joint_names = ("a", "b") if type_name == JOINT_STATE_TYPE else ()
    where = {"topics": ("t", "u")} if is_scalar else {"topic": "t", "joints": joint_names}
    good = {
        "std_msgs/Float32": struct.pack("<f", 0.2),
        "std_msgs/Float32MultiArray": struct.pack("<3I3f", 0, 0, 3, 0.2, 0.2, math.nan),  # the third is not a wheel
        JOINT_STATE_TYPE: joints(["a", "b"], [], [0.2, 0.2]),
    }[type_name]
    feedback = Feedback([("t", type_name), ("u", type_name)], encoders(**where, unit="m/s"), DRIVE)

    def read(now_s: float) -> Pose | None:
        for topic, _ in feedback.topics:
            reading = feedback.read(topic, good, now_s=now_s)
        assert reading is not None
        return reading.pose

    read(0.0)
    with pytest.raises(BadPayload, match=problem):
        feedback.read("t", payload, now_s=0.5)
    assert read(1.0) == pytest.approx(Pose(0.2), abs=1e-6)


def test_restarts_at_any_time_move_the_robot_by_no_more_than_a_hand() -> None:
    """Boards that restart while the robot drives; the seed is fixed."""
    dice = random.Random(36)
    for _ in range(300):
        feedback = pair("std_msgs/Int32")
        count, true_m, now_s, restarts = dice.randrange(0, 100_000), 0.0, 0.0, 0
        speed = dice.uniform(-0.6, 0.6)
        feed(feedback, count, count, now_s, "i")
        for _ in range(30):
            now_s += 0.1
            if dice.random() < 0.05:
                count, restarts = 0, restarts + 1
                if dice.random() < 0.5:
                    now_s += dice.uniform(0.2, 5.0)
            else:
                ticks = round(speed * 0.1 / M_PER_TICK)
                count, true_m = count + ticks, true_m + ticks * M_PER_TICK
            found = feed(feedback, count, count, now_s, "i")
        assert found is not None
        assert found.pose is not None
        assert found.pose.x_m == pytest.approx(true_m, abs=0.01 + 0.12 * restarts)
