"""Drives: from the first velocity of a robot to its stop; how they are found in messages, and the log of them."""

import asyncio
import contextlib
import os
import time
from collections import deque
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import msgspec
import structlog

from hostlink.core.host import Host
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.core.runtime.detached import DetachedThread
from hostlink.core.runtime.folders import FolderOwner
from hostlink.core.runtime.units import NS_PER_S
from hostlink.core.runtime.whole_file import replace_file

PAUSE_NS = 3_000_000_000  # between two commands of one drive: a key is released and pressed again
MAX_OPEN = 1024  # unfinished drives

MAX_RECENT = 1000
MAX_FILE_BYTES = 1_000_000  # about 2,000 drives with two lines each, and two for each pause; one earlier file is kept
NAME = "drives.jsonl"
NAME_BEFORE = "drives.before.jsonl"
DIED = "the daemon died"  # end of a drive that has only a start line

END_S = 1.0  # to write the last drives


class Drive(msgspec.Struct, kw_only=True):
    """One drive.

    Times are wall times; `seconds` is measured by a clock that is never set. `end` is empty while it lasts.
    """

    robot: str
    owner: str
    address: str = ""  # of the last command
    priority: int
    began_ns: int
    ended_ns: int  # so far
    seconds: float | None = None  # so far; None in files of older releases
    commands: int = 0
    fastest_m_s: float = 0.0
    fastest_rad_s: float = 0.0
    end: str = ""


class _Key(NamedTuple):
    robot: str
    owner: str


class DriveFinder:
    """Current drives, and paused ones that may continue."""

    def __init__(self) -> None:
        self._open: dict[_Key, Drive] = {}  # oldest first
        self._began_s: dict[_Key, float] = {}  # loop time of the start
        self._changed: dict[_Key, Drive] = {}  # begun, ended or continued

    def __len__(self) -> int:
        return len(self._open)

    def observe(self, event: RobotEvent) -> bool:
        """Handle an event of a robot. Return whether a drive has begun, ended or continued."""
        if event.kind is EventKind.COMMANDED:
            self._command(event)
        elif event.kind is EventKind.STOPPED:
            drive = self._open.get(_Key(event.robot, str(event.facts["owner"])))
            self._end([] if drive is None else [drive], event, str(event.facts["reason"]))
        elif event.kind is EventKind.LOCKED:
            self._end(self._of(event.robot), event, f"locked: {event.facts['reason']}")
        elif event.kind is EventKind.GONE:
            self._end(self._of(event.robot), event, "its device disconnected")
        return bool(self._changed)

    def pop_changed(self) -> list[Drive]:
        """Return the drives that have begun, ended or continued since the last call."""
        changed, self._changed = self._changed, {}
        return list(changed.values())

    def under_way(self) -> list[Drive]:
        """Return the current drives, oldest first. Paused ones are included."""
        return list(self._open.values())

    def pop_finished(self, now_ns: int) -> list[Drive]:
        """Remove and return the drives that ended long enough ago, and the oldest above MAX_OPEN."""
        surplus = len(self._open) - MAX_OPEN
        finished = [
            key
            for number, (key, drive) in enumerate(self._open.items())
            if number < surplus or (drive.end and not 0 <= now_ns - drive.ended_ns < PAUSE_NS)
        ]
        for key in finished:
            self._began_s.pop(key, None)
        return [self._open.pop(key) for key in finished]

    def _of(self, robot: str) -> list[Drive]:
        return [drive for drive in self._open.values() if drive.robot == robot]

    def _command(self, event: RobotEvent) -> None:
        velocity, owner = event.facts["limited"], str(event.facts["owner"])
        assert isinstance(velocity, PlanarVelocity | Twist)  # noqa: S101 - see EventKind
        if velocity.is_zero:
            return  # a zero starts no drive
        key = _Key(event.robot, owner)
        drive = self._open.get(key)
        is_continued = drive is not None and not drive.end
        if drive is None:
            priority = int(str(event.facts["priority"]))
            drive = Drive(
                robot=event.robot, owner=owner, priority=priority, began_ns=event.stamp_ns, ended_ns=event.stamp_ns
            )
            self._open[key], self._began_s[key] = drive, event.at_s
        drive.end = ""
        if not is_continued:
            self._note_change(key, drive)
        drive.ended_ns, drive.seconds = event.stamp_ns, event.at_s - self._began_s[key]
        drive.address = str(event.facts["address"])
        drive.commands += 1
        drive.fastest_m_s = max(drive.fastest_m_s, velocity.speed_m_s)
        drive.fastest_rad_s = max(drive.fastest_rad_s, velocity.turn_rad_s)
        if not is_continued:  # otherwise the other drives have ended already
            for other in self._open.values():
                if other.robot == event.robot and other is not drive and not other.end:
                    self._end([other], event, f"taken over by {owner}")

    def _end(self, drives: list[Drive], event: RobotEvent, reason: str) -> None:
        for drive in drives:
            if not drive.end:
                key = _Key(drive.robot, drive.owner)
                drive.end = reason
                drive.ended_ns = event.stamp_ns
                drive.seconds = event.at_s - self._began_s[key]
                self._note_change(key, drive)

    def _note_change(self, key: _Key, drive: Drive) -> None:
        self._changed[key] = drive
        if len(self._changed) > MAX_OPEN:  # bounded, in case no caller reads them
            del self._changed[next(iter(self._changed))]


