"""Recordings of other programs, and other programs that read hostlink's recordings."""

import csv
import io
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapLibraryWriter
from mcap_ros1.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from hostlink.components.recorder.bags import RosFormat, export_ros
from hostlink.components.recorder.channel import (
    CDR,
    EVENTS,
    JSON,
    LOG,
    PARAMETERS,
    TEXT_MD5,
    TEXT_TYPE,
    Channel,
    as_text,
    ros_channel,
)
from hostlink.components.recorder.definitions import why_unknown
from hostlink.components.recorder.export import export_csv
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.components.recorder.plot import read_lines, read_paths
from hostlink.components.recorder.reader import McapReader, contents_of, open_source
from hostlink.components.recorder.salvage import repair
from hostlink.components.recorder.tables import read
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import HostlinkError, RecordingFailed, UnknownFormat
from tests.support.fake_device import message_type
from tests.support.foreign_recordings import (
    BEGIN_NS,
    COUNT,
    ODOMETRY,
    ROS1,
    ROS2,
    SEPARATOR,
    TEXT,
    mcap_file,
    odometry,
    ros1_bag,
    ros1_support,
    ros2_mcap,
    ros2_mcap_file,
    ros2_sqlite,
    ros2_support,
    stamp,
)

CATALOG = Catalog()
OTHERS = [ros1_bag, ros2_sqlite, ros2_mcap, ros2_mcap_file, ros2_support, ros1_support]
Make = Callable[[Path], Path]


