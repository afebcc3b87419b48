"""Feedback: from which topics a robot's motion is known, and what they tell. Pure.

| topic from the device                                             | recognised by                   | tells    |
|-------------------------------------------------------------------|---------------------------------|----------|
| Odometry, Pose2D, PoseStamped and the other poses                 | the type                        | pose     |
| Twist, TwistStamped, TwistWithCovarianceStamped                   | the type and a name of motion   | velocity |
| counts of encoders, speeds of wheels, JointState                  | `[robots.X.encoders]` only      | pose     |
| the same, while a dimension of wheel or drive is unknown          |                                 | motion   |

A pose that the device was given and sends back says nothing of its motion: it is left out, and its flaw is named.

A count that is recognised by its name alone could be anything that never changes, and would say that a robot that
drives is stopped.
"""

import math
import re
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from hostlink.core.robot.kinematics import Drive, Pose, wrap_angle
from hostlink.core.robot.readings import POSE_TYPES, READERS, VELOCITY_TYPES, Flaw, OdometryReading
from hostlink.core.robot.wheel_feedback import WheelFeedback, WheelSettings

GIVEN = 16  # poses that are kept: the board may send them back later
SENT_BACK = 4  # different ones in a row: fewer may be a coincidence
ROUNDING = 1e-4  # m and rad: float32 rounds to 1e-5 within 100 m


class FeedbackKind(StrEnum):
    """Knowledge of a robot's motion."""

    POSE = "pose"  # and its velocity
    VELOCITY = "velocity"
    MOTION = "motion"  # only whether it moves
    NONE = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedbackSettings:
    """Settings of a robot's feedback. Without any, it is recognised."""

    topic: str | None = None  # of its pose or velocity; "": none of its topics tells it
    encoders: WheelSettings | None = None


RECOGNISED = FeedbackSettings()
_MEASURED = re.compile(r"odom|vel|speed|twist|motion", re.IGNORECASE)
_COMMANDED = re.compile(r"cmd|command|target|goal|set|ref|desired|wanted|joy|rc\d|teleop", re.IGNORECASE)


