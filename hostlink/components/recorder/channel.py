"""Channel: one topic of a recording, with the data that a reader needs for its messages."""

import functools
import struct
from dataclasses import dataclass
from typing import Protocol

from hostlink.core.messages import serialisation
from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.ros2_names import ros2_type

JSON, ROS1, CDR = "json", serialisation.ROS1, serialisation.CDR
_SCHEMA_ENCODINGS = {ROS1: "ros1msg", JSON: "jsonschema", CDR: "ros2msg"}
LIBRARY = "hostlink"  # library name in the header of a file that has only wall times: repaired, of another program
LIBRARY_STEADY = "hostlink; publish_time is steady"
DEVICE, VELOCITY, HOSTLINK = "device", "velocity", "hostlink"  # publishers of a topic
EVENT, LOG_LINE, PARAMETER_SET = "hostlink.Event", "hostlink.LogLine", "hostlink.Parameters"
TEXT_TYPE, TEXT_DEFINITION = "std_msgs/String", "string data\n"
TEXT_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
TEXT_HEAD = struct.Struct("<I")  # a string of ROS 1: length in bytes, then the bytes
EVENTS_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC = "/hostlink/events", "/hostlink/log", "/hostlink/parameters"


@dataclass(frozen=True, slots=True)
class Channel:
    """Channel as in MCAP: https://mcap.dev/spec, and its profile ros1."""

    topic: str
    encoding: str  # ROS1: payload in the serialisation of rosserial and ROS 1; CDR of an unknown type; or JSON
    type_name: str
    schema: str  # ros1msg: the full definition; or jsonschema; empty: unknown
    metadata: tuple[tuple[str, str], ...] = ()
    language: str = ""  # schema language, if not the one that hostlink writes with this encoding

    @property
    def robot(self) -> str:
        """Name of the robot that the channel belongs to; empty if none."""
        return dict(self.metadata).get("robot", "")

    @property
    def origin(self) -> str:
        """Publisher of the channel: DEVICE, VELOCITY, HOSTLINK or empty."""
        return dict(self.metadata).get("origin", "")

    @property
    def schema_encoding(self) -> str:
        return self.language or usual_language(self.encoding, self.schema)

    @property
    def content(self) -> str:
        """Kind of hostlink's own JSON on the channel: EVENT, LOG_LINE or PARAMETER_SET; empty for other channels.

        Older recordings have these channels as JSON. Newer ones have them as std_msgs/String.
        """
        if self.encoding == JSON:
            return self.type_name
        return dict(self.metadata).get("content", "") if self.encoding == ROS1 else ""


def usual_language(encoding: str, schema: str) -> str:
    """Return the schema language that hostlink writes with an encoding; empty for CDR without a schema.

    An empty ros2msg would be a message without fields, and a reader would decode it without an error.
    """
    return "" if encoding == CDR and not schema else _SCHEMA_ENCODINGS.get(encoding, "")


class Sink(Protocol):
    """Destination of recorded messages: a file writer or a black box. Its methods never wait."""

    def announce(self, channel: Channel) -> None:
        """Add a channel, which may stay without a message: the topics that a robot subscribes to are recorded too."""
        ...

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str) -> None:
        """Add a message. `robot` is the robot that it belongs to; empty if none."""
        ...


@functools.lru_cache(maxsize=64)
def _pair(name: str, value: str) -> tuple[str, str]:
    """Return an entry of the metadata; the same one for all channels of a type or of a robot."""
    return name, value


def ros_channel(
    topic: str,
    type_name: str,
    type_: MessageType | None,
    *,
    is_latched: bool,
    robot: str = "",
    origin: str = "",
    encoding: str = ROS1,
) -> Channel:
    """Create the channel of a topic. Without a definition its messages are kept but cannot be decoded.

    `robot` is the robot that it belongs to. `origin` is its publisher: DEVICE, VELOCITY (a command to the robot),
    HOSTLINK or "". `encoding` is that of the topic. One of CDR has the type's name in ROS 2.
    """
    md5 = "*" if type_ is None else type_.md5
    metadata = (
        _pair("callerid", "/hostlink"),
        *(() if encoding == CDR else (_pair("md5sum", md5),)),
        _pair("latching", str(int(is_latched))),
        ("topic", topic),
        _pair("robot", robot),
        _pair("origin", origin),
    )
    if encoding == CDR:
        type_name = ros2_type(type_name)
    return Channel(topic, encoding, type_name, "" if type_ is None else type_.full_definition, metadata)


def _text_channel(topic: str, content: str) -> Channel:
    """Create a std_msgs/String channel with JSON in it, so that a reader of ROS 1 can read the whole file."""
    facts = {"callerid": "/hostlink", "md5sum": TEXT_MD5, "latching": "0", "topic": topic, "content": content}
    return Channel(topic, ROS1, TEXT_TYPE, TEXT_DEFINITION, tuple(facts.items()))


EVENTS = _text_channel(EVENTS_TOPIC, EVENT)
LOG = _text_channel(LOG_TOPIC, LOG_LINE)
PARAMETERS = _text_channel(PARAMETERS_TOPIC, PARAMETER_SET)


def as_text(data: bytes) -> bytes:
    """Encode the payload of a std_msgs/String."""
    return TEXT_HEAD.pack(len(data)) + data


def json_of(channel: Channel, payload: bytes) -> bytes:
    """Return the JSON of a message on a channel that has `content` or the encoding JSON."""
    return payload if channel.encoding == JSON else payload[TEXT_HEAD.size :]


def note_newest(channels: dict[Channel, None], channel: Channel, most: int) -> None:
    """Move a channel to the end, or add it. Above `most` channels, remove the first."""
    channels.pop(channel, None)
    channels[channel] = None
    if len(channels) > most:
        del channels[next(iter(channels))]
