"""Fast reader of odometry: the same values as a full decode, and no payload breaks it."""

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryEstimator
from hostlink.core.robot.readings import ODOMETRY_TYPE, POSE_TYPE, READERS, Flaw, OdometryReading
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadPayload
from tests.support.fake_device import message_type

texts = st.text(max_size=20)
floats = st.floats()


def odometry(yaw_rad: float = 0.0, twist: PlanarVelocity | None = None, length: float = 1.0) -> dict[str, Any]:
    twist = PlanarVelocity() if twist is None else twist
    orientation = {"w": length * math.cos(yaw_rad / 2), "z": length * math.sin(yaw_rad / 2)}
    return {
        "pose": {"pose": {"position": {"x": 1.0, "y": 2.0}, "orientation": orientation}},
        "twist": {"twist": {"linear": {"x": twist.x_m_s, "y": twist.y_m_s}, "angular": {"z": twist.yaw_rad_s}}},
    }


def read(type_name: str, message: dict[str, Any]) -> OdometryReading:
    return READERS[type_name](message_type(type_name).encode(message))


def updated(reading: OdometryReading) -> OdometryEstimator:
    estimator = OdometryEstimator()
    estimator.update(reading.pose, now_s=0.0, wall_ns=0, twist=reading.twist)
    return estimator


def test_a_pose2d_is_wrapped_and_has_neither_twist_nor_stamp() -> None:
    reading = read(POSE_TYPE, {"x": 1.0, "y": 2.0, "theta": 7.0})
    assert reading.pose == pytest.approx(Pose(1.0, 2.0, 7.0 - math.tau))
    assert (reading.twist, reading.stamp_ns) == (None, None)


@pytest.mark.parametrize("length", [1.0, 0.95])
@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -3.0, math.pi])
def test_an_odometry_has_pose_and_twist_also_with_a_rounded_quaternion(yaw_rad: float, length: float) -> None:
    reading = read(ODOMETRY_TYPE, odometry(yaw_rad, PlanarVelocity(0.2, 0.1, -0.4), length))
    assert reading.pose == pytest.approx(Pose(1.0, 2.0, yaw_rad))
    assert reading.twist == PlanarVelocity(0.2, 0.1, -0.4)


def test_a_twist_of_no_numbers_is_estimated_from_the_poses() -> None:
    observed = updated(read(ODOMETRY_TYPE, odometry(0.0, PlanarVelocity(math.nan, yaw_rad_s=0.0)))).snapshot(0.0)
    assert observed.twist == PlanarVelocity()


@given(texts, texts, st.lists(floats, min_size=11, max_size=11), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_an_odometry_is_read_as_the_full_decode_has_it(
    frame: str, child: str, numbers: list[float], secs: int, nsecs: int
) -> None:
    position, orientation = dict(zip("xyz", numbers, strict=False)), dict(zip("xyzw", numbers[3:], strict=False))
    linear, angular = dict(zip("xy", numbers[7:], strict=False)), dict(zip("xz", numbers[9:], strict=False))
    message = {
        "header": {"seq": 7, "stamp": {"secs": secs, "nsecs": nsecs}, "frame_id": frame},
        "child_frame_id": child,
        "pose": {"pose": {"position": position, "orientation": orientation}, "covariance": [0.5] * 36},
        "twist": {"twist": {"linear": linear, "angular": angular}, "covariance": [0.25] * 36},
    }
    reading = read(ODOMETRY_TYPE, message)
    if reading.pose is None:
        assert set(reading.flaws) & {
            Flaw.NOT_FINITE, Flaw.TOO_FAR, Flaw.ZERO_QUATERNION, Flaw.HEADING_IN_Z, Flaw.BAD_QUATERNION,
        }  # fmt: skip
    else:
        assert reading.pose[:2] == (numbers[0], numbers[1])
    twist = (numbers[7], numbers[8], numbers[10])
    assert reading.twist == (twist if all(map(math.isfinite, twist)) else None)
    assert reading.stamp_ns == secs * 1_000_000_000 + nsecs
    estimator = updated(reading)
    assert estimator.count == 1 or estimator.snapshot(0.0) is None


@given(floats, floats, floats)
def test_any_pose2d_leaves_finite_numbers(x: float, y: float, theta: float) -> None:
    estimator = updated(read(POSE_TYPE, {"x": 0.1, "y": 0.2, "theta": 0.3}))
    estimator.update(read(POSE_TYPE, {"x": x, "y": y, "theta": theta}).pose, now_s=0.4, wall_ns=0)
    observed = estimator.snapshot(0.4)
    assert all(map(math.isfinite, observed.pose))


@given(st.sampled_from([POSE_TYPE, ODOMETRY_TYPE]), st.binary(max_size=800))
@example(POSE_TYPE, bytes(24))
@example(ODOMETRY_TYPE, bytes(12) + b"\xff\xff\xff\xff" + bytes(700))
@example(ODOMETRY_TYPE, bytes(12) + b"\x01\x00\x00\x00a" + bytes(4 + 680))
@example(ODOMETRY_TYPE, bytes(699))
@example(ODOMETRY_TYPE, bytes(700))
@example(ODOMETRY_TYPE, bytes(701))
def test_reader_refuses_exactly_the_payloads_that_the_full_decode_refuses(type_name: str, payload: bytes) -> None:
    try:
        message_type(type_name).decode(payload)
    except BadPayload:
        with pytest.raises(BadPayload, match=type_name):
            READERS[type_name](payload)
    else:
        READERS[type_name](payload)
