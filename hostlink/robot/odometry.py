"""OdometryView: what is known of where a robot is and how it moves, from the poses that it tells."""

import itertools
import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from hostlink.robot.kinematics import Pose, chord_per_arc, wrap_angle

WINDOW_S = 0.4  # four poses of the paper's robot: steady enough, and not late
SHORTEST_S = 0.05  # poses that a network delivered together say nothing about speed
LONGEST_S = 2.0  # over a longer silence anything may have happened, a restart too
JUMP_M_S = 10.0  # faster than any small robot: the odometry was set, or the device restarted
JUMP_RAD_S = 20.0
RESET_M_S = 1.0  # towards the origin less is enough: the paper's robot makes 0.34 m/s
RESET_RAD_S = 6.0
ORIGIN_M = 0.05  # how near the origin the first pose after a reset is
ORIGIN_RAD = 0.2


class Twist(NamedTuple):
    """How the robot moves, in its own frame."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0


class _Sample(NamedTuple):
    at_s: float
    number: int  # of poses so far, with those that came at the same time
    pose: Pose


class OdometryView:
    """The newest pose, and the motion over the poses of the last WINDOW_S.

    Poses that came in one read have one arrival time; only the last of them counts for the motion. One pose from
    before the window is kept, so that a motion is never measured over the few milliseconds between two late poses.
    """

    def __init__(self) -> None:
        self.count = 0
        self._twist: Twist | None = None  # as the device tells it; None: it tells only poses
        self._wall_ns = 0
        self._window: deque[_Sample] = deque()

    def see(self, message: Mapping[str, Any], *, now_s: float, wall_ns: int) -> None:
        """Take a decoded geometry_msgs/Pose2D or nav_msgs/Odometry."""
        if "theta" in message:
            pose, twist = Pose(message["x"], message["y"], wrap_angle(message["theta"])), None
        else:
            pose = _planar(message["pose"]["pose"])
            moving = message["twist"]["twist"]
            twist = Twist(moving["linear"]["x"], moving["angular"]["z"])
        self.update(pose, now_s=now_s, wall_ns=wall_ns, twist=twist)

    def update(self, pose: Pose, *, now_s: float, wall_ns: int, twist: Twist | None = None) -> None:
        """Take a pose; one that is not made of finite numbers is not counted."""
        if not all(map(math.isfinite, pose)):
            return
        self.count += 1
        sample = _Sample(now_s, self.count, pose)
        if self._window and _is_jump(self._window[-1], sample):
            self._window.clear()
        if self._window and self._window[-1].at_s == now_s:
            self._window.pop()
        self._window.append(sample)
        while len(self._window) > 1 and self._window[1].at_s <= now_s - WINDOW_S:
            self._window.popleft()
        self._twist = twist if twist is not None and all(map(math.isfinite, twist)) else None
        self._wall_ns = wall_ns

    def snapshot(self, now_s: float) -> dict[str, Any] | None:
        """Pose, twist, wall time and age for the API; None before the first pose."""
        if not self._window:
            return None
        first, last = self._window[0], self._window[-1]
        span_s = last.at_s - first.at_s
        twist = self._twist or self._estimate()
        return {
            "pose": last.pose._asdict(),
            "twist": twist._asdict(),
            "stamp_ns": self._wall_ns,
            "age_s": round(now_s - last.at_s, 6),
            "rate_hz": round((last.number - first.number) / span_s, 2) if span_s >= SHORTEST_S else 0.0,
            "count": self.count,
        }

    def _estimate(self) -> Twist:
        span_s = self._window[-1].at_s - self._window[0].at_s
        if span_s < SHORTEST_S:
            return Twist()
        moves = [_move(before.pose, after.pose) for before, after in itertools.pairwise(self._window)]
        return Twist(sum(arc_m for arc_m, _ in moves) / span_s, sum(turned_rad for _, turned_rad in moves) / span_s)


def _move(before: Pose, after: Pose) -> tuple[float, float]:
    """How far the robot went along its arc, backwards negative, and how far it turned."""
    turned_rad = wrap_angle(after.theta_rad - before.theta_rad)
    heading_rad = before.theta_rad + turned_rad / 2  # of the arc's chord
    dx_m, dy_m = after.x_m - before.x_m, after.y_m - before.y_m
    chord_m = dx_m * math.cos(heading_rad) + dy_m * math.sin(heading_rad)
    return chord_m / chord_per_arc(turned_rad), turned_rad


def _is_jump(before: _Sample, after: _Sample) -> bool:
    """Whether no robot moves like this; poses of one read may be a tenth of a second apart in truth."""
    silence_s = after.at_s - before.at_s
    is_reset = after.pose == Pose() != before.pose
    if is_reset or silence_s > LONGEST_S:
        return True
    moved_m = math.dist(before.pose[:2], after.pose[:2])
    turned_rad = abs(wrap_angle(after.pose.theta_rad - before.pose.theta_rad))
    is_at_origin = math.hypot(*after.pose[:2]) < ORIGIN_M and abs(after.pose.theta_rad) < ORIGIN_RAD
    most_m_s, most_rad_s = (RESET_M_S, RESET_RAD_S) if is_at_origin else (JUMP_M_S, JUMP_RAD_S)
    span_s = max(silence_s, 0.1)
    return moved_m > most_m_s * span_s or turned_rad > most_rad_s * span_s


def _planar(pose: Mapping[str, Any]) -> Pose:
    """The yaw of a quaternion of any length: some devices do not normalise."""
    position, orientation = pose["position"], pose["orientation"]
    w, x, y, z = (orientation[axis] for axis in "wxyz")
    yaw_rad = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return Pose(position["x"], position["y"], wrap_angle(yaw_rad))
