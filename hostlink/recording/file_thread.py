"""FileThread: writes a recording off the event loop, in files that are split by size and time."""

import asyncio
import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from hostlink.recording.channel import Channel, note_newest
from hostlink.recording.mcap_writer import MAX_CHANNELS, McapWriter

MAX_WAITING_BYTES = 16 * 1024 * 1024  # of messages that the disk is too slow for; a new one is dropped over it
MESSAGE_BYTES = 200  # that a waiting message takes beside its payload
WRITE_INTERVAL_S = 0.05
CHUNK_INTERVAL_S = 0.7  # with the intervals of writing and of poses, on a busy machine: under a second is lost
MAX_ANNOUNCEMENTS = 16_384  # of topics that come and go; later channels begin with their first message
MAX_EXPECTED = MAX_CHANNELS // 2  # channels with which a file begins, the newest: others must have room
FULL_FILE_S = 60.0  # a file without room for a channel is ended no sooner: ten thousand topics at once are no end
BURST = 64  # messages between two looks at the clock; the loop gets the interpreter within half a millisecond
CLOSE_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class Splitting:
    """When a recording continues in another file."""

    max_file_bytes: int
    max_file_s: float
    fsync: bool = False


class _Waiting(NamedTuple):
    channel: Channel
    stamp_ns: int
    payload: bytes | None  # None: the channel is announced
    steady_ns: int


