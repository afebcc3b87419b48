"""Messages for ROS programs: right by REP 103 and 105, and read back by an independent reader."""

import math

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.ros_messages import UNMEASURED, FrameIds, Variances, odometry_of, transform_of, variances_of
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.fake_device import message_type

FRAMES = FrameIds("odom", "base_link")
STAMP = {"secs": 1_700_000_000, "nsecs": 5}
CATALOG = Catalog()
READER = get_typestore(Stores.ROS1_NOETIC)


def test_an_odometry_is_read_by_an_independent_reader() -> None:
    type_ = message_type("nav_msgs/Odometry")
    message = odometry_of(Pose(1.0, -2.0, math.pi / 2), PlanarVelocity(0.3, 0.1, -0.5), FRAMES, STAMP)
    read = READER.deserialize_ros1(type_.encode(message), "nav_msgs/msg/Odometry")
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1_700_000_000, 5)
    assert (read.header.frame_id, read.child_frame_id) == ("odom", "base_link")
    position, orientation = read.pose.pose.position, read.pose.pose.orientation
    assert (position.x, position.y, position.z) == (1.0, -2.0, 0.0)
    assert (orientation.x, orientation.y) == (0.0, 0.0)
    assert (orientation.z, orientation.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert (read.twist.twist.linear.x, read.twist.twist.linear.y, read.twist.twist.angular.z) == (0.3, 0.1, -0.5)
    for covariance in (read.pose.covariance, read.twist.covariance):
        matrix = np.asarray(covariance).reshape(6, 6)
        assert np.array_equal(np.diag(matrix), [1e-3, 1e-3, UNMEASURED, UNMEASURED, UNMEASURED, 1e-2])
        assert np.array_equal(matrix, np.diag(np.diag(matrix)))


def test_a_covariance_that_the_device_publishes_is_kept_and_zeros_or_nan_are_not() -> None:
    reported = [float(number) for number in range(36)]
    for twist in ([0.0] * 36, [math.nan] * 36):
        message = odometry_of(Pose(), PlanarVelocity(), FRAMES, STAMP, Variances(reported, twist))
        assert message["pose"]["covariance"] == reported
        assert message["twist"]["covariance"][0] == 1e-3


def test_covariances_have_their_places_in_the_matrix() -> None:
    assert variances_of({"x": 0.0, "y": 0.0, "theta": 0.0}) == ((), ())
    assert variances_of({"pose": {"covariance": [1.0]}, "twist": {"covariance": [2.0]}}) == ([1.0], [2.0])


def test_a_transform_has_the_same_pose() -> None:
    odometry = odometry_of(Pose(1.0, 2.0, 0.5), PlanarVelocity(), FrameIds("r/odom", "r/base_link"), STAMP)
    type_ = message_type("tf2_msgs/TFMessage")
    (transform,) = type_.decode(type_.encode(transform_of(odometry)))["transforms"]  # type: ignore[misc]
    assert transform["header"]["frame_id"] == "r/odom"
    assert transform["child_frame_id"] == "r/base_link"
    assert transform["transform"]["translation"] == odometry["pose"]["pose"]["position"]
    assert transform["transform"]["rotation"] == odometry["pose"]["pose"]["orientation"]