@pytest.fixture(params=OTHERS, ids=lambda make: make.__name__)
def theirs(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    make: Make = request.param
    return make(tmp_path)


@pytest.mark.slow
def test_csv_of_another_programs_recording_has_its_values(theirs: Path, tmp_path: Path) -> None:
    done, lines = export_csv(open_source(theirs), tmp_path / "csv")
    assert (done.messages, lines, done.left_out, done.damage) == (COUNT, {"odom.csv": COUNT}, {}, [])
    row = list(csv.DictReader(io.StringIO((tmp_path / "csv" / "odom.csv").read_text())))[7]
    assert (row["time_s"], row["pose.pose.position.x"], row["header.frame_id"]) == (
        "1700000000.070000000",
        "0.7",
        "odom",
    )
    assert (row["header.stamp"], row["pose.covariance[35]"]) == ("10.000000005", "0.25")


@pytest.mark.slow
@pytest.mark.parametrize("format_", [RosFormat.ROS2_MCAP, RosFormat.ROS2_SQLITE])
def test_ros_2_bag_of_another_programs_recording_has_its_values(
    theirs: Path, tmp_path: Path, format_: RosFormat
) -> None:
    done = export_ros(open_source(theirs), tmp_path / "bag", format_)
    with Ros2Reader(tmp_path / "bag") as bag:
        found = [
            (each.msgtype, stamp_ns, ROS2.deserialize_cdr(data, each.msgtype))
            for each, stamp_ns, data in bag.messages()
        ]
    assert (done.messages, len(found)) == (COUNT, COUNT)
    name, stamp_ns, message = found[7]
    assert (name, stamp_ns) == (ODOMETRY, stamp(7))
    assert ROS2.serialize_cdr(message, name) == ROS2.serialize_cdr(odometry(ROS2, 7), name)


def test_ros_1_bag_of_another_programs_recording_has_its_values(theirs: Path, tmp_path: Path) -> None:
    done = export_ros(open_source(theirs), tmp_path / "run.bag", RosFormat.ROS1)
    with Ros1Reader(tmp_path / "run.bag") as bag:
        assert [(each.msgtype, each.digest) for each in bag.connections] == [
            (ODOMETRY, ROS1.generate_msgdef(ODOMETRY)[1])
        ]
        found = [(stamp_ns, ROS1.deserialize_ros1(data, ODOMETRY)) for _, stamp_ns, data in bag.messages()]
    assert (done.messages, len(found)) == (COUNT, COUNT)
    stamp_ns, message = found[7]
    assert (stamp_ns, message.pose.pose.position.x, message.header.frame_id) == (stamp(7), 0.7, "odom")
    assert (message.header.stamp.sec, message.twist.covariance[35]) == (10, 0.25)


@pytest.mark.slow
def test_contents_tables_and_pictures_of_another_programs_recording(theirs: Path) -> None:
    found = contents_of(theirs)
    assert (found.messages, found.seconds, found.damage) == (COUNT, pytest.approx((COUNT - 1) / 100), [])
    assert [(topic.channel.topic, why_unknown(topic.channel)) for topic in found.topics] == [("/odom", "")]
    table = read(theirs)["/odom"]
    assert (table["pose.pose.position.x"][7], table.time_s[7]) == (0.7, pytest.approx(0.07))
    (line,) = read_lines(open_source(theirs), ["/odom.pose.pose.position.x"])["/odom.pose.pose.position.x"]
    assert len(line.points()[1]) == COUNT
    assert read_paths(open_source(theirs))["/odom"][7] == (0.7, 2.0)


def test_json_of_another_program_is_kept_as_a_text(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "theirs.mcap", ("/facts", "json", "a.B", "jsonschema", b"{}", b'{"a": 1}'))
    export_ros(open_source(path), tmp_path / "run.bag", RosFormat.ROS1)
    with Ros1Reader(tmp_path / "run.bag") as bag:
        assert [bytes(data) for _, _, data in bag.messages()] == [as_text(b'{"a": 1}')]
    assert export_csv(open_source(path), tmp_path / "csv")[1] == {"facts.csv": 1}


def test_cut_cdr_is_omitted_and_counted(tmp_path: Path) -> None:
    definition = b"string data\nuint8[] more\n"
    good = ROS2.serialize_cdr(ROS2.types["std_msgs/msg/String"](data="abc"), "std_msgs/msg/String")
    payloads = [bytes(good) + b"\0\0\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"", bytes(good) + b"\xff\xff\xff\xff"]
    path = mcap_file(
        tmp_path / "a.mcap", *(("/own", "cdr", "my_msgs/msg/Own", "ros2msg", definition, each) for each in payloads)
    )
    for format_ in RosFormat:
        done = export_ros(open_source(path), tmp_path / format_.value, format_)
        assert (done.messages, done.left_out["/own"].split(":")[0]) == (1, "3 messages cannot be decoded, the first")


@pytest.mark.parametrize(
    "definition",
    [
        f"my_msgs/B[] b\n{SEPARATOR}MSG: my_msgs/B\nmy_msgs/C c\n{SEPARATOR}MSG: my_msgs/C\n",
        "uint8[4000000000] x",
        "my_msgs/Own a",
        "my_msgs/A1 x\nmy_msgs/A1 y\n"
        + "".join(f"{SEPARATOR}MSG: my_msgs/A{n}\nmy_msgs/A{n + 1} x\nmy_msgs/A{n + 1} y\n" for n in range(1, 40))
        + f"{SEPARATOR}MSG: my_msgs/A40\nuint8 z\n",
    ],
)
def test_cdr_of_a_type_that_grows_without_end_is_refused(tmp_path: Path, definition: str) -> None:
    own = ("/own", "cdr", "my_msgs/msg/Own", "ros2msg", definition.encode(), b"\0\1\0\0\xff\xff\xff\xff")
    with pytest.raises(UnknownFormat, match="/own"):
        export_ros(open_source(mcap_file(tmp_path / "a.mcap", own)), tmp_path / "bag", RosFormat.ROS1)


def test_ros_2_types_that_differ_in_ros_1_keep_their_fields(tmp_path: Path) -> None:
    """Such as bounded lists, and a name that ROS 1 uses for another type."""
    definition = b"std_msgs/Header header\nfloat32[<=3] few\nstring<=5 short\nbuiltin_interfaces/Duration span\n"
    body = b"\0\1\0\0" + (7).to_bytes(4, "little") + bytes(4) + b"\2\0\0\0a\0\0\0" + b"\1\0\0\0" + bytes(4)
    body += b"\3\0\0\0ab\0\0" + (2).to_bytes(4, "little") + bytes(4)
    path = mcap_file(tmp_path / "a.mcap", ("/own", "cdr", "nav_msgs/msg/Path", "ros2msg", definition, body))
    assert export_ros(open_source(path), tmp_path / "a.bag", RosFormat.ROS1).left_out == {}
    fields = read(tmp_path / "a.bag")["/own"]
    assert list(fields) == ["header.seq", "header.stamp", "header.frame_id", "few", "short", "span"]
    assert (fields["header.stamp"].tolist(), fields["short"].tolist(), fields["span"].tolist()) == (
        [7.0],
        ["ab"],
        [2.0],
    )


def test_definition_in_idl_is_read(tmp_path: Path) -> None:
    idl = "module my_msgs { module msg { struct Own { double x; sequence<uint8> data; }; }; };\n"
    schema = f"{SEPARATOR}IDL: my_msgs/msg/Own\n{idl}".encode()
    payload = b"\0\1\0\0" + np.float64(1.5).tobytes() + b"\2\0\0\0ab"
    path = mcap_file(tmp_path / "a.mcap", ("/own", "cdr", "my_msgs/msg/Own", "ros2idl", schema, payload))
    table = read(path)["/own"]
    assert (table["x"].tolist(), table["data"].tolist()) == ([1.5], [b"ab"])
    assert export_ros(open_source(path), tmp_path / "bag", RosFormat.ROS2_MCAP).messages == 1


# -- hostlink's recordings, read by others ---------------------------------------------------------------------------


def ours(path: Path) -> Path:
    """Write a recording with every kind of channel that hostlink writes."""
    pose = message_type("geometry_msgs/Pose2D")
    writer = McapWriter(path, metadata={"owner": "test"})
    channel = ros_channel("/robot_0/odometry", pose.name, pose, is_latched=False, robot="robot_0", origin="device")
    writer.write(EVENTS, BEGIN_NS, as_text(b'{"kind": "locked", "robot": "robot_0", "facts": {}}'))
    writer.write(channel, BEGIN_NS, pose.encode({"x": 1.5}))
    writer.write(LOG, BEGIN_NS, as_text(b'{"event": "robot.stopped", "level": "info"}'))
    writer.write(PARAMETERS, BEGIN_NS, as_text(b"{}"))
    writer.write(ros_channel("/mystery", "my_msgs/Unknown", None, is_latched=False), BEGIN_NS, b"\1\2")
    writer.close()
    return path


def test_ros_1_reader_reads_every_message(tmp_path: Path) -> None:
    with ours(tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
    assert found["/robot_0/odometry"].x == 1.5
    assert json.loads(found["/hostlink/events"].data)["kind"] == "locked"
    assert json.loads(found["/hostlink/log"].data)["event"] == "robot.stopped"
    assert len(found) == 5


def test_snippet_of_the_document_reads_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    document = (Path(__file__).parents[4] / "docs" / "recording.md").read_text()
    (snippet,) = (part.partition("```")[0] for part in document.split("```python\n")[1:] if "make_reader" in part)
    ours(tmp_path / "run.mcap")
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "recording.md", "exec"), {})  # noqa: S102 - the document's own
    printed = capsys.readouterr().out
    assert "/robot_0/odometry 1.5" in printed
    assert "locked" in printed


def test_texts_of_hostlink_are_the_catalogs_type() -> None:
    text = message_type("std_msgs/String")
    assert (EVENTS.type_name, EVENTS.schema, TEXT_MD5) == (text.name, text.full_definition, text.md5)


def test_events_and_logs_of_older_recordings_are_tables(tmp_path: Path) -> None:
    older = McapWriter(tmp_path / "old.mcap", metadata={}, has_steady_times=False)
    older.write(Channel("/hostlink/events", JSON, "hostlink.Event", "{}"), BEGIN_NS, b'{"kind": "locked"}')
    older.close()
    for path in (tmp_path / "old.mcap", ours(tmp_path / "new.mcap")):
        assert read(path)["/hostlink/events"]["kind"].tolist() == ["locked"]


def test_export_for_ros_2_is_decoded_by_mcaps_ros_2_support(tmp_path: Path) -> None:
    export_ros(open_source(ours(tmp_path / "run.mcap")), tmp_path / "bag", RosFormat.ROS2_MCAP, skips_unknown=True)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Ros2DecoderFactory()])
        found = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
    assert json.loads(found["/hostlink/events"].data)["kind"] == "locked"


