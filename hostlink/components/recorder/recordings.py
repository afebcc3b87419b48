"""Recordings: current ones, and the files in the folder."""

import asyncio
import functools
import itertools
import math
import os
import re
import socket
import time
from collections.abc import AsyncIterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import structlog

from hostlink.components.recorder.black_box import BlackBox
from hostlink.components.recorder.drives import DriveLog
from hostlink.components.recorder.folder import MEGABYTE, Folder, check_name, default_folder, file_stamp
from hostlink.components.recorder.mcap_format import MAGIC
from hostlink.components.recorder.mcap_writer import MAX_CHANNELS, FileThread
from hostlink.components.recorder.recorder import Recorder, TopicSelection
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.host import Host
from hostlink.core.runtime.detached import DetachedThread
from hostlink.core.runtime.folders import FolderOwner, FolderTaken
from hostlink.errors import BadRequest, RecordingBusy, RecordingFailed, UnknownTopic, size

log = structlog.get_logger()

MAX_UNDER_WAY = 8
FOLDER_INTERVAL_S = 2.0  # of the check of the folder
DISK_S = 10.0  # longest answer of a disk: one that sleeps needs several seconds
REMOVED_S = 60.0  # for how long a removed folder is a finding
LOOK_INTERVAL_S = 1.0  # of the parameters and the free disk space
PART = ".upload.part"  # file of an upload that is not complete; no recording has such a name


@dataclass(slots=True, eq=False)
class Recording:
    """Current recording."""

    name: str
    owner: str
    selection: TopicSelection
    recorder: Recorder
    thread: FileThread
    began_s: float  # loop time
    began_ns: int  # wall time
    removed: list[str] = field(default_factory=list)  # names of files that another program removed meanwhile

    @property
    def seconds(self) -> float:
        return asyncio.get_running_loop().time() - self.began_s


class Totals(NamedTuple):
    """Sums of all recordings since the daemon started."""

    messages: int = 0
    written_bytes: int = 0
    dropped: int = 0

    def plus(self, thread: FileThread) -> "Totals":
        """Add the counters of one more recording."""
        return Totals(*(each + getattr(thread, name) for name, each in self._asdict().items()))


