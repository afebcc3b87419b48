"""History: what the black box knows of a robot's last minutes, for whoever comes later. Pure."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from hostlink.errors import BadPayload
from hostlink.recording.ring import Entry
from hostlink.robot.kinematics import Pose, frame_of, placed
from hostlink.robot.odometry_estimator import OdometryEstimator
from hostlink.robot.odometry_reader import READERS

NS_PER_S = 1e9

Decode = Callable[[bytes], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class PastPose:
    """Where the robot was, in the frame in which it is shown now."""

    stamp_ns: int
    pose: Pose


def past_poses(
    entries: Iterable[Entry], topic: str, type_name: str, estimator: OdometryEstimator, present: Pose | None
) -> list[PastPose]:
    """The poses of a topic, as the robot's estimator would have shown them.

    `estimator`: a new one with the robot's settings; `present`: where the robot is shown at the last of the entries.
    """
    read = READERS[type_name]
    found: list[PastPose] = []
    for entry in entries:
        if entry.channel.topic != topic or entry.channel.type_name != type_name:
            continue
        try:
            reading = read(entry.payload)
        except BadPayload:
            continue
        estimator.update(reading.pose, now_s=entry.stamp_ns / NS_PER_S, wall_ns=entry.stamp_ns, twist=reading.twist)
        snapshot = estimator.snapshot(entry.stamp_ns / NS_PER_S)
        if snapshot is not None:
            found.append(PastPose(entry.stamp_ns, snapshot.pose))
    if present is None or not found:
        return found
    frame = frame_of(present, found[-1].pose)
    return [PastPose(each.stamp_ns, placed(frame, each.pose)) for each in found]


def past_messages(
    entries: Iterable[Entry], topic: str, decode: Decode, since_ns: int
) -> list[tuple[int, dict[str, Any]]]:
    """(stamp_ns, fields) of a topic's messages; one that cannot be decoded is left out."""
    found = []
    for entry in entries:
        if entry.channel.topic == topic and entry.stamp_ns >= since_ns:
            try:
                found.append((entry.stamp_ns, decode(entry.payload)))
            except BadPayload:
                continue
    return found
