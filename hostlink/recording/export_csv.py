"""A recording as tables of text: one CSV file a topic, one line a message."""

import csv
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

from hostlink.errors import BadPayload
from hostlink.recording.channel import NS_PER_S, Channel
from hostlink.recording.export import Exported, check_done, chosen_channels, new_output
from hostlink.recording.source import Source, open_source
from hostlink.recording.tables import decoder_of, flat

MAX_ARRAY = 64  # elements of an array that have columns of their own; more are one column, as JSON
MAX_COLUMNS = 10_000  # of a file; JSON may have other fields in each message
MAX_OPEN_FILES = 128  # at once; a process may have 1024, or 256, and a hundred robots have more topics
_LONGEST_NAME = 200  # characters; a file's may have 255 bytes
_TIME = "time_s"  # since the epoch, when the message arrived

_Key = tuple[str, str]  # a topic may change its type


def export_csv(
    source: Source, folder: Path, *, topics: Iterable[str] = (), skips_unknown: bool = False
) -> tuple[Exported, dict[str, int]]:
    """Write the tables into a new folder; returns what became of the messages, and how many lines each file has.

    A topic has the columns of all its messages: the recording is read twice. A failure leaves no folder.
    `topics`: names or patterns, none: all; `skips_unknown`: topics that cannot be converted are left out.

    Raises:
        OSError: of the folder, or it is there already.
        RecordingFailed: the recording cannot be read, or has nothing to export.
        UnknownFormat: it has topics that cannot be converted; nothing was written.
    """
    done = Exported()
    channels = chosen_channels(source.path, topics, done, skips_unknown=skips_unknown)
    files: dict[_Key, _File] = {}
    opened: dict[_Key, _File] = {}  # the one that was written to last is the last
    names = _Names()
    columns = _columns(open_source(source.path), channels)
    with new_output(folder):
        folder.mkdir()
        try:
            for channel, stamp_ns, cells in _decoded(source, channels, done):
                key = _key(channel)
                if key not in files:
                    files[key] = _File(folder / f"{names.free(file_name(channel.topic))}.csv", columns[key])
                opened[key] = opened.pop(key, files[key])
                if len(opened) > MAX_OPEN_FILES:
                    opened.pop(next(iter(opened))).close()
                files[key].add(stamp_ns, cells)
                done.messages += 1
        finally:
            for file in opened.values():
                file.close()
        check_done(source, done)
    return done, {file.path.name: file.lines for file in files.values()}


def file_name(topic: str) -> str:
    """Of a topic: /robot_0/odometry is robot_0.odometry."""
    return re.sub(r"[^A-Za-z0-9_.-]", ".", topic.strip("/")).strip(".")[:_LONGEST_NAME] or "topic"


class _Names:
    """Those of a folder's files; on some disks a and A are one name."""

    def __init__(self) -> None:
        self._tries: Counter[str] = Counter()  # the names that are taken, too

    def free(self, name: str) -> str:
        """With a number, if another topic has it."""
        free, wanted = name, name.lower()
        while free.lower() in self._tries:
            self._tries[wanted] += 1
            free = f"{name}_{self._tries[wanted]}"
        self._tries[free.lower()] += 1
        return free


def _columns(source: Source, channels: set[Channel]) -> dict[_Key, list[str]]:
    found: dict[_Key, dict[str, None]] = {}
    for channel, _, cells in _decoded(source, channels, Exported()):
        of_topic = found.setdefault(_key(channel), {})
        if len(of_topic) < MAX_COLUMNS:
            of_topic.update(dict.fromkeys(cells))
    return {key: list(of_topic) for key, of_topic in found.items()}


def _decoded(
    source: Source, channels: set[Channel], done: Exported
) -> Iterator[tuple[Channel, int, dict[str, object]]]:
    decoders = {channel: decoder_of(channel) for channel in channels}
    for message in source.messages(lambda channel: channel in channels):
        try:
            fields = decoders[message.channel](message.payload)
        except BadPayload as error:
            done.leave_out(message.channel.topic, error)
            continue
        yield message.channel, message.stamp_ns, dict(_cells(fields))


def _key(channel: Channel) -> _Key:
    return channel.topic, channel.type_name


def _cells(fields: dict[str, Any]) -> Iterator[tuple[str, object]]:
    for path, value in flat(fields):
        if isinstance(value, list) and len(value) <= MAX_ARRAY and not any(isinstance(each, dict) for each in value):
            yield from ((f"{path}[{number}]", each) for number, each in enumerate(value))
        elif isinstance(value, (list, bytes)):
            yield path, json.dumps(value, default=list)
        else:
            yield path, value


class _File:
    def __init__(self, path: Path, columns: list[str]) -> None:
        self.path, self.lines = path, 0
        self._columns = [_TIME, *columns]
        self._file: IO[str] | None = None
        self._writer: csv.DictWriter[str] | None = None
        self._open("x").writeheader()

    def _open(self, mode: str) -> "csv.DictWriter[str]":
        file = self.path.open(mode, newline="", encoding="utf-8", errors="replace")  # JSON may have half a pair
        self._file, self._writer = file, csv.DictWriter(file, self._columns, restval="", extrasaction="ignore")
        return self._writer

    def add(self, stamp_ns: int, cells: dict[str, object]) -> None:
        writer = self._writer or self._open("a")
        seconds, rest_ns = divmod(stamp_ns, NS_PER_S)
        writer.writerow({_TIME: f"{seconds}.{rest_ns:09d}", **cells})
        self.lines += 1

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = self._writer = None  # with their buffers, 100 kB: thousands of files may be closed
