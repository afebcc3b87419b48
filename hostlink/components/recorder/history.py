"""History of robots from the black box, with a bounded number of samples at equal steps. Pure."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import msgspec

from hostlink.components.recorder.channel import DEVICE, EVENT, VELOCITY, Channel, json_of
from hostlink.components.recorder.ring import Entry
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.kinematics import Pose, frame_of, placed
from hostlink.core.robot.odometry import OdometryEstimator
from hostlink.core.robot.readings import READERS
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload

Sample = TypeVar("Sample")

MAX_SAMPLES = 6000  # of one topic: two and a half minutes at 40 Hz; above it every second, third, ... sample is kept
MAX_TOPICS = 16  # of odometry, and of velocities; a robot has one of each
PLOT_LEAF = "plot_data"
FREQUENT = (EventKind.COMMANDED.value, EventKind.REFUSED.value)


class Thinned(Generic[Sample]):
    """Samples at equal steps, at most twice `most`, and always the last one."""

    def __init__(self, most: int) -> None:
        self._most, self._step, self._count = most, 1, 0
        self._kept: list[Sample] = []
        self._last: Sample | None = None

    def add(self, sample: Sample) -> None:
        """Add the next sample. Without room, drop every second kept sample."""
        if self._count % self._step == 0:
            self._kept.append(sample)
            self._last = None
            if len(self._kept) > 2 * self._most:
                self._kept = self._kept[::2]
                self._step *= 2
        else:
            self._last = sample
        self._count += 1

    def samples(self) -> list[Sample]:
        """Return the kept samples in order."""
        return self._kept if self._last is None else [*self._kept, self._last]


Decode = Callable[[bytes], dict[str, Any]]
Part = Literal["odometry", "velocity", "plot", "events"]
Rest = Callable[[], None]
_Key = tuple[Part, str, str]  # topic and type; all events have the empty ones


@dataclass(frozen=True, slots=True)
class PastPose:
    """Pose and twist of the robot at a time, in the frame in which it is shown now."""

    at_s: float
    pose: Pose
    twist: PlanarVelocity


class _Kind(msgspec.Struct):
    kind: str = ""


class RobotHistory:
    """Collector of a robot's entries that are shown. Each part is bounded before anything is decoded."""

    def __init__(self, robot: str, *, odometry: tuple[str, str] | None = None, commands: str | None = None) -> None:
        """`odometry` is the (topic, type) shown; None selects what a device published.

        `commands` is the topic; None any.
        """
        self._robot = robot
        self._plot_topic = f"/{robot}/{PLOT_LEAF}"
        self._odometry, self._commands = odometry, commands
        self._parts: dict[int, tuple[Channel, Part | None]] = {}
        self._kept: dict[_Key, Thinned[Entry]] = {}

    def is_wanted(self, channel: Channel) -> bool:
        """Whether messages of this channel are shown."""
        return self._part_of(channel) is not None

    def add(self, entry: Entry) -> None:
        """Keep an entry if it is shown. Call it in the order of arrival."""
        channel = entry.channel
        known = self._parts.get(id(channel))
        if known is None:  # hashing a channel costs more than the rest
            known = self._parts[id(channel)] = channel, self._part_of(channel)
        part = known[1]
        if part is None or (part == "events" and _kind_of(entry) in FREQUENT):
            return
        key = (part, "", "") if part == "events" else (part, channel.topic, channel.type_name)
        kept = self._kept.get(key)
        if kept is None:
            if sum(each[0] == part for each in self._kept) >= MAX_TOPICS:
                return
            kept = self._kept[key] = Thinned((MAX_SAMPLES - 1) // 2)
        kept.add(entry)

    def poses(self, estimator: OdometryEstimator, present: Pose | None, rest: Rest) -> list[PastPose]:
        """Return the poses as the robot's estimator would have shown them.

        `estimator` is a new one with the robot's settings. `present` is the pose shown at the last entry. `rest` is
        called after each entry.
        """
        topics = [(topic, type_name) for part, topic, type_name in self._kept if part == "odometry"]
        if not topics:
            return []
        topic, type_name = min(topics, key=lambda each: (not each[0].endswith("/odometry"), each))
        found: list[PastPose] = []
        for entry in self._kept["odometry", topic, type_name].samples():
            rest()
            try:
                reading = READERS[type_name](entry.payload)
            except BadPayload:
                continue
            estimator.update(reading.pose, now_s=entry.at_s, wall_ns=int(entry.at_s * NS_PER_S), twist=reading.twist)
            snapshot = estimator.snapshot(entry.at_s)
            if snapshot is not None and snapshot.pose is not None and snapshot.twist is not None:
                found.append(PastPose(entry.at_s, snapshot.pose, snapshot.twist))
        if present is None or not found:
            return found
        frame = frame_of(present, found[-1].pose)
        return [PastPose(each.at_s, placed(frame, each.pose), each.twist) for each in found]

    def commands(self, decode: Decode, rest: Rest) -> list[tuple[float, dict[str, Any]]]:
        """Return (at_s, fields) of the velocities that were sent to the device."""
        topic = min((topic for part, topic, _ in self._kept if part == "velocity"), default="")
        return self._messages(("velocity", topic, TWIST_TYPE), lambda entry: decode(entry.payload), rest)

    def plot_data(self, decode: Decode, rest: Rest) -> list[tuple[float, dict[str, Any]]]:
        """Return (at_s, fields) of the device's plot data."""
        return self._messages(("plot", self._plot_topic, TWIST_TYPE), lambda entry: decode(entry.payload), rest)

    def events(self, rest: Rest) -> list[tuple[float, dict[str, Any]]]:
        """Return (at_s, event) of the robot's events, without single commands.

        An event of a link before it is known whose it is has no robot. The number of the link says whose it is, also
        where several devices have one address. Events of other links are omitted.
        """
        found = self._messages(("events", "", ""), decode_event, rest)
        links = {_link_of(event) for _, event in found if event.get("robot") == self._robot} - {None}
        return [each for each in found if each[1].get("robot") != "" or _link_of(each[1]) in links]

    def _messages(
        self, key: _Key, decode: Callable[[Entry], dict[str, Any]], rest: Rest
    ) -> list[tuple[float, dict[str, Any]]]:
        """Return (at_s, fields) of the kept messages. Omit messages that cannot be decoded."""
        found = []
        for entry in self._kept[key].samples() if key in self._kept else ():
            rest()
            with contextlib.suppress(BadPayload):
                found.append((entry.at_s, decode(entry)))
        return found

    def _part_of(self, channel: Channel) -> Part | None:
        if channel.content == EVENT:
            return "events"
        if channel.type_name == TWIST_TYPE:
            if channel.topic == self._plot_topic:
                return "plot"
            is_command = channel.origin == VELOCITY if self._commands is None else channel.topic == self._commands
            return "velocity" if is_command else None
        if self._odometry is None:
            return "odometry" if channel.type_name in READERS and channel.origin == DEVICE else None
        return "odometry" if (channel.topic, channel.type_name) == self._odometry else None


def decode_event(entry: Entry) -> dict[str, Any]:
    """Decode the fields of an event.

    Raises:
        BadPayload: the payload is not a JSON object.
    """
    try:
        return msgspec.json.decode(json_of(entry.channel, entry.payload), type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadPayload(EVENT, str(error)) from None


def _link_of(event: dict[str, Any]) -> int | None:
    """Return the number of the link of a decoded event, whose fields may have any types; None without one."""
    facts = event.get("facts")
    link = facts.get("link") if isinstance(facts, dict) else None
    return link if isinstance(link, int) else None


def _kind_of(entry: Entry) -> str:
    try:
        return msgspec.json.decode(json_of(entry.channel, entry.payload), type=_Kind).kind
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):  # omitted later, when it is decoded
        return ""
