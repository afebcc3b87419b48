"""Files in which a daemon keeps something for its next start on this port: read once, written after each change."""

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
import structlog

from hostlink.core.config import Config
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.core.runtime.detached import DetachedThread
from hostlink.core.runtime.folders import FolderOwner, FolderTaken, state_folder
from hostlink.core.runtime.whole_file import replace_file

log = structlog.get_logger()

MAX_FILE_BYTES = 4_000_000
DISK_TIMEOUT_S = 5.0  # for reading at the start; a slower disk is not waited for
LAST_TIMEOUT_S = 0.5  # for writing at the end
LAST_INTERVAL_S = 0.01

Content = TypeVar("Content")


def folder_of(config: Config, kind: str) -> Path | None:
    """Return the folder of what a daemon with these settings keeps; None if no device finds its next start.

    Each port has its own: two daemons on one computer have robots of their own.
    """
    udp, boards = config.udp, config.micro_ros.udp
    ports = (config.tcp.port, 0 if udp is None else udp.port, 0 if boards is None else boards.port)
    port = next(filter(None, ports), 0)
    if not port and not config.serial:
        return None
    return state_folder() / kind / str(port)


class KeptFile(Generic[Content]):
    """The file, which belongs to one daemon at a time. Methods block, and raise the OSError of the disk."""

    def __init__(self, folder: Path, kind: str, type_: type[Content]) -> None:
        """`kind`: what it keeps, a word for the log. `type_`: of the content; it can be made without arguments."""
        self.path, self.kind, self._type = folder / f"{kind}.json", kind, type_
        self._owner = FolderOwner(folder, "a daemon")
        self._turn = threading.Lock()
        self._has_ended = False

    def read(self) -> Content:
        """Return the content; an empty one if there is no file. A damaged file is set aside."""
        with self._claimed():
            return self._read()

    def _read(self) -> Content:
        try:
            with self.path.open("rb") as file:
                data = file.read(MAX_FILE_BYTES + 1)
        except FileNotFoundError:
            return self._type()
        reason = f"it has more than {MAX_FILE_BYTES} bytes"
        if len(data) <= MAX_FILE_BYTES:
            try:
                return msgspec.json.decode(data, type=self._type)
            except (msgspec.DecodeError, UnicodeDecodeError) as error:
                reason = str(error)
        aside = self.path.with_name(f"{self.path.name}.damaged")
        self.path.replace(aside)
        event = f"{self.kind}.damaged"
        log.warning(event, file=str(self.path), reason=reason, kept_as=str(aside))
        return self._type()

    def write(self, content: Content) -> None:
        """Write the whole file or nothing."""
        with self._claimed():
            replace_file(self.path, msgspec.json.encode(content))

    def release(self) -> None:
        """Leave the file to another daemon: now, or when the thread that uses it now is ready."""
        self._has_ended = True
        if self._turn.acquire(blocking=False):
            self._turn.release()
            self._owner.release()

    @contextlib.contextmanager
    def _claimed(self) -> Iterator[None]:
        try:
            with self._turn:
                self._owner.claim()
                yield
        finally:
            if self._has_ended:
                self._owner.release()


class Keeper(Generic[Content]):
    """Reads the file at the start of the daemon, and writes it after each change. Failures are logged once."""

    def __init__(
        self, file: KeptFile[Content], current: Callable[[], Content], restore: Callable[[Content], None], advice: str
    ) -> None:
        """`current` returns what is to be kept, `restore` gets what was kept. `advice`: for the log of a failure."""
        self._file, self._current, self._restore, self._advice = file, current, restore, advice
        self.kind, self._thread = file.kind, DetachedThread(file.kind)
        self._saved: Content | None = None
        self.changed = asyncio.Event()
        self._is_usable = True  # false: another daemon has the file, or the disk did not answer
        self._has_failed = False

    async def open(self) -> None:
        """Read what was kept. Nothing is restored if that fails."""
        try:
            self._saved = await self._thread.run(self._file.read, timeout_s=DISK_TIMEOUT_S)
        except (OSError, TimeoutError) as error:
            self._is_usable = False
            self._warn(error)
            return
        self._restore(self._saved)

    async def run(self) -> None:
        """Write after each change, until cancelled."""
        while True:
            await self.changed.wait()
            self.changed.clear()
            await self._save(None)

    async def aclose(self) -> None:
        """Write what has changed since, and leave the file to another daemon."""
        with contextlib.suppress(TimeoutError):  # of an earlier write
            async with asyncio.timeout(LAST_TIMEOUT_S):
                while self._thread.is_busy:  # noqa: ASYNC110 - the thread tells only its caller, who was cancelled
                    await asyncio.sleep(LAST_INTERVAL_S)
        await self._save(LAST_TIMEOUT_S)
        self._file.release()

    async def _save(self, timeout_s: float | None) -> None:
        current = self._current()
        if current == self._saved or not self._is_usable or self._thread.is_busy:
            return
        try:
            await self._thread.run(lambda: self._file.write(current), timeout_s=timeout_s)
        except (OSError, TimeoutError, ValueError) as error:  # ValueError: a path of a serial port that is not text
            self._warn(error)
        else:
            self._saved, self._has_failed = current, False

    def _warn(self, error: Exception) -> None:
        if not self._has_failed:
            self._has_failed = True
            reason = str(error) or "the disk does not answer"
            if isinstance(error, FolderTaken):
                reason = f"another daemon with this port keeps its {self._file.kind} there"
            event = f"{self._file.kind}.not_kept"
            log.warning(event, file=str(self._file.path), reason=reason, advice=self._advice)


@contextlib.asynccontextmanager
async def keeping(keeper: Keeper[Content], watch: Callable[[Callable[[], None]], None]) -> AsyncIterator[None]:
    """Keep something over restarts, for the length of a block. `watch` is given what to call at each change."""
    await keeper.open()
    watch(keeper.changed.set)
    try:
        async with meanwhile((keeper.kind, keeper.run())):
            yield
    finally:
        watch(lambda: None)
        await keeper.aclose()
