"""Reading MCAP files, also those that were never finished: a daemon was killed, a disk was full, a cable was pulled."""

import contextlib
import itertools
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from hostlink.errors import RecordingFailed
from hostlink.recording.channel import Channel

MAX_RECORD_BYTES = 256 * 1024 * 1024  # a length that damage has made is not read into memory
MAX_CHUNK_BYTES = 64 * 1024 * 1024  # unpacked; those of other writers have a few MB
MAX_DEFINITIONS_BYTES = 64 * 1024 * 1024  # of schemas and channels, which are kept; a large one has a few kB
MAX_NAMED = 10  # damaged chunks; of the others the number alone is told
MAX_REASON = 200  # characters of a library's words for one
_DAMAGES = (McapError, ValueError, OverflowError, MemoryError, struct.error)  # of a length that is none


class StoredMessage(NamedTuple):
    """One message of a file."""

    channel: Channel
    stamp_ns: int
    payload: bytes


class Reader:
    """Reads one file from its beginning to the end that it has; `damage` says what was wrong with it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._damage: list[str] = []  # of the whole file
        self._chunks: list[str] = []  # why those that are named are damaged
        self._damaged_chunks = 0
        self.profile = ""
        self.metadata: dict[str, str] = {}
        self._schemas: dict[int, tuple[str, str]] = {}  # name, text
        self._channels: dict[int, Channel] = {}
        self._has_read_summary = False
        self._definitions_left_bytes = MAX_DEFINITIONS_BYTES

    def messages(self) -> Iterator[StoredMessage]:
        """Every message that can be read, in the order of writing.

        Raises:
            RecordingFailed: the file cannot be read, or is no MCAP file.
        """
        try:
            with self.path.open("rb") as file:
                for record in self._records(file):
                    if not isinstance(record, Message):
                        self._note(record)
                    elif record.channel_id in self._channels or self._finds_at_the_end(record.channel_id):
                        yield StoredMessage(self._channels[record.channel_id], record.log_time, record.data)
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror}") from error

    @property
    def damage(self) -> list[str]:
        """What was wrong with what was read so far; empty: nothing."""
        others = self._damaged_chunks - len(self._chunks)
        return [*self._chunks, *([f"{others} other chunks of it are damaged"] if others else []), *self._damage]

    @property
    def channels(self) -> list[Channel]:
        """Those that were met so far, also without a message."""
        return list(dict.fromkeys(self._channels.values()))

    def _records(self, file: IO[bytes]) -> Iterator[McapRecord]:
        """What is in the file and in its chunks. A chunk that is damaged is left out, with what it contains."""
        is_begun = False
        try:
            for record in stored_records(file):
                is_begun = True
                yield from self._of_chunk(record) if isinstance(record, Chunk) else [record]
        except _DAMAGES as error:
            if not is_begun:
                raise RecordingFailed(f"{self.path} is no MCAP file") from error
            is_cut = isinstance(error, EndOfFile)
            self._damage.append("it was never finished" if is_cut else f"unreadable from byte {file.tell()}: {error}")

    def _finds_at_the_end(self, channel_id: int) -> bool:
        """Whether the summary has a channel whose definition was in a damaged chunk; a cut file has no summary."""
        if not self._has_read_summary:
            self._has_read_summary = True
            with self.path.open("rb") as file, contextlib.suppress(*_DAMAGES):
                for record in stored_records(file):
                    is_missing = isinstance(record, McapChannel) and record.id not in self._channels
                    if isinstance(record, Schema) or is_missing:
                        self._note(record)
        return channel_id in self._channels

    def _of_chunk(self, chunk: Chunk) -> Iterator[McapRecord]:
        try:
            yield from _records_in(_unpacked(chunk))
        except Exception as error:  # noqa: BLE001 - the library's and its decompressors', for damaged bytes
            self._damaged_chunks += 1
            if self._damaged_chunks <= MAX_NAMED:
                self._chunks.append(f"a chunk of it is damaged: {type(error).__name__}: {error}"[:MAX_REASON])

    def _note(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            schema = record.name, record.data.decode(errors="replace")
            if self._schemas.get(record.id) != schema and self._has_room(*schema):
                self._schemas[record.id] = schema
        elif isinstance(record, McapChannel):
            channel = _channel(record, self._schemas.get(record.schema_id, ("", "")))
            is_new = self._channels.get(record.id) != channel
            if is_new and self._has_room(channel.topic, *itertools.chain.from_iterable(channel.metadata)):
                self._channels[record.id] = channel
        elif isinstance(record, Metadata):
            self.metadata |= record.metadata
        elif isinstance(record, Header):
            self.profile = record.profile

    def _has_room(self, *texts: str) -> bool:
        """For one more definition: they are kept, and a few bytes of a file can become many of them."""
        if self._definitions_left_bytes >= 0:
            self._definitions_left_bytes -= sum(map(len, texts))
            if self._definitions_left_bytes < 0:
                self._damage.append(
                    f"its definitions have more than {MAX_DEFINITIONS_BYTES} bytes: the rest is left out"
                )
        return self._definitions_left_bytes >= 0


def stored_records(file: IO[bytes]) -> Iterator[McapRecord]:
    """The records of a file, its chunks as they are stored.

    Raises:
        McapError: it is no MCAP file, or damaged.
    """
    yield from StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records


def _unpacked(chunk: Chunk) -> bytes:
    """Never more than it claims: a few bytes can become all that the memory has.

    Raises:
        ValueError: it is something else than it claims, or claims too much; or what the decompressor raises.
    """
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"it claims {size} bytes")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"its compression {chunk.compression[:20]!r} is unknown")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes{' or more' * (len(data) > size)} and claims {size}")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("its checksum is another")
    return data


def _records_in(data: bytes) -> Iterator[McapRecord]:
    """One by one: millions of them may be in a chunk."""
    stream = ReadDataStream(BytesIO(data))
    while stream.count < len(data):
        opcode, length = stream.read1(), stream.read8()
        if opcode == Opcode.CHANNEL:
            yield McapChannel.read(stream)
        elif opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(stream)
        else:
            stream.read(length)


def _channel(record: McapChannel, schema: tuple[str, str]) -> Channel:
    return Channel(record.topic, record.message_encoding, *schema, tuple(record.metadata.items()))
