"""Odometry: poses read from a device, corrected by its calibration, and the motion that they mean. Pure."""

import itertools
import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from hostlink.core.robot.kinematics import Pose, chord_per_arc, frame_of, is_near_origin, placed, wrap_angle
from hostlink.core.robot.readings import FARTHEST_M
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.units import NS_PER_S

WINDOW_S = 0.4  # four poses of the paper's robot: steady enough, and not late
CLOSEST_S = 0.005  # of those that are kept of a device that publishes faster
SHORTEST_S = 0.05  # poses that a network delivered together carry no speed
SHORTEST_SPAN_S = 0.1  # between poses of one read, in truth

BUNCHED = 1.5  # messages a bunch: fewer are single delays
TOGETHER = 1 / 8  # of the period between two messages of a bunch: a device that leaves some out sends none so close
LONGEST_S = 2.0  # over a longer silence anything may have happened, a restart too
KEPT_RATE_S = 1.0  # odometry is published ten times a second and more, and a radio delays it
RESET_MARGIN = 1.5  # towards the origin less is enough: what the robot may be commanded, and what a late pose adds
SHAKE_M = 0.02
SHAKE_RAD = 0.05
RESET_WAIT_S = 5.0  # for the first pose after a reset: the longest stall of a network
CLOCK_SET_NS = 10_000_000_000  # a stamp so far back is of a host whose clock was set; smaller steps are ignored

LEAP = PlanarVelocity(10.0, yaw_rad_s=20.0)  # faster than any small robot: the odometry was set, or bytes are damaged
FASTEST = PlanarVelocity(1.0, yaw_rad_s=4.0)  # the limits of a robot without configuration


class WheelWay(NamedTuple):
    """Distance that each wheel rolled between two poses, by the robot's own numbers."""

    left_m: float
    right_m: float
    sideways_m: float  # of the chord: what no arc explains, because the robot bent between the two poses


class OdometryCorrection(NamedTuple):
    """Correction of one robot: factors of its wheels' radii, and the separation that it assumes and has."""

    left_factor: float = 1.0
    right_factor: float = 1.0
    nominal_separation_m: float = 0.210  # with which the robot integrates
    separation_m: float = 0.210  # the true one

    def advance(self, pose: Pose, before: Pose, after: Pose) -> Pose:
        """Pose of the robot that was truly at `pose` when its own odometry went from `before` to `after`."""
        way = wheel_way(before, after, self.nominal_separation_m)
        left_m, right_m = way.left_m * self.left_factor, way.right_m * self.right_factor
        turned_rad = (right_m - left_m) / self.separation_m
        chord_m = (left_m + right_m) / 2 * chord_per_arc(turned_rad)
        heading_rad = pose.theta_rad + turned_rad / 2
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return Pose(
            pose.x_m + chord_m * cos - way.sideways_m * sin,
            pose.y_m + chord_m * sin + way.sideways_m * cos,
            wrap_angle(pose.theta_rad + turned_rad),
        )

    def velocity(self, measured: PlanarVelocity) -> PlanarVelocity:
        """The true motion of a robot that measures this one. Wheels say nothing of a sideways motion: it is kept."""
        turning_m_s = measured.yaw_rad_s * self.nominal_separation_m / 2
        left_m_s = (measured.x_m_s - turning_m_s) * self.left_factor
        right_m_s = (measured.x_m_s + turning_m_s) * self.right_factor
        yaw_rad_s = (right_m_s - left_m_s) / self.separation_m
        return PlanarVelocity((left_m_s + right_m_s) / 2, measured.y_m_s, yaw_rad_s)


def wheel_way(before: Pose, after: Pose, separation_m: float) -> WheelWay:
    """Distance that each wheel rolled along the arc between two poses."""
    turned_rad = wrap_angle(after.theta_rad - before.theta_rad)
    heading_rad = before.theta_rad + turned_rad / 2  # of the arc's chord
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    dx_m, dy_m = after.x_m - before.x_m, after.y_m - before.y_m
    arc_m = (dx_m * cos + dy_m * sin) / chord_per_arc(turned_rad)
    turning_m = turned_rad * separation_m / 2
    return WheelWay(arc_m - turning_m, arc_m + turning_m, dy_m * cos - dx_m * sin)


