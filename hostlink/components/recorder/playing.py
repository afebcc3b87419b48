"""Playback of a recording: when each message is due, which robots it has, and which messages move a robot. Pure."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from hostlink.components.recorder.channel import DEVICE, ROS1, VELOCITY, Channel
from hostlink.components.recorder.reader import StoredMessage
from hostlink.core.robot.admission import LEASE_S, NOT_PLANAR
from hostlink.core.robot.velocity import TWIST_TYPE, ZERO, PlanarVelocity, Twist
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload

_MOVING = ("Twist", "TwistStamped", "")  # last part of a type's name; empty: the type is the topic's own


@dataclass(frozen=True, slots=True)
class Due:
    """Message with the time at which it is due after the start of the playback."""

    at_s: float
    message: StoredMessage
    cut_s: float = 0.0  # omitted part of the pause before it


def schedule(
    messages: Iterable[StoredMessage],
    *,
    begin_ns: int | None = None,
    rate: float = 1.0,
    start_s: float = 0.0,
    max_pause_s: float = math.inf,
) -> Iterator[Due]:
    """Yield every message from `start_s` on, in the order of the file and at its intervals. Backward steps count as 0.

    `begin_ns` is the steady time of the recording's beginning; None uses the first message. `max_pause_s`: longer
    pauses of the recording are shortened to this.
    """
    at_s, before_ns = 0.0, None if begin_ns is None else begin_ns + int(start_s * NS_PER_S)
    for message in messages:
        if before_ns is None:
            before_ns = message.steady_ns + int(start_s * NS_PER_S)
        pause_s = (message.steady_ns - before_ns) / NS_PER_S
        if pause_s < 0 and not at_s and start_s:
            continue  # before the start
        cut_s = max(0.0, pause_s - max_pause_s)
        at_s += max(0.0, pause_s - cut_s)
        before_ns = message.steady_ns
        yield Due(at_s / rate, message, cut_s)


@dataclass(frozen=True, slots=True)
class DueVelocity:
    """Velocity with the time at which it is due after the start of the playback."""

    at_s: float
    velocity: PlanarVelocity


def drives(due_messages: Iterable[Due], robot: str, topic: str, *, rate: float = 1.0) -> Iterator[DueVelocity]:
    """Yield the velocities of a robot's topic, and a zero after each lease without another velocity.

    A recording may lack the zero that ended a drive: the link was lost, the file is cut, or a chunk is damaged.

    Raises:
        BadPayload: a message is not a velocity, or has components that no robot has.
    """
    end_s: float | None = None  # end of the lease of a moving velocity
    for due in due_messages:
        if end_s is not None and due.at_s >= end_s:
            yield DueVelocity(end_s, ZERO)
            end_s = None
        channel = due.message.channel
        # A robot that connected later may have the topic.
        if channel.topic == topic and channel.robot == robot and is_drive(channel):
            twist = Twist.decode(due.message.payload)
            if not twist.is_planar:
                raise BadPayload(TWIST_TYPE, NOT_PLANAR)
            velocity = twist.planar
            yield DueVelocity(due.at_s, velocity)
            end_s = None if velocity.is_zero else due.at_s + LEASE_S / rate
    if end_s is not None:
        yield DueVelocity(end_s, ZERO)


class NewestDue:
    """Filter of velocities that are sent more slowly than they are due: of those that are overdue, only the newest.

    A file may have any number of velocities of one time. A zero is never left out.
    """

    def __init__(self) -> None:
        self.left_out = 0

    def of(self, velocities: Iterable[DueVelocity], now_s: Callable[[], float]) -> Iterator[DueVelocity]:
        """Yield what is to be sent. `now_s`: time since the start of the playback."""
        overdue: DueVelocity | None = None
        for due in velocities:
            if overdue is not None and due.at_s <= now_s():
                self.left_out += 1
            elif overdue is not None:
                yield overdue
            overdue = None
            if due.at_s > now_s() or due.velocity.is_zero:
                yield due
            else:
                overdue = due
        if overdue is not None:
            yield overdue


def is_drive(channel: Channel) -> bool:
    """Whether the channel has velocities that a gate sent to a robot."""
    return channel.origin == VELOCITY and channel.encoding == ROS1 and channel.type_name == TWIST_TYPE


def is_playable(channel: Channel) -> bool:
    """Whether a played device can send the messages of a channel: as ROS 1 serialises them."""
    return channel.encoding == ROS1


def may_move(channel: Channel) -> bool:
    """Whether a robot could read messages of this channel as velocities, judged by type and not by publisher.

    A daemon reads geometry_msgs/msg/Twist as geometry_msgs/Twist. A file of another program may have either.
    """
    return channel.origin == VELOCITY or channel.type_name.rpartition("/")[2] in _MOVING


def robots_of(channels: Iterable[Channel]) -> dict[str, list[Channel]]:
    """Return the channels that each robot's device published, and those of its velocity. Other robots are omitted.

    A topic that the device published and that may be the velocity of another robot is omitted, and so is one whose
    messages are not in the serialisation of ROS 1, in which a played device sends.
    """
    robots: dict[str, dict[str, Channel]] = {}
    for channel in filter(is_playable, channels):
        is_of_another = channel.origin == DEVICE and may_move(channel) and "vel" in channel.topic.rpartition("/")[2]
        if channel.robot and channel.origin in (DEVICE, VELOCITY) and not is_of_another:
            robots.setdefault(channel.robot, {})[channel.topic] = channel
    found = {robot: list(of_robot.values()) for robot, of_robot in robots.items()}
    return {robot: listed for robot, listed in found.items() if any(each.origin == DEVICE for each in listed)}
