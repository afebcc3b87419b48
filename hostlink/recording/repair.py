"""Repair: a file that was never finished, or is damaged, written anew with its index."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hostlink.errors import RecordingFailed
from hostlink.recording.mcap_writer import McapWriter
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
        RecordingFailed: it cannot be read or written, or is no MCAP file.
    """
    reader = Reader(path)
    beside = path.with_name(f"{path.name}.repaired")
    try:
        beside.unlink(missing_ok=True)
        writer = McapWriter(beside, metadata={})
        try:
            for message in reader.messages():
                writer.write(*message)
                if writer.messages % 10_000 == 0:
                    on_progress(writer.messages)
            for channel in reader.channels:
                writer.announce(channel)
            writer.add_metadata(reader.metadata)
            writer.close()
            if reader.damage:
                beside.replace(path)
        finally:
            writer.abandon()
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingFailed(f"{path}: {error.strerror or error}") from error
    return Repaired(writer.messages, tuple(reader.damage))