MAX_BUNCHES, FEWEST_BUNCHES = 8, 2  # of messages, from which their period is measured


@dataclass(frozen=True, slots=True)
class OdometrySnapshot:
    """The newest pose and the motion over the last few, at one moment.

    What the robot's feedback does not tell is None. One of `pose`, `twist` and `is_moving` is known.
    """

    pose: Pose | None
    twist: PlanarVelocity | None
    stamp_ns: int
    age_s: float
    rate_hz: float
    count: int
    restarts: int
    ignored: int
    is_moving: bool | None = None  # None: the twist says it


def aged_rate_hz(rate_hz: float, age_s: float) -> float:
    """The rate of messages of which the newest is this old: since then none has come.

    A radio delivers messages in bunches: a rate is believed for KEPT_RATE_S.
    """
    if age_s > LONGEST_S:
        return 0.0
    return rate_hz if age_s <= KEPT_RATE_S else min(rate_hz, 1 / age_s)


class _Sample(NamedTuple):
    at_s: float
    number: int  # of poses so far, with those that came at the same time
    pose: Pose


class _Change(Enum):
    """Motion between two poses of a device."""

    MOTION = auto()
    SILENCE = auto()  # too long for a speed
    RESET = auto()  # that hostlink sent
    RESTART = auto()  # at the origin all at once
    LEAP = auto()  # to where no robot can be by then


_ORIGIN = _NO_FRAME = Pose()


class SendTimes:
    """Estimate of when each message was sent, for a device whose messages arrive in bunches. Pure.

    A radio or a buffer delays them by up to a bunch. The last one of a bunch has waited least, so it counts as sent
    when it arrived, and those of the next bunch follow it at the mean period. Without bunches, a message was sent when
    it arrived: a device that leaves some out is late by itself.
    """

    __slots__ = ("_arrived_s", "_count", "_ends", "_period_s", "_sent_s")

    def __init__(self) -> None:
        self._count = 0
        self._arrived_s = self._sent_s = -math.inf
        self._period_s = 0.0
        self._ends: list[tuple[float, int]] = []  # arrival and number of the last message of each recent bunch

    def add(self, at_s: float) -> float:
        """Note the arrival of the next message. Return when it was sent."""
        gap_s = at_s - self._arrived_s
        if gap_s > LONGEST_S:
            self._ends.clear()
            self._period_s = 0.0
        elif gap_s > self._period_s * TOGETHER:
            self._end_bunch()
        self._count, self._arrived_s = self._count + 1, at_s
        self._sent_s = max(self._sent_s, min(self._expected_s(), at_s))
        return self._sent_s

    def _end_bunch(self) -> None:
        ends, apart_s = self._ends, self._period_s * TOGETHER
        while ends and self._arrived_s - ends[-1][0] <= apart_s:  # the period was too short when it was noted
            ends.pop()
        ends.append((self._arrived_s, self._count))
        del ends[:-MAX_BUNCHES]
        while len(ends) > 1 and ends[1][0] - ends[0][0] <= apart_s:
            del ends[0]
        if len(ends) > 1:
            self._period_s = (ends[-1][0] - ends[0][0]) / (ends[-1][1] - ends[0][1])

    def _expected_s(self) -> float:
        """Time at which the newest message was sent, if the bunches are regular."""
        ends, bunches = self._ends, len(self._ends) - 1
        if bunches < FEWEST_BUNCHES or ends[-1][1] - ends[0][1] < BUNCHED * bunches or self._period_s < CLOSEST_S:
            return self._arrived_s
        longest_s = max(after[0] - before[0] for before, after in itertools.pairwise(ends))
        sent_s = ends[-1][0] + (self._count - ends[-1][1]) * self._period_s
        return max(sent_s, self._arrived_s - longest_s)