def test_failed_export_leaves_no_files(tmp_path: Path) -> None:
    class Failing:
        """Recording whose disk fails halfway."""

        def __init__(self, path: Path) -> None:
            self._source = open_source(path)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._source, name)

        def messages(self, *arguments: Any, **options: Any) -> Any:
            for number, message in enumerate(self._source.messages(*arguments, **options)):
                if number == 2:
                    raise RecordingFailed("the disk is gone")
                yield message

    path, target = ros1_bag(tmp_path), tmp_path / "out"
    source: Any = Failing(path)
    for export in (
        lambda: export_csv(source, target),
        *(lambda each=each: export_ros(source, target, each) for each in RosFormat),
    ):
        with pytest.raises(HostlinkError, match="the disk is gone"):
            export()
        assert not target.exists()


TIMES = [3, 1, 1, 9, 7, 8, 2, 2, 20, 19, 18, 30, 0, 31, 32]


def unsorted(path: Path, *, uses_chunking: bool = True, is_cut: bool = False) -> Path:
    """Write messages that are not in the order of time, a few in a chunk, as programs do that merge recordings."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(file, chunk_size=250, use_chunking=uses_chunking)
        writer.start("", library="theirs")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        channel = writer.register_channel("/text", "ros1", schema)
        for number, second in enumerate(TIMES):
            at_ns = BEGIN_NS + second * 1_000_000_000
            writer.add_message(channel, at_ns, as_text(b"%d" % number), at_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    if is_cut:
        whole = path.read_bytes()
        path.write_bytes(whole[: whole.rindex(b"\x0f\x04")])  # before the end of the data
    return path


@pytest.mark.parametrize("is_cut", [False, True], ids=["with an index", "cut"])
@pytest.mark.parametrize("uses_chunking", [True, False], ids=["chunks", "no chunks"])
def test_messages_of_a_file_that_is_not_in_the_order_of_time_are_sorted(
    tmp_path: Path, uses_chunking: bool, is_cut: bool
) -> None:
    source = open_source(unsorted(tmp_path / "run.mcap", uses_chunking=uses_chunking, is_cut=is_cut))
    found = [(message.stamp_ns, int(message.payload[4:])) for message in source.messages()]
    assert found == [(BEGIN_NS + TIMES[number] * 10**9, number) for number in sorted(range(15), key=TIMES.__getitem__)]
    assert source.damage == (["the file was not finished"] if is_cut else [])
    export_csv(source, tmp_path / "csv")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "csv" / "text.csv").read_text())))
    assert [float(row["time_s"]) - BEGIN_NS / 1e9 for row in rows] == sorted(TIMES)


def test_file_that_is_too_mixed_up_to_be_sorted_is_sorted_in_part_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hostlink.components.recorder.reader.MAX_WAITING_BYTES", 2 * 210)
    source = open_source(unsorted(tmp_path / "run.mcap"))
    found = [int(message.payload[4:]) for message in source.messages()]
    assert sorted(found) == list(range(15))
    assert source.damage == ["its messages are too mixed up to be sorted by time; they are sorted in part"]


def test_topic_of_the_tools_of_ros_2_does_not_stop_an_export_unless_it_is_named(tmp_path: Path) -> None:
    """Bags of old distributions have it without a definition, or in another encoding."""
    odd = ("/parameter_events", "", "rcl_interfaces/msg/ParameterEvent", "", b"", b"\1")
    path = mcap_file(tmp_path / "run.mcap", odd, TEXT)
    done, lines = export_csv(open_source(path), tmp_path / "csv")
    assert (lines, list(done.left_out)) == ({"text.csv": 1}, ["/parameter_events"])
    with pytest.raises(UnknownFormat, match="/parameter_events"):
        export_csv(open_source(path), tmp_path / "other", topics=["/parameter_events"])


def unfinished(path: Path, kept_bytes: int | None = None) -> Path:
    """Return the bag as rosbag leaves it when it is killed: without an index, and the last chunk without its length."""
    whole = ros1_bag(path.parent).read_bytes()
    index_at = int.from_bytes(whole[whole.index(b"index_pos=") + 10 :][:8], "little")
    at = whole.index(b"index_pos=") + 10
    data = whole[:at] + bytes(8) + whole[at + 8 : index_at]
    path.write_bytes(data[:kept_bytes])
    return path


@pytest.mark.parametrize("name", ["run.bag.active", "run.bag"])
def test_bag_that_was_not_closed_is_read_exported_and_repaired(tmp_path: Path, name: str) -> None:
    path = unfinished(tmp_path / name)
    found = contents_of(path)
    assert (found.messages, found.damage, found.begin_ns) == (COUNT, ["the file was not finished"], BEGIN_NS)
    done, _ = export_csv(open_source(path), tmp_path / "csv")
    assert done.messages == COUNT
    repaired = repair(path)
    assert repaired.messages == COUNT
    with Ros1Reader(repaired.output or path) as bag:
        assert [(connection.topic, at_ns) for connection, at_ns, _ in bag.messages()] == [
            ("/odom", stamp(number)) for number in range(COUNT)
        ]
    assert repaired.original is not None
    assert contents_of(tmp_path / "run.bag").damage == []
    assert repair(tmp_path / "run.bag").damage == ()


@pytest.mark.parametrize("has_length", [True, False])
def test_bag_whose_last_chunk_is_cut_gives_its_messages(tmp_path: Path, has_length: bool) -> None:
    path = unfinished(tmp_path / "run.bag.active")
    data = path.read_bytes()
    length_at = data.index(b"compression=none") + len(b"compression=none")
    if data[length_at + 4 :][:5] == b"size=":  # another field of the chunk's header follows
        length_at += len(b"\x09\0\0\0size=\0\0\0\0")
    length = data[length_at:][:4] if has_length else bytes(4)
    path.write_bytes(data[:length_at] + length + data[length_at + 4 : len(data) // 2])
    found = contents_of(path)
    assert 100 < found.messages < COUNT
    assert found.damage == ["the file was not finished"]


def test_file_other_than_a_bag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.bag.active"
    path.write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    with pytest.raises(RecordingFailed, match="cannot be read"):
        contents_of(path)


def cdr_recording(path: Path, type_name: str) -> Path:
    """Write a recording of hostlink's with a CDR topic whose type had no definition, and a text."""
    writer = McapWriter(path, metadata={})
    message = b"\0\1\0\0" + struct.pack("<i", 7)
    writer.write(ros_channel("/own", type_name, None, is_latched=False, encoding=CDR), BEGIN_NS, message)
    writer.write(
        ros_channel("/text", TEXT_TYPE, Catalog().message(TEXT_TYPE), is_latched=False), BEGIN_NS, as_text(b"a")
    )
    writer.close()
    return path


