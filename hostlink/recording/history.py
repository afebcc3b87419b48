"""History: what the black box knows of a robot's last minutes, for whoever comes later. Pure."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from hostlink.errors import BadPayload
from hostlink.recording.channel import DEVICE, EVENTS, NS_PER_S
from hostlink.recording.ring import Entry
from hostlink.robot.kinematics import Pose, frame_of, placed
from hostlink.robot.odometry_estimator import OdometryEstimator, Twist
from hostlink.robot.odometry_reader import READERS

MAX_SAMPLES = 6000  # of one topic: two and a half minutes at 40 Hz; of more only every second, third, ... is kept

Decode = Callable[[bytes], dict[str, Any]]
Sample = TypeVar("Sample")


@dataclass(frozen=True, slots=True)
class PastPose:
    """Where the robot was, in the frame in which it is shown now, and how it moved."""

    stamp_ns: int
    pose: Pose
    twist: Twist


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
            found.append(PastPose(entry.stamp_ns, snapshot.pose, snapshot.twist))
    if present is None or not found:
        return found
    frame = frame_of(present, found[-1].pose)
    return [PastPose(each.stamp_ns, placed(frame, each.pose), each.twist) for each in found]


def past_messages(
    entries: Iterable[Entry], topic: str, type_name: str, decode: Decode
) -> list[tuple[int, dict[str, Any]]]:
    """(stamp_ns, fields) of a topic's messages of this type; one that cannot be decoded is left out."""
    found = []
    for entry in entries:
        if entry.channel.topic == topic and entry.channel.type_name == type_name:
            try:
                found.append((entry.stamp_ns, decode(entry.payload)))
            except BadPayload:
                continue
    return found


def decode_event(payload: bytes) -> dict[str, Any]:
    """The fields of what happened.

    Raises:
        BadPayload: it is no JSON of an object.
    """
    try:
        return msgspec.json.decode(payload, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadPayload(EVENTS.type_name, str(error)) from None


def odometry_of(entries: Iterable[Entry]) -> tuple[str, str] | None:
    """(topic, type) of the odometry that a device published; None: there is none."""
    found = {
        (entry.channel.topic, entry.channel.type_name)
        for entry in entries
        if entry.channel.type_name in READERS and entry.channel.origin == DEVICE
    }
    return min(found, key=lambda each: (not each[0].endswith("/odometry"), each), default=None)


def thinned(samples: list[Sample]) -> list[Sample]:
    """At most MAX_SAMPLES, at equal steps; the last is always one of them."""
    step = -(-len(samples) // MAX_SAMPLES)
    return samples[::-1][::step][::-1] if step > 1 else samples
