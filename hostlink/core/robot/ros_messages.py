"""Messages that ROS programs expect of a robot: nav_msgs/Odometry and a transform, made of its device's messages.

Metres, radians, x forward, y left, z up (REP 103); the pose in `odom`, the motion in `base_link` (REP 105).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.velocity import PlanarVelocity

UNMEASURED = 1e6  # the variance of what wheels cannot measure: height, roll and pitch
POSE_VARIANCES = (1e-3, 1e-3, UNMEASURED, UNMEASURED, UNMEASURED, 1e-2)  # diff_drive_controller's for x, y and yaw
TWIST_VARIANCES = (1e-3, 1e-3, UNMEASURED, UNMEASURED, UNMEASURED, 1e-2)
_AXES = 6


class FrameIds(NamedTuple):
    """The names of the frames between which a robot's odometry is."""

    odom: str
    base: str


class Variances(NamedTuple):
    """The covariances that a device publishes, row by row; empty: none."""

    pose: Sequence[float] = ()
    twist: Sequence[float] = ()


NO_VARIANCES = Variances()


def odometry_of(
    pose: Pose, twist: PlanarVelocity, frames: FrameIds, stamp: Mapping[str, int], published: Variances = NO_VARIANCES
) -> dict[str, Any]:
    """A nav_msgs/Odometry of a planar pose."""
    half_rad = pose.theta_rad / 2
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(half_rad), "w": math.cos(half_rad)}
    motion = {"linear": _vector(twist.x_m_s, twist.y_m_s), "angular": _vector(0.0, 0.0, twist.yaw_rad_s)}
    return {
        "header": {"seq": 0, "stamp": dict(stamp), "frame_id": frames.odom},
        "child_frame_id": frames.base,
        "pose": {
            "pose": {"position": _vector(pose.x_m, pose.y_m), "orientation": orientation},
            "covariance": _covariance(published.pose, POSE_VARIANCES),
        },
        "twist": {"twist": motion, "covariance": _covariance(published.twist, TWIST_VARIANCES)},
    }


def variances_of(message: Mapping[str, Any]) -> Variances:
    """Covariances of a decoded nav_msgs/Odometry; a geometry_msgs/Pose2D has none."""
    if "theta" in message:
        return NO_VARIANCES
    return Variances(message["pose"]["covariance"], message["twist"]["covariance"])


def transform_of(odometry: Mapping[str, Any]) -> dict[str, Any]:
    """The tf2_msgs/TFMessage with the content of an Odometry."""
    pose = odometry["pose"]["pose"]
    transform = {"translation": pose["position"], "rotation": pose["orientation"]}
    return {
        "transforms": [
            {"header": odometry["header"], "child_frame_id": odometry["child_frame_id"], "transform": transform}
        ]
    }


def _covariance(published: Sequence[float], variances: tuple[float, ...]) -> list[float]:
    """Covariance from the device, otherwise a diagonal: zeros would claim that nothing is ever wrong."""
    if any(published) and all(map(math.isfinite, published)):
        return list(published)
    return covariance_of(variances)


def covariance_of(variances: tuple[float, ...]) -> list[float]:
    """Return the covariance of values that do not depend on each other."""
    return [variances[row] if row == column else 0.0 for row in range(_AXES) for column in range(_AXES)]


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}
