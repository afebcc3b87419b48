"""When each message of a recording is due, and which robots are in it. Pure."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from hostlink.recording.channel import DEVICE, VELOCITY, Channel
from hostlink.recording.reader import StoredMessage

NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class Due:
    """A message, and when it is due after the beginning of the play."""

    at_s: float
    message: StoredMessage


def schedule(messages: Iterable[StoredMessage], *, rate: float = 1.0, start_s: float = 0.0) -> Iterator[Due]:
    """Every message from `start_s` on, in the order of the file, at its intervals; times that go back are none."""
    at_ns, before_ns = 0, None
    for message in messages:
        at_ns += 0 if before_ns is None else max(0, message.stamp_ns - before_ns)
        before_ns = message.stamp_ns
        at_s = at_ns / NS_PER_S - start_s
        if at_s >= 0:
            yield Due(at_s / rate, message)


def robots_of(channels: Iterable[Channel]) -> dict[str, list[Channel]]:
    """By robot, the channels that its device published, and those of its velocity; others have none of both."""
    robots: dict[str, dict[str, Channel]] = {}
    for channel in channels:
        if channel.robot and channel.origin in (DEVICE, VELOCITY):
            robots.setdefault(channel.robot, {})[channel.topic] = channel
    found = {robot: list(of_robot.values()) for robot, of_robot in robots.items()}
    return {robot: listed for robot, listed in found.items() if any(each.origin == DEVICE for each in listed)}
