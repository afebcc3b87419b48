"""Tables: a recording as numpy arrays, with one table for each topic and one column for each field."""

import array
import functools
import itertools
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hostlink.components.recorder.channel import JSON, ROS1, Channel, json_of
from hostlink.components.recorder.definitions import ros2_type
from hostlink.components.recorder.reader import RecordingSource, StoredMessage, open_source
from hostlink.components.recorder.ros1_definitions import ros1_type
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, UnknownFormat

Column = NDArray[Any]
Decode = Callable[[bytes], dict[str, Any]]
MAX_DEPTH = 64  # nesting of messages and lists
MAX_COLUMNS = 2048  # of one table; JSON messages may have varying fields
MAX_PART = 2**32  # of the seconds or nanoseconds of a time
MAX_STAMP_NS = 2**63 - 1  # limit of numpy's int64; the format allows twice that


class Table(Mapping[str, Column]):
    """Messages of one topic, N of them.

    `table["pose.position.x"]` is an array of N numbers, of N x M if the field is an array of M, and of N objects if it
    is a string or has no fixed length. `time_s` (N, float64) counts from the beginning of the recording, by a clock
    that is never set. `stamp_ns` (N, int64) is wall time. JSON with varying fields has the first MAX_COLUMNS of them.
    """

    def __init__(
        self,
        topic: str,
        type_name: str,
        columns: "dict[str, Column | _Values]",
        stamp_ns: Column,
        steady_ns: Column,
        begin_ns: int,
    ) -> None:
        self.topic, self.type_name = topic, type_name
        self.stamp_ns: NDArray[np.int64] = stamp_ns
        self.time_s: NDArray[np.float64] = (steady_ns - min(begin_ns, MAX_STAMP_NS)) / NS_PER_S
        self._columns = columns

    def __getitem__(self, field: str) -> Column:
        found = self._columns[field]
        return found.column(len(self.stamp_ns)) if isinstance(found, _Values) else found

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        return f"<{self.topic}: {len(self.stamp_ns)} {self.type_name}, fields {', '.join(self) or 'none'}>"


class Tables(dict[str, Table]):
    """Tables of a recording, by topic.

    `damage` describes the unreadable parts of the file. `undecoded` counts the messages that could not be decoded, by
    topic.
    """

    def __init__(self, tables: dict[str, Table], source: RecordingSource, undecoded: dict[str, int]) -> None:
        super().__init__(tables)
        self.metadata, self.damage, self.undecoded = source.metadata, source.damage, undecoded

    def __missing__(self, topic: str) -> Table:
        raise KeyError(f"no topic {topic}; available: {', '.join(self)}")

    def __repr__(self) -> str:
        return "\n".join(map(repr, self.values()))


def read(path: str | Path, topics: tuple[str, ...] = ()) -> Tables:
    """Read a recording, also an unfinished one; only the named topics, if there are any.

    `path` is an MCAP file, a ROS 1 bag, or a folder or file of rosbag2.

    Raises:
        RecordingFailed: the file cannot be read, or is not a recording.
    """
    source = open_source(Path(path))
    found: dict[str, _Rows] = {}
    for message in source.messages(lambda channel: not topics or channel.topic in topics):
        topic = message.channel.topic
        rows = found.get(topic)
        if rows is None:
            rows = found[topic] = _Rows()
        rows.add(message)
    tables = {topic: rows.table(source.begin_ns) for topic, rows in sorted(found.items()) if rows.stamps_ns}
    return Tables(tables, source, {topic: rows.undecoded for topic, rows in found.items() if rows.undecoded})


