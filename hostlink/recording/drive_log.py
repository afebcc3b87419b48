"""The files with who drove when: a line of JSON for the beginning of a drive, and one for its end."""

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

from hostlink.detached import DetachedThread
from hostlink.hub.hub import Hub
from hostlink.hub.robot_events import RobotEvent
from hostlink.recording.drives import PAUSE_NS, Drive, Drives

# -- drive file -------------------------------------------------------------------------------------------------------

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


# -- drive log --------------------------------------------------------------------------------------------------------

log = structlog.get_logger()

END_S = 1.0  # for the lines of the last drives


class DriveLog:
    """An observer of what is commanded."""

    def __init__(self, hub: Hub, folder: Path, *, is_kept: bool) -> None:
        """`folder`: of the recordings; `is_kept`: in a file there."""
        self.lost = 0  # drives that could not be written
        self._hub, self._folder, self._is_kept = hub, folder, is_kept
        self._drives = Drives()
        self._recent: deque[Drive] = deque(maxlen=MAX_RECENT)
        self._observer = hub.join_daemon()
        self._is_open = asyncio.Event()  # a drive is under way, or was a moment ago
        self._has_begun = asyncio.Event()
        self._turn = asyncio.Lock()  # at the file
        self._thread = DetachedThread("drives")
        self._is_failing = False

    async def start(self) -> None:
        """Note every drive from now on, after those that the file has."""
        if self._is_kept:
            self._recent.extend(await asyncio.to_thread(read_drives, self._folder))
        self._observer.observe(self._receive)
        self._hub.spawn(self._begin(), name="drives that begin")
        self._hub.spawn(self._finish(), name="drives")

    def correct(self, commands: list[LastCommand]) -> None:
        """When the drives ended that an earlier daemon did not end; the file has it already."""
        for drive in self._recent:
            corrected(drive, commands)

    async def aclose(self) -> None:
        """The daemon ends: no drive goes on."""
        self._observer.leave()
        for drive in self._drives.under_way():
            drive.end = drive.end or "hostlink stopped"
        with contextlib.suppress(TimeoutError):  # a dead disk
            async with asyncio.timeout(END_S):
                await self._write_last()

    async def _write_last(self) -> None:
        await self._write(self._drives.pop_begun())
        await self._keep(self._drives.pop_finished(time.time_ns() + 2 * PAUSE_NS))

    def newest_first(self, *, robot: str | None = None, limit: int | None = None) -> list[Drive]:
        """The last MAX_RECENT drives, and those that are under way; of these so many as `limit` allows."""
        found = [*self._recent, *self._drives.under_way()]
        return list(islice((drive for drive in reversed(found) if robot in (None, drive.robot)), limit))

    def _receive(self, event: RobotEvent) -> None:
        self._drives.observe(event)
        if self._drives and not self._is_open.is_set():
            self._is_open.set()
        if self._drives.has_begun:
            self._has_begun.set()

    async def _begin(self) -> None:
        """A daemon that is killed leaves the line of a drive without an end."""
        while True:
            await self._has_begun.wait()
            self._has_begun.clear()
            await self._write(self._drives.pop_begun())

    async def _finish(self) -> None:
        while True:
            await self._is_open.wait()
            await asyncio.sleep(PAUSE_NS / 1e9)
            await self._keep(self._drives.pop_finished(time.time_ns()))
            if not self._drives:
                self._is_open.clear()

    async def _keep(self, drives: list[Drive]) -> None:
        self._recent.extend(drives)
        await self._write(drives)

    async def _write(self, drives: list[Drive]) -> None:
        if not (drives and self._is_kept):
            return
        try:
            async with self._turn:
                await self._thread.run(lambda: append_drives(self._folder, drives))
        except OSError as error:
            if not self._is_failing:
                log.warning("drives.lost", file=str(self._folder / NAME), reason=error.strerror or str(error))
            self._is_failing = True
            self.lost += sum(bool(drive.end) for drive in drives)  # of the others a later line has all
