"""Source: any recording that hostlink reads: an MCAP file, a ROS 1 bag, a folder or file of rosbag2."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

from hostlink.errors import RecordingFailed
from hostlink.recording.channel import CDR, NS_PER_S, ROS1, Channel
from hostlink.recording.reader import Reader, StoredMessage, Wanted

ROS1_SUFFIX, ROS2_SUFFIX = ".bag", ".db3"
MAX_REASON = 200  # characters of a library's error text
_NEVER = 2**64


class Source(Protocol):
    """Recording that can be read once."""

    path: Path
    metadata: dict[str, str]

    def messages(self, wanted: Wanted | None = None, *, after_s: float = 0.0) -> Iterator[StoredMessage]:
        """See `Reader.messages`."""
        ...

    def read_channels(self) -> list[Channel]:
        """See `Reader.read_channels`."""
        ...

    @property
    def channels(self) -> list[Channel]:
        """See `Reader.channels`."""
        ...

    @property
    def damage(self) -> list[str]:
        """See `Reader.damage`."""
        ...

    @property
    def begin_ns(self) -> int:
        """See `Reader.begin_ns`."""
        ...

    @property
    def size_bytes(self) -> int:
        """Size of all files of the recording."""
        ...


def open_source(path: Path) -> Source:
    """Choose the reader by name. The file itself is opened when it is read."""
    is_bag = path.is_dir() or path.suffix in (ROS1_SUFFIX, ROS2_SUFFIX)
    return BagReader(path) if is_bag else Reader(path)


class BagReader:
    """Reader of a ROS 1 or ROS 2 bag, by rosbags."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, str] = {}
        self.damage: list[str] = []
        self.channels: list[Channel] = []
        self._begin_ns = _NEVER

    @property
    def begin_ns(self) -> int:
        """Time of the bag's first message; 0 before it was read."""
        return 0 if self._begin_ns == _NEVER else self._begin_ns

    @property
    def size_bytes(self) -> int:
        """Size of all files of the recording."""
        files = self.path.iterdir() if self.path.is_dir() else [self.path]
        return sum(file.stat().st_size for file in files if file.is_file())

    def read_channels(self) -> list[Channel]:
        """Return the channels that the bag lists.

        Raises:
            RecordingFailed: the bag cannot be read, or is not a bag.
        """
        with self._opened() as bag:
            self.channels = list(dict.fromkeys(map(_channel, bag.connections)))
        return self.channels

    def messages(self, wanted: Wanted | None = None, *, after_s: float = 0.0) -> Iterator[StoredMessage]:
        """Yield the messages ordered by time.

        Raises:
            RecordingFailed: the bag cannot be read, or is not a bag.
        """
        with self._opened() as bag:
            channels = {connection.id: _channel(connection) for connection in bag.connections}
            self.channels = list(dict.fromkeys(channels.values()))
            if bag.message_count:
                self._begin_ns = bag.start_time
            chosen = [each for each in bag.connections if wanted is None or wanted(channels[each.id])]
            start_ns = bag.start_time + int(after_s * NS_PER_S) if after_s else None
            found = bag.messages(chosen, start=start_ns) if chosen else iter(())
            try:
                for connection, stamp_ns, payload in found:
                    yield StoredMessage(channels[connection.id], stamp_ns, bytes(payload), stamp_ns)
            except Exception as error:  # noqa: BLE001 - rosbags' readers raise any exception for damaged bytes
                self.damage.append(f"unreadable after a part: {type(error).__name__}: {error}"[:MAX_REASON])

    def _opened(self) -> contextlib.AbstractContextManager[Any]:
        """Open the bag.

        Raises:
            RecordingFailed: the bag cannot be read, or is not a bag.
        """
        from rosbags.rosbag1 import Reader as Ros1Reader  # noqa: PLC0415 - most recordings are MCAP files
        from rosbags.rosbag2 import Reader as Ros2Reader  # noqa: PLC0415

        try:
            bag: Any = (Ros1Reader if self.path.suffix == ROS1_SUFFIX else Ros2Reader)(self.path)
            bag.open()
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror or error}") from error
        except Exception as error:
            raise RecordingFailed(f"{self.path} cannot be read: {error}"[:MAX_REASON]) from error
        return contextlib.closing(bag)


def _channel(connection: Any) -> Channel:
    from rosbags.interfaces import ConnectionExtRosbag1, MessageDefinitionFormat  # noqa: PLC0415 - as above
    from rosbags.rosbag2.metadata import dump_qos_v8  # noqa: PLC0415

    definition, extra = connection.msgdef, connection.ext
    if isinstance(extra, ConnectionExtRosbag1):
        package, _, base = connection.msgtype.partition("/msg/")
        facts = {"callerid": extra.callerid or "", "md5sum": connection.digest, "latching": str(extra.latching or 0)}
        return Channel(connection.topic, ROS1, f"{package}/{base}", definition.data, tuple(facts.items()))
    language = "ros2idl" if definition.format == MessageDefinitionFormat.IDL else ""
    qos = (("offered_qos_profiles", dump_qos_v8(extra.offered_qos_profiles)),) if extra.offered_qos_profiles else ()
    encoding = CDR if extra.serialization_format == "cdr" else extra.serialization_format
    return Channel(connection.topic, encoding, connection.msgtype, definition.data, qos, language)
