"""A recording as tables of text: one CSV file a topic, one line a message."""

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hostlink.recording.reader import Reader
from hostlink.recording.tables import Decoders, flat

MAX_ARRAY = 64  # elements of an array that have columns of their own; more are one column, as JSON
_TIME = "time_s"  # since the epoch, when the message arrived
NS_PER_S = 1_000_000_000


def export_csv(reader: Reader, folder: Path) -> dict[str, int]:
    """Write the tables into a new folder; returns how many lines each file has.

    The columns of a topic are those of its first message. What cannot be decoded is left out.

    Raises:
        OSError: of the folder.
        RecordingFailed: the recording cannot be read.
    """
    folder.mkdir()
    files: dict[str, _File] = {}
    decoders = Decoders()
    try:
        for message in reader.messages():
            fields = decoders.decode(message)
            if fields is not None:
                topic = message.channel.topic
                if topic not in files:
                    files[topic] = _File(folder / f"{file_name(topic)}.csv")
                files[topic].add(message.stamp_ns, dict(_cells(fields)))
    finally:
        for file in files.values():
            file.close()
    return {file.path.name: file.lines for file in files.values()}


def file_name(topic: str) -> str:
    """Of a topic: /robot_0/odometry is robot_0.odometry."""
    return re.sub(r"[^A-Za-z0-9_.-]", ".", topic.strip("/")) or "topic"


def _cells(fields: dict[str, Any]) -> Iterator[tuple[str, object]]:
    for path, value in flat(fields):
        if isinstance(value, list) and len(value) <= MAX_ARRAY and not any(isinstance(each, dict) for each in value):
            yield from ((f"{path}[{number}]", each) for number, each in enumerate(value))
        else:
            yield path, value


class _File:
    def __init__(self, path: Path) -> None:
        self.path, self.lines = path, 0
        self._file = path.open("x", newline="", encoding="utf-8")
        self._writer: csv.DictWriter[str] | None = None

    def add(self, stamp_ns: int, cells: dict[str, object]) -> None:
        if self._writer is None:
            self._writer = csv.DictWriter(self._file, [_TIME, *cells], restval="", extrasaction="ignore")
            self._writer.writeheader()
        seconds, rest_ns = divmod(stamp_ns, NS_PER_S)
        self._writer.writerow({_TIME: f"{seconds}.{rest_ns:09d}", **cells})
        self.lines += 1

    def close(self) -> None:
        self._file.close()
