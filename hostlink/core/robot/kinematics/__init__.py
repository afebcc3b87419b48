"""Drives of robots: wheel speeds, odometry and possible velocities. Metres, radians, seconds; x forward, y left."""

from hostlink.core.robot.kinematics.ackermann import AckermannDrive, Steering
from hostlink.core.robot.kinematics.choice import DRIVES, SETTINGS, WHEELS_NEED, drive_of
from hostlink.core.robot.kinematics.drive import PLANAR, Drive, PlanarDrive
from hostlink.core.robot.kinematics.pose import (
    SMALL_ANGLE_RAD,
    Pose,
    chord_per_arc,
    frame_of,
    is_near_origin,
    moved,
    placed,
    wrap_angle,
    yaw_of,
)
from hostlink.core.robot.kinematics.wheeled import (
    DifferentialDrive,
    MecanumDrive,
    Omni4Drive,
    OmniDrive,
    SkidSteerDrive,
)

__all__ = [
    "DRIVES",
    "PLANAR",
    "SETTINGS",
    "SMALL_ANGLE_RAD",
    "WHEELS_NEED",
    "AckermannDrive",
    "DifferentialDrive",
    "Drive",
    "MecanumDrive",
    "Omni4Drive",
    "OmniDrive",
    "PlanarDrive",
    "Pose",
    "SkidSteerDrive",
    "Steering",
    "chord_per_arc",
    "drive_of",
    "frame_of",
    "is_near_origin",
    "moved",
    "placed",
    "wrap_angle",
    "yaw_of",
]
