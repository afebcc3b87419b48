"""Writers of MCAP files: one file in chunks that are readable while it is unfinished, and the thread that writes it."""

import asyncio
import contextlib
import fcntl
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from hostlink.components.recorder import mcap_format
from hostlink.components.recorder.channel import LIBRARY, LIBRARY_STEADY, Channel, note_newest
from hostlink.components.recorder.mcap_format import (
    CHANNEL_OFFSET,
    MAGIC,
    STATISTICS,
    U16,
    U32,
    U64,
    Opcode,
    record,
    text,
    texts,
)

CHUNK_BYTES = 64 * 1024  # compressing it takes 1.2 ms at most; 3.8 ms with 1 MiB, which is usual
MAX_CHANNELS = 8192  # of one file; channel numbers of the format have 16 bits
PROFILE = "ros1"
# Kinds of records that the end of a file repeats or lists, in their order there.
_SUMMARY = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.METADATA_INDEX)

MAX_WAITING_BYTES = 16 * 1024 * 1024  # waiting messages on a slow disk; further ones are dropped
MESSAGE_BYTES = 200  # memory of a waiting message besides its payload
WRITE_INTERVAL_S = 0.05
CHUNK_INTERVAL_S = 0.7  # together with the write and pose intervals less than a second is lost on a busy machine
MAX_ANNOUNCEMENTS = 16_384  # bounds short-lived topics; later channels are added with their first message
MAX_EXPECTED = MAX_CHANNELS // 2  # channels at the start of each file, the newest: there must be room for others
# A file whose channels are used up is ended no sooner, so that ten thousand topics at once cause few files.
FULL_FILE_S = 60.0
BURST = 64  # messages between two checks of the clock; the loop waits at most half a millisecond for the interpreter
CLOSE_TIMEOUT_S = 2.0


class McapWriter:
    """Writer of one file, for one thread. Messages are in the file after `end_chunk`; `close` adds the index.

    A chunk ends by itself above CHUNK_BYTES. A channel or schema is in the file with the next chunk that has a message,
    and in the index. A message's `log_time` is wall time. Its `publish_time` is steady: it starts as wall time and
    continues by a clock that is never set. Every method raises the OSError of the file.
    """

    def __init__(
        self, path: Path, *, metadata: Mapping[str, str], fsync: bool = False, has_steady_times: bool = True
    ) -> None:
        """Create a new file.

        `metadata` describes the recording. `fsync`: an ended chunk survives a power failure. `has_steady_times`: False
        for messages of a file that has only wall times.

        Raises:
            OSError: the file exists or cannot be written.
        """
        self.path = path
        self.messages = self.last_size_bytes = 0  # file size after the last flush
        self._fsync = fsync
        self._file = path.open("xb")
        with contextlib.suppress(OSError):  # a network file system may not support locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # a repair skips a locked file
        self._inode = os.fstat(self._file.fileno()).st_ino
        self._chunk = mcap_format.Chunk()
        self._summary: dict[Opcode, list[bytes]] = {opcode: [] for opcode in _SUMMARY}
        self._ids: dict[Channel, int] = {}
        self._schema_ids: dict[tuple[str, str, str], int] = {}
        self._counts = Counter[int]()  # messages by channel
        self._first_ns, self._last_ns = 2**64, 0  # times of the messages in the file
        library = LIBRARY_STEADY if has_steady_times else LIBRARY
        self._file.write(MAGIC + record(Opcode.HEADER, text(PROFILE), text(library)))
        self.add_metadata(metadata)
        self.flush()

    @property
    def is_there(self) -> bool:
        """Whether the file still has its name. Data written to a removed file is lost when it is closed."""
        try:
            return self.path.stat().st_ino == self._inode
        except OSError:
            return False

    def write(self, channel: Channel, stamp_ns: int, payload: bytes, steady_ns: int | None = None) -> bool:
        """Add a message to the chunk. False: the file has no free channel number.

        `steady_ns` is the arrival time by a clock that is never set; None uses `stamp_ns`.
        """
        channel_id = self.announce(channel)
        if channel_id is None:
            return False
        publish_ns = stamp_ns if steady_ns is None else max(steady_ns, 0)
        self._chunk.add_message(channel_id, self.messages, stamp_ns, publish_ns, payload)
        self._counts[channel_id] += 1
        self.messages += 1
        self._write_full_chunk()
        return True

    def announce(self, channel: Channel) -> int | None:
        """Add a channel without a message. Return its number; None if there are MAX_CHANNELS already."""
        channel_id = self._ids.get(channel)
        if channel_id is None and len(self._ids) < MAX_CHANNELS:
            channel_id = self._ids[channel] = len(self._ids) + 1
            numbers = U16.pack(channel_id) + U16.pack(self._schema_id(channel))
            facts = text(channel.topic), text(channel.encoding), texts(dict(channel.metadata))
            self._define(Opcode.CHANNEL, numbers, *facts)
        return channel_id

    def _schema_id(self, channel: Channel) -> int:
        key = channel.type_name, channel.schema, channel.schema_encoding
        if key not in self._schema_ids:
            number = self._schema_ids[key] = len(self._schema_ids) + 1
            content = channel.type_name, channel.schema_encoding, channel.schema
            self._define(Opcode.SCHEMA, U16.pack(number), *map(text, content))
        return self._schema_ids[key]

    def _define(self, opcode: Opcode, *parts: bytes) -> None:
        """Add a schema or a channel."""
        definition = record(opcode, *parts)
        self._summary[opcode].append(definition)
        self._chunk.data += definition
        self._write_full_chunk()

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Write values that describe the file, at once."""
        if metadata:
            name, begin = text("hostlink"), self._file.tell()
            written = record(Opcode.METADATA, name, texts(metadata))
            index = record(Opcode.METADATA_INDEX, U64.pack(begin), U64.pack(len(written)), name)
            self._summary[Opcode.METADATA_INDEX].append(index)
            self._file.write(written)

    def end_chunk(self) -> None:
        """End the chunk, so that everything written so far can be read. A chunk without a message is not written."""
        self._write_chunk()
        self.flush()

    def _write_full_chunk(self) -> None:
        if len(self._chunk.data) > CHUNK_BYTES:
            self._write_chunk()

    def _write_chunk(self) -> None:
        if self._chunk:
            chunk, index = self._chunk.records(self._file.tell())
            self._file.write(chunk)
            self._summary[Opcode.CHUNK_INDEX].append(index)
            self._first_ns = min(self._first_ns, self._chunk.first_ns)
            self._last_ns = max(self._last_ns, self._chunk.last_ns)
            self._chunk = mcap_format.Chunk()

    def flush(self) -> None:
        """Flush to the operating system, or to the disk with `fsync`."""
        self._file.flush()
        self.last_size_bytes = self._file.tell()
        if self._fsync:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index and complete the file."""
        try:
            self._write_chunk()
            self._summary[Opcode.STATISTICS].append(self._statistics())
            self._file.write(mcap_format.file_end(self._file.tell(), self._summary))
            self.flush()
        finally:
            self._file.close()

    def _statistics(self) -> bytes:
        schemas, channels, _, chunks, metadata = map(len, self._summary.values())
        head = STATISTICS.pack(self.messages, schemas, channels, 0, metadata, chunks)
        times = U64.pack(self._first_ns if self.messages else 0) + U64.pack(self._last_ns)
        of_channels = b"".join(CHANNEL_OFFSET.pack(*item) for item in self._counts.items())
        return record(Opcode.STATISTICS, head, times, U32.pack(len(of_channels)), of_channels)

    def abandon(self) -> None:
        """Close the unfinished file."""
        with contextlib.suppress(OSError):  # the buffer cannot be written either; the first error was raised already
            self._file.close()


