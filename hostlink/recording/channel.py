"""Channel: one topic in a recording, and what a reader must know to understand its messages."""

import json
from dataclasses import dataclass
from typing import Protocol

from hostlink.messages.message_type import MessageType

JSON, ROS1 = "json", "ros1"
NS_PER_S = 1_000_000_000  # of the stamps of messages
DEVICE, VELOCITY, HOSTLINK = "device", "velocity", "hostlink"  # who publishes a topic
EVENTS_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC = "/hostlink/events", "/hostlink/log", "/hostlink/parameters"


@dataclass(frozen=True, slots=True)
class Channel:
    """As MCAP has it: https://mcap.dev/spec, and its profile ros1."""

    topic: str
    encoding: str  # ROS1: the payload as rosserial and ROS 1 have it; JSON
    type_name: str
    schema: str  # ros1msg: the definition with all that it contains; jsonschema
    metadata: tuple[tuple[str, str], ...] = ()

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
        return "ros1msg" if self.encoding == ROS1 else "jsonschema"


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


def _json_channel(topic: str, type_name: str, properties: dict[str, str]) -> Channel:
    schema = {
        "title": type_name,
        "type": "object",
        "properties": {name: {"type": kind} for name, kind in properties.items()},
    }
    return Channel(topic, JSON, type_name, json.dumps(schema))


EVENTS = _json_channel(EVENTS_TOPIC, "hostlink.Event", {"kind": "string", "robot": "string", "facts": "object"})
LOG = _json_channel(LOG_TOPIC, "hostlink.LogLine", {"event": "string", "level": "string"})
PARAMETERS = _json_channel(PARAMETERS_TOPIC, "hostlink.Parameters", {})


def note_newest(channels: dict[Channel, None], channel: Channel, most: int) -> None:
    """Put a channel last, also one that is there already; over `most` the first goes."""
    channels.pop(channel, None)
    channels[channel] = None
    if len(channels) > most:
        del channels[next(iter(channels))]
