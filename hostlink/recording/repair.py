"""Repair: a file that was never finished, or is damaged, written anew with its index."""

import fcntl
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hostlink.errors import RecordingFailed
from hostlink.recording.channel import JSON, ROS1
from hostlink.recording.mcap_writer import MAX_CHANNELS, PROFILE, McapWriter
from hostlink.recording.reader import Reader


@dataclass(frozen=True, slots=True)
class Repaired:
    """What was found in a file."""

    messages: int
    damage: tuple[str, ...]


def repair(path: Path, on_progress: Callable[[int], None] = lambda _: None) -> Repaired:
    """Put a finished file in the place of this one, with every message that can be read; a whole one stays as it is.

    `on_progress`: called with the number of messages, now and then. Whatever fails leaves the file as it was.

    Raises:
        RecordingFailed: it cannot be read or written, is no MCAP file, is damaged and another program's, or is not
            finished because it is being written: what comes later would be lost.
    """
    _check_left(path)
    reader = Reader(path)
    beside = path.with_name(f"{path.name}.repaired")
    try:
        beside.unlink(missing_ok=True)
        writer = McapWriter(beside, metadata={}, has_steady_times=Reader(path).reads_steady_times())
        try:
            for message in reader.messages():
                if not writer.write(*message):
                    raise RecordingFailed(f"{path} has more than {MAX_CHANNELS} channels")
                if writer.messages % 10_000 == 0:
                    on_progress(writer.messages)
            for channel in reader.channels:
                writer.announce(channel)
            writer.add_metadata(reader.metadata)
            writer.close()
            if reader.damage:
                _check_ours(reader)
                beside.replace(path)
        finally:
            writer.abandon()
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingFailed(f"{path}: {error.strerror or error}") from error
    return Repaired(writer.messages, tuple(reader.damage))


def _check_left(path: Path) -> None:
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise RecordingFailed(f"{path} is being written: stop the recording first") from None
    except OSError:  # reading says why, or there are no locks
        return


def _check_ours(reader: Reader) -> None:
    """Whatever else a file has would be lost: schemas in other languages, attachments."""
    if reader.profile != PROFILE or any(channel.encoding not in (ROS1, JSON) for channel in reader.channels):
        raise RecordingFailed(f"{reader.path} is of another program: `mcap recover` may repair it")
