"""Malicious files: wrong lengths, and data that expands without limit."""

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard

from hostlink.components.recorder.bags import RosFormat, export_ros
from hostlink.components.recorder.export import export_csv
from hostlink.components.recorder.reader import (
    MAX_CHUNK_BYTES,
    MAX_DEFINITION_BYTES,
    MAX_DEFINITIONS_BYTES,
    MAX_NAMED,
    McapReader,
    contents_of,
)
from hostlink.components.recorder.tables import MAX_COLUMNS, read
from hostlink.errors import RecordingFailed

MAGIC = b"\x89MCAP0\r\n"
HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, METADATA = 1, 3, 4, 5, 6, 12
LITTLE = 16 * 1024 * 1024
SEPARATOR = "=" * 80
JUNK_CHUNKS = 5_000
TEXT = "std_msgs/String"


def text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def record(opcode: int, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack("<BQ", opcode, len(body)) + body


def schema(number: int, name: str, definition: str) -> bytes:
    return record(SCHEMA, struct.pack("<H", number), text(name), text("ros1msg"), text(definition))


def channel(number: int, topic: str, encoding: str = "ros1") -> bytes:
    return record(CHANNEL, struct.pack("<HH", number, number), text(topic), text(encoding), struct.pack("<I", 0))


def message(number: int, payload: bytes, stamp_ns: int = 10**18) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", number, 0, stamp_ns, stamp_ns), payload)


def chunk(data: bytes, compression: str, claimed_bytes: int, crc: int = 0) -> bytes:
    sizes = struct.pack("<QQQI", 0, 0, claimed_bytes, crc)
    return record(CHUNK, sizes, text(compression), struct.pack("<Q", len(data)), data)


def file(folder: Path, *records: bytes) -> Path:
    path = folder / "hostile.mcap"
    end = record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    path.write_bytes(MAGIC + record(HEADER, text("ros1"), text("hostlink")) + b"".join(records) + end + MAGIC)
    return path


def one(folder: Path, definition: str, payload: bytes, *, encoding: str = "ros1", stamp_ns: int = 10**18) -> Path:
    """Write a file with one message."""
    parts = (schema(1, "a/A", definition), channel(1, "/x", encoding), message(1, payload, stamp_ns))
    return file(folder, *parts)


def peak_bytes(work: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def growing(compression: str) -> bytes:
    zeros = bytes(20 * LITTLE)
    return zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed_bytes", [1000, MAX_CHUNK_BYTES + 1])
def test_chunk_larger_than_its_stated_size_is_skipped(tmp_path: Path, compression: str, claimed_bytes: int) -> None:
    good = schema(1, TEXT, "string data") + channel(1, "/x") + message(1, text("a"))
    path = file(tmp_path, chunk(growing(compression), compression, claimed_bytes), good)
    reader = McapReader(path)
    assert peak_bytes(lambda: list(reader.messages())) < LITTLE
    assert len(reader.damage) == 1
    assert [each.payload for each in McapReader(path).messages()] == [text("a")]


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_every_compression_of_the_format_is_read(tmp_path: Path, compression: str) -> None:
    data = schema(1, TEXT, "string data") + channel(1, "/x") + message(1, text("a")) + message(1, text("b"))
    packed = {"": data, "zstd": zstandard.compress(data), "lz4": lz4.frame.compress(data)}[compression]
    reader = McapReader(file(tmp_path, chunk(packed, compression, len(data), zlib.crc32(data))))
    assert [each.payload for each in reader.messages()] == [text("a"), text("b")]
    assert reader.damage == []


@pytest.mark.parametrize(("compression", "crc"), [("zstd", 1), ("gzip", 0)])
def test_chunk_with_wrong_size_or_checksum_is_damage(tmp_path: Path, compression: str, crc: int) -> None:
    data = schema(1, TEXT, "string data") + channel(1, "/x") + message(1, text("a"))
    reader = McapReader(file(tmp_path, chunk(zstandard.compress(data), compression, len(data), crc)))
    assert list(reader.messages()) == []
    assert len(reader.damage) == 1


def test_of_many_damaged_chunks_a_few_are_named_and_the_others_counted(tmp_path: Path) -> None:
    good = schema(1, TEXT, "string data") + channel(1, "/x") + message(1, text("a"))
    path = file(tmp_path, *[chunk(b"junk", "zstd", 100)] * JUNK_CHUNKS, good)
    reader = McapReader(path)
    assert [each.payload for each in reader.messages()] == [text("a")]
    assert len(reader.damage) == MAX_NAMED + 1
    assert reader.damage[0].startswith("a chunk is damaged: ")
    assert reader.damage[-1] == f"{JUNK_CHUNKS - MAX_NAMED} other chunks or records are damaged"
    assert len(contents_of(path).damage) == MAX_NAMED + 1


@pytest.mark.slow
def test_chunk_of_many_messages_is_read_one_by_one(tmp_path: Path) -> None:
    data = schema(1, TEXT, "string data") + channel(1, "/x") + 40_000 * message(1, b"")
    path = file(tmp_path, chunk(zstandard.compress(data), "zstd", len(data)))
    assert peak_bytes(lambda: sum(1 for _ in McapReader(path).messages())) < LITTLE // 4


def metadata(name: str, value: str) -> bytes:
    values = text(name) + text(value)
    return record(METADATA, text("m"), struct.pack("<I", len(values)), values)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["schemas", "metadata"])
def test_expanded_definitions_and_metadata_are_bounded(tmp_path: Path, kind: str) -> None:
    """Each text is different, and every channel has it."""
    parts = []
    for number in range(1, 140):
        value = chr(ord("0") + number) * (MAX_DEFINITION_BYTES // 2 - 100)  # two bytes of UTF-8 beyond 127
        is_schema = kind == "schemas"
        define = schema(number, "a/A", value) + channel(number, "/x") if is_schema else metadata(f"{number}", value)
        parts.append(define + (message(number, b"{}") if is_schema else b""))
    groups = [b"".join(parts[at : at + 16]) for at in range(0, len(parts), 16)]
    path = file(tmp_path, *(chunk(zstandard.compress(data), "zstd", len(data)) for data in groups * 2))
    assert path.stat().st_size < LITTLE // 100
    reader = McapReader(path)
    assert peak_bytes(lambda: list(reader.messages())) < 12 * LITTLE
    assert sum(map(len, reader.metadata.values())) <= MAX_DEFINITIONS_BYTES
    if kind == "schemas":
        assert reader.metadata == {}
    assert reader.damage == [f"the definitions and metadata exceed {MAX_DEFINITIONS_BYTES} bytes; the rest is omitted"]


@pytest.mark.parametrize("is_in_chunk", [True, False])
def test_definition_or_metadata_larger_than_its_limit_is_omitted_and_named(
    tmp_path: Path, *, is_in_chunk: bool
) -> None:
    large = "x" * MAX_DEFINITION_BYTES
    parts = [
        schema(1, "a/A", "int8 a"), channel(1, "/x"), schema(2, "a/B", large), metadata("key", large),
        metadata("other", "kept"), message(1, b"a"),
    ]  # fmt: skip
    data = b"".join(parts)
    path = file(tmp_path, *([chunk(zstandard.compress(data), "zstd", len(data))] if is_in_chunk else parts))
    reader = McapReader(path)
    assert [each.payload for each in reader.messages()] == [b"a"]
    assert reader.metadata == {"other": "kept"}
    assert [each.partition(":")[0] for each in reader.damage] == ["a record is damaged"] * 2
    assert all("exceeds the limit of 1048576; it is omitted" in each for each in reader.damage)


def test_channels_of_one_schema_share_its_text(tmp_path: Path) -> None:
    many = [
        record(CHANNEL, struct.pack("<HH", n, 1), text(f"/{n}"), text("json"), struct.pack("<I", 0)) for n in range(99)
    ]
    data = b"".join([schema(1, "a/A", " " * LITTLE), *many])
    path = file(tmp_path, chunk(zstandard.compress(data), "zstd", len(data)))
    assert peak_bytes(lambda: contents_of(path)) < 8 * LITTLE


@pytest.mark.parametrize(
    "payload",
    [b"[" * 100_000 + b"]" * 100_000, b'{"a":' * 5000 + b"1" + b"}" * 5000, b'{"a":' + b"[" * 900 + b"]" * 900 + b"}"],
)
def test_endlessly_nested_json_is_undecodable(tmp_path: Path, payload: bytes) -> None:
    path = one(tmp_path, "{}", payload, encoding="json")
    assert read(path).undecoded == {"/x": 1}
    with pytest.raises(RecordingFailed, match="has no message to export"):
        export_csv(McapReader(path), tmp_path / "csv")


@pytest.mark.parametrize("number", [b'"x"', b"[]", b"null", b"9" * 400])
def test_json_resembling_a_time_keeps_its_fields(tmp_path: Path, number: bytes) -> None:
    path = one(tmp_path, "{}", b'{"at":{"secs":' + number + b',"nsecs":1}}', encoding="json")
    assert list(read(path)["/x"]) == ["at.secs", "at.nsecs"]
    assert export_csv(McapReader(path), tmp_path / "csv")[1] == {"x.csv": 1}


@pytest.mark.slow
def test_json_with_other_fields_in_each_message_is_a_table_of_bounded_width(tmp_path: Path) -> None:
    fields = [",".join(f'"{number}_{each}":1' for each in range(10)) for number in range(1500)]
    messages = [message(1, f"{{{each}}}".encode()) for each in fields]
    path = file(tmp_path, schema(1, "a/A", "{}"), channel(1, "/x", "json"), *messages)
    assert peak_bytes(lambda: read(path)) < 6 * LITTLE
    table = read(path)["/x"]
    assert (len(table), len(table.stamp_ns)) == (MAX_COLUMNS, 1500)


@pytest.mark.slow
def test_sparse_json_fields_need_memory_for_their_values_only(tmp_path: Path) -> None:
    """A full table of 8,000 rows and 2000 columns would have sixteen million values."""
    messages = [message(1, f'{{"{number % 2000}":{number},"all":1}}'.encode()) for number in range(8_000)]
    path = file(tmp_path, schema(1, "a/A", "{}"), channel(1, "/x", "json"), *messages)
    assert peak_bytes(lambda: read(path)) < 3 * LITTLE
    table = read(path)["/x"]
    assert (table["all"].dtype.kind, len(table), len(table["7"])) == ("i", 2001, 8_000)
    assert [(row, value) for row, value in enumerate(table["7"]) if value is not None][:2] == [(7, 7), (2007, 2007)]


@pytest.mark.slow
def test_thousand_csv_files_keep_no_buffer(tmp_path: Path) -> None:
    """The topics have the same file name, because they contain no letters."""
    channels = [channel(number, "/" + "$" * number, "json") + message(number, b"{}") for number in range(1, 1001)]
    path = file(tmp_path, *channels)
    assert peak_bytes(lambda: export_csv(McapReader(path), tmp_path / "csv")) < 2 * LITTLE
    names = {each.name for each in (tmp_path / "csv").iterdir()}
    assert names == {"topic.csv", *(f"topic_{number}.csv" for number in range(2, 1001))}


def test_half_a_surrogate_pair_is_written_as_one_character(tmp_path: Path) -> None:
    path = one(tmp_path, "{}", b'{"a\\ud800":"\\udc00"}', encoding="json")
    assert export_csv(McapReader(path), tmp_path / "csv")[1] == {"x.csv": 1}
    assert (tmp_path / "csv" / "x.csv").read_text().splitlines()[0] == "time_s,a?"


@pytest.mark.parametrize(
    ("definition", "payload"),
    [
        (f"B[] b\n{SEPARATOR}\nMSG: a/B\n", struct.pack("<I", 2**32 - 1)),
        ("uint8[4000000000] x", b"1"),
        ("A a", b""),
        (
            "".join(f"A{n} x\nA{n} y\n{SEPARATOR}\nMSG: a/A{n}\n" for n in range(1, 40)) + "uint8 z\n",
            b"1",
        ),
    ],
)
@pytest.mark.parametrize("format_", [RosFormat.ROS2_MCAP, RosFormat.ROS2_SQLITE])
def test_type_that_grows_without_end_is_left_out(
    tmp_path: Path, definition: str, payload: bytes, format_: RosFormat
) -> None:
    with pytest.raises(RecordingFailed, match="/x"):
        export_ros(McapReader(one(tmp_path, definition, payload)), tmp_path / "bag", format_)
    assert not (tmp_path / "bag").exists()


def test_time_beyond_any_clock_is_read(tmp_path: Path) -> None:
    path = one(tmp_path, "string data", text("a"), stamp_ns=2**64 - 1)
    assert contents_of(path).messages == 1
    assert read(path)["/x"].stamp_ns.tolist() == [2**63 - 1]


@pytest.mark.parametrize(("format_", "beyond_ns"), [(RosFormat.ROS1, 2**32 * 10**9), (RosFormat.ROS2_SQLITE, 2**63)])
def test_message_of_a_time_that_a_bag_cannot_have_is_left_out(
    tmp_path: Path, format_: RosFormat, beyond_ns: int
) -> None:
    parts = schema(1, TEXT, "string data"), channel(1, "/x"), message(1, text("a"), beyond_ns - 1)
    path = file(tmp_path, *parts, message(1, text("b"), beyond_ns))
    done = export_ros(McapReader(path), tmp_path / "bag", format_)
    assert (done.messages, list(done.left_out)) == (1, ["/x"])
