"""McapWriter: messages into one MCAP file, in chunks of which each can be read when the next was never written."""

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from hostlink.recording.channel import LIBRARY, LIBRARY_STEADY, Channel

CHUNK_BYTES = 64 * 1024  # 1.2 ms of compression at most, as measured; 3.8 with the library's 1 MiB
MAX_CHANNELS = 8192  # of a file; the numbers of the format have 16 bits
PROFILE = "ros1"


class McapWriter:
    """Not for two threads. What it has written is in the file after `end_chunk`; without `close` only the index lacks.

    A message's `log_time` is wall time. Its `publish_time` is steady: it begins as wall time and counts on by a clock
    that is never set. Every method raises the OSError of the file.
    """

    def __init__(
        self, path: Path, *, metadata: Mapping[str, str], fsync: bool = False, has_steady_times: bool = True
    ) -> None:
        """Make a new file.

        `metadata`: about the recording; `fsync`: a chunk that was ended survives a power cut, too;
        `has_steady_times`: False for messages of a file that has wall times alone.

        Raises:
            OSError: there is a file of that name, or none can be written there.
        """
        self.path = path
        self.messages = self.last_size_bytes = 0  # the file's size as of the last flush
        self._fsync = fsync
        self._file = path.open("xb")
        with contextlib.suppress(OSError):  # a folder of another computer may have no locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # whoever repairs files leaves this one alone
        self._inode = os.fstat(self._file.fileno()).st_ino
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, library=LIBRARY_STEADY if has_steady_times else LIBRARY)
        self._ids: dict[Channel, int] = {}
        self._schema_ids: dict[tuple[str, str], int] = {}
        self.add_metadata(metadata)
        self.flush()

    @property
    def is_there(self) -> bool:
        """Whether the file still has its name: what is written to a removed one is lost at its end."""
        try:
            return self.path.stat().st_ino == self._inode
        except OSError:
            return False

    def write(self, channel: Channel, stamp_ns: int, payload: bytes, steady_ns: int | None = None) -> bool:
        """Add a message to the chunk; False: the file has no room for one more channel.

        `steady_ns`: when it arrived, by a clock that is never set; None: as `stamp_ns`.
        """
        channel_id = self.announce(channel)
        if channel_id is None:
            return False
        publish_ns = stamp_ns if steady_ns is None else max(steady_ns, 0)
        self._writer.add_message(channel_id, stamp_ns, payload, publish_ns, self.messages)
        self.messages += 1
        return True

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Facts about the recording."""
        if metadata:
            self._writer.add_metadata("hostlink", dict(metadata))

    def end_chunk(self) -> None:
        """What was written can be read from now on."""
        self._writer._Writer__finalize_chunk()  # type: ignore[attr-defined]  # noqa: SLF001 - it has no public name; a test holds it
        self.flush()

    def flush(self) -> None:
        """To the operating system, or to the disk."""
        self._file.flush()
        self.last_size_bytes = self._file.tell()
        if self._fsync:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index; the file is complete."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self.flush()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is: nothing more can be written."""
        with contextlib.suppress(OSError):  # its buffer cannot be written either; the first error was raised already
            self._file.close()

    def announce(self, channel: Channel) -> int | None:
        """Its number in the file; a reader knows of it from now on. None: there are MAX_CHANNELS already."""
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