class Recordings:
    """Owner of the folder and of the current recordings."""

    def __init__(self, host: Host, config: RecordingConfig, black_box: BlackBoxConfig, *, api: str = "") -> None:
        """`api`: the address of the daemon's API, for other daemons that want the folder."""
        path = default_folder() if config.folder is None else config.folder
        owner = f"the daemon with process id {os.getpid()} on {socket.gethostname()}" + (f", API {api}" if api else "")
        self._owner = FolderOwner(path, owner)
        free_mb = config.min_free_disk_mb
        self.folder = Folder(path, max_disk_mb=config.max_disk_mb, min_free_disk_mb=free_mb, owner=self._owner)
        self.black_box = BlackBox(host, black_box, path, min_free_disk_mb=free_mb, owner=self._owner)
        self.drives = DriveLog(host, path, is_kept=config.drives, owner=self._owner)
        self.removed = 0  # old recordings removed for the budget
        self.failed = 0  # recordings that ended by a failure
        self.changes = 0  # changes of the folder: a recording ended, or files were removed
        self.max_file_bytes = int(config.max_file_mb * MEGABYTE)
        self._host, self._config, self._has_black_box = host, config, black_box.enabled
        self._under_way: dict[str, Recording] = {}
        self._starting: set[str] = set()
        self._is_storing = False  # a client sends a file
        self._ended = Totals()
        self._folder_thread = DetachedThread("folder")
        self._removals, self._removed_at_s = 0, -math.inf

    def under_way(self) -> list[Recording]:
        """Return the current recordings, oldest first."""
        return list(self._under_way.values())

    def totals(self) -> Totals:
        """Return the sums of ended and current recordings."""
        threads = (recording.thread for recording in self._under_way.values())
        return functools.reduce(Totals.plus, threads, self._ended)

    def check_robot(self, name: str) -> None:
        """Check that there is a robot of this name.

        Raises:
            UnknownTopic: there is none.
        """
        self._host.robot(name)

    def open_files(self) -> set[Path]:
        """Return the files that are being written."""
        return {path for each in self._under_way.values() for path in each.thread.paths[-1:]}

    def find(self, name: str) -> Recording:
        """Return the current recording of that name.

        Raises:
            UnknownTopic: there is none.
        """
        found = self._under_way.get(name)
        if found is None:
            raise UnknownTopic("recording", name, self._under_way)
        return found

    async def start(self, selection: TopicSelection, *, name: str = "", owner: str = "") -> Recording:
        """Start a recording that lasts until `stop` or the end of the daemon.

        Raises:
            BadRequest: the name is invalid.
            RecordingBusy: the name is in use, too many recordings are running, or another daemon owns the folder.
            RecordingFailed: the folder cannot be written to, or its disk is full.
        """
        name = check_name(name) if name else await asyncio.to_thread(self._new_name, selection)
        if name in self._under_way or name in self._starting:
            raise RecordingBusy(f"a recording {name} is under way already; choose another name")
        if len(self._under_way) + len(self._starting) >= MAX_UNDER_WAY:
            raise RecordingBusy(f"{MAX_UNDER_WAY} recordings are under way; stop one first")
        self._starting.add(name)
        try:
            thread = await self._open(name, owner, selection)
        finally:
            self._starting.discard(name)
        recorder = Recorder(self._host, thread, selection)
        began_s = asyncio.get_running_loop().time()
        recording = Recording(name, owner, selection, recorder, thread, began_s, time.time_ns())
        self._under_way[name] = recording
        recorder.start()
        self._host.spawn(self._look_after(recording), name=f"recording {name}", is_vital=False)
        log.info("recording.started", recording=name, file=str(recording.thread.paths[0]), owner=owner)
        return recording

    async def stop(self, name: str) -> Recording:
        """End a recording and complete its file.

        Raises:
            UnknownTopic: no current recording has this name.
        """
        recording = self.find(name)
        recording.recorder.stop()
        await recording.thread.aclose()
        self._forget(recording)
        return recording

    async def remove(self, name: str) -> str:
        """Remove a file and return its name.

        Raises:
            RecordingBusy: it is being written, or another daemon owns the folder.
            UnknownTopic: there is none of that name.
            RecordingFailed: the disk refuses.
        """
        path = await asyncio.to_thread(self.folder.find, name)
        if path is None:
            raise UnknownTopic("recording", name)
        if path in self.open_files():
            raise RecordingBusy(f"{path.name} is being written; stop the recording first")
        try:
            await asyncio.to_thread(self._unlink, path)
        except FolderTaken as error:
            raise RecordingBusy(error.strerror) from error
        except OSError as error:
            raise RecordingFailed(f"{path.name}: {error.strerror}") from error
        self.changes += 1
        return path.name

    def _unlink(self, path: Path) -> None:
        self.folder.claim()
        path.unlink()

    async def store(self, name: str, size_bytes: int, pieces: AsyncIterable[bytes]) -> Path:
        """Store a recording that a client sends, one at a time. No other recording is removed for it.

        Raises:
            BadRequest: the name is invalid, the bytes are not MCAP, or are not `size_bytes`.
            RecordingBusy: the name is in use, another file is being sent, or another daemon owns the folder.
            RecordingFailed: the disk has no room for `size_bytes`, or cannot be written to.
            TimeoutError: no piece came in time.
        """
        name = check_name(name)
        if self._is_storing:
            raise RecordingBusy("another file is being uploaded; try again when it is complete")
        if name in self._under_way or name in self._starting:
            raise RecordingBusy(f"a recording {name} is under way; choose another name")
        self._is_storing = True
        self._starting.add(name)
        part, path = self.folder.path / PART, self.folder.file(name, 0)
        try:
            await asyncio.to_thread(self._check_room, path, size_bytes)
            await _write(part, size_bytes, pieces)
            await asyncio.to_thread(part.rename, path)
        except TimeoutError:  # of the pieces
            raise
        except FolderTaken as error:
            raise RecordingBusy(error.strerror) from error
        except OSError as error:
            raise RecordingFailed(f"{path.name}: {error.strerror or error}") from error
        finally:
            self._is_storing = False
            self._starting.discard(name)
            part.unlink(missing_ok=True)
        self.changes += 1
        log.info("recording.stored", recording=name, file=str(path), bytes=size_bytes)
        return path

    def _check_room(self, path: Path, size_bytes: int) -> None:
        """Check that a file of this size may be created.

        Raises:
            RecordingBusy: the file exists.
            RecordingFailed: there is no room for it.
            FolderTaken: another daemon owns the folder.
        """
        self.folder.claim()
        if path.exists():
            raise RecordingBusy(f"a recording named {path.stem} already exists; choose another name")
        usage = self.folder.usage()
        room_bytes = min(usage.budget_bytes - usage.used_bytes, usage.free_bytes - usage.min_free_bytes)
        if size_bytes > room_bytes:
            room = size(max(0, room_bytes))
            raise RecordingFailed(
                f"{path.name} has {size(size_bytes)}, and there is room for {room}; remove recordings"
            )
        self.folder.path.mkdir(parents=True, exist_ok=True)

    async def open(self) -> None:
        """Start the drive log and the black box."""
        found = await self._folder_finding()
        await self.drives.start()
        self.black_box.start(self.drives.correct)
        if self._config.drives or self._has_black_box:
            self._report(*found)
            self._host.spawn(self._watch_folder(), name="folder of recordings", is_vital=False)

    async def _watch_folder(self) -> None:
        """Tell while nothing can be saved, and make a removed folder again."""
        while True:
            await asyncio.sleep(FOLDER_INTERVAL_S)
            self._report(*await self._folder_finding())

    def _report(self, code: str, detail: str) -> None:
        self._host.report(detail, code=code)

    async def _folder_finding(self) -> tuple[str, str]:
        """Return code and detail of the finding about the folder; empty if nothing is wrong."""
        path = self.folder.path
        try:
            if not self._folder_thread.is_busy:
                await self._folder_thread.run(self.folder.check, timeout_s=DISK_S)
        except FolderTaken as error:
            return "recordings_taken", error.strerror or str(error)
        except TimeoutError:  # the thread still waits
            pass
        except OSError as error:
            return "recordings_unusable", f"{path}: {error.strerror or error}"
        if self._folder_thread.is_busy:
            return "recordings_unusable", f"{path}: its disk does not answer"
        now_s = asyncio.get_running_loop().time()
        if self._owner.removals > self._removals:
            self._removals, self._removed_at_s = self._owner.removals, now_s
        if now_s - self._removed_at_s < REMOVED_S:
            return "recordings_removed", str(path)
        return "", ""

    async def aclose(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.drives.aclose(), name="end of the drives")
            tasks.create_task(self.black_box.aclose(), name="end of the black box")
            for name in list(self._under_way):
                tasks.create_task(self.stop(name), name=f"end of recording {name}")
        self._owner.release()

    async def _open(self, name: str, owner: str, selection: TopicSelection) -> FileThread:
        make = functools.partial(
            FileThread,
            lambda number: self.folder.file(name, number),
            loop=asyncio.get_running_loop(),
            metadata={
                "recording": name,
                "owner": owner,
                "topics": " ".join(selection.topics),
                "robots": " ".join(selection.robots),
            },
            max_file_bytes=self.max_file_bytes,
            max_file_s=self._config.max_file_s,
            fsync=self._config.fsync,
            on_end=lambda: self._note_end(name),
            on_file=self._make_room,
            on_removed=lambda path, lost: self._note_removed(name, path, lost),
        )
        opening = asyncio.get_running_loop().run_in_executor(None, make)
        try:
            return await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_discard)
            raise
        except FileExistsError:
            raise RecordingBusy(f"a recording named {name} already exists; choose another name") from None
        except FolderTaken as error:
            raise RecordingBusy(error.strerror) from error
        except OSError as error:
            raise RecordingFailed(f"{self.folder.path}: {error.strerror or error}") from error

    def _make_room(self) -> None:
        """Make room in the folder. Called in the recording's thread, or before it starts."""
        removed = len(self.folder.make_room(self.open_files()))
        self.removed += removed
        self.changes += removed > 0

    def _note_removed(self, name: str, path: Path, lost: int) -> None:
        """Tell that another program removed a file that was being written."""
        log.error("recording.file_removed", recording=name, file=str(path), lost=lost)
        if name in self._under_way:
            self._under_way[name].removed.append(path.name)
        self.changes += 1

    async def _look_after(self, recording: Recording) -> None:
        is_crowded = False
        while self._under_way.get(recording.name) is recording:
            recording.recorder.note_parameters(time.time_ns())
            was_crowded, is_crowded = is_crowded, recording.thread.has_no_room
            if is_crowded and not was_crowded:
                log.warning("recording.channel_limit_reached", recording=recording.name, max_channels=MAX_CHANNELS)
            await asyncio.sleep(LOOK_INTERVAL_S)

    def _note_end(self, name: str) -> None:
        """Handle the end of the thread, which was stopped or failed."""
        recording = self._under_way.get(name)
        if recording is not None and recording.thread.failure is not None:
            self.failed += 1
            recording.recorder.stop()
            self._forget(recording)

    def _forget(self, recording: Recording) -> None:
        if self._under_way.pop(recording.name, None) is recording:
            self.changes += 1
            thread = recording.thread
            self._ended = self._ended.plus(thread)
            written_mb = thread.written_bytes / MEGABYTE
            facts = {"messages": thread.messages - thread.lost, "dropped": thread.dropped, "megabytes": written_mb}
            if thread.failure is None:
                log.info("recording.stopped", recording=recording.name, **facts)
            else:
                log.error("recording.failed", recording=recording.name, reason=thread.failure, **facts)

    def _new_name(self, selection: TopicSelection) -> str:
        """Build a name from the time and the robots. Called in a thread, because it waits for the disk."""
        stamp = file_stamp(time.time_ns())
        base = re.sub(r"[^A-Za-z0-9_+-]", "-", "_".join((stamp, *selection.robots)))[:90]
        names = itertools.chain((base,), (f"{base}.{number}" for number in itertools.count(2)))
        return next(name for name in names if not self._is_taken(name))

    def _is_taken(self, name: str) -> bool:
        """Whether the name is in use: since the same second, or since an hour that a clock change repeated."""
        if name in self._under_way or name in self._starting:
            return True
        try:
            return self.folder.file(name, 0).exists()
        except OSError:  # creating the file will report the error
            return False


async def _write(path: Path, size_bytes: int, pieces: AsyncIterable[bytes]) -> None:
    """Write an MCAP file piece by piece, in threads.

    Raises:
        BadRequest: the bytes are not MCAP, or are not `size_bytes`.
        OSError: the disk refuses.
    """
    written, head = 0, b""
    with await asyncio.to_thread(path.open, "wb") as file:
        async for piece in pieces:
            written += len(piece)
            head += piece[: len(MAGIC) - len(head)]
            if not MAGIC.startswith(head) or written > size_bytes:
                break
            await asyncio.to_thread(file.write, piece)
        await asyncio.to_thread(file.flush)
    if head != MAGIC:
        raise BadRequest("the file is not an MCAP file")
    if written != size_bytes:
        raise BadRequest(f"the file has {size_bytes} bytes, and {written} arrived")


def _discard(opening: "asyncio.Future[FileThread]") -> None:
    """Discard a recording whose start was cancelled."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().discard()