class OdometryEstimator:
    """Newest pose of a device, and its motion over the poses of the last WINDOW_S.

    Poses of one read have one arrival time; only the last of them counts for the motion, unless they arrive in bunches
    all the time: then `SendTimes` estimates when they were sent. Of a device that publishes
    hundreds in a second one in CLOSEST_S counts: each snapshot reads all of them. One pose from before the
    window is kept, so that a motion is never measured over the few milliseconds between two late poses.

    A device that restarts begins at the origin again. The shown pose continues from where the robot was (REP 105: an
    odometry does not jump), or begins again with the device if it is not to continue; `restarts` counts them. A reset
    that was requested begins at the origin in any case. One pose that is far from all others is damage that the
    checksum let pass; a second one there is believed.

    A device that publishes only its velocity, or only whether it moves, has no pose.

    With a `correction`, each motion between two poses is shown as the robot truly made it; the checks
    apply to the device's own values.
    """

    __slots__ = (
        "_arrived_s", "_back_at_once", "_continues", "_correction", "_doubtful", "_fastest", "_frame", "_has_pose",
        "_is_moving", "_newest", "_reset_until_s", "_send_times", "_small_m", "_small_rad", "_stamp_ns", "_twist",
        "_window", "count", "ignored", "is_differential", "restarts",
    )  # fmt: skip

    def __init__(
        self,
        *,
        continues: bool = True,
        fastest: PlanarVelocity = FASTEST,
        correction: OdometryCorrection | None = None,
        is_differential: bool = False,
    ) -> None:
        """`continues`: over a restart of the device; `fastest`: what the robot may be commanded.

        `is_differential`: what its poses show of a sideways motion is an error of them.
        """
        self.count = 0
        self.restarts = 0  # how often the device began anew without a request
        self.ignored = 0  # poses that cannot be true
        self._continues, self._correction = continues, correction
        self.is_differential = is_differential
        self.change_fastest(fastest)
        self._frame = _NO_FRAME  # where the device's origin is in what is shown
        self._newest: _Sample | None = None  # the newest, as the device published it
        self._doubtful: _Sample | None = None
        self._reset_until_s = float("-inf")
        self._twist: PlanarVelocity | None = None  # as the device publishes it; None: it publishes only poses
        self._stamp_ns = 0
        self._has_pose = False
        self._is_moving: bool | None = None
        self._window: list[_Sample] = []
        self._send_times = SendTimes()
        self._arrived_s = 0.0

    def change_fastest(self, fastest: PlanarVelocity) -> None:
        """Set what the robot may be commanded from now on."""
        self._fastest = fastest
        self._back_at_once = fastest.scaled(RESET_MARGIN)
        self._small_m = min(self._back_at_once.speed_m_s, LEAP.speed_m_s) * SHORTEST_SPAN_S
        self._small_rad = min(self._back_at_once.turn_rad_s, LEAP.turn_rad_s) * SHORTEST_SPAN_S

    def anew(self) -> "OdometryEstimator":
        """Another with the same settings, which has seen nothing."""
        return OdometryEstimator(
            continues=self._continues,
            fastest=self._fastest,
            correction=self._correction,
            is_differential=self.is_differential,
        )

    def expect_reset(self, now_s: float) -> None:
        """The device was commanded to make its place the origin: the next pose there is right."""
        self._reset_until_s = now_s + RESET_WAIT_S

    def withdraw(self) -> None:
        """Drop what was added: it turned out to be no odometry. The counts remain."""
        self._window.clear()
        self._newest = self._doubtful = self._twist = self._is_moving = None
        self._has_pose = False
        self._frame = _NO_FRAME

    def update(
        self,
        pose: Pose | None,
        *,
        now_s: float,
        wall_ns: int,
        twist: PlanarVelocity | None = None,
        is_stamped: bool = False,
        is_moving: bool | None = None,
    ) -> None:
        """Add a reading; one that cannot be true is not counted.

        `wall_ns` is its arrival, or if it `is_stamped` the time of the device's own stamp. After a first pose, readings
        without one are ignored: the last good pose ages.
        """
        twist = twist if twist is not None and twist.is_finite else None
        if pose is None and (self._has_pose or (twist is None and is_moving is None)):
            self.ignored += 1
            return
        sent_s = self._send_times.add(now_s)
        new = _Sample(now_s, self.count + 1, _ORIGIN if pose is None else pose)
        if pose is None:
            pass
        elif self._is_small_motion(new):
            if self._correction is not None:
                self._correct(self._correction, new)
        elif not (_is_possible(pose) and self._place(new)):
            self.ignored += 1
            return
        elif not self._has_pose:
            self._has_pose = True
            self._window.clear()
        self.count += 1
        window = self._window
        is_close = len(window) > 1 and sent_s - window[-2].at_s < CLOSEST_S
        if is_close or (window and window[-1].at_s == sent_s):
            window.pop()
        is_framed = pose is not None and self._frame is not _NO_FRAME
        window.append(_Sample(sent_s, self.count, placed(self._frame, new.pose) if is_framed else new.pose))
        while len(window) > 1 and window[1].at_s <= sent_s - WINDOW_S:
            del window[0]
        self._newest, self._arrived_s = None if pose is None else new, now_s
        if not is_stamped and sent_s < now_s:
            wall_ns -= round((now_s - sent_s) * NS_PER_S)
        self._twist, self._is_moving = None if twist is None else self._true_twist(twist), is_moving
        if wall_ns > self._stamp_ns or wall_ns < self._stamp_ns - CLOCK_SET_NS:
            self._stamp_ns = wall_ns

    def _is_small_motion(self, new: _Sample) -> bool:
        """Whether it is a step that any robot may make at once: most poses need no further check.

        The distance is along the axes, which is never shorter; a NaN is not a small motion.
        """
        before = self._newest
        if before is None or self._doubtful is not None or new.at_s <= self._reset_until_s:
            return False
        here, there = before.pose, new.pose
        return (
            new.at_s - before.at_s <= LONGEST_S
            and abs(there[0] - here[0]) + abs(there[1] - here[1]) <= self._small_m
            and abs(there[2] - here[2]) <= self._small_rad
            and (there != _ORIGIN or here == _ORIGIN)
            and -FARTHEST_M < there[0] < FARTHEST_M
            and -FARTHEST_M < there[1] < FARTHEST_M
        )

    def snapshot(self, now_s: float) -> OdometrySnapshot | None:
        """Snapshot of this moment; None before the first pose."""
        if not self._window:
            return None
        first, last = self._window[0], self._window[-1]
        span_s, age_s = last.at_s - first.at_s, now_s - self._arrived_s
        rate_hz = (last.number - first.number) / span_s if span_s >= SHORTEST_S else 0.0
        return OdometrySnapshot(
            pose=last.pose if self._has_pose else None,
            twist=self._twist or (self._estimate() if self._has_pose else None),
            is_moving=self._is_moving,
            stamp_ns=self._stamp_ns,
            age_s=age_s,
            rate_hz=aged_rate_hz(rate_hz, age_s),
            count=self.count,
            restarts=self.restarts,
            ignored=self.ignored,
        )

    def _place(self, new: _Sample) -> bool:
        """Find the frame of a new pose; False: it is not believed yet."""
        doubtful, self._doubtful = self._doubtful, None
        change = self._change(new)
        if doubtful is not None and self._is_there(doubtful, new, change):
            change = _Change.LEAP
        elif change is _Change.LEAP:
            self._doubtful = new
            return False
        if change in (_Change.RESTART, _Change.LEAP):
            self.restarts += 1
            self._frame = frame_of(self._window[-1].pose, new.pose) if self._continues else _NO_FRAME
        elif change is _Change.RESET:
            self._reset_until_s = float("-inf")
            self._frame = _NO_FRAME
        if change is not _Change.MOTION:
            self._window.clear()
        elif self._correction is not None:
            self._correct(self._correction, new)
        return True

    def _correct(self, correction: OdometryCorrection, new: _Sample) -> None:
        """Move the device's frame to where the robot's true motion ended at the new pose."""
        if self._newest is not None:
            before = self._newest.pose
            true = correction.advance(placed(self._frame, before), before, new.pose)
            self._frame = frame_of(true, new.pose)

    def _true_twist(self, twist: PlanarVelocity) -> PlanarVelocity:
        return twist if self._correction is None else self._correction.velocity(twist)

    def _is_there(self, doubtful: _Sample, new: _Sample, change: _Change) -> bool:
        """Whether a second pose confirms a doubtful one."""
        if change is _Change.LEAP:
            return not _is_too_far(doubtful, new, LEAP)
        if change is not _Change.MOTION or self._newest is None:
            return False
        # By now it may be possible to have come so far, but the doubtful one came too soon for that.
        return _apart(doubtful.pose, new.pose) < _apart(self._newest.pose, new.pose)

    def _change(self, new: _Sample) -> _Change:
        before = self._newest
        is_at_origin = is_near_origin(new.pose)
        if is_at_origin and new.at_s <= self._reset_until_s:
            return _Change.RESET
        if before is None:
            return _Change.MOTION
        is_silence = new.at_s - before.at_s > LONGEST_S
        is_back = new.pose == _ORIGIN and _has_moved(before.pose)
        if is_back or (is_silence and is_at_origin and not is_near_origin(before.pose)):
            return _Change.RESTART
        if is_at_origin and _is_too_far(before, new, self._back_at_once):
            return _Change.RESTART
        if _is_too_far(before, new, LEAP):
            return _Change.LEAP
        return _Change.SILENCE if is_silence else _Change.MOTION

    def _estimate(self) -> PlanarVelocity:
        span_s = self._window[-1].at_s - self._window[0].at_s
        if span_s < SHORTEST_S:
            return PlanarVelocity()
        moves = [_move(before.pose, after.pose) for before, after in itertools.pairwise(self._window)]
        forward_m, left_m, turned_rad = map(math.fsum, zip(*moves, strict=True))
        return PlanarVelocity(forward_m / span_s, 0.0 if self.is_differential else left_m / span_s, turned_rad / span_s)


