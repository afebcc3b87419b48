"""OdometryView: what is known of where a robot is and how it moves, from the poses that it tells."""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from hostlink.robot.kinematics import Pose, wrap_angle

WINDOW_S = 0.4  # four poses of the paper's robot: steady enough, and not late
JUMP_M_S = 10.0  # faster than any small robot: the odometry was reset, or the device restarted
JUMP_RAD_S = 50.0


class Twist(NamedTuple):
    """How the robot moves, in its own frame."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0


class OdometryView:
    """The newest pose, and the motion over the last WINDOW_S of poses.

    Poses that came in one read have one arrival time; only the last of them counts for the motion.
    """

    def __init__(self) -> None:
        self.count = 0
        self._pose: Pose | None = None
        self._twist: Twist | None = None  # as the device tells it; None: it tells only poses
        self._wall_ns = 0
        self._window: deque[tuple[float, Pose]] = deque()

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
        """Take a pose; one that is no number is not counted."""
        if not all(math.isfinite(value) for value in pose):
            return
        if self._window and _is_jump(self._window[-1], (now_s, pose)):
            self._window.clear()
        if self._window and self._window[-1][0] == now_s:
            self._window.pop()
        self._window.append((now_s, pose))
        while self._window[0][0] < now_s - WINDOW_S and len(self._window) > 2:  # noqa: PLR2004 - a motion has two ends
            self._window.popleft()
        self._pose, self._twist, self._wall_ns = pose, twist, wall_ns
        self.count += 1

    def snapshot(self, now_s: float) -> dict[str, Any] | None:
        """Pose, twist, wall time and age for the API; None before the first pose."""
        if self._pose is None:
            return None
        twist = self._twist or self._estimate()
        span_s = self._window[-1][0] - self._window[0][0]
        return {
            "pose": self._pose._asdict(),
            "twist": twist._asdict(),
            "stamp_ns": self._wall_ns,
            "age_s": round(now_s - self._window[-1][0], 6),
            "rate_hz": round((len(self._window) - 1) / span_s, 2) if span_s > 0 else 0.0,
            "count": self.count,
        }

    def _estimate(self) -> Twist:
        (first_s, first), (last_s, last) = self._window[0], self._window[-1]
        span_s = last_s - first_s
        if span_s <= 0:
            return Twist()
        turned_rad = 0.0
        for (_, before), (_, after) in zip(self._window, list(self._window)[1:], strict=False):
            turned_rad += wrap_angle(after.theta_rad - before.theta_rad)
        heading_rad = first.theta_rad + turned_rad / 2  # of the chord of an arc
        forward_m = (last.x_m - first.x_m) * math.cos(heading_rad) + (last.y_m - first.y_m) * math.sin(heading_rad)
        half_rad = turned_rad / 2
        arc_m = forward_m if abs(half_rad) < 1e-9 else forward_m * half_rad / math.sin(half_rad)  # noqa: PLR2004
        return Twist(arc_m / span_s, turned_rad / span_s)


def _is_jump(before: tuple[float, Pose], after: tuple[float, Pose]) -> bool:
    """Whether no robot moves like this; poses of one read may be a tenth of a second apart in truth."""
    span_s = max(after[0] - before[0], 0.1)
    moved_m = math.dist(before[1][:2], after[1][:2])
    turned_rad = abs(wrap_angle(after[1].theta_rad - before[1].theta_rad))
    is_reset = after[1] == Pose() and before[1] != Pose()
    return is_reset or moved_m > JUMP_M_S * span_s or turned_rad > JUMP_RAD_S * span_s


def _planar(pose: Mapping[str, Any]) -> Pose:
    position, q = pose["position"], pose["orientation"]
    yaw_rad = math.atan2(2 * (q["w"] * q["z"] + q["x"] * q["y"]), 1 - 2 * (q["y"] ** 2 + q["z"] ** 2))
    return Pose(position["x"], position["y"], wrap_angle(yaw_rad))
