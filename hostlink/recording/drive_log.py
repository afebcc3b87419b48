"""DriveLog: who drove when, of the last drives in memory and of many more in a file that the next start reads."""

import asyncio
import os
import time
from collections import deque
from itertools import islice
from pathlib import Path

import msgspec
import structlog

from hostlink.hub.hub import Hub
from hostlink.hub.robot_events import RobotEvent
from hostlink.recording.drives import PAUSE_NS, Drive, Drives

log = structlog.get_logger()

MAX_RECENT = 1000
MAX_FILE_BYTES = 1_000_000  # about 4,000 drives; there is one such file more, the one before
NAME = "drives.jsonl"
NAME_BEFORE = "drives.before.jsonl"


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

    async def start(self) -> None:
        """Note every drive from now on, after those that the file has."""
        if self._is_kept:
            self._recent.extend(await asyncio.to_thread(read_drives, self._folder))
        self._observer.observe(self._receive)
        self._hub.spawn(self._finish(), name="drives")

    async def aclose(self) -> None:
        """The daemon ends: no drive goes on."""
        self._observer.leave()
        for drive in self._drives.under_way():
            drive.end = drive.end or "hostlink stopped"
        await self._keep(self._drives.pop_finished(time.time_ns() + 2 * PAUSE_NS))

    def newest_first(self, *, robot: str | None = None, limit: int | None = None) -> list[Drive]:
        """The last MAX_RECENT drives, and those that are under way; of these so many as `limit` allows."""
        found = [*self._recent, *self._drives.under_way()]
        return list(islice((drive for drive in reversed(found) if robot in (None, drive.robot)), limit))

    def _receive(self, event: RobotEvent) -> None:
        self._drives.observe(event)
        if self._drives:
            self._is_open.set()

    async def _finish(self) -> None:
        while True:
            await self._is_open.wait()
            await asyncio.sleep(PAUSE_NS / 1e9)
            await self._keep(self._drives.pop_finished(time.time_ns()))
            if not self._drives:
                self._is_open.clear()

    async def _keep(self, drives: list[Drive]) -> None:
        self._recent.extend(drives)
        if not (drives and self._is_kept):
            return
        try:
            await asyncio.to_thread(append_drives, self._folder, drives)
        except OSError as error:
            if not self.lost:
                log.warning("drives.lost", file=str(self._folder / NAME), reason=error.strerror or str(error))
            self.lost += len(drives)


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
    """The last MAX_RECENT of the files, oldest first; lines that are damaged or cut are left out."""
    found: deque[Drive] = deque(maxlen=MAX_RECENT)
    for name in (NAME_BEFORE, NAME):
        try:
            lines = (folder / name).read_bytes()[-2 * MAX_FILE_BYTES :].splitlines()
        except OSError:  # there is none yet
            continue
        found.extend(drive for drive in map(_read, lines) if drive is not None)
    return list(found)


def _read(line: bytes) -> Drive | None:
    try:
        return msgspec.json.decode(line, type=Drive)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
