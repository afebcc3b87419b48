"""Export of recordings to bags of ROS 1 and ROS 2, by rosbags, which the extra `export` installs."""

import sqlite3
from collections.abc import Callable, Iterable
from enum import Enum
from pathlib import Path
from typing import Any, Final

from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from hostlink.components.recorder.channel import (
    CDR,
    JSON,
    ROS1,
    TEXT_DEFINITION,
    TEXT_MD5,
    TEXT_TYPE,
    Channel,
    as_text,
)
from hostlink.components.recorder.definitions import ros2_type
from hostlink.components.recorder.export import Exported, check_done, chosen_channels, new_output
from hostlink.components.recorder.reader import RecordingSource
from hostlink.components.recorder.ros1_definitions import ros1_type, ros2_name
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, RecordingFailed

_VERSION: Final = 9  # version of rosbag2's metadata, since Iron
Convert = Callable[[bytes], bytes]


class RosFormat(Enum):
    """Output format."""

    ROS1 = "ros1"  # a .bag file
    ROS2_MCAP = "ros2"  # a folder with an MCAP file of CDR, as `ros2 bag record` writes it
    ROS2_SQLITE = "rosbag2"  # a folder with a .db3 file


def export_ros(
    source: RecordingSource, path: Path, format_: RosFormat, *, topics: Iterable[str] = (), skips_unknown: bool = False
) -> Exported:
    """Write a new bag. After a failure nothing is left of it.

    `topics`: names or patterns, empty for all; `skips_unknown`: topics that cannot be converted are omitted.

    Raises:
        OSError: the file or folder exists or cannot be written.
        RecordingFailed: the recording cannot be read, or has nothing to export.
        UnknownFormat: it has topics that cannot be converted; nothing was written.
    """
    done = Exported()
    channels = chosen_channels(source.path, topics, done, skips_unknown=skips_unknown)
    try:
        with new_output(path):
            if format_ is RosFormat.ROS1:
                with Ros1Writer(path) as ros1:
                    _export(source, _Ros1(ros1), channels, done)
            else:
                plugin = StoragePlugin.MCAP if format_ is RosFormat.ROS2_MCAP else StoragePlugin.SQLITE3
                with Ros2Writer(path, version=_VERSION, storage_plugin=plugin) as ros2:
                    _export(source, _Ros2(ros2), channels, done)
    except sqlite3.Error as error:  # mostly a full disk
        raise OSError(str(error)) from error
    return done


def _export(source: RecordingSource, bag: "_Ros1 | _Ros2", channels: set[Channel], done: Exported) -> None:
    opened: dict[Channel, tuple[Any, Convert]] = {}
    for message in source.messages(lambda channel: channel in channels):
        channel = message.channel
        if channel not in opened:
            opened[channel] = bag.open(channel)
        connection, convert = opened[channel]
        if message.stamp_ns > bag.last_ns:
            reason = f"its time, {message.stamp_ns} ns since 1970, is outside the range of a bag"
            done.leave_out(channel.topic, BadPayload(channel.type_name, reason))
            continue
        try:
            payload = convert(message.payload)
        except BadPayload as error:
            done.leave_out(channel.topic, error)
            continue
        bag.write(connection, message.stamp_ns, payload)
        done.messages += 1
    check_done(source, done)


class _Ros1:
    """ROS 1 bag: ROS 1 payloads are copied, others converted."""

    last_ns: Final = 2**32 * NS_PER_S - 1  # in 2106

    def __init__(self, writer: Ros1Writer) -> None:
        self._writer = writer
        self._chunks = 1
        self._connections: dict[tuple[object, ...], Any] = {}

    def open(self, channel: Channel) -> tuple[Any, Convert]:
        """Return the bag's connection for a channel, and its payload conversion."""
        facts = dict(channel.metadata)
        convert: Convert = _as_is
        if channel.encoding == JSON:
            name, definition, md5, convert = TEXT_TYPE, TEXT_DEFINITION, TEXT_MD5, as_text
        elif channel.encoding == ROS1:
            name, definition = channel.type_name, channel.schema
            md5 = facts.get("md5sum") or ros1_type(channel).md5
        else:
            type_ = ros2_type(channel)
            name, convert = channel.type_name, type_.to_ros1
            definition, md5 = type_.ros1_definition()
        caller, latching = facts.get("callerid") or None, int(facts.get("latching") == "1")
        key = channel.topic, ros2_name(name), definition, md5, caller, latching
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(
                channel.topic, ros2_name(name), msgdef=definition, md5sum=md5, callerid=caller, latching=latching
            )
        return self._connections[key], convert

    def write(self, connection: Any, stamp_ns: int, payload: bytes) -> None:
        self._writer.write(connection, stamp_ns, payload)
        chunks = self._writer.chunks
        if len(chunks) > self._chunks:  # of a written chunk only the number of messages is still needed
            for number, messages in chunks[-2].connections.items():
                chunks[-2].connections[number] = range(len(messages))  # type: ignore[assignment]
            self._chunks = len(chunks)


class _Ros2:
    """ROS 2 bag: CDR payloads are copied, others converted."""

    last_ns: Final = 2**63 - 1

    def __init__(self, writer: Ros2Writer) -> None:
        self._writer = writer
        self._text_store = get_typestore(Stores.ROS2_KILTED)
        self._connections: dict[tuple[object, ...], Any] = {}

    def open(self, channel: Channel) -> tuple[Any, Convert]:
        """Return the bag's connection for a channel, and its payload conversion."""
        if channel.encoding == JSON:
            return self._add(channel.topic, ros2_name(TEXT_TYPE), self._text_store, ""), self._text
        type_ = ros2_type(channel)
        qos = dict(channel.metadata).get("offered_qos_profiles", "")
        connection = self._add(channel.topic, type_.name, type_.store, qos)
        if channel.encoding == CDR:
            return connection, _checked(type_.decode)
        decode = ros1_type(channel).decode  # rosbags would take hours, or all memory, for an invalid message
        return connection, _checked(decode, type_.from_ros1)

    def write(self, connection: Any, stamp_ns: int, payload: bytes) -> None:
        self._writer.write(connection, stamp_ns, payload)

    def _add(self, topic: str, name: str, store: Any, qos: str) -> Any:
        try:
            profiles = parse_qos(qos)
        except Exception as error:
            raise RecordingFailed(f"{topic}: its QoS profile cannot be read: {error}") from error
        key = topic, name, qos
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(
                topic, name, typestore=store, offered_qos_profiles=profiles
            )
        return self._connections[key]

    def _text(self, payload: bytes) -> bytes:
        return bytes(self._text_store.ros1_to_cdr(as_text(payload), ros2_name(TEXT_TYPE)))


def _as_is(payload: bytes) -> bytes:
    return payload


def _checked(check: Callable[[bytes], object], convert: Convert = _as_is) -> Convert:
    """Return a conversion that first calls `check`, which raises BadPayload for an invalid message."""

    def convert_checked(payload: bytes) -> bytes:
        check(payload)
        return convert(payload)

    return convert_checked
