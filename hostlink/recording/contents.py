"""What is in a recording, without decoding it."""

from dataclasses import dataclass, field
from pathlib import Path

from hostlink.recording.channel import NS_PER_S, Channel
from hostlink.recording.reader import Reader


@dataclass(slots=True)
class TopicContents:
    """One channel."""

    channel: Channel
    messages: int = 0
    payload_bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Messages a second; None: one message has no rate."""
        seconds = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.messages - 1) / seconds if seconds > 0 else None


@dataclass(slots=True)
class Contents:
    """A file."""

    path: Path
    size_bytes: int
    metadata: dict[str, str]
    damage: list[str]
    topics: list[TopicContents] = field(default_factory=list)

    @property
    def messages(self) -> int:
        """Of all topics."""
        return sum(topic.messages for topic in self.topics)

    @property
    def first_ns(self) -> int:
        """The earliest message; 0: there is none."""
        return min((topic.first_ns for topic in self.topics if topic.messages), default=0)

    @property
    def seconds(self) -> float:
        """From the earliest message to the latest."""
        last_ns = max((topic.last_ns for topic in self.topics if topic.messages), default=0)
        return (last_ns - self.first_ns) / NS_PER_S


def contents_of(path: Path) -> Contents:
    """Look through a file.

    Raises:
        RecordingFailed: it cannot be read, or is no recording.
    """
    reader = Reader(path)
    topics: dict[Channel, TopicContents] = {}
    for channel, stamp_ns, payload in reader.messages():
        found = topics.get(channel)
        if found is None:
            found = topics[channel] = TopicContents(channel, first_ns=stamp_ns, last_ns=stamp_ns)
        found.messages += 1
        found.payload_bytes += len(payload)
        found.first_ns, found.last_ns = min(found.first_ns, stamp_ns), max(found.last_ns, stamp_ns)
    for channel in reader.channels:
        topics.setdefault(channel, TopicContents(channel))
    listed = sorted(topics.values(), key=lambda topic: topic.channel.topic)
    return Contents(path, path.stat().st_size, reader.metadata, reader.damage, listed)
