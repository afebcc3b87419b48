"""Events that a DeviceSession derives from a device's bytes, and what belongs to them."""

from typing import NamedTuple

from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.errors import HostlinkError

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")


class Parameter(NamedTuple):
    """Answer to a parameter request.

    One of the three fields is filled; all are empty when the parameter does not exist.
    """

    ints: tuple[int, ...] = ()
    floats: tuple[float, ...] = ()
    strings: tuple[str, ...] = ()


class TopicsNegotiated(NamedTuple):
    """The device has announced its topics.

    `is_changed`: the topics differ from the ones before, or an id changed its meaning meanwhile; frames that waited for
    the device were dropped. `gap_at`: an id whose TopicInfo was lost; the session requests the topics again.
    """

    topics: tuple[DeviceEndpoint, ...]
    is_changed: bool
    gap_at: int | None


class TopicRefused(NamedTuple):
    """One endpoint cannot be used. The other endpoints of the device are not affected."""

    topic: DeviceEndpoint
    reason: HostlinkError


class TopicsRequested(NamedTuple):
    """The session requests the topics of the device."""

    reason: str


class TopicsAnswered(NamedTuple):
    """The device has begun to answer a topic request, which was sent at `asked_at_s`: it is alive."""

    asked_at_s: float


class MessageReceived(NamedTuple):
    """The device published a message."""

    topic: DeviceEndpoint
    payload: bytes


class ServiceRequested(NamedTuple):
    """The device calls a service of the host.

    `request` is the identity of the request, as the protocol chooses it: the hub returns it with the response. None: a
    response has no identity, and the device takes the next one for that to its oldest request.
    """

    service: DeviceEndpoint
    payload: bytes
    request: bytes | None = None


class ServiceResponded(NamedTuple):
    """A service of the device answered.

    `request` is the identity that `DeviceSession.call` returned for the request. None: answers have no identity, and
    this one is that to the oldest request.
    """

    service: DeviceEndpoint
    payload: bytes
    request: bytes | None = None


class ResponseRefused(NamedTuple):
    """A service of the device answered, but not with a message of its type. `request` as in ServiceResponded."""

    service: DeviceEndpoint
    reason: HostlinkError
    request: bytes | None = None


class TimeRequested(NamedTuple):
    """The device requested the time; the answer is queued."""


class ParameterRequested(NamedTuple):
    """The device requested a parameter. It blocks until the answer arrives."""

    name: str


class DeviceLogged(NamedTuple):
    """The device's program logged a line; `level` indexes LOG_LEVELS."""

    level: int
    text: str


class UnknownTopicUsed(NamedTuple):
    """The device sent a frame with an id that it never announced."""

    topic_id: int


class VersionRefused(NamedTuple):
    """The device speaks a version of its protocol that is not understood. Occurs once per session.

    `version`: as the log names it. `advice` says what to do.
    """

    version: str
    advice: str


Event = (
    TopicsNegotiated
    | TopicRefused
    | TopicsRequested
    | TopicsAnswered
    | MessageReceived
    | ServiceRequested
    | ServiceResponded
    | ResponseRefused
    | TimeRequested
    | ParameterRequested
    | DeviceLogged
    | UnknownTopicUsed
    | VersionRefused
)