class _QueuedMessage(NamedTuple):
    channel: Channel
    stamp_ns: int
    payload: bytes | None  # None announces the channel
    steady_ns: int


class FileThread:
    """Writer thread of one recording. `put`, `aclose` and the counters belong to the loop's thread.

    A file that can no longer be written ends the recording: `failure` has the reason, `on_end` is called in the loop.
    """

    def __init__(
        self,
        path_of: Callable[[int], Path],
        *,
        loop: asyncio.AbstractEventLoop,
        metadata: Mapping[str, str],
        max_file_bytes: int,
        max_file_s: float,
        fsync: bool = False,
        on_end: Callable[[], None] = lambda: None,
        on_file: Callable[[], None] = lambda: None,
        on_removed: Callable[[Path, int], None] = lambda _path, _messages: None,
    ) -> None:
        """Create the first file. It may wait for the disk, so do not call it in the loop's thread.

        `path_of` returns the path of a file by its number, from 0; `on_file` is called in the thread before each file.
        The recording continues in another file above `max_file_bytes` or `max_file_s`, and when another program removed
        the file: then `on_removed` is called in the loop with its path and the number of messages that are lost.

        Raises:
            OSError: the first file cannot be created.
        """
        self.messages = self.written_bytes = 0
        self.lost = 0  # of the messages: those in files that another program removed
        # The same offset in every file of the recording.
        self._monotonic_to_steady_ns = time.time_ns() - time.monotonic_ns()
        self._announcements = 0
        self._not_put = self._not_written = 0  # messages; each counter is written by one thread
        # The file has no free channel number; messages of further channels are dropped until the next file.
        self.has_no_room = False
        self.paths: list[Path] = []
        self.failure: str | None = None
        self._path_of, self._metadata, self._fsync = path_of, dict(metadata), fsync
        self._max_file_bytes, self._max_file_s = max_file_bytes, max_file_s
        self._on_end, self._on_file, self._on_removed = on_end, on_file, on_removed
        self._loop = loop
        self._waiting: deque[_QueuedMessage] = deque()
        self._announced: dict[Channel, None] = {}
        self._put_bytes = self._taken_bytes = 0
        self._ending = threading.Event()
        self._is_discarded = False
        self._ended = asyncio.Event()
        self._files_bytes = 0  # of the earlier files
        self._begun_s = self._chunk_due_s = 0.0
        self._number = 0  # of the next file
        self._writer = self._open()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of messages that are not in the files."""
        return self._not_put + self._not_written + self.lost

    def announce(self, channel: Channel) -> None:
        """Add a channel to every file from now on, as long as it is among the newest."""
        self._announcements += 1
        if self._announcements <= MAX_ANNOUNCEMENTS:
            self._waiting.append(_QueuedMessage(channel, 0, None, 0))

    def put(self, channel: Channel, stamp_ns: int, payload: bytes, robot: str = "") -> None:  # noqa: ARG002 - of a Sink
        """Queue a message. Drop and count it when the queue is full, or after the end."""
        size_bytes = len(payload) + MESSAGE_BYTES
        is_full = self._put_bytes - self._taken_bytes + size_bytes > MAX_WAITING_BYTES
        if is_full or self.failure is not None or self._ending.is_set():
            self._not_put += 1
            return
        self._put_bytes += size_bytes
        self._waiting.append(
            _QueuedMessage(channel, stamp_ns, payload, time.monotonic_ns() + self._monotonic_to_steady_ns)
        )

    async def aclose(self) -> None:
        """Write what is queued and complete the file. Give up when the disk accepts nothing for CLOSE_TIMEOUT_S."""
        self._ending.set()
        taken_bytes = -1
        while not self._ended.is_set() and self._taken_bytes > taken_bytes:
            taken_bytes = self._taken_bytes
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_TIMEOUT_S):
                    await self._ended.wait()
        if not self._ended.is_set():
            self.failure = self.failure or f"the disk accepted no data for {CLOSE_TIMEOUT_S:g} s"

    def discard(self) -> None:
        """End the recording and remove its files, without waiting."""
        self._is_discarded = True
        self._ending.set()

    # -- in the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ending.wait(WRITE_INTERVAL_S):
                self._write_waiting()
            self._write_waiting()
            self._end_file()
            if self._is_discarded:
                for path in self.paths:
                    path.unlink(missing_ok=True)
        except Exception as error:  # noqa: BLE001 - any error ends this recording only
            self.failure = _reason(error)
            self._writer.abandon()
            self._not_written += len(self._waiting)
            self._waiting.clear()
        finally:
            self.written_bytes = self._files_bytes + self._writer.last_size_bytes
            with contextlib.suppress(RuntimeError):  # the loop has ended without waiting for a blocked disk
                self._loop.call_soon_threadsafe(self._note_end)

    def _note_end(self) -> None:
        self._ended.set()
        self._on_end()

    def _write_waiting(self) -> None:
        while self._waiting:
            for _ in range(min(BURST, len(self._waiting))):
                channel, stamp_ns, payload, steady_ns = self._waiting.popleft()
                if payload is None:
                    note_newest(self._announced, channel, MAX_EXPECTED)
                    self._writer.announce(channel)
                else:
                    self._taken_bytes += len(payload) + MESSAGE_BYTES
                    is_written = self._write(channel, stamp_ns, payload, steady_ns)
                    self.messages += is_written
                    self._not_written += not is_written
            self._keep_time()
        self._keep_time()

    def _write(self, channel: Channel, stamp_ns: int, payload: bytes, steady_ns: int) -> bool:
        """Write a message. False: the file has no free channel number and is too new to be ended."""
        if self._writer.write(channel, stamp_ns, payload, steady_ns):
            return True
        if time.monotonic() < self._begun_s + FULL_FILE_S:
            self.has_no_room = True
            return False
        self._begin_next()
        return self._writer.write(channel, stamp_ns, payload, steady_ns)

    def _end_file(self) -> None:
        """Complete the file; if another program removed it, report that and count its messages as dropped."""
        if self._writer.is_there:
            self._writer.close()
            return
        path, messages = self._writer.path, self._writer.messages
        self._writer.abandon()
        self.paths.remove(path)
        self.lost += messages
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._on_removed, path, messages)

    def _begin_next(self) -> None:
        self._end_file()
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
        is_long = now_s > self._begun_s + self._max_file_s
        if is_long or self._writer.last_size_bytes > self._max_file_bytes or not self._writer.is_there:
            self._begin_next()

    def _open(self) -> McapWriter:
        """Create the next file. A later file skips numbers in use, because a name must not end the recording."""
        self._on_file()
        while True:
            path = self._path_of(self._number)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._number += 1
            try:
                writer = McapWriter(path, metadata=self._metadata, fsync=self._fsync)
            except FileExistsError:
                if self._number == 1:
                    raise
            else:
                break
        for channel in self._announced:
            writer.announce(channel)
        self.paths.append(path)
        self._begun_s = time.monotonic()
        self._chunk_due_s = self._begun_s + CHUNK_INTERVAL_S
        return writer


def _reason(error: Exception) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
