"""Readers of the messages that say where a robot is or how it moves. Pure.

A reading has only what can be believed: a pose with NaN, or farther away than any robot drives, or with an orientation
that is not a rotation, is left out, and its flaw is named. What is merely unusual (a stamp of zero) is named, too, and
does not remove the pose.
"""

import functools
import math
import struct
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

from hostlink.core.robot.kinematics import Pose, wrap_angle, yaw_of
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, PlanarVelocity
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload

POSE_TYPE, ODOMETRY_TYPE = "geometry_msgs/Pose2D", "nav_msgs/Odometry"

FARTHEST_M = 1e6  # no odometry counts so far; beyond, sums lose the digits that matter

EXACT = 1e-3  # of a quaternion that has only z: half a turn, if its length is 1

POSE_TYPES = (  # that say where the robot is; those that also have a velocity, or a frame, first
    ODOMETRY_TYPE, POSE_TYPE, "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose",
)  # fmt: skip
VELOCITY_TYPES = ("geometry_msgs/TwistWithCovarianceStamped", TWIST_STAMPED_TYPE, TWIST_TYPE)


class Flaw(StrEnum):
    """Flaw of one message. The first six leave no pose."""

    NOT_FINITE = "not_finite"  # NaN or infinity in the pose, or in the velocity of a message without a pose
    TOO_FAR = "too_far"  # the pose is farther from the origin than any odometry counts
    ZERO_QUATERNION = "zero_quaternion"  # all four numbers of the orientation are 0
    HEADING_IN_Z = "heading_in_z"  # only orientation.z is set, to something that is not the length of a quaternion
    BAD_QUATERNION = "bad_quaternion"  # the length is far from 1
    SENT_BACK = "sent_back"  # the pose is one that the device was given, and so were those before
    ZERO_STAMP = "zero_stamp"
    SLASH_FRAME = "slash_frame"  # a frame begins with a slash, which tf2 refuses
    ZERO_COVARIANCE = "zero_covariance"  # of the pose; a filter divides by it


class OdometryReading(NamedTuple):
    """Pose and twist as the device has them; None for what it does not publish, or what cannot be believed."""

    pose: Pose | None = None
    twist: PlanarVelocity | None = None
    stamp_ns: int | None = None  # by the device's own clock; None: the type has none
    is_moving: bool | None = None  # of a source that knows only whether the robot moves
    flaws: tuple[Flaw, ...] = ()
    frame_id: str = ""  # that is flawed

    @property
    def is_empty(self) -> bool:
        """Whether nothing of it can be used."""
        return self.pose is None and self.twist is None and self.is_moving is None


Reader = Callable[[bytes], OdometryReading]

SHORTEST_QUATERNION, LONGEST_QUATERNION = 0.9, 1.1  # float32 rounds to 1e-7, four decimals in a text to 1e-4
_POSE2D = struct.Struct("<3d")
_HEADER = struct.Struct("<4xIII")  # seq, secs, nsecs, length of frame_id
_LENGTH = struct.Struct("<I")
_POSE = struct.Struct("<2d8x4d")  # x, y, orientation
_TWIST = struct.Struct("<2d24xd")  # linear x, y; angular z
_COVARIANCE_BYTES = 36 * 8
_NO_COVARIANCE = bytes(_COVARIANCE_BYTES)
_SLASH = 0x2F


class _Parts(NamedTuple):
    """Parts of a message type, in their order on the wire."""

    has_header: bool = False
    has_child_frame: bool = False
    has_pose: bool = False
    has_twist: bool = False
    has_covariance: bool = False  # after the pose and after the twist


_PARTS = {
    ODOMETRY_TYPE: _Parts(has_header=True, has_child_frame=True, has_pose=True, has_twist=True, has_covariance=True),
    "geometry_msgs/Pose": _Parts(has_pose=True),
    "geometry_msgs/PoseStamped": _Parts(has_header=True, has_pose=True),
    "geometry_msgs/PoseWithCovariance": _Parts(has_pose=True, has_covariance=True),
    "geometry_msgs/PoseWithCovarianceStamped": _Parts(has_header=True, has_pose=True, has_covariance=True),
    TWIST_TYPE: _Parts(has_twist=True),
    TWIST_STAMPED_TYPE: _Parts(has_header=True, has_twist=True),
    "geometry_msgs/TwistWithCovarianceStamped": _Parts(has_header=True, has_twist=True, has_covariance=True),
}