class FileThread:
    """`put`, `aclose` and the figures are for the loop's thread; the rest happens in a thread of its own.

    A file that cannot be written any more ends the recording: `failure` has the reason, `on_end` is called in the loop.
    """

    def __init__(
        self,
        path_of: Callable[[int], Path],
        splitting: Splitting,
        *,
        loop: asyncio.AbstractEventLoop,
        metadata: Mapping[str, str],
        on_end: Callable[[], None] = lambda: None,
        on_file: Callable[[], None] = lambda: None,
    ) -> None:
        """Make the first file, which may wait for the disk: not in the loop's own thread.

        `path_of` the file of that number, from 0; `on_file` is called in the thread before each file.

        Raises:
            OSError: the first file cannot be made.
        """
        self.messages = self.written_bytes = 0
        self._monotonic_to_steady_ns = time.time_ns() - time.monotonic_ns()  # the same in every file of the recording
        self._announcements = 0
        self._not_put = self._not_written = 0  # messages; each is counted by one thread
        self.has_no_room = False  # for a channel: its messages are dropped until the next file
        self.paths: list[Path] = []
        self.failure: str | None = None
        self._path_of, self._splitting, self._metadata = path_of, splitting, dict(metadata)
        self._on_end, self._on_file = on_end, on_file
        self._loop = loop
        self._waiting: deque[_Waiting] = deque()
        self._announced: dict[Channel, None] = {}
        self._put_bytes = self._taken_bytes = 0
        self._ending = threading.Event()
        self._is_discarded = False
        self._ended = asyncio.Event()
        self._files_bytes = 0  # of those before the present one
        self._begun_s = self._chunk_due_s = 0.0
        self._number = 0  # of the next file
        self._writer = self._open()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that are not in the file."""
        return self._not_put + self._not_written

    def announce(self, channel: Channel) -> None:
        """Every file has this channel from now on, also without a message, as long as it is among the newest."""
        self._announcements += 1
        if self._announcements <= MAX_ANNOUNCEMENTS:
            self._waiting.append(_Waiting(channel, 0, None, 0))

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str = "") -> None:  # noqa: ARG002 - of a Sink
        """Write it soon; dropped and counted while too much waits, or after the end."""
        size_bytes = len(payload) + MESSAGE_BYTES
        is_full = self._put_bytes - self._taken_bytes + size_bytes > MAX_WAITING_BYTES
        if is_full or self.failure is not None or self._ending.is_set():
            self._not_put += 1
            return
        self._put_bytes += size_bytes
        self._waiting.append(_Waiting(channel, stamp_ns, payload, time.monotonic_ns() + self._monotonic_to_steady_ns))

    async def aclose(self) -> None:
        """Write what waits and complete the file; a disk that takes nothing for CLOSE_TIMEOUT_S is left to itself."""
        self._ending.set()
        taken_bytes = -1
        while not self._ended.is_set() and self._taken_bytes > taken_bytes:
            taken_bytes = self._taken_bytes
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_TIMEOUT_S):
                    await self._ended.wait()
        if not self._ended.is_set():
            self.failure = self.failure or f"the disk has taken nothing of the rest for {CLOSE_TIMEOUT_S:g} s"

    def discard(self) -> None:
        """End it, and remove what it has written, without waiting."""
        self._is_discarded = True
        self._ending.set()

    # -- in the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ending.wait(WRITE_INTERVAL_S):
                self._write_waiting()
            self._write_waiting()
            self._writer.close()
            if self._is_discarded:
                for path in self.paths:
                    path.unlink(missing_ok=True)
        except Exception as error:  # noqa: BLE001 - whatever it is, it ends this recording and nothing else
            self.failure = _reason(error)
            self._writer.abandon()
            self._not_written += len(self._waiting)
            self._waiting.clear()
        finally:
            self.written_bytes = self._files_bytes + self._writer.last_size_bytes
            with contextlib.suppress(RuntimeError):  # the loop has ended and does not wait for a disk that stands still
                self._loop.call_soon_threadsafe(self._note_end)

    def _note_end(self) -> None:
        self._ended.set()
        self._on_end()

    def _write_waiting(self) -> None:
        while self._waiting:
            for _ in range(min(BURST, len(self._waiting))):
                channel, stamp_ns, payload, steady_ns = self._waiting.popleft()
                if payload is None:
                    self._expect(channel)
                else:
                    self._taken_bytes += len(payload) + MESSAGE_BYTES
                    is_written = self._write(channel, stamp_ns, payload, steady_ns)
                    self.messages += is_written
                    self._not_written += not is_written
            self._keep_time()
        self._keep_time()

    def _expect(self, channel: Channel) -> None:
        note_newest(self._announced, channel, MAX_EXPECTED)
        self._writer.announce(channel)

    def _write(self, channel: Channel, stamp_ns: int, payload: bytes, steady_ns: int) -> bool:
        """False: the file has no room for one more channel, and is too new to be ended."""
        if self._writer.write(channel, stamp_ns, payload, steady_ns):
            return True
        if time.monotonic() < self._begun_s + FULL_FILE_S:
            self.has_no_room = True
            return False
        self._begin_next()
        return self._writer.write(channel, stamp_ns, payload, steady_ns)

    def _begin_next(self) -> None:
        self._writer.close()
        self._files_bytes += self._writer.last_size_bytes
        self._writer = self._open()
        self.has_no_room = False

    def _keep_time(self) -> None:
        now_s = time.monotonic()
        if now_s < self._chunk_due_s:
            return
        self._chunk_due_s = now_s + CHUNK_INTERVAL_S
        self._writer.end_chunk()
        self.written_bytes = self._files_bytes + self._writer.last_size_bytes
        is_long = now_s > self._begun_s + self._splitting.max_file_s
        if is_long or self._writer.last_size_bytes > self._splitting.max_file_bytes or not self._writer.is_there:
            self._begin_next()

    def _open(self) -> McapWriter:
        self._on_file()
        writer = self._new_file()
        path = writer.path
        for channel in self._announced:
            writer.announce(channel)
        self.paths.append(path)
        self._begun_s = time.monotonic()
        self._chunk_due_s = self._begun_s + CHUNK_INTERVAL_S
        return writer

    def _new_file(self) -> McapWriter:
        """With its number; for a later file with the next that is free: the recording must not end for a name."""
        is_first = not self.paths
        while True:
            path = self._path_of(self._number)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._number += 1
            try:
                return McapWriter(path, metadata=self._metadata, fsync=self._splitting.fsync)
            except FileExistsError:
                if is_first:
                    raise


def _reason(error: Exception) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
