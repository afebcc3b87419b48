"""Salvage of incidents from the memory (ring.py) of a process that was killed or ran out of time, and file repair.

| who does it                         | when                                                               |
|-------------------------------------|--------------------------------------------------------------------|
| a process that the guardian starts  | the daemon was killed; under systemd its next start is soon enough |
| a process that the daemon starts    | it ends, and has no time to write all pending incidents            |
| the next daemon, in a thread        | it starts, and no other process does it                            |

The holder of the memory's lock does it; others leave the memory alone. Incidents are not written twice.
"""

import contextlib
import fcntl
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from hostlink.components.recorder.channel import CDR, EVENTS, JSON, ROS1, Channel
from hostlink.components.recorder.definitions import need_rosbags
from hostlink.components.recorder.drives import LastCommand, finish_drives
from hostlink.components.recorder.folder import Folder
from hostlink.components.recorder.history import decode_event
from hostlink.components.recorder.incident import Incident, OutOfTime, write_incident
from hostlink.components.recorder.mcap_writer import MAX_CHANNELS, PROFILE, McapWriter
from hostlink.components.recorder.reader import NOT_FINISHED, ROS1_SUFFIX, UNFINISHED_SUFFIX, BagReader, McapReader
from hostlink.components.recorder.ring import RING, Entry, read_blocks, read_entries, read_schemas, write_fact
from hostlink.core.runtime import remains
from hostlink.errors import BadPayload, RecordingFailed

# -- salvage ----------------------------------------------------------------------------------------------------------

ABOUT, CLOSED, _FACT = "about", "closed", ".json"
MAX_PENDING_CHANNELS = 64  # channels of a pending incident that its file contains even without a message
BEGUN_S = 60.0  # a younger memory without a lock may just be being created
KEPT_S = 7 * 24 * 3600.0  # memory that could not be saved for so long is removed, because tmpfs is small
_STOPS = ("stopped", "locked", "gone")


class About(msgspec.Struct):
    """Target folder and limits of a memory's incidents."""

    folder: str
    max_disk_mb: float
    min_free_disk_mb: float
    before_s: float


class Pending(msgspec.Struct):
    """Pending incident, and channels that its file contains even without a message."""

    incident: Incident
    channels: list[Channel]


@dataclass(slots=True)
class Salvaged:
    """Result of a salvage: saved incidents, lost incidents with the reason, and the last drivers."""

    saved: list[tuple[Incident, Path]] = field(default_factory=list)
    lost: list[tuple[Incident, str]] = field(default_factory=list)
    commands: list[LastCommand] = field(default_factory=list)


def pending_name(number: int) -> str:
    """Return the name of the fact about a pending incident."""
    return f"{remains.PENDING}{number}"


def main(pid: int) -> None:
    """Save the incidents of this process. What a disk refuses is left to the next start of the daemon."""
    for path in remains.of_process(pid):
        with contextlib.suppress(OSError):
            salvage(Path(path))