# -- drive file -------------------------------------------------------------------------------------------------------


class LastCommand(NamedTuple):
    """Last driver of a robot when the daemon was killed, with the time of the last command."""

    robot: str
    owner: str
    stamp_ns: int


def append_drives(folder: Path, drives: list[Drive]) -> None:
    """Append drives, one line each. Blocks on the disk.

    Above MAX_FILE_BYTES, keep only the last line of each drive. Start a new file if that leaves most of it.

    Raises:
        OSError: the disk failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / NAME
    if file.exists() and file.stat().st_size > MAX_FILE_BYTES:
        newest = b"".join(msgspec.json.encode(drive) + b"\n" for drive in _read_file(file))
        if len(newest) > MAX_FILE_BYTES / 2:
            file.replace(folder / NAME_BEFORE)
        else:
            replace_file(file, newest)
    with file.open("ab+") as stream:
        stream.seek(-min(1, stream.tell()), os.SEEK_END)
        # The last line was cut by a full disk or a power failure; start a new line.
        is_cut = stream.read() not in (b"", b"\n")
        stream.write(b"\n" * is_cut + b"".join(msgspec.json.encode(drive) + b"\n" for drive in drives))


def read_drives(folder: Path) -> list[Drive]:
    """Read the last MAX_RECENT drives, ordered by their ends. Skip damaged and cut lines.

    A drive without an end has ended with its daemon.
    """
    drives = _newest_lines([*_read_file(folder / NAME_BEFORE), *_read_file(folder / NAME)])[-MAX_RECENT:]
    for drive in drives:
        drive.end = drive.end or DIED
    return drives


def finish_drives(folder: Path, commands: list[LastCommand]) -> None:
    """Write the ends of drives that a killed daemon could not write.

    Raises:
        OSError: the disk failed.
    """
    changed = [drive for drive in read_drives(folder) if corrected(drive, commands)]
    if changed:
        append_drives(folder, changed)


def corrected(drive: Drive, commands: list[LastCommand]) -> bool:
    """Set the end of a drive that has only a start line to its last command. Return whether it was changed."""
    is_unknown = drive.end == DIED and drive.ended_ns == drive.began_ns
    last_ns = max((each.stamp_ns for each in commands if each[:2] == (drive.robot, drive.owner)), default=0)
    if not is_unknown or last_ns <= drive.ended_ns:
        return False
    drive.ended_ns, drive.seconds = last_ns, None  # the steady clock of its daemon is lost
    return True


def _read_file(file: Path) -> list[Drive]:
    """Read the last line of each drive; an empty list if there is no file yet."""
    try:
        lines = file.read_bytes()[-2 * MAX_FILE_BYTES :].splitlines()
    except OSError:
        return []
    return _newest_lines([drive for drive in map(_read, lines) if drive is not None])


def _newest_lines(drives: list[Drive]) -> list[Drive]:
    """Return the last of each drive, in the order of these."""
    found: dict[tuple[str, str, int], Drive] = {}
    for drive in drives:
        key = (drive.robot, drive.owner, drive.began_ns)
        found.pop(key, None)
        found[key] = drive
    return list(found.values())


def _read(line: bytes) -> Drive | None:
    try:
        return msgspec.json.decode(line, type=Drive)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


# -- drive log --------------------------------------------------------------------------------------------------------

log = structlog.get_logger()


class DriveLog:
    """Log of all drives, from the events of commands."""

    def __init__(self, host: Host, folder: Path, *, is_kept: bool, owner: FolderOwner | None = None) -> None:
        """`folder` is that of the recordings, with its owner. `is_kept`: also write a file there."""
        self.lost = 0  # drives that could not be written
        self._host, self._folder, self._is_kept, self._owner = host, folder, is_kept, owner
        self._drives = DriveFinder()
        self._recent: deque[Drive] = deque(maxlen=MAX_RECENT)
        self._observer = host.join_as_observer()
        self._is_open = asyncio.Event()  # set while a drive lasts, and shortly afterwards
        self._has_changed = asyncio.Event()
        self._turn = asyncio.Lock()  # for access to the file
        self._thread = DetachedThread("drives")
        self._is_failing = False

    async def start(self) -> None:
        """Log every drive from now on, after the drives in the file."""
        if self._is_kept:
            self._recent.extend(await self._thread.run(lambda: read_drives(self._folder)))
        self._observer.observe(self._receive)
        self._host.spawn(self._write_changes(), name="drives that change", is_vital=False)
        self._host.spawn(self._finish(), name="drives", is_vital=False)

    def correct(self, commands: list[LastCommand]) -> None:
        """Set the ends of drives that an earlier daemon did not end. The file has them already."""
        for drive in self._recent:
            corrected(drive, commands)

    async def aclose(self) -> None:
        """End all drives, because the daemon ends."""
        self._observer.leave()
        for drive in self._drives.under_way():
            drive.end = drive.end or "hostlink stopped"
        with contextlib.suppress(TimeoutError):  # a dead disk
            async with asyncio.timeout(END_S):
                await self._write(self._drives.pop_changed())
                await self._keep(self._drives.pop_finished(time.time_ns() + 2 * PAUSE_NS))

    def newest_first(self, *, robot: str | None = None, limit: int | None = None) -> list[Drive]:
        """Return the last MAX_RECENT drives and the current ones, newest first, at most `limit`."""
        found = [*self._recent, *self._drives.under_way()]
        return list(islice((drive for drive in reversed(found) if robot in (None, drive.robot)), limit))

    def _receive(self, event: RobotEvent) -> None:
        if self._drives.observe(event):
            self._is_open.set()
            self._has_changed.set()

    async def _write_changes(self) -> None:
        """Write a line of each drive when it begins, ends or continues, so that a killed daemon leaves it."""
        while True:
            await self._has_changed.wait()
            self._has_changed.clear()
            await self._write(self._drives.pop_changed())

    async def _finish(self) -> None:
        while True:
            await self._is_open.wait()
            await asyncio.sleep(PAUSE_NS / NS_PER_S)
            finished = self._drives.pop_finished(time.time_ns())
            self._recent.extend(finished)
            await self._write([drive for drive in finished if not drive.end])  # the others are written already
            if not self._drives:
                self._is_open.clear()

    async def _keep(self, drives: list[Drive]) -> None:
        self._recent.extend(drives)
        await self._write(drives)

    def _append(self, drives: list[Drive]) -> None:
        if self._owner is not None:
            self._owner.claim()
        append_drives(self._folder, drives)

    async def _write(self, drives: list[Drive]) -> None:
        if not (drives and self._is_kept):
            return
        try:
            async with self._turn:
                await self._thread.run(lambda: self._append(drives))
        except OSError as error:
            if not self._is_failing:
                log.warning("drives.lost", file=str(self._folder / NAME), reason=error.strerror or str(error))
            self._is_failing = True
            self.lost += sum(bool(drive.end) for drive in drives)  # a later line has the complete data of the others
        else:
            self._is_failing = False
