"""Readers of poses and velocities: what is believed, and what the flaws of the rest are."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.readings import ODOMETRY_TYPE, POSE_TYPE, POSE_TYPES, READERS, VELOCITY_TYPES, Flaw
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadPayload
from tests.support.fake_device import message_type

QUARTER = {"z": math.sin(math.pi / 4), "w": math.cos(math.pi / 4)}
STAMPED = {"header": {"stamp": {"secs": 7, "nsecs": 5}, "frame_id": "odom"}}
COVARIANCE = {"covariance": [0.1] * 36}


def message_of(type_name: str, orientation: dict[str, float], x: float = 1.0) -> dict[str, Any]:
    """A message of a type of poses, or of velocities with x as the speed."""
    pose: dict[str, Any] = {"position": {"x": x, "y": 2.0}, "orientation": orientation}
    twist: dict[str, Any] = {"linear": {"x": x, "y": 0.1}, "angular": {"z": 0.4}}
    match type_name:
        case "geometry_msgs/Pose":
            return pose
        case "geometry_msgs/PoseStamped":
            return {**STAMPED, "pose": pose}
        case "geometry_msgs/PoseWithCovariance":
            return {"pose": pose, **COVARIANCE}
        case "geometry_msgs/PoseWithCovarianceStamped":
            return {**STAMPED, "pose": {"pose": pose, **COVARIANCE}}
        case "nav_msgs/Odometry":
            return {**STAMPED, "pose": {"pose": pose, **COVARIANCE}, "twist": {"twist": twist, **COVARIANCE}}
        case "geometry_msgs/Twist":
            return twist
        case "geometry_msgs/TwistStamped":
            return {**STAMPED, "twist": twist}
        case _:
            return {**STAMPED, "twist": {"twist": twist, **COVARIANCE}}


def payload(type_name: str, message: dict[str, Any]) -> bytes:
    return message_type(type_name).encode(message)


@pytest.mark.parametrize("type_name", POSE_TYPES)
@pytest.mark.parametrize("x", [1e6, -1e150])
def test_reader_believes_no_pose_that_no_robot_can_reach(type_name: str, x: float) -> None:
    message = {"x": 0.0, "y": x} if type_name == POSE_TYPE else message_of(type_name, QUARTER, x)
    reading = READERS[type_name](payload(type_name, message))
    assert (reading.pose, reading.flaws) == (None, (Flaw.TOO_FAR,))


QUATERNION_TYPES = [name for name in POSE_TYPES if name != POSE_TYPE]


@pytest.mark.parametrize("type_name", QUATERNION_TYPES)
def test_reader_of_a_pose_has_its_place_and_heading(type_name: str) -> None:
    reading = READERS[type_name](payload(type_name, message_of(type_name, QUARTER)))
    assert reading.pose == pytest.approx(Pose(1.0, 2.0, math.pi / 2))
    assert reading.flaws == ()
    assert reading.stamp_ns == (
        None if type_name in ("geometry_msgs/Pose", "geometry_msgs/PoseWithCovariance") else 7_000_000_005
    )


@pytest.mark.parametrize("type_name", VELOCITY_TYPES)
def test_reader_of_a_velocity_has_no_pose(type_name: str) -> None:
    reading = READERS[type_name](payload(type_name, message_of(type_name, {}, 0.3)))
    assert (reading.pose, reading.twist) == (None, PlanarVelocity(0.3, 0.1, 0.4))


@pytest.mark.parametrize("type_name", [*QUATERNION_TYPES, *VELOCITY_TYPES])
@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_reader_believes_no_number_that_is_not_finite(type_name: str, number: float) -> None:
    reading = READERS[type_name](payload(type_name, message_of(type_name, QUARTER, number)))
    assert reading.is_empty
    assert reading.flaws == (Flaw.NOT_FINITE,)


@pytest.mark.parametrize("field", ["x", "y", "theta"])
def test_reader_of_a_pose2d_names_nan(field: str) -> None:
    reading = READERS[POSE_TYPE](payload(POSE_TYPE, {"x": 1.0, "y": 1.0, "theta": 1.0, field: math.nan}))
    assert (reading.pose, reading.flaws) == (None, (Flaw.NOT_FINITE,))


@pytest.mark.parametrize(
    ("orientation", "flaw"),
    [
        ({}, Flaw.ZERO_QUATERNION),
        ({"z": 0.4}, Flaw.HEADING_IN_Z),
        ({"z": -3.0}, Flaw.HEADING_IN_Z),
        ({"w": 0.5}, Flaw.BAD_QUATERNION),
        ({"w": 1.0, "z": 1.0}, Flaw.BAD_QUATERNION),
        ({"w": math.nan}, Flaw.NOT_FINITE),
    ],
)
@pytest.mark.parametrize("type_name", QUATERNION_TYPES)
def test_reader_makes_no_pose_of_an_orientation_that_is_not_a_rotation(
    type_name: str, orientation: dict[str, float], flaw: Flaw
) -> None:
    reading = READERS[type_name](payload(type_name, message_of(type_name, orientation)))
    assert (reading.pose, reading.flaws) == (None, (flaw,))


def test_reader_of_an_odometry_keeps_the_velocity_of_a_flawed_pose() -> None:
    reading = READERS[ODOMETRY_TYPE](payload(ODOMETRY_TYPE, message_of(ODOMETRY_TYPE, {}, 0.3)))
    assert reading.twist == PlanarVelocity(0.3, 0.1, 0.4)


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, math.pi, -math.pi / 2])
def test_reader_takes_half_a_turn_and_every_other_rotation(yaw_rad: float) -> None:
    orientation = {"z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2) if yaw_rad != math.pi else 0.0}
    reading = READERS[ODOMETRY_TYPE](payload(ODOMETRY_TYPE, message_of(ODOMETRY_TYPE, orientation)))
    assert reading.pose is not None
    assert math.remainder(reading.pose.theta_rad - yaw_rad, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_reader_names_what_is_unusual_and_keeps_the_pose() -> None:
    message = message_of(ODOMETRY_TYPE, QUARTER)
    message["header"] = {"stamp": {"secs": 0, "nsecs": 0}, "frame_id": "/odom"}
    message["pose"]["covariance"] = [0.0] * 36
    reading = READERS[ODOMETRY_TYPE](payload(ODOMETRY_TYPE, message))
    assert reading.pose is not None
    assert set(reading.flaws) == {Flaw.ZERO_STAMP, Flaw.SLASH_FRAME, Flaw.ZERO_COVARIANCE}
    assert reading.frame_id == "/odom"


def test_reader_names_a_child_frame_with_a_slash() -> None:
    message = message_of(ODOMETRY_TYPE, QUARTER) | {"child_frame_id": "/base_link"}
    reading = READERS[ODOMETRY_TYPE](payload(ODOMETRY_TYPE, message))
    assert (reading.flaws, reading.frame_id) == ((Flaw.SLASH_FRAME,), "/base_link")


@given(st.sampled_from(sorted(READERS)), st.binary(max_size=720))
def test_reader_refuses_exactly_the_payloads_that_the_full_decode_refuses(type_name: str, data: bytes) -> None:
    try:
        message_type(type_name).decode(data)
    except BadPayload:
        with pytest.raises(BadPayload, match=type_name):
            READERS[type_name](data)
    else:
        READERS[type_name](data)


@given(st.sampled_from(QUATERNION_TYPES), st.lists(st.floats(), min_size=6, max_size=6))
def test_reader_gives_a_finite_pose_or_a_flaw(type_name: str, numbers: list[float]) -> None:
    message = message_of(type_name, dict(zip("xyzw", numbers, strict=False)), numbers[4])
    reading = READERS[type_name](payload(type_name, message))
    assert (reading.pose is None) == bool(reading.flaws)
    assert reading.pose is None or all(map(math.isfinite, reading.pose))