def salvage(folder: Path, *, rest: Callable[[], None] = lambda: None) -> Salvaged | None:
    """Write the incidents of an ended process and remove its memory. Blocks on the disk.

    Return None if the process is alive or another one does it. `rest` is that of `write_incident`.

    Raises:
        OSError: the disk failed; unwritten incidents are retried at the next start.
        OutOfTime: raised by `rest`; unwritten incidents are retried too.
    """
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context((folder / RING).open("rb"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except FileNotFoundError:
            if _age_s(folder) > BEGUN_S:
                shutil.rmtree(folder, ignore_errors=True)
            return None
        except BlockingIOError:
            return None
        if not (folder / RING).exists():  # another process has just done it
            return None
        found = Salvaged()
        about = _read(folder / f"{ABOUT}{_FACT}", About)
        if about is not None:
            _save_all(folder, about, read_blocks(file.read()), found, rest)
        shutil.rmtree(folder, ignore_errors=True)
        return found


def clear_old() -> None:
    """Remove memory that could not be saved for KEPT_S."""
    for path in remains.of_user():
        with contextlib.suppress(OSError), (Path(path) / RING).open("rb") as file:
            if _age_s(Path(path)) > KEPT_S:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True)


def _save_all(
    folder: Path, about: About, by_robot: dict[str, list[bytes]], found: Salvaged, rest: Callable[[], None]
) -> None:
    schemas = read_schemas(folder)

    def entries_of(robot: str) -> Iterator[Entry]:
        return read_entries(by_robot.get(robot, ()), schemas)

    if not (folder / f"{CLOSED}{_FACT}").exists():
        _note_death(folder, {robot: entries_of(robot) for robot in by_robot if robot}, found)
    finish_drives(Path(about.folder).parent, found.commands)
    into = Folder(Path(about.folder), max_disk_mb=about.max_disk_mb, min_free_disk_mb=about.min_free_disk_mb)
    for path in sorted(folder.glob(f"{remains.PENDING}*{_FACT}")):
        pending = _read(path, Pending)
        if pending is not None:
            incident = pending.incident
            entries = [entries_of(robot) for robot in {incident.robot, ""}]
            try:
                written = write_incident(into, incident, pending.channels, entries, before_s=about.before_s, rest=rest)
                found.saved.append((incident, written))
            except (OSError, OutOfTime):
                raise
            except Exception as error:  # noqa: BLE001 - damaged; the next start would fail in the same way
                found.lost.append((incident, repr(error)))
        path.unlink(missing_ok=True)


def _note_death(folder: Path, by_robot: dict[str, Iterator[Entry]], found: Salvaged) -> None:
    """Add an incident for each robot that was driven when the process ended without stopping it."""
    for number, (robot, entries) in enumerate(by_robot.items()):
        last, newest_ns, newest_s = _last_command(robot, entries)
        if last is not None:
            found.commands.append(last)
            detail = f"hostlink ended without stopping it, while {last.owner} drove it"
            incident = Incident(robot, "daemon_died", detail, newest_ns, newest_s)
            write_fact(folder, f"{remains.PENDING}died-{number}", Pending(incident, []))
    write_fact(folder, CLOSED, "after its death")


def _last_command(robot: str, entries: Iterable[Entry]) -> tuple[LastCommand | None, int, float]:
    """Return the last command (None if the robot was stopped), and wall and steady time of the newest message."""
    last, newest_ns, newest_s = None, 0, 0.0
    for entry in entries:
        newest_ns, newest_s = entry.stamp_ns, entry.at_s
        if entry.channel.topic != EVENTS.topic or entry.channel.type_name != EVENTS.type_name:
            continue
        # A program may publish other content on the topic.
        with contextlib.suppress(BadPayload, KeyError, AttributeError, TypeError):
            event = decode_event(entry)
            facts = event["facts"]
            if event["kind"] == "commanded":
                is_zero = not any(facts["limited"].values())
                last = None if is_zero else LastCommand(robot, str(facts["owner"]), entry.stamp_ns)
            elif event["kind"] in _STOPS:
                last = None
    return last, newest_ns, newest_s


def _age_s(folder: Path) -> float:
    try:
        return time.time() - folder.stat().st_mtime
    except OSError:
        return 0.0


def _read(path: Path, kind: type[Any]) -> Any:
    """Read the fact of a file; None if it is missing or damaged."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None


# -- repair -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Repaired:
    """Result of a repair."""

    messages: int
    damage: tuple[str, ...]
    original: Path | None = None  # the damaged file, which is kept; None for one that only lacked its end
    output: Path | None = None  # the repaired file, if it has another name


def repair(path: Path, on_progress: Callable[[int], None] = lambda _: None) -> Repaired:
    """Replace a file by a finished one with every readable message. An intact file is not changed.

    A file with other damage than a missing end is kept under the name NAME.damaged, because a later version may read
    more of it. `on_progress` is called with the number of messages now and then. After any failure the file is
    unchanged.

    Raises:
        RecordingFailed: the file cannot be read or written, is not an MCAP file, has no readable message, is a damaged
            file of another program, or is still being written.
    """
    _check_left(path)
    if path.name.endswith((ROS1_SUFFIX, UNFINISHED_SUFFIX)):
        return _repair_bag(path)
    reader = McapReader(path)
    part = Path(f"{path}.repaired")
    original: Path | None = None
    try:
        part.unlink(missing_ok=True)
        beginning = McapReader(path)
        beginning.read_beginning()
        writer = McapWriter(part, metadata={}, has_steady_times=beginning.has_steady_times)
        try:
            for message in reader.messages():
                if not writer.write(*message):
                    raise RecordingFailed(f"{path} has more than {MAX_CHANNELS} channels")
                if writer.messages % 10_000 == 0:
                    on_progress(writer.messages)
            if not writer.messages and reader.damage:
                raise RecordingFailed(f"{path} has no readable message, and was not changed: {reader.damage[0]}")
            for channel in reader.channels:
                writer.announce(channel)
            writer.add_metadata(reader.metadata)
            writer.close()
            if reader.damage:
                _check_ours(reader)
                if reader.damage != [NOT_FINISHED]:
                    original = path.with_name(f"{path.name}.damaged")
                    path.replace(original)
                part.replace(path)
        finally:
            writer.abandon()
            part.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingFailed(f"{path}: {error.strerror or error}") from error
    return Repaired(writer.messages, tuple(reader.damage), original)


def _repair_bag(path: Path) -> Repaired:
    """Write a bag of ROS 1 with an index: FILE.bag of FILE.bag.active, which is kept, as is another damaged file.

    Raises:
        RecordingFailed: the file cannot be read or written, has no readable message, or FILE.bag exists.
    """
    need_rosbags(str(path))
    from hostlink.components.recorder.bags import RosFormat, export_ros  # noqa: PLC0415 - of the extra `export`

    source = BagReader(path)
    source.read_channels()
    if not source.damage:
        return Repaired(sum(1 for _ in source.messages()), tuple(source.damage))
    is_active = path.name.endswith(UNFINISHED_SUFFIX)
    part = path.with_suffix("") if is_active else path.with_name(f"{path.name}.repaired")
    try:
        done = export_ros(source, part, RosFormat.ROS1, skips_unknown=True)
        left_out = (f"{topic} is left out: {reason}" for topic, reason in done.left_out.items())
        damage = (*source.damage, *left_out)
        if is_active:
            return Repaired(done.messages, damage, path, part)
        original = path.with_name(f"{path.name}.damaged")
        path.replace(original)
        part.replace(path)
    except OSError as error:
        raise RecordingFailed(f"{part}: {error.strerror or error}") from error
    return Repaired(done.messages, damage, original)


def _check_left(path: Path) -> None:
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise RecordingFailed(f"{path} is being written: stop the recording first") from None
    except OSError:  # reading reports the error, or the file system has no locks
        return


def _is_ours(channel: Channel) -> bool:
    """Whether hostlink writes such a channel: CDR only of a type without a definition."""
    return channel.encoding in (ROS1, JSON) or (channel.encoding == CDR and not channel.schema)


def _check_ours(reader: McapReader) -> None:
    """Check that the file is hostlink's. Other content, such as foreign schemas or attachments, would be lost."""
    if reader.profile != PROFILE or not all(map(_is_ours, reader.channels)):
        raise RecordingFailed(f"{reader.path} was written by another program; `mcap recover` may repair it")
