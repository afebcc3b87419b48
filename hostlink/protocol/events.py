"""What a Session makes of a device's bytes: one value an event, named in the past."""

from typing import NamedTuple

from hostlink.errors import HostlinkError
from hostlink.protocol.control import TopicInfo


class TopicsNegotiated(NamedTuple):
    """The device has announced its topics; `gap_at` is an id whose TopicInfo was lost, and is requested again.

    `is_changed`: they are others than before, or some were in between, and what waited for the device was dropped.
    """

    topics: tuple[TopicInfo, ...]
    is_changed: bool
    gap_at: int | None


class TopicRefused(NamedTuple):
    """An endpoint that cannot be used; the others go on."""

    topic: TopicInfo
    reason: HostlinkError


class TopicsRequested(NamedTuple):
    """The session requests the topics of the device."""

    reason: str


class MessageReceived(NamedTuple):
    """A message of a topic of the device's."""

    topic: TopicInfo
    payload: bytes


class ServiceRequested(NamedTuple):
    """The device calls a service of the host."""

    service: TopicInfo
    payload: bytes


class ServiceResponded(NamedTuple):
    """The device's own service answers."""

    service: TopicInfo
    payload: bytes


class TimeRequested(NamedTuple):
    """The device requested the time; the answer is queued."""


class ParameterRequested(NamedTuple):
    """The device waits for a parameter, spinning."""

    name: str


class DeviceLogged(NamedTuple):
    """The device's program logged a line; `level` indexes control.LOG_LEVELS."""

    level: int
    text: str


class UnknownTopicUsed(NamedTuple):
    """A frame came for an id that the device never announced."""

    topic_id: int


class Protocol1Recognised(NamedTuple):
    """The device speaks rosserial of before 2013; one event a session."""


Event = (
    TopicsNegotiated
    | TopicRefused
    | TopicsRequested
    | MessageReceived
    | ServiceRequested
    | ServiceResponded
    | TimeRequested
    | ParameterRequested
    | DeviceLogged
    | UnknownTopicUsed
    | Protocol1Recognised
)
