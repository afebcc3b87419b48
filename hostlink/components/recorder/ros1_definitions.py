"""Types of channels with ROS 1 payloads, by the definition in the recording, and names of types in ROS 2."""

from hostlink.components.recorder.channel import ROS1, Channel
from hostlink.core.messages.catalog import read_full_definition
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import ConfigError, UnknownFormat

MAX_REASON = 200  # characters of a library's error text


def ros2_name(type_name: str) -> str:
    """Convert a type name to the form of ROS 2 and rosbags: geometry_msgs/msg/Pose2D."""
    package, _, base = type_name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{base}"


def ros1_type(channel: Channel) -> MessageType:
    """Return the type of a channel with ROS 1 payloads.

    Raises:
        UnknownFormat: the channel has another encoding, or no definition.
    """
    if channel.encoding != ROS1 or channel.schema_encoding != "ros1msg":
        raise UnknownFormat(encoding_of(channel))
    if not channel.schema and channel.type_name != "std_msgs/Empty":
        raise UnknownFormat(f"the recording has no definition of {channel.type_name or 'its type'}")
    try:
        return read_full_definition(channel.type_name, channel.schema)
    except ConfigError as error:
        raise UnknownFormat(f"the definition of {channel.type_name} cannot be read: {error}"[:MAX_REASON]) from error


def encoding_of(channel: Channel) -> str:
    schema = f", its schema encoding is {channel.schema_encoding!r}" if channel.schema_encoding else ""
    return f"its message encoding is {channel.encoding!r}{schema}; hostlink reads ros1, cdr and json"
