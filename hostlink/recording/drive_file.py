"""The files with who drove when: a line of JSON for the beginning of a drive, and one for its end."""

import os
from pathlib import Path
from typing import NamedTuple

import msgspec

from hostlink.recording.drives import Drive

MAX_RECENT = 1000
MAX_FILE_BYTES = 1_000_000  # about 2,000 drives, two lines each; there is one such file more, the one before
NAME = "drives.jsonl"
NAME_BEFORE = "drives.before.jsonl"
DIED = "the daemon died"  # the end of a drive of which the file has the beginning alone


class LastCommand(NamedTuple):
    """Who drove a robot last when the daemon was killed, and until when."""

    robot: str
    owner: str
    stamp_ns: int


def append_drives(folder: Path, drives: list[Drive]) -> None:
    """Write them, a line each; over MAX_FILE_BYTES another file is begun. It waits for the disk.

    Raises:
        OSError: of the disk.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / NAME
    if file.exists() and file.stat().st_size > MAX_FILE_BYTES:
        file.replace(folder / NAME_BEFORE)
    with file.open("ab+") as stream:
        stream.seek(-min(1, stream.tell()), os.SEEK_END)
        is_cut = stream.read() not in (b"", b"\n")  # by a full disk, or the end of the power: the next one is whole
        stream.write(b"\n" * is_cut + b"".join(msgspec.json.encode(drive) + b"\n" for drive in drives))


def read_drives(folder: Path) -> list[Drive]:
    """The last MAX_RECENT of the files, in the order of their ends; lines that are damaged or cut are left out.

    One that has no end has ended with its daemon.
    """
    found: dict[tuple[str, str, int], Drive] = {}
    for name in (NAME_BEFORE, NAME):
        try:
            lines = (folder / name).read_bytes()[-2 * MAX_FILE_BYTES :].splitlines()
        except OSError:  # there is none yet
            continue
        for drive in map(_read, lines):
            if drive is not None:
                key = (drive.robot, drive.owner, drive.began_ns)
                found.pop(key, None)
                found[key] = drive
    drives = list(found.values())[-MAX_RECENT:]
    for drive in drives:
        drive.end = drive.end or DIED
    return drives


def finish_drives(folder: Path, commands: list[LastCommand]) -> None:
    """Write when drives ended that a daemon that was killed could not end.

    Raises:
        OSError: of the disk.
    """
    changed = [drive for drive in read_drives(folder) if corrected(drive, commands)]
    if changed:
        append_drives(folder, changed)


def corrected(drive: Drive, commands: list[LastCommand]) -> bool:
    """Let a drive end with its last command, if the file has its beginning alone; whether it is so."""
    is_unknown = drive.end == DIED and drive.ended_ns == drive.began_ns
    last_ns = max((each.stamp_ns for each in commands if each[:2] == (drive.robot, drive.owner)), default=0)
    if not is_unknown or last_ns <= drive.ended_ns:
        return False
    drive.ended_ns, drive.seconds = last_ns, None  # the steady clock of its daemon is gone
    return True


def _read(line: bytes) -> Drive | None:
    try:
        return msgspec.json.decode(line, type=Drive)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
