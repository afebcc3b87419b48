"""A recording as a bag of ROS 1, or of ROS 2: rosbags writes both, and converts payloads between them."""

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

from hostlink.errors import BadPayload, RecordingFailed
from hostlink.recording.channel import (
    CDR,
    JSON,
    NS_PER_S,
    ROS1,
    TEXT_DEFINITION,
    TEXT_MD5,
    TEXT_TYPE,
    Channel,
    as_text,
)
from hostlink.recording.definitions import ros1_type, ros2_name, ros2_type
from hostlink.recording.export import Exported, check_done, chosen_channels, new_output
from hostlink.recording.source import Source

_VERSION: Final = 9  # of rosbag2's metadata, since Iron
Convert = Callable[[bytes], bytes]


class RosFormat(Enum):
    """What is written."""

    ROS1 = "ros1"  # a file .bag
    ROS2_MCAP = "ros2"  # a folder with an MCAP file of CDR, as `ros2 bag record` makes it
    ROS2_SQLITE = "rosbag2"  # a folder with a .db3 file


def export_ros(
    source: Source, path: Path, format_: RosFormat, *, topics: Iterable[str] = (), skips_unknown: bool = False
) -> Exported:
    """Write a new bag; a failure leaves nothing of it.

    `topics`: names or patterns, none: all; `skips_unknown`: topics that cannot be converted are left out.

    Raises:
        OSError: of the file or folder, or it is there already.
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
    except sqlite3.Error as error:  # the disk is full, most of all
        raise OSError(str(error)) from error
    return done


def _export(source: Source, bag: "_Ros1 | _Ros2", channels: set[Channel], done: Exported) -> None:
    opened: dict[Channel, tuple[Any, Convert]] = {}
    for message in source.messages(lambda channel: channel in channels):
        channel = message.channel
        if channel not in opened:
            opened[channel] = bag.open(channel)
        connection, convert = opened[channel]
        if message.stamp_ns > bag.last_ns:
            reason = f"it came {message.stamp_ns} ns after 1970, a time that a bag lacks"
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
    """Payloads of ROS 1 as they are, others converted."""

    last_ns: Final = 2**32 * NS_PER_S - 1  # in 2106

    def __init__(self, writer: Ros1Writer) -> None:
        self._writer = writer
        self._chunks = 1
        self._connections: dict[tuple[object, ...], Any] = {}

    def open(self, channel: Channel) -> tuple[Any, Convert]:
        """The connection in the bag, and how payloads are converted."""
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
        """Add a message."""
        self._writer.write(connection, stamp_ns, payload)
        chunks = self._writer.chunks
        if len(chunks) > self._chunks:  # of one that was written only the number of its messages is still needed
            for number, messages in chunks[-2].connections.items():
                chunks[-2].connections[number] = range(len(messages))  # type: ignore[assignment]
            self._chunks = len(chunks)


class _Ros2:
    """Payloads in CDR as they are, others converted."""

    last_ns: Final = 2**63 - 1

    def __init__(self, writer: Ros2Writer) -> None:
        self._writer = writer
        self._text_store = get_typestore(Stores.ROS2_KILTED)
        self._connections: dict[tuple[object, ...], Any] = {}

    def open(self, channel: Channel) -> tuple[Any, Convert]:
        """The connection in the bag, and how payloads are converted."""
        if channel.encoding == JSON:
            return self._add(channel.topic, ros2_name(TEXT_TYPE), self._text_store, ""), self._text
        type_ = ros2_type(channel)
        qos = dict(channel.metadata).get("offered_qos_profiles", "")
        connection = self._add(channel.topic, type_.name, type_.store, qos)
        if channel.encoding == CDR:
            return connection, _checked(type_.check_cdr)
        decode = ros1_type(channel).decode  # what is not a message would take rosbags hours, or all of the memory
        return connection, _checked(decode, type_.from_ros1)

    def write(self, connection: Any, stamp_ns: int, payload: bytes) -> None:
        """Add a message."""
        self._writer.write(connection, stamp_ns, payload)

    def _add(self, topic: str, name: str, store: Any, qos: str) -> Any:
        try:
            profiles = parse_qos(qos)
        except Exception as error:
            raise RecordingFailed(f"{topic}: its QoS is not readable: {error}") from error
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
    """`convert`, after `check` has raised BadPayload for what is not a message."""

    def convert_checked(payload: bytes) -> bytes:
        check(payload)
        return convert(payload)

    return convert_checked