class Feedback:
    """The feedback of one robot. `topics` are those that it reads; `lacks` is what is missing to know more."""

    def __init__(self, endpoints: Iterable[tuple[str, str]], settings: FeedbackSettings, drive: Drive) -> None:
        """`endpoints`: name and type of each topic from the robot's devices, in their order. The settings decide first.

        Raises:
            ConfigError: the settings do not fit the topics or the drive.
        """
        offered = [(name, type_name) for name, type_name in endpoints]
        self._wheels: WheelFeedback | None = None
        self._doubts_orientation = False
        self._given: deque[Pose] = deque(maxlen=GIVEN)  # newest poses that the device was sent
        self._sent_back = deque[Pose](maxlen=SENT_BACK)  # different ones of them that it sent in a row
        self.topics: tuple[tuple[str, str], ...] = ()
        self.kind, self.lacks = FeedbackKind.NONE, ""
        if settings.encoders is not None:
            self._use_encoders(offered, settings.encoders, drive)
        elif settings.topic != "":
            self._use_message(offered, settings.topic)

    def _use_encoders(self, offered: list[tuple[str, str]], encoders: WheelSettings, drive: Drive) -> None:
        found = [_named(offered, name) for name in encoders.names]
        missing = [name for name, topic in zip(encoders.names, found, strict=True) if topic is None]
        if missing:
            self.lacks = f"the topic {', '.join(missing)}, which its encoders have by the settings"
            return
        self.topics = tuple(topic for topic in found if topic is not None)
        self._wheels = WheelFeedback(dict(self.topics), encoders, drive)
        self.kind = FeedbackKind.POSE if self._wheels.has_pose else FeedbackKind.MOTION
        self.lacks = self._wheels.lacks

    def _use_message(self, offered: list[tuple[str, str]], wanted: str | None) -> None:
        if wanted is not None:
            topic = _named(offered, wanted)
            if topic is None:
                self.lacks = f"the topic {wanted}, which the settings name"
                return
            if topic[1] not in READERS:
                self.lacks = f"a type of {wanted} that tells of motion; {topic[1]} does not"
                return
        else:
            topic = recognised(offered)
            if topic is None:
                self.lacks = "a topic that tells of its motion"
                return
        self.topics = (topic,)
        self.kind = FeedbackKind.POSE if topic[1] in POSE_TYPES else FeedbackKind.VELOCITY
        self._read = READERS[topic[1]]

    @property
    def restarts(self) -> int:
        """Number of times that the counts of the wheels began anew."""
        return 0 if self._wheels is None else self._wheels.restarts

    def restart(self) -> None:
        """Note that a device of the robot has connected again."""
        self._doubts_orientation = False
        if self._wheels is not None:
            self._wheels.restart()

    def note_given(self, pose: Pose) -> None:
        """Note a pose that the device is sent, for example by an external localisation."""
        self._given.append(pose)

    def _is_sent_back(self, pose: Pose) -> bool:
        """Whether this pose is one that the device was given, after others that were, too.

        A device that is given its place once begins there, and then counts on by itself.
        """
        if not any(_is_same(pose, given) for given in self._given):
            self._sent_back.clear()
        elif not any(_is_same(pose, before) for before in self._sent_back):
            self._sent_back.append(pose)
        return len(self._sent_back) == SENT_BACK

    def reset_pose(self) -> None:
        """Make the robot's place the origin, if the host integrates its pose."""
        if self._wheels is not None:
            self._wheels.reset_pose()

    def read(self, topic: str, payload: bytes, *, now_s: float) -> OdometryReading | None:
        """Read a message of one of `topics`. Return None while too little is known, e.g. of one of two wheels.

        A reading may be empty: then its flaws say why.

        Raises:
            BadPayload: the payload is damaged.
        """
        if self._wheels is not None:
            return self._wheels.read(topic, payload, now_s=now_s)
        reading = self._read(payload)
        if self._given and reading.pose is not None and self._is_sent_back(reading.pose):
            return reading._replace(pose=None, twist=None, flaws=(Flaw.SENT_BACK, *reading.flaws))
        if Flaw.HEADING_IN_Z in reading.flaws:
            self._doubts_orientation = True  # half a turn is then not told from 1 rad
        elif self._doubts_orientation and reading.pose is not None:
            if abs(reading.pose.theta_rad) == math.pi:
                return reading._replace(pose=None, flaws=(Flaw.HEADING_IN_Z, *reading.flaws))
            self._doubts_orientation = False
        return reading


def recognised(offered: Iterable[tuple[str, str]]) -> tuple[str, str] | None:
    """Return the topic that tells most of the robot's motion, by its type and its name; None if there is none."""
    best: tuple[tuple[int, bool, str], tuple[str, str]] | None = None
    for name, type_name in offered:
        if type_name in POSE_TYPES:
            rank = POSE_TYPES.index(type_name)
        elif type_name in VELOCITY_TYPES and _MEASURED.search(name) and not _COMMANDED.search(name):
            rank = len(POSE_TYPES) + VELOCITY_TYPES.index(type_name)
        else:
            continue
        key = (rank, "odom" not in name, name)
        if best is None or key < best[0]:
            best = key, (name, type_name)
    return None if best is None else best[1]


def _is_same(one: Pose, other: Pose) -> bool:
    """Whether two poses are equal but for the rounding of a board."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < ROUNDING and (
        abs(wrap_angle(one.theta_rad - other.theta_rad)) < ROUNDING
    )


def _named(offered: list[tuple[str, str]], name: str) -> tuple[str, str] | None:
    return next((each for each in offered if each[0].lstrip("/") == name.lstrip("/")), None)
