"""A recording as a bag of ROS 1, or of ROS 2: rosbags writes both, and converts what ROS 2 has otherwise."""

import sqlite3
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Final

from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hostlink.messages.full_definition import read_full_definition
from hostlink.messages.message_type import MessageType
from hostlink.recording.channel import ROS1, Channel
from hostlink.recording.reader import Reader, StoredMessage

TEXT_TYPE = "std_msgs/String"  # in which ROS has hostlink's own JSON
_VERSION: Final = 9  # of rosbag2's metadata, since Iron


class RosFormat(Enum):
    """What is written."""

    ROS1 = "ros1"  # a file .bag
    ROS2_MCAP = "ros2"  # a folder with an MCAP file of CDR, as `ros2 bag record` makes it
    ROS2_SQLITE = "rosbag2"  # a folder with a .db3 file


@dataclass(slots=True)
class Exported:
    """What became of a recording's messages."""

    messages: int = 0
    left_out: dict[str, str] = field(default_factory=dict)  # topics, and why


def export_ros(reader: Reader, path: Path, format_: RosFormat) -> Exported:
    """Write a new bag.

    Raises:
        OSError: of the file or folder; rosbags' WriterError: it is there already.
        RecordingFailed: the recording cannot be read.
    """
    if format_ is RosFormat.ROS1:
        with Ros1Writer(path) as ros1:
            return _export(reader, _Ros1(ros1))
    plugin = StoragePlugin.MCAP if format_ is RosFormat.ROS2_MCAP else StoragePlugin.SQLITE3
    try:
        with Ros2Writer(path, version=_VERSION, storage_plugin=plugin) as ros2:
            return _export(reader, _Ros2(ros2))
    except sqlite3.Error as error:  # the disk is full, most of all
        raise OSError(str(error)) from error


class _Ros1:
    """Payloads as they are."""

    def __init__(self, writer: Ros1Writer) -> None:
        self._writer = writer
        self._store = get_typestore(Stores.ROS1_NOETIC)

    def open(self, channel: Channel) -> Any:
        name = _ros2_name(channel.type_name)
        if channel.encoding != ROS1:
            return self._writer.add_connection(channel.topic, _ros2_name(TEXT_TYPE), typestore=self._store)
        facts = dict(channel.metadata)
        return self._writer.add_connection(
            channel.topic,
            name,
            msgdef=channel.schema,
            md5sum=facts["md5sum"],
            callerid=facts.get("callerid"),
            latching=int(facts.get("latching", "0")),
        )

    def convert(self, payload: bytes, channel: Channel) -> bytes:
        del channel
        return payload

    def write(self, connection: Any, stamp_ns: int, payload: bytes) -> None:
        self._writer.write(connection, stamp_ns, payload)


class _Ros2:
    """Payloads as CDR. Types that ROS 2 has itself are ROS 2's; others are those of the recording."""

    def __init__(self, writer: Ros2Writer) -> None:
        self._writer = writer
        self._store = get_typestore(Stores.ROS2_KILTED)
        self._types: dict[Channel, MessageType] = {}

    def open(self, channel: Channel) -> Any:
        if channel.encoding == ROS1:
            self._type(channel)
        name = _ros2_name(channel.type_name if channel.encoding == ROS1 else TEXT_TYPE)
        if name not in self._store.fielddefs:
            types = get_types_from_msg(channel.schema, name)
            self._store.register({each: known for each, known in types.items() if each not in self._store.fielddefs})
        return self._writer.add_connection(channel.topic, name, typestore=self._store)

    def convert(self, payload: bytes, channel: Channel) -> bytes:
        if channel.encoding == ROS1:  # what is no message would take rosbags hours, or all of the memory
            self._type(channel).decode(payload)
        name = _ros2_name(channel.type_name if channel.encoding == ROS1 else TEXT_TYPE)
        return bytes(self._store.ros1_to_cdr(payload, name))

    def write(self, connection: Any, stamp_ns: int, payload: bytes) -> None:
        self._writer.write(connection, stamp_ns, payload)

    def _type(self, channel: Channel) -> MessageType:
        if channel not in self._types:
            self._types[channel] = read_full_definition(channel.type_name, channel.schema)
        return self._types[channel]


def _export(reader: Reader, bag: "_Ros1 | _Ros2") -> Exported:
    done = Exported()
    opened: dict[Channel, Any] = {}
    for message in reader.messages():
        channel = message.channel
        if channel.topic in done.left_out:
            continue
        if channel.encoding == ROS1 and not channel.schema:
            done.left_out[channel.topic] = f"nobody has a definition of {channel.type_name}"
            continue
        try:
            payload = bag.convert(_payload(message), channel) if channel in opened else None
            if payload is None:
                opened[channel] = bag.open(channel)
                payload = bag.convert(_payload(message), channel)
        except (OSError, sqlite3.Error):  # not the topic's fault, but the disk's
            raise
        except Exception as error:  # noqa: BLE001 - rosbags raises what it finds, for a definition or a payload that is none
            done.left_out[channel.topic] = f"{type(error).__name__}: {error}"
            continue
        bag.write(opened[channel], message.stamp_ns, payload)
        done.messages += 1
    return done


def _payload(message: StoredMessage) -> bytes:
    """JSON is a text of ROS 1: its length, then itself."""
    if message.channel.encoding == ROS1:
        return message.payload
    return len(message.payload).to_bytes(4, "little") + message.payload


def _ros2_name(type_name: str) -> str:
    """As rosbags names types of both."""
    package, _, base = type_name.partition("/")
    return f"{package}/msg/{base}"
