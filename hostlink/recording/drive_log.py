"""DriveLog: who drove when, of the last drives in memory and of many more in a file that the next start reads."""

import asyncio
import contextlib
import time
from collections import deque
from itertools import islice
from pathlib import Path

import structlog

from hostlink.detached import DetachedThread
from hostlink.hub.hub import Hub
from hostlink.hub.robot_events import RobotEvent
from hostlink.recording.drive_file import MAX_RECENT, NAME, LastCommand, append_drives, corrected, read_drives
from hostlink.recording.drives import PAUSE_NS, Drive, Drives

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
