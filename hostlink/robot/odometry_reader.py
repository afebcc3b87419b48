"""Pose, twist and stamp of a robot's odometry, read from the bytes: a full decode of every message costs more."""

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

from hostlink.errors import BadPayload
from hostlink.robot.kinematics import Pose, wrap_angle
from hostlink.robot.velocity import PlanarVelocity

POSE_TYPE, ODOMETRY_TYPE = "geometry_msgs/Pose2D", "nav_msgs/Odometry"
_POSE = struct.Struct("<3d")
_HEADER = struct.Struct("<4xIII")  # seq, secs, nsecs, length of frame_id
_LENGTH = struct.Struct("<I")  # of child_frame_id
_BODY = struct.Struct("<2d8x4d288x2d24xd288x")  # x, y, orientation; linear x, y; angular z; covariances between
_NS_PER_S = 1_000_000_000


class OdometryReading(NamedTuple):
    """Pose and twist as the device has them; None for what it does not publish."""

    pose: Pose
    twist: PlanarVelocity | None = None
    stamp_ns: int | None = None  # by the device's own clock


def read_pose(payload: bytes) -> OdometryReading:
    """From a geometry_msgs/Pose2D.

    Raises:
        BadPayload: it is none.
    """
    if len(payload) != _POSE.size:
        raise BadPayload(POSE_TYPE, f"{len(payload)} bytes instead of {_POSE.size}")
    x_m, y_m, theta_rad = _POSE.unpack(payload)
    return OdometryReading(Pose(x_m, y_m, wrap_angle(theta_rad)))


def read_odometry(payload: bytes) -> OdometryReading:
    """From a nav_msgs/Odometry.

    Raises:
        BadPayload: it is none.
    """
    try:
        secs, nsecs, frame_bytes = _HEADER.unpack_from(payload)
        (child_bytes,) = _LENGTH.unpack_from(payload, _HEADER.size + frame_bytes)
        body_at = _HEADER.size + frame_bytes + _LENGTH.size + child_bytes
        x_m, y_m, *orientation, forward_m_s, left_m_s, yaw_rad_s = _BODY.unpack_from(payload, body_at)
    except struct.error as error:
        raise BadPayload(ODOMETRY_TYPE, f"{len(payload)} bytes are too few: {error}") from error
    if len(payload) != body_at + _BODY.size:
        raise BadPayload(ODOMETRY_TYPE, f"{len(payload)} bytes instead of {body_at + _BODY.size}")
    pose = Pose(x_m, y_m, _yaw(*orientation))
    return OdometryReading(pose, PlanarVelocity(forward_m_s, left_m_s, yaw_rad_s), secs * _NS_PER_S + nsecs)


READERS: dict[str, Callable[[bytes], OdometryReading]] = {POSE_TYPE: read_pose, ODOMETRY_TYPE: read_odometry}


def _yaw(x: float, y: float, z: float, w: float) -> float:
    """Of a quaternion of any length: some devices do not normalise."""
    return wrap_angle(math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
