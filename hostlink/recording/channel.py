"""Channel: one topic in a recording, and what a reader must know to understand its messages."""

import struct
from dataclasses import dataclass
from typing import Protocol

from hostlink.messages.message_type import MessageType

JSON, ROS1, CDR = "json", "ros1", "cdr"
SCHEMA_ENCODINGS = {ROS1: "ros1msg", JSON: "jsonschema", CDR: "ros2msg"}
LIBRARY = "hostlink"  # that wrote a file, as its header names it: one whose messages have wall times alone
LIBRARY_STEADY = "hostlink; publish_time is steady"
NS_PER_S = 1_000_000_000  # of the stamps of messages
DEVICE, VELOCITY, HOSTLINK = "device", "velocity", "hostlink"  # who publishes a topic
EVENT, LOG_LINE, PARAMETER_SET = "hostlink.Event", "hostlink.LogLine", "hostlink.Parameters"
TEXT_TYPE, TEXT_DEFINITION = "std_msgs/String", "string data\n"
TEXT_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
TEXT_HEAD = struct.Struct("<I")  # a string of ROS 1: how many bytes, then these
EVENTS_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC = "/hostlink/events", "/hostlink/log", "/hostlink/parameters"


@dataclass(frozen=True, slots=True)
class Channel:
    """As MCAP has it: https://mcap.dev/spec, and its profile ros1."""

    topic: str
    encoding: str  # ROS1: the payload as rosserial and ROS 1 have it; JSON
    type_name: str
    schema: str  # ros1msg: the definition with all that it contains; jsonschema
    metadata: tuple[tuple[str, str], ...] = ()
    language: str = ""  # of the schema, if it is not the one that hostlink writes with this encoding

    @property
    def robot(self) -> str:
        """Whose it is."""
        return dict(self.metadata).get("robot", "")

    @property
    def origin(self) -> str:
        """Who publishes it."""
        return dict(self.metadata).get("origin", "")

    @property
    def schema_encoding(self) -> str:
        """What language the schema is in."""
        return self.language or SCHEMA_ENCODINGS.get(self.encoding, "")

    @property
    def content(self) -> str:
        """What hostlink itself writes on the channel, as JSON: one of EVENT, LOG_LINE, PARAMETER_SET; empty: nothing.

        Older recordings have these channels as JSON; now they are texts of ROS 1.
        """
        if self.encoding == JSON:
            return self.type_name
        return dict(self.metadata).get("content", "") if self.encoding == ROS1 else ""


class Sink(Protocol):
    """Where a recorder puts messages: a file's writer, a black box. It never waits."""

    def announce(self, channel: Channel) -> None:
        """There is this channel from now on, though it may have no message: what a robot listens to is part of it."""
        ...

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str) -> None:
        """`robot`: whose it is; empty: nobody's."""
        ...


def ros_channel(
    topic: str, type_name: str, type_: MessageType | None, *, is_latched: bool, robot: str = "", origin: str = ""
) -> Channel:
    """The channel of a topic; without a definition its messages are kept, and nobody can decode them.

    `robot`: whose it is; `origin`: who publishes it, one of DEVICE, VELOCITY (a command to the robot), HOSTLINK and "".
    """
    md5 = "*" if type_ is None else type_.md5
    metadata = (
        ("callerid", "/hostlink"),
        ("md5sum", md5),
        ("latching", str(int(is_latched))),
        ("topic", topic),
        ("robot", robot),
        ("origin", origin),
    )
    return Channel(topic, ROS1, type_name, "" if type_ is None else type_.full_definition, metadata)


def _text_channel(topic: str, content: str) -> Channel:
    """A text of ROS 1 with JSON in it: a reader that knows ROS 1 alone reads the whole file."""
    facts = {"callerid": "/hostlink", "md5sum": TEXT_MD5, "latching": "0", "topic": topic, "content": content}
    return Channel(topic, ROS1, TEXT_TYPE, TEXT_DEFINITION, tuple(facts.items()))


EVENTS = _text_channel(EVENTS_TOPIC, EVENT)
LOG = _text_channel(LOG_TOPIC, LOG_LINE)
PARAMETERS = _text_channel(PARAMETERS_TOPIC, PARAMETER_SET)


def as_text(data: bytes) -> bytes:
    """The payload of a text of ROS 1."""
    return TEXT_HEAD.pack(len(data)) + data


def json_of(channel: Channel, payload: bytes) -> bytes:
    """The JSON of a message whose channel has `content`, or is encoded so."""
    return payload if channel.encoding == JSON else payload[TEXT_HEAD.size :]


def note_newest(channels: dict[Channel, None], channel: Channel, most: int) -> None:
    """Put a channel last, also one that is there already; over `most` the first goes."""
    channels.pop(channel, None)
    channels[channel] = None
    if len(channels) > most:
        del channels[next(iter(channels))]
