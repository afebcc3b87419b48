"""McapWriter: writes messages into one MCAP file, in chunks that are readable although the file is unfinished."""

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from hostlink.recording.channel import LIBRARY, LIBRARY_STEADY, Channel

CHUNK_BYTES = 64 * 1024  # compressing it takes 1.2 ms at most; 3.8 ms with the library's default of 1 MiB
MAX_CHANNELS = 8192  # of one file; channel numbers of the format have 16 bits
PROFILE = "ros1"


class McapWriter:
    """Writer of one file, for one thread. Messages are in the file after `end_chunk`; `close` adds the index.

    A message's `log_time` is wall time. Its `publish_time` is steady: it starts as wall time and continues by a clock
    that is never set. Every method raises the OSError of the file.
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
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, library=LIBRARY_STEADY if has_steady_times else LIBRARY)
        self._ids: dict[Channel, int] = {}
        self._schema_ids: dict[tuple[str, str], int] = {}
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
        self._writer.add_message(channel_id, stamp_ns, payload, publish_ns, self.messages)
        self.messages += 1
        return True

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Add metadata about the recording."""
        if metadata:
            self._writer.add_metadata("hostlink", dict(metadata))

    def end_chunk(self) -> None:
        """End the chunk, so that everything written so far can be read."""
        self._writer._Writer__finalize_chunk()  # type: ignore[attr-defined]  # noqa: SLF001 - it has no public name; a test holds it
        self.flush()

    def flush(self) -> None:
        """Flush to the operating system, or to the disk with `fsync`."""
        self._file.flush()
        self.last_size_bytes = self._file.tell()
        if self._fsync:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index and complete the file."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self.flush()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the unfinished file."""
        with contextlib.suppress(OSError):  # the buffer cannot be written either; the first error was raised already
            self._file.close()

    def announce(self, channel: Channel) -> int | None:
        """Add a channel without a message. Return its number; None if there are MAX_CHANNELS already."""
        channel_id = self._ids.get(channel)
        if channel_id is None and len(self._ids) < MAX_CHANNELS:
            return self._register(channel)
        return channel_id

    def _register(self, channel: Channel) -> int:
        key = (channel.type_name, channel.schema)
        if key not in self._schema_ids:
            data = channel.schema.encode()
            self._schema_ids[key] = self._writer.register_schema(channel.type_name, channel.schema_encoding, data)
        channel_id: int = self._writer.register_channel(
            channel.topic, channel.encoding, self._schema_ids[key], dict(channel.metadata)
        )
        self._ids[channel] = channel_id
        return channel_id