@pytest.mark.parametrize("format_", RosFormat)
def test_cdr_without_a_definition_is_refused_and_left_out_by_its_name(tmp_path: Path, format_: RosFormat) -> None:
    path = cdr_recording(tmp_path / "a.mcap", "my_msgs/Own")
    with pytest.raises(
        UnknownFormat, match=r"/own \(my_msgs/msg/Own: the recording has no definition of my_msgs/msg/Own"
    ):
        export_ros(open_source(path), tmp_path / "out", format_)
    done = export_ros(
        open_source(path), tmp_path / f"out{'.bag' * (format_ is RosFormat.ROS1)}", format_, skips_unknown=True
    )
    assert (done.messages, list(done.left_out)) == (1, ["/own"])


def test_cdr_of_a_type_that_ros_2_itself_has_is_exported_with_its_values(tmp_path: Path) -> None:
    path = cdr_recording(tmp_path / "a.mcap", "example_interfaces/Int32")
    with pytest.raises(UnknownFormat, match="no definition of example_interfaces/msg/Int32"):
        export_csv(open_source(path), tmp_path / "out")
    path = cdr_recording(tmp_path / "b.mcap", "std_msgs/Int32")
    _, lines = export_csv(open_source(path), tmp_path / "csv")
    assert lines == {"own.csv": 1, "text.csv": 1}
    assert "7" in (tmp_path / "csv" / "own.csv").read_text().splitlines()[1].split(",")


def test_recording_with_cdr_of_an_unknown_type_is_repaired(tmp_path: Path) -> None:
    path = cdr_recording(tmp_path / "a.mcap", "my_msgs/Own")
    path.write_bytes(path.read_bytes()[:-100])
    assert repair(path).messages == 2
    (own,) = [each for each in McapReader(path).messages() if each.channel.topic == "/own"]
    assert (own.channel.encoding, own.channel.type_name) == ("cdr", "my_msgs/msg/Own")
