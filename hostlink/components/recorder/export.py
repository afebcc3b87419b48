"""Export of recordings to CSV, with a report of what is left out, as of every export."""

import contextlib
import csv
import fnmatch
import json
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from hostlink.components.recorder.channel import Channel
from hostlink.components.recorder.definitions import why_unknown
from hostlink.components.recorder.reader import RecordingSource, open_source
from hostlink.components.recorder.tables import decoder_of, flat
from hostlink.core.runtime.plain_text import csv_text
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, RecordingFailed, UnknownFormat

MAX_NAMED = 10  # topics named in a refusal
OF_TOOLS = ("/parameter_events", "/rosout")  # every node of ROS 2 publishes them for itself

MAX_ARRAY = 64  # elements of an array with columns of their own; a longer array is one column with JSON
MAX_COLUMNS = 10_000  # of one file; JSON messages may have varying fields
MAX_OPEN_FILES = 128  # a process may open 1024 files, or 256, and a hundred robots have more topics


@dataclass(slots=True)
class Exported:
    """Result of an export."""

    messages: int = 0
    left_out: dict[str, str] = field(default_factory=dict)  # topic -> what was omitted, and why
    damage: list[str] = field(default_factory=list)  # of the source
    _bad: Counter[str] = field(default_factory=Counter)

    def leave_out(self, topic: str, error: BadPayload) -> None:
        """Count a message that cannot be converted."""
        self._bad[topic] += 1
        if self._bad[topic] == 1:
            self.left_out[topic] = f"a message cannot be decoded: {error}"
        else:
            first = self.left_out[topic].partition(": ")[2]
            self.left_out[topic] = f"{self._bad[topic]} messages cannot be decoded, the first: {first}"


def chosen_channels(path: Path, patterns: Iterable[str], done: Exported, *, skips_unknown: bool) -> set[Channel]:
    """Return the channels to export: those whose topics match a pattern, or all without patterns.

    `skips_unknown`: channels that cannot be converted are noted in `done` and omitted. Those of ROS 2's own tools are
    omitted in any case, unless they are named.

    Raises:
        UnknownFormat: some channels cannot be converted; the text names them.
        RecordingFailed: no topic matches, or the recording cannot be read.
    """
    listed, channels = tuple(patterns), open_source(path).read_channels()
    chosen = {channel for channel in channels if not listed or matches(channel.topic, listed)}
    if listed and not chosen:
        topics = ", ".join(sorted({channel.topic for channel in channels}))
        raise RecordingFailed(f"{path} has no topic {' '.join(listed)}; available: {topics or 'none'}")
    unknown = {channel: why for channel in chosen if (why := why_unknown(channel))}
    named = {channel.topic: f"{channel.type_name}: {why}" for channel, why in unknown.items()}
    refused = {topic: why for topic, why in named.items() if topic not in OF_TOOLS or topic in listed}
    if refused and not skips_unknown:
        lines = [f"{topic} ({why})" for topic, why in sorted(refused.items())]
        more = f"; and {len(lines) - MAX_NAMED} more" if len(lines) > MAX_NAMED else ""
        raise UnknownFormat(
            f"{path}: cannot convert {'; '.join(lines[:MAX_NAMED])}{more}. "
            "Name the topics to export, or add --skip-unknown"
        )
    done.left_out |= named
    return chosen - unknown.keys()


def matches(topic: str, patterns: Iterable[str]) -> bool:
    """Whether the topic matches one of the patterns, which may contain *."""
    return any(fnmatch.fnmatchcase(topic, pattern) for pattern in patterns)


@contextlib.contextmanager
def new_output(path: Path) -> Iterator[None]:
    """Create a file or folder in the block. If the block fails, remove it.

    Raises:
        FileExistsError: the path exists.
    """
    if path.exists() or path.is_symlink():
        raise FileExistsError(17, "already exists", str(path))
    try:
        yield
    except BaseException:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):  # of a failing disk; the first error is raised
                path.unlink(missing_ok=True)
        raise


