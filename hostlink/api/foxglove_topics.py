"""FoxgloveTopics: the topics to which one client of Foxglove's protocol publishes."""

from typing import NamedTuple

from hostlink.api.foxglove_frames import ROS1, Published
from hostlink.api.foxglove_requests import ClientChannel
from hostlink.errors import BadPayload, BadRequest
from hostlink.hub.participant import MAX_ADVERTISED, Participant
from hostlink.hub.topic_graph import resolve
from hostlink.messages.message_type import MessageType


class _Advertised(NamedTuple):
    """A channel of the client's."""

    topic: str
    type_name: str


class FoxgloveTopics:
    """By the ids that the client chose; several may share a topic, which is taken back with the last."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._channels: dict[int, _Advertised] = {}

    def advertise(self, channel: ClientChannel) -> None:
        """Note a channel.

        Raises:
            BadRequest: the id is in use, the encoding is another, nobody knows the type, or there are too many.
            WrongType: the topic is in use with another type.
        """
        if channel.id in self._channels:
            raise BadRequest(f"advertise: the id {channel.id} is in use")
        if channel.encoding != ROS1:
            raise BadRequest(f"advertise: {channel.topic} must be of the encoding {ROS1}, not {channel.encoding!r}")
        if len(self._channels) >= MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} channels advertised")
        self._participant.advertise(channel.topic, channel.schema_name)
        self._channels[channel.id] = _Advertised(resolve(channel.topic), channel.schema_name)

    def unadvertise(self, number: int) -> None:
        """Take back a channel; one that is not there is no error."""
        gone = self._channels.pop(number, None)
        if gone is not None and all(other.topic != gone.topic for other in self._channels.values()):
            self._participant.unadvertise(gone.topic)

    def find(self, number: int) -> str | None:
        """The topic of the channel of this id, if it is advertised."""
        return self._channels[number].topic if number in self._channels else None

    def topic(self, number: int) -> str:
        """Of the channel of this id.

        Raises:
            BadRequest: it is not advertised.
        """
        if number not in self._channels:
            raise BadRequest(f"publish: the channel {number} is not advertised")
        return self._channels[number].topic

    def publish(self, published: Published, came_s: float) -> None:
        """Send a payload that is exactly one message and came then; a velocity drives the robot.

        Raises:
            BadRequest: the channel is not advertised, or as Participant.publish.
            BadPayload: the payload is not one message of the type; a device would read beyond its end.
            HostlinkError: as Participant.publish.
        """
        topic = self.topic(published.channel_id)
        type_name = self._channels[published.channel_id].type_name
        _check(self._participant.message_type(topic, type_name), published.payload)
        self._participant.publish(topic, published.payload, at_s=came_s)


def _check(type_: MessageType, payload: bytes) -> None:
    if type_.fixed_bytes is None:
        type_.decode(payload)
    elif len(payload) != type_.fixed_bytes:
        raise BadPayload(type_.name, f"{len(payload)} bytes instead of {type_.fixed_bytes}")