def flat(message: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of every field that is not a message. A time becomes seconds."""
    for name, value in message.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping) and _is_time(value):
            yield path, value["secs"] + value["nsecs"] / NS_PER_S
        elif isinstance(value, Mapping):
            yield from flat(value, f"{path}.")
        else:
            yield path, value


def _is_time(value: Mapping[str, Any]) -> bool:
    """Whether the value is a time, by its fields and their values, because JSON may contain anything."""
    return value.keys() == {"secs", "nsecs"} and all(
        isinstance(part, int) and abs(part) < MAX_PART for part in value.values()
    )


def _is_deep(value: Any) -> bool:
    """Whether JSON is nested so deeply that reading it would exhaust Python's stack. Some releases can decode it."""
    level = [value]
    for _ in range(MAX_DEPTH):
        inner = itertools.chain.from_iterable(each.values() if isinstance(each, dict) else each for each in level)
        level = [each for each in inner if isinstance(each, dict | list)]
        if not level:
            return False
    return True


class Decoders:
    """Decoders of the messages of each channel."""

    def __init__(self) -> None:
        self._found: dict[Channel, Decode | None] = {}

    def decode(self, message: StoredMessage) -> dict[str, Any] | None:
        """Decode a message to its fields; None if the channel or the message cannot be decoded."""
        channel = message.channel
        if channel not in self._found:
            try:
                self._found[channel] = decoder_of(channel)
            except UnknownFormat:
                self._found[channel] = None
        decode = self._found[channel]
        try:
            return None if decode is None else decode(message.payload)
        except BadPayload:
            return None


def decoder_of(channel: Channel) -> Decode:
    """Return the function that decodes the channel's messages to fields.

    Raises:
        UnknownFormat: hostlink cannot read them; the text says why.
    """
    if channel.content or channel.encoding == JSON:
        return functools.partial(_decode_json, channel)
    if channel.encoding == ROS1:
        return ros1_type(channel).decode
    return ros2_type(channel).decode


def _decode_json(channel: Channel, payload: bytes) -> dict[str, Any]:
    """Decode a JSON object.

    Raises:
        BadPayload: the payload is not a JSON object, or is nested too deeply.
    """
    try:
        found = json.loads(json_of(channel, payload))
    except (ValueError, RecursionError) as error:  # endlessly nested JSON
        raise BadPayload(channel.type_name, str(error)) from None
    if not isinstance(found, dict) or _is_deep(found):
        raise BadPayload(channel.type_name, "it is not JSON of an object")
    return found


class _Values:
    """Values of one field, for the messages that have it. The full column is built only when it is read."""

    def __init__(self) -> None:
        self._rows = array.array("Q")
        self._values: list[Any] = []

    def add(self, row: int, value: object) -> None:
        self._rows.append(row)
        self._values.append(value)

    def is_complete(self, length: int) -> bool:
        return len(self._values) == length

    def column(self, length: int) -> Column:
        if self.is_complete(length):
            return _column(self._values)
        objects = np.empty(length, dtype=object)
        for row, value in zip(self._rows, self._values, strict=True):
            objects[row] = value
        return objects


class _Rows:
    def __init__(self) -> None:
        self.stamps_ns, self.steady_ns = array.array("q"), array.array("q")
        self.undecoded = 0
        self._decoders = Decoders()
        self._type_name = self._topic = ""
        self._values: dict[str, _Values] = {}

    def add(self, message: StoredMessage) -> None:
        fields = self._decoders.decode(message)
        if fields is None:
            self.undecoded += 1
            return
        self._topic, self._type_name = message.channel.topic, message.channel.type_name
        for path, value in dict(flat(fields)).items():
            values = self._values.get(path)
            if values is None and len(self._values) < MAX_COLUMNS:  # JSON messages may have varying fields
                values = self._values[path] = _Values()
            if values is not None:
                values.add(len(self.stamps_ns), value)
        self.stamps_ns.append(min(message.stamp_ns, MAX_STAMP_NS))
        self.steady_ns.append(min(message.steady_ns, MAX_STAMP_NS))

    def table(self, begin_ns: int) -> Table:
        length = len(self.stamps_ns)
        columns = {
            path: values.column(length) if values.is_complete(length) else values
            for path, values in self._values.items()
        }
        stamp_ns, steady_ns = (np.array(each, dtype=np.int64) for each in (self.stamps_ns, self.steady_ns))
        return Table(self._topic, self._type_name, columns, stamp_ns, steady_ns, begin_ns)


def _column(values: list[Any]) -> Column:
    """Build a column of numbers if all values are numbers, otherwise of objects."""
    is_regular = len({len(value) for value in values if isinstance(value, list)}) <= 1
    if is_regular and None not in values:
        try:
            found = np.array(values)
        except (ValueError, OverflowError):  # nested lists of different lengths
            found = np.empty(0)
        if found.dtype.kind in "biuf" and len(found) == len(values):
            return found
    objects = np.empty(len(values), dtype=object)
    objects[:] = values
    return objects