def check_done(source: RecordingSource, done: Exported) -> None:
    """Check that at least one message was exported.

    Raises:
        RecordingFailed: nothing was exported; the text says why.
    """
    if not done.messages:
        why = "; ".join(f"{topic}: {reason}" for topic, reason in list(done.left_out.items())[:MAX_NAMED])
        raise RecordingFailed(f"{source.path} has no message to export{f': {why}' if why else ''}")
    done.damage = source.damage


_LONGEST_NAME = 200  # characters; a file name may have 255 bytes
_TIME = "time_s"  # arrival time since the epoch

_Key = tuple[str, str]  # topic and type, because the type of a topic may change


def export_csv(
    source: RecordingSource, folder: Path, *, topics: Iterable[str] = (), skips_unknown: bool = False
) -> tuple[Exported, dict[str, int]]:
    """Write the tables into a new folder. Return the result, and the number of lines of each file.

    A table has the columns of all messages of its topic, so the recording is read twice. After a failure no folder is
    left.
    `topics`: names or patterns, empty for all; `skips_unknown`: topics that cannot be converted are omitted.

    Raises:
        OSError: the folder exists or cannot be written.
        RecordingFailed: the recording cannot be read, or has nothing to export.
        UnknownFormat: it has topics that cannot be converted; nothing was written.
    """
    done = Exported()
    channels = chosen_channels(source.path, topics, done, skips_unknown=skips_unknown)
    files: dict[_Key, _File] = {}
    opened: dict[_Key, _File] = {}  # the last one is the one written to last
    names = Counter[str]()
    columns = _columns(open_source(source.path), channels)
    with new_output(folder):
        folder.mkdir()
        try:
            for channel, stamp_ns, cells in _decoded(source, channels, done):
                key = _key(channel)
                if key not in files:
                    files[key] = _File(folder / f"{_free_name(file_name(channel.topic), names)}.csv", columns[key])
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
    """Convert a topic to a file name: /robot_0/odometry becomes robot_0.odometry."""
    return re.sub(r"[^A-Za-z0-9_.-]", ".", topic.strip("/")).strip(".")[:_LONGEST_NAME] or "topic"


def _free_name(name: str, tries: Counter[str]) -> str:
    """Return a name that no file of the folder has, also on disks that ignore case. `tries`: of all names so far."""
    free, wanted = name, name.lower()
    while free.lower() in tries:
        tries[wanted] += 1
        free = f"{name}_{tries[wanted]}"
    tries[free.lower()] += 1
    return free


def _columns(source: RecordingSource, channels: set[Channel]) -> dict[_Key, list[str]]:
    found: dict[_Key, dict[str, None]] = {}
    for channel, _, cells in _decoded(source, channels, Exported()):
        of_topic = found.setdefault(_key(channel), {})
        if len(of_topic) < MAX_COLUMNS:
            of_topic.update(dict.fromkeys(cells))
    return {key: list(of_topic) for key, of_topic in found.items()}


def _decoded(
    source: RecordingSource, channels: set[Channel], done: Exported
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


def _safe(value: object) -> object:
    """Return a value as a cell: a text of a device may be a formula, or contain escape codes."""
    return csv_text(value) if isinstance(value, str) else value


class _File:
    def __init__(self, path: Path, columns: list[str]) -> None:
        self.path, self.lines = path, 0
        self._columns = [_TIME, *columns]
        self._file: IO[str] | None = None
        self._writer: csv.DictWriter[str] | None = None
        self._open("x").writerow({column: csv_text(column) for column in self._columns})

    def _open(self, mode: str) -> "csv.DictWriter[str]":
        file = self.path.open(mode, newline="", encoding="utf-8", errors="replace")  # JSON may contain a lone surrogate
        self._file, self._writer = file, csv.DictWriter(file, self._columns, restval="", extrasaction="ignore")
        return self._writer

    def add(self, stamp_ns: int, cells: dict[str, object]) -> None:
        writer = self._writer or self._open("a")
        seconds, rest_ns = divmod(stamp_ns, NS_PER_S)
        writer.writerow({_TIME: f"{seconds}.{rest_ns:09d}"} | {name: _safe(value) for name, value in cells.items()})
        self.lines += 1

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = self._writer = None  # frees their buffers of 100 kB, because thousands of files may be closed
