"""Reading MCAP files, also those that were never finished: a daemon was killed, a disk was full, a cable was pulled."""

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


class StoredMessage(NamedTuple):
    """One message of a file."""

    channel: Channel
    stamp_ns: int
    payload: bytes


class Reader:
    """Reads one file from its beginning to the end that it has; `damage` says what was wrong with it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[str] = []
        self.profile = ""
        self.metadata: dict[str, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

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
                    elif record.channel_id in self._channels:  # else its definition was in a damaged chunk
                        yield StoredMessage(self._channels[record.channel_id], record.log_time, record.data)
        except OSError as error:
            raise RecordingFailed(f"{self.path}: {error.strerror}") from error

    @property
    def channels(self) -> list[Channel]:
        """Those that were met so far, also without a message."""
        return list(dict.fromkeys(self._channels.values()))

    def _records(self, file: IO[bytes]) -> Iterator[McapRecord]:
        """What is in the file and in its chunks. A chunk that is damaged is left out, with what it contains."""
        records = StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records
        is_begun = False
        try:
            for record in records:
                is_begun = True
                yield from self._of_chunk(record) if isinstance(record, Chunk) else [record]
        except (McapError, ValueError, OverflowError, MemoryError, struct.error) as error:  # a length that is none
            if not is_begun:
                raise RecordingFailed(f"{self.path} is no MCAP file") from error
            is_cut = isinstance(error, EndOfFile)
            self.damage.append("it was never finished" if is_cut else f"unreadable from byte {file.tell()}: {error}")

    def _of_chunk(self, chunk: Chunk) -> Iterator[McapRecord]:
        try:
            yield from _records_in(_unpacked(chunk))
        except Exception as error:  # noqa: BLE001 - the library's and its decompressors', for damaged bytes
            self.damage.append(f"a chunk of it is damaged: {type(error).__name__}: {error}")

    def _note(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, McapChannel):
            self._channels[record.id] = _channel(record, self._schemas.get(record.schema_id))
        elif isinstance(record, Metadata):
            self.metadata |= record.metadata
        elif isinstance(record, Header):
            self.profile = record.profile


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


def _channel(record: McapChannel, schema: Schema | None) -> Channel:
    name, text = ("", "") if schema is None else (schema.name, schema.data.decode(errors="replace"))
    return Channel(record.topic, record.message_encoding, name, text, tuple(record.metadata.items()))
