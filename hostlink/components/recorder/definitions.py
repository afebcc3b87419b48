"""Types of a recording's channels: ROS 1 by the definition in the file, ROS 2 by rosbags if it is installed."""

import importlib.util
from typing import TYPE_CHECKING

from hostlink.components.recorder.channel import CDR, ROS1, Channel
from hostlink.core.messages.catalog import read_full_definition
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import ConfigError, LibraryMissing, UnknownFormat

if TYPE_CHECKING:
    from hostlink.components.recorder.ros2_definitions import Ros2Type

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


def ros2_type(channel: Channel) -> "Ros2Type":
    """Return the ROS 2 type of a channel with ROS 1 or CDR payloads.

    Raises:
        UnknownFormat: the channel has another encoding, or no readable definition, or rosbags is not installed.
    """
    if channel.encoding not in (ROS1, CDR):
        raise UnknownFormat(encoding_of(channel))
    try:
        need_rosbags(channel.topic)
    except LibraryMissing as error:
        raise UnknownFormat(error.problem) from None
    from hostlink.components.recorder.ros2_definitions import built_type  # noqa: PLC0415 - of the extra `export`

    return built_type(channel)


def need_rosbags(where: str) -> None:
    """Check that rosbags is installed.

    Raises:
        LibraryMissing: it is not.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise LibraryMissing(where, "rosbags", "export")


def why_unknown(channel: Channel) -> str:
    """Return why hostlink cannot convert the messages of a channel; empty if it can."""
    try:
        if not channel.content and channel.encoding != "json":
            if channel.encoding == ROS1 and importlib.util.find_spec("rosbags") is None:
                ros1_type(channel)  # which is enough for tables; an export to a bag is refused before
            else:
                ros2_type(channel)
    except UnknownFormat as error:
        return str(error)
    return ""


def encoding_of(channel: Channel) -> str:
    schema = f", its schema encoding is {channel.schema_encoding!r}" if channel.schema_encoding else ""
    return f"its message encoding is {channel.encoding!r}{schema}; hostlink reads ros1, cdr and json"
