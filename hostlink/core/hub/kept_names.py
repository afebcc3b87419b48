"""File of robots' names: which robot was robot_0, for the next start of the daemon on this port."""

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import msgspec
import structlog

from hostlink.core.config import Config
from hostlink.core.hub.links import Links
from hostlink.core.robot.names import Remembered
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.core.runtime.detached import DetachedThread
from hostlink.core.runtime.folders import FolderOwner, FolderTaken, state_folder
from hostlink.core.runtime.whole_file import replace_file

log = structlog.get_logger()

FILE, DAMAGED = "names.json", "names.json.damaged"
MAX_FILE_BYTES = 4_000_000  # MAX_REMEMBERED names with long addresses
DISK_TIMEOUT_S = 5.0  # for reading at the start; a slower disk is not waited for
LAST_TIMEOUT_S = 0.5  # for writing at the end
LAST_INTERVAL_S = 0.01

Names = dict[str, Remembered]


def folder_of(config: Config) -> Path | None:
    """Return the folder of the names of a daemon with these settings; None if no device finds its next start.

    Each port has its own: two daemons on one computer have robots of their own.
    """
    port = config.tcp.port or (0 if config.udp is None else config.udp.port)
    if not port and not config.serial:
        return None
    return state_folder() / "names" / str(port)


class NamesFile:
    """The file, which belongs to one daemon at a time. Methods block, and raise the OSError of the disk."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE
        self._owner = FolderOwner(folder, "a daemon")
        self._turn = threading.Lock()
        self._has_ended = False

    def read(self) -> Names:
        """Return the names; none if there is no file. A damaged file is set aside."""
        with self._claimed():
            return self._read()

    def _read(self) -> Names:
        try:
            with self.path.open("rb") as file:
                data = file.read(MAX_FILE_BYTES + 1)
        except FileNotFoundError:
            return {}
        reason = f"it has more than {MAX_FILE_BYTES} bytes"
        if len(data) <= MAX_FILE_BYTES:
            try:
                return msgspec.json.decode(data, type=Names)
            except (msgspec.DecodeError, UnicodeDecodeError) as error:
                reason = str(error)
        aside = self.path.with_name(DAMAGED)
        self.path.replace(aside)
        log.warning("names.damaged", file=str(self.path), reason=reason, kept_as=str(aside))
        return {}

    def write(self, names: Names) -> None:
        """Write the whole file or nothing."""
        with self._claimed():
            replace_file(self.path, msgspec.json.encode(names))

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


class KeptNames:
    """Reads the names at the start of the daemon, and writes them after each change. Failures are logged once."""

    def __init__(self, links: Links, file: NamesFile) -> None:
        self._links, self._file = links, file
        self._thread = DetachedThread("names")
        self._saved: Names = {}
        self._changed = asyncio.Event()
        self._is_usable = True  # false: another daemon has the file, or the disk did not answer
        self._has_failed = False

    async def open(self) -> None:
        """Read the names. Robots that nothing names may have other names than before if that fails."""
        try:
            self._saved = await self._thread.run(self._file.read, timeout_s=DISK_TIMEOUT_S)
        except (OSError, TimeoutError) as error:
            self._is_usable = False
            self._warn(error)
            return
        self._links.remember(self._saved)
        self._links.on_named = self._changed.set

    async def run(self) -> None:
        """Write the names after each change, until cancelled."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            await self._save(None)

    async def aclose(self) -> None:
        """Write what has changed since, and leave the file to another daemon."""
        self._links.on_named = lambda: None
        with contextlib.suppress(TimeoutError):  # of an earlier write
            async with asyncio.timeout(LAST_TIMEOUT_S):
                while self._thread.is_busy:  # noqa: ASYNC110 - the thread tells only its caller, who was cancelled
                    await asyncio.sleep(LAST_INTERVAL_S)
        await self._save(LAST_TIMEOUT_S)
        self._file.release()

    async def _save(self, timeout_s: float | None) -> None:
        names = self._links.remembered
        if names == self._saved or not self._is_usable or self._thread.is_busy:
            return
        try:
            await self._thread.run(lambda: self._file.write(names), timeout_s=timeout_s)
        except (OSError, TimeoutError, ValueError) as error:  # ValueError: a path of a serial port that is not text
            self._warn(error)
        else:
            self._saved, self._has_failed = names, False

    def _warn(self, error: Exception) -> None:
        if not self._has_failed:
            self._has_failed = True
            reason = str(error) or "the disk does not answer"
            if isinstance(error, FolderTaken):
                reason = "another daemon with this port keeps its names there"
            advice = "give each robot its name in hostlink.toml: [robots.NAME] address = ..."
            log.warning("names.not_kept", file=str(self._file.path), reason=reason, advice=advice)


@contextlib.asynccontextmanager
async def kept_names(links: Links, file: NamesFile | None) -> AsyncIterator[None]:
    """Keep the names of robots over restarts, for the length of a block. Without a file, they are not kept."""
    if file is None:
        yield
        return
    names = KeptNames(links, file)
    await names.open()
    try:
        async with meanwhile(("names", names.run())):
            yield
    finally:
        await names.aclose()


def names_file(config: Config) -> NamesFile | None:
    """Return the file of the names of a daemon with these settings; None if it keeps none."""
    folder = folder_of(config)
    return None if folder is None else NamesFile(folder)
