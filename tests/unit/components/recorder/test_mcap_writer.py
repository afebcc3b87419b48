"""McapWriter: its files as other programs read them, finished and unfinished."""

import contextlib
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from hostlink.components.recorder.channel import CDR, EVENTS, Channel, as_text, ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.components.recorder.reader import McapReader, StoredMessage
from hostlink.components.recorder.salvage import Repaired, repair
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import RecordingFailed

CATALOG = Catalog()
POSE, TEXT = (CATALOG.message(name) for name in ("geometry_msgs/Pose2D", "std_msgs/String"))
CHANNELS = [
    ros_channel("/robot_0/odometry", "geometry_msgs/Pose2D", POSE, is_latched=False),
    ros_channel("/chat", "std_msgs/String", TEXT, is_latched=True),
    ros_channel("/mystery", "my_msgs/Unknown", None, is_latched=False),
    ros_channel("/board", "my_msgs/Unknown", None, is_latched=False, encoding=CDR),
    EVENTS,
]


def drawn(count: int, seed: int = 1) -> list[StoredMessage]:
    """Return messages of all channels; the clock is set back halfway."""
    random_ = random.Random(seed)
    stamps = [10**18 + 10**9 * (number if number < count // 2 else number - 5) for number in range(count)]
    return [
        StoredMessage(
            random_.choice(CHANNELS), stamp_ns, random_.randbytes(random_.choice((0, 3, 24, 700))), 10**18 + number
        )
        for number, stamp_ns in enumerate(stamps)
    ]


def write(path: Path, messages: list[StoredMessage], *, chunk_of: int = 50, is_finished: bool = True) -> list[int]:
    """Write them. Return the number of messages at each file size, one for each chunk."""
    writer = McapWriter(path, metadata={"owner": "test"})
    sizes = []
    for number, message in enumerate(messages, 1):
        writer.write(*message)
        if number % chunk_of == 0:
            writer.end_chunk()
            sizes.append(writer.last_size_bytes)
    if is_finished:
        writer.close()
    else:
        writer.abandon()
    return sizes


def test_written_messages_are_read_in_order(tmp_path: Path) -> None:
    messages = drawn(500)
    write(tmp_path / "a.mcap", messages)
    reader = McapReader(tmp_path / "a.mcap")
    assert list(reader.messages()) == messages
    assert (reader.damage, reader.profile, reader.metadata) == ([], "ros1", {"owner": "test"})


def test_librarys_seeking_reader_reads_it_by_its_index(tmp_path: Path) -> None:
    messages = drawn(500)
    write(tmp_path / "a.mcap", messages)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        found = [(channel.topic, message.data) for _, channel, message in reader.iter_messages(log_time_order=False)]
    assert summary.statistics.message_count == 500
    assert {channel.topic for channel in summary.channels.values()} == {channel.topic for channel in CHANNELS}
    assert found == [(message.channel.topic, message.payload) for message in messages]


def test_schema_has_all_that_its_type_contains(tmp_path: Path) -> None:
    odometry = CATALOG.message("nav_msgs/Odometry")
    channel = ros_channel("/odom", "nav_msgs/Odometry", odometry, is_latched=False)
    write(tmp_path / "a.mcap", [StoredMessage(channel, 1, b"", 1)])
    (message,) = McapReader(tmp_path / "a.mcap").messages()
    assert "MSG: geometry_msgs/PoseWithCovariance" in message.channel.schema
    assert dict(message.channel.metadata)["md5sum"] == odometry.md5


def test_cdr_without_a_definition_has_its_ros_2_name_and_no_schema_for_other_programs(tmp_path: Path) -> None:
    """With the schema encoding ros2msg, an empty schema would be a message without fields."""
    write(tmp_path / "a.mcap", [StoredMessage(channel, 1, b"\0\1\0\0x", 1) for channel in CHANNELS])
    with (tmp_path / "a.mcap").open("rb") as file:
        found = {
            channel.topic: (channel.message_encoding, schema.name, schema.encoding, schema.data, message.data)
            for schema, channel, message in make_reader(file).iter_messages()
        }
    assert found["/board"] == ("cdr", "my_msgs/msg/Unknown", "", b"", b"\0\1\0\0x")
    assert found["/mystery"][:4] == ("ros1", "my_msgs/Unknown", "ros1msg", b"")


def test_each_ended_chunk_of_a_file_that_is_never_finished_can_be_read(tmp_path: Path) -> None:
    messages = drawn(130)
    write(tmp_path / "a.mcap", messages, is_finished=False)
    reader = McapReader(tmp_path / "a.mcap")
    assert list(reader.messages()) == messages[:100]
    assert reader.damage == ["the file was not finished"]


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_file_that_is_cut_anywhere_gives_every_chunk_before_the_cut(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path, messages = tmp_path_factory.mktemp("cut") / "a.mcap", drawn(300)
    sizes = write(path, messages)
    whole = path.read_bytes()
    cut = data.draw(st.integers(sizes[0], len(whole)))
    path.write_bytes(whole[:cut])
    found = list(McapReader(path).messages())
    assert found == messages[: len(found)]
    assert len(found) >= 50 * sum(size <= cut for size in sizes)
    repaired = repair(path)
    assert repaired.messages == len(found)
    reader = McapReader(path)
    assert list(reader.messages()) == found
    assert reader.damage == []
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damaged_file_gives_messages_that_were_written_and_no_traceback(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path, messages = tmp_path_factory.mktemp("damaged") / "a.mcap", drawn(300)
    write(path, messages)
    damaged = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        damaged[data.draw(st.integers(8, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(damaged)
    payloads = {message.payload for message in messages}
    with contextlib.suppress(RecordingFailed):  # cut in the first record: not a recording
        for found in McapReader(path).messages():
            assert found.payload in payloads


def test_damaged_chunk_loses_its_messages_but_no_channel(tmp_path: Path) -> None:
    path, messages = tmp_path / "a.mcap", drawn(300)
    sizes = write(path, messages)
    damaged = bytearray(path.read_bytes())
    damaged[sizes[0] // 2] ^= 0xFF  # in the first chunk, which has every definition
    path.write_bytes(damaged)
    assert list(McapReader(path).messages()) == messages[50:]
    assert repair(path).messages == 250
    assert list(McapReader(path).messages()) == messages[50:]


def test_damaged_metadata_costs_no_message_and_repair_keeps_the_original(tmp_path: Path) -> None:
    path, messages = tmp_path / "a.mcap", drawn(100)
    writer = McapWriter(path, metadata={"note": "hello"})
    for message in messages:
        writer.write(*message)
    writer.close()
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(b"hello")] = 0xFF  # not UTF-8
    path.write_bytes(damaged)
    assert list(McapReader(path).messages()) == messages
    repaired = repair(path)
    assert (repaired.messages, repaired.original) == (100, tmp_path / "a.mcap.damaged")
    assert (tmp_path / "a.mcap.damaged").read_bytes() == damaged
    assert list(McapReader(path).messages()) == messages


def test_damaged_length_of_an_indexed_chunk_costs_only_that_chunk(tmp_path: Path) -> None:
    path, messages = tmp_path / "a.mcap", drawn(300)
    sizes = write(path, messages)
    damaged = bytearray(path.read_bytes())
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    damaged[summary.chunk_indexes[1].chunk_start_offset + 7] ^= 0x40  # a high byte of the length
    path.write_bytes(damaged)
    found = list(McapReader(path).messages())
    assert len(found) >= len(messages) - 100
    assert len(sizes) > 2


def test_repairing_a_whole_file_leaves_its_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", drawn(100))
    before = (tmp_path / "a.mcap").read_bytes()
    assert repair(tmp_path / "a.mcap").damage == ()
    assert (tmp_path / "a.mcap").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"no recording at all" * 100])
def test_file_that_is_not_a_recording_is_refused_and_unchanged(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingFailed, match="is not an MCAP file"):
        repair(path)
    assert path.read_bytes() == content
    assert [each.name for each in tmp_path.iterdir()] == ["a.mcap"]


def test_folder_is_not_repaired(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RecordingFailed, match=r"^\.: Is a directory$"):
        repair(Path())


def test_file_that_is_being_written_is_not_repaired(tmp_path: Path) -> None:
    path, messages = tmp_path / "a.mcap", drawn(100)
    writer = McapWriter(path, metadata={})
    for message in messages[:50]:
        writer.write(*message)
    writer.end_chunk()
    with pytest.raises(RecordingFailed, match="is being written: stop the recording first"):
        repair(path)
    for message in messages[50:]:
        writer.write(*message)
    writer.close()
    assert repair(path) == Repaired(100, ())
    assert list(McapReader(path).messages()) == messages


def test_missing_file_is_reported_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingFailed, match="No such file"):
        list(McapReader(tmp_path / "a.mcap").messages())


def test_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [])
    with pytest.raises(FileExistsError):
        McapWriter(tmp_path / "a.mcap", metadata={})


def test_file_that_was_removed_or_replaced_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, metadata={})
    assert writer.is_there
    path.unlink()
    assert not writer.is_there
    path.write_bytes(b"another")
    assert not writer.is_there
    writer.abandon()


def test_channels_are_values() -> None:
    again = ros_channel("/chat", "std_msgs/String", TEXT, is_latched=True)
    assert again == CHANNELS[1]
    assert hash(again) == hash(CHANNELS[1])
    assert isinstance(again, Channel)


def test_channel_without_a_message_is_in_the_file_and_in_a_repaired_one(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, metadata={})
    writer.announce(CHANNELS[0])
    writer.write(CHANNELS[1], 1, b"")
    writer.end_chunk()
    writer.abandon()
    for _ in range(2):
        reader = McapReader(path)
        assert len(list(reader.messages())) == 1
        assert set(reader.channels) == set(CHANNELS[:2])
        repair(path)


@pytest.mark.parametrize(("profile", "encoding"), [("ros2", "cdr"), ("", "protobuf"), ("ros1", "cbor")])
def test_damaged_file_of_another_program_is_unchanged(tmp_path: Path, profile: str, encoding: str) -> None:
    """Schemas of another program may be in any language and would be lost when rewritten."""
    path = tmp_path / "theirs.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile, library="theirs")
        schema_id = writer.register_schema("a/A", "protobuf", b"\xff\x00")
        writer.add_message(writer.register_channel("/a", encoding, schema_id), 1, b"payload", 1)
        writer.finish()
    before = path.read_bytes()[:-20]
    path.write_bytes(before)
    with pytest.raises(RecordingFailed, match="another program"):
        repair(path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["theirs.mcap"]


def test_repair_keeps_a_long_pause_of_another_programs_file(tmp_path: Path) -> None:
    path, pause_ns = tmp_path / "theirs.mcap", 2 * 3600 * 10**9
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros1", library="theirs")
        schema_id = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        channel_id = writer.register_channel("/a", "ros1", schema_id)
        for number in range(2):
            writer.add_message(channel_id, 10**18 + number * pause_ns, as_text(b"a"), 10**18)
        writer.finish()
    path.write_bytes(path.read_bytes()[:-20])
    for _ in range(2):
        first, last = (message.steady_ns for message in McapReader(path).messages())
        assert last - first == pause_ns
        repair(path)


@pytest.mark.parametrize(
    ("change", "damage"),
    [
        (lambda data: data[:-3], "the file was not finished"),
        (lambda data: data[:-8], "the file was not finished"),
        (lambda data: data[:-8] + b"\x89MCAP0\r\r", "it does not end as an MCAP file does"),
        (lambda data: data, None),
    ],
)
def test_end_of_a_file_that_is_cut_is_another_damage_than_a_wrong_one(
    tmp_path: Path, change: Callable[[bytes], bytes], damage: str | None
) -> None:
    messages = drawn(100)
    write(tmp_path / "a.mcap", messages)
    (tmp_path / "b.mcap").write_bytes(change((tmp_path / "a.mcap").read_bytes()))
    reader = McapReader(tmp_path / "b.mcap")
    assert list(reader.messages()) == messages
    assert len(reader.damage) == (damage is not None)
    assert damage is None or damage in reader.damage[0]


def test_repair_of_a_file_without_a_readable_message_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, metadata={"robot": "robot_0"})
    writer.close()
    path.write_bytes(path.read_bytes()[:100])
    before = path.read_bytes()
    with pytest.raises(
        RecordingFailed, match="has no readable message, and was not changed: the file was not finished"
    ):
        repair(path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["a.mcap"]
