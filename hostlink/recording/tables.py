"""Tables: a recording as numpy arrays, a table a topic, a column a field."""

import array
import itertools
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hostlink.errors import BadPayload, ConfigError
from hostlink.messages.full_definition import read_full_definition
from hostlink.messages.message_type import MessageType
from hostlink.recording.channel import NS_PER_S, ROS1, Channel
from hostlink.recording.reader import Reader, StoredMessage

Column = NDArray[Any]
MAX_DEPTH = 64  # of messages in messages, and lists in lists
MAX_COLUMNS = 2048  # of a table; JSON may have other fields in each message
MAX_PART = 2**32  # of a time: its seconds, its nanoseconds
MAX_STAMP_NS = 2**63 - 1  # of numpy's int64; the format has twice that


class Table(Mapping[str, Column]):
    """The messages of one topic, N of them.

    `table["pose.position.x"]` is an array of N numbers, of N x M where the field is an array of M, and of N objects
    where it is a text or has no fixed length. `time_s` (N, float64) counts from the beginning of the recording. JSON
    with ever new fields has the first MAX_COLUMNS of them.
    """

    def __init__(
        self, topic: str, type_name: str, columns: "dict[str, Column | _Values]", stamp_ns: Column, begin_ns: int
    ) -> None:
        self.topic, self.type_name = topic, type_name
        self.stamp_ns: NDArray[np.int64] = stamp_ns
        self.time_s: NDArray[np.float64] = (stamp_ns - min(begin_ns, MAX_STAMP_NS)) / NS_PER_S
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


class Tables(Mapping[str, Table]):
    """The tables of a recording, by topic.

    `damage` says what of the file could not be read; `undecoded` counts the messages that nobody could, by topic.
    """

    def __init__(self, tables: dict[str, Table], reader: Reader, undecoded: dict[str, int]) -> None:
        self.metadata, self.damage, self.undecoded = reader.metadata, reader.damage, undecoded
        self._tables = tables

    def __getitem__(self, topic: str) -> Table:
        try:
            return self._tables[topic]
        except KeyError:
            raise KeyError(f"no topic {topic}; there are: {', '.join(self)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __repr__(self) -> str:
        return "\n".join(map(repr, self._tables.values()))


def read(path: str | Path, topics: tuple[str, ...] = ()) -> Tables:
    """Read a recording, also one that was never finished; of these topics alone, if any are named.

    Raises:
        RecordingFailed: the file cannot be read, or is no recording.
    """
    reader = Reader(Path(path))
    found: dict[str, _Rows] = {}
    begin_ns: int | None = None
    for message in reader.messages():
        begin_ns = message.stamp_ns if begin_ns is None else min(begin_ns, message.stamp_ns)
        topic = message.channel.topic
        if not topics or topic in topics:
            rows = found.get(topic)
            if rows is None:
                rows = found[topic] = _Rows()
            rows.add(message)
    tables = {topic: rows.table(begin_ns or 0) for topic, rows in sorted(found.items()) if rows.stamps_ns}
    return Tables(tables, reader, {topic: rows.undecoded for topic, rows in found.items() if rows.undecoded})


def flat(message: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(path, value) of every field that is no message; a time is seconds."""
    for name, value in message.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping) and _is_time(value):
            yield path, value["secs"] + value["nsecs"] / NS_PER_S
        elif isinstance(value, Mapping):
            yield from flat(value, f"{path}.")
        else:
            yield path, value


def _is_time(value: Mapping[str, Any]) -> bool:
    """By its fields and what they are: JSON may have anything in them."""
    return value.keys() == {"secs", "nsecs"} and all(
        isinstance(part, int) and abs(part) < MAX_PART for part in value.values()
    )


def _is_deep(value: Any) -> bool:
    """Whether JSON is nested so that reading it would exhaust Python's stack; decoding it does so in some releases."""
    level = [value]
    for _ in range(MAX_DEPTH):
        inner = itertools.chain.from_iterable(each.values() if isinstance(each, dict) else each for each in level)
        level = [each for each in inner if isinstance(each, dict | list)]
        if not level:
            return False
    return True


class Decoders:
    """How the messages of each channel are decoded; what has no definition is not."""

    def __init__(self) -> None:
        self._types: dict[Channel, MessageType | None] = {}

    def decode(self, message: StoredMessage) -> dict[str, Any] | None:
        """The fields; None: nobody can decode it."""
        channel = message.channel
        try:
            if channel.encoding != ROS1:
                found = json.loads(message.payload)
                return found if isinstance(found, dict) and not _is_deep(found) else None
            if channel not in self._types:
                schema = channel.schema
                self._types[channel] = read_full_definition(channel.type_name, schema) if schema else None
            type_ = self._types[channel]
            return None if type_ is None else type_.decode(message.payload)
        except ConfigError:
            self._types[channel] = None
        except (BadPayload, ValueError, RecursionError):  # JSON in JSON, without end
            return None
        return None


class _Values:
    """Of one field: the messages that have it. As long as the table it is while somebody reads it, not before."""

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
        self.stamps_ns: list[int] = []
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
            if values is None and len(self._values) < MAX_COLUMNS:  # JSON has other fields each time
                values = self._values[path] = _Values()
            if values is not None:
                values.add(len(self.stamps_ns), value)
        self.stamps_ns.append(min(message.stamp_ns, MAX_STAMP_NS))

    def table(self, begin_ns: int) -> Table:
        length = len(self.stamps_ns)
        columns = {
            path: values.column(length) if values.is_complete(length) else values
            for path, values in self._values.items()
        }
        return Table(self._topic, self._type_name, columns, np.array(self.stamps_ns, dtype=np.int64), begin_ns)


def _column(values: list[Any]) -> Column:
    """Numbers where all are; else objects."""
    is_regular = len({len(value) for value in values if isinstance(value, list)}) <= 1
    if is_regular and None not in values:
        try:
            found = np.array(values)
        except (ValueError, OverflowError):  # lists in lists, of several lengths
            found = np.empty(0)
        if found.dtype.kind in "biuf" and len(found) == len(values):
            return found
    objects = np.empty(len(values), dtype=object)
    objects[:] = values
    return objects