def _move(before: Pose, after: Pose) -> tuple[float, float, float]:
    """Distance of the robot forward and to the left along its arc, and the angle that it turned."""
    turned_rad = wrap_angle(after.theta_rad - before.theta_rad)
    heading_rad = before.theta_rad + turned_rad / 2  # of the arc's chord
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    dx_m, dy_m = after.x_m - before.x_m, after.y_m - before.y_m
    chord = chord_per_arc(turned_rad)
    return (dx_m * cos + dy_m * sin) / chord, (dy_m * cos - dx_m * sin) / chord, turned_rad


def _apart(one: Pose, other: Pose) -> float:
    """Metres and radians as one number: only to compare."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m, wrap_angle(one.theta_rad - other.theta_rad))


def _is_possible(pose: Pose) -> bool:
    return all(map(math.isfinite, pose)) and max(abs(pose.x_m), abs(pose.y_m)) < FARTHEST_M


def _has_moved(pose: Pose) -> bool:
    """Whether it is away from the origin by more than a wheel that shakes on the spot."""
    return math.hypot(*pose[:2]) > SHAKE_M or abs(pose.theta_rad) > SHAKE_RAD


def _is_too_far(before: _Sample, after: _Sample, most: PlanarVelocity) -> bool:
    """Whether it would have to be faster than that; poses of one read may be a tenth of a second apart in truth."""
    moved_m = math.dist(before.pose[:2], after.pose[:2])
    turned_rad = abs(wrap_angle(after.pose.theta_rad - before.pose.theta_rad))
    span_s = max(after.at_s - before.at_s, SHORTEST_SPAN_S)
    return moved_m > most.speed_m_s * span_s or turned_rad > most.turn_rad_s * span_s
