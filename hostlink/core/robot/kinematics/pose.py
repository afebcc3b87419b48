"""Poses, angles and arcs in the plane. Metres, radians."""

import math
from typing import NamedTuple

SMALL_ANGLE_RAD = 1e-8  # below it an arc and its chord are equally long to the last digit of a double


class Pose(NamedTuple):
    """Pose of the robot, in the frame in which its odometry began; theta in (-pi, pi]."""

    x_m: float = 0.0
    y_m: float = 0.0
    theta_rad: float = 0.0


def wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to (-pi, pi]; NaN for an angle that is not finite."""
    if not math.isfinite(angle_rad):
        return math.nan
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped <= -math.pi else wrapped


def chord_per_arc(turned_rad: float) -> float:
    """Length of the chord of an arc, in lengths of the arc; 2/pi for half a turn."""
    half_rad = turned_rad / 2
    return 1.0 if abs(turned_rad) < SMALL_ANGLE_RAD else math.sin(half_rad) / half_rad


def moved(pose: Pose, x_m: float, y_m: float, turned_rad: float) -> Pose:
    """The pose after a motion with a constant velocity of the body: along an arc of a circle, at any length.

    `x_m` and `y_m` are the ways forward and to the left along the arc: velocities times the duration. This is the
    exponential of a planar twist: (x sin D - y (1 - cos D)) / D and (x (1 - cos D) + y sin D) / D for a turn of D, as
    the chord and its direction, so that no digits get lost near D = 0.
    """
    chord, heading_rad = chord_per_arc(turned_rad), pose.theta_rad + turned_rad / 2
    cos, sin = chord * math.cos(heading_rad), chord * math.sin(heading_rad)
    return Pose(
        pose.x_m + x_m * cos - y_m * sin, pose.y_m + x_m * sin + y_m * cos, wrap_angle(pose.theta_rad + turned_rad)
    )


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """The heading of a quaternion of any length, in radians. By products alone: a length of zero raises nothing."""
    return wrap_angle(math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def placed(frame: Pose, pose: Pose) -> Pose:
    """A pose in a frame, expressed in the frame around it."""
    cos, sin = math.cos(frame.theta_rad), math.sin(frame.theta_rad)
    return Pose(
        frame.x_m + cos * pose.x_m - sin * pose.y_m,
        frame.y_m + sin * pose.x_m + cos * pose.y_m,
        wrap_angle(frame.theta_rad + pose.theta_rad),
    )


def frame_of(outer: Pose, inner: Pose) -> Pose:
    """The frame that makes `inner` be at `outer`: placed(frame_of(outer, inner), inner) == outer."""
    turned = Pose(theta_rad=wrap_angle(outer.theta_rad - inner.theta_rad))
    arm = placed(turned, inner)
    return Pose(outer.x_m - arm.x_m, outer.y_m - arm.y_m, turned.theta_rad)


ORIGIN_M, ORIGIN_RAD = 0.05, 0.2  # how near the origin the first pose after a reset is; a robot may roll on


def is_near_origin(pose: Pose) -> bool:
    return math.hypot(*pose[:2]) < ORIGIN_M and abs(pose.theta_rad) < ORIGIN_RAD
