"""Types of a recording's channels: ROS 1 by the definition in the file, ROS 2 by rosbags if it is installed."""

import importlib.util
from typing import TYPE_CHECKING

from hostlink.components.recorder.channel import CDR, ROS1, Channel
from hostlink.components.recorder.ros1_definitions import encoding_of, ros1_type
from hostlink.errors import LibraryMissing, UnknownFormat

if TYPE_CHECKING:
    from hostlink.components.recorder.ros2_definitions import Ros2Type


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