def read_pose(payload: bytes) -> OdometryReading:
    """Read a geometry_msgs/Pose2D.

    Raises:
        BadPayload: the payload has another size.
    """
    if len(payload) != _POSE2D.size:
        raise BadPayload(POSE_TYPE, f"{len(payload)} bytes instead of {_POSE2D.size}")
    x_m, y_m, theta_rad = _POSE2D.unpack(payload)
    if not (-FARTHEST_M < x_m < FARTHEST_M and -FARTHEST_M < y_m < FARTHEST_M and math.isfinite(theta_rad)):
        return OdometryReading(flaws=(_why_nowhere(x_m, y_m, theta_rad),))
    return OdometryReading(Pose(x_m, y_m, wrap_angle(theta_rad)))


def _read(type_name: str, parts: _Parts, payload: bytes) -> OdometryReading:
    """Read a message with these parts.

    Raises:
        BadPayload: the payload is not of the type.
    """
    covariance_bytes = _COVARIANCE_BYTES if parts.has_covariance else 0
    at, stamp_ns, frame_id = 0, None, ""
    flaws: list[Flaw] = []
    pose: Pose | None = None
    twist: PlanarVelocity | None = None
    try:
        if parts.has_header:
            secs, nsecs, frame_bytes = _HEADER.unpack_from(payload)
            at = _HEADER.size + frame_bytes
            stamp_ns = secs * NS_PER_S + nsecs
            if not stamp_ns:
                flaws.append(Flaw.ZERO_STAMP)
            if frame_bytes and payload[_HEADER.size] == _SLASH:
                flaws.append(Flaw.SLASH_FRAME)
                frame_id = payload[_HEADER.size : at].decode(errors="replace")
        if parts.has_child_frame:
            (frame_bytes,) = _LENGTH.unpack_from(payload, at)
            at += _LENGTH.size
            if frame_bytes and payload[at] == _SLASH and Flaw.SLASH_FRAME not in flaws:
                flaws.append(Flaw.SLASH_FRAME)
                frame_id = payload[at : at + frame_bytes].decode(errors="replace")
            at += frame_bytes
        if parts.has_pose:
            pose, flaw = _pose(*_POSE.unpack_from(payload, at))
            if flaw is not None:
                flaws.append(flaw)
            at += _POSE.size
            if covariance_bytes and payload[at : at + covariance_bytes] == _NO_COVARIANCE:
                flaws.append(Flaw.ZERO_COVARIANCE)
            at += covariance_bytes
        if parts.has_twist:
            twist = PlanarVelocity(*_TWIST.unpack_from(payload, at))
            if not twist.is_finite:
                twist = None
                if not parts.has_pose:
                    flaws.append(Flaw.NOT_FINITE)
            at += _TWIST.size + covariance_bytes
    except (struct.error, IndexError) as error:
        raise BadPayload(type_name, f"{len(payload)} bytes are too few: {error}") from error
    if len(payload) != at:
        raise BadPayload(type_name, f"{len(payload)} bytes instead of {at}")
    return OdometryReading(pose, twist, stamp_ns, None, tuple(flaws), frame_id)


def _why_nowhere(*numbers: float) -> Flaw:
    return Flaw.TOO_FAR if all(map(math.isfinite, numbers)) else Flaw.NOT_FINITE


def _pose(x_m: float, y_m: float, x: float, y: float, z: float, w: float) -> tuple[Pose | None, Flaw | None]:
    """Pose on the floor, or why there is none. A quaternion that is nearly of length 1 counts: boards round."""
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not (-FARTHEST_M < x_m < FARTHEST_M and -FARTHEST_M < y_m < FARTHEST_M and math.isfinite(length)):
        return None, _why_nowhere(x_m, y_m, length)
    if length == 0:
        return None, Flaw.ZERO_QUATERNION
    if x == y == w == 0 and abs(length - 1) > EXACT:
        return None, Flaw.HEADING_IN_Z
    if not SHORTEST_QUATERNION <= length <= LONGEST_QUATERNION:
        return None, Flaw.BAD_QUATERNION
    return Pose(x_m, y_m, yaw_of(x, y, z, w)), None


READERS: dict[str, Reader] = {
    POSE_TYPE: read_pose,
    **{type_name: functools.partial(_read, type_name, parts) for type_name, parts in _PARTS.items()},
}
