"""Contents of a recording, without decoding."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from hostlink.recording.channel import NS_PER_S, Channel
from hostlink.recording.source import open_source

CLOCK_STEP_NS = NS_PER_S  # a smaller step is the delay of a message, or a slewed clock
MAX_STEPS = 10  # listed clock steps


@dataclass(slots=True)
class TopicContents:
    """Contents of one channel."""

    channel: Channel
    messages: int = 0
    payload_bytes: int = 0
    first_ns: int = 0  # steady time, as is last_ns
    last_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Messages per second; None with fewer than two messages."""
        seconds = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.messages - 1) / seconds if seconds > 0 else None


class ClockStep(NamedTuple):
    """Step of the wall clock: its time and size."""

    at_s: float  # since the beginning of the recording
    step_s: float


@dataclass(slots=True)
class Contents:
    """Contents of a recording."""

    path: Path
    size_bytes: int
    metadata: dict[str, str]
    damage: list[str]
    topics: list[TopicContents] = field(default_factory=list)
    begin_ns: int = 0  # wall time of the first message; 0 without messages
    clock_steps: list[ClockStep] = field(default_factory=list)  # the first MAX_STEPS

    @property
    def messages(self) -> int:
        """Number of messages of all topics."""
        return sum(topic.messages for topic in self.topics)

    @property
    def seconds(self) -> float:
        """Time from the first to the last message, by a clock that is never set."""
        met = [topic for topic in self.topics if topic.messages]
        last_ns = max((topic.last_ns for topic in met), default=0)
        return (last_ns - min((topic.first_ns for topic in met), default=0)) / NS_PER_S


def contents_of(path: Path) -> Contents:
    """Read the contents of a file.

    Raises:
        RecordingFailed: the file cannot be read, or is not a recording.
    """
    source = open_source(path)
    found = Contents(path, 0, {}, [])
    topics: dict[Channel, TopicContents] = {}
    ahead_ns: int | None = None  # wall time minus steady time
    for message in source.messages():
        topic = topics.get(message.channel)
        if topic is None:
            topic = topics[message.channel] = TopicContents(message.channel)
            topic.first_ns = topic.last_ns = message.steady_ns
        topic.messages += 1
        topic.payload_bytes += len(message.payload)
        topic.first_ns, topic.last_ns = min(topic.first_ns, message.steady_ns), max(topic.last_ns, message.steady_ns)
        if ahead_ns is None:
            found.begin_ns, ahead_ns = message.stamp_ns, message.stamp_ns - message.steady_ns
        step_ns = message.stamp_ns - message.steady_ns - ahead_ns
        ahead_ns += step_ns
        if abs(step_ns) > CLOCK_STEP_NS and len(found.clock_steps) < MAX_STEPS:
            at_s = (message.steady_ns - source.begin_ns) / NS_PER_S
            found.clock_steps.append(ClockStep(at_s, step_ns / NS_PER_S))
    for channel in source.channels:
        topics.setdefault(channel, TopicContents(channel))
    found.topics = sorted(topics.values(), key=lambda topic: topic.channel.topic)
    found.size_bytes, found.metadata, found.damage = source.size_bytes, source.metadata, source.damage
    return found
