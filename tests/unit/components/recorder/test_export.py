"""Exports, read by the programs that own the formats."""

import csv
import io
import json
import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_typestore

from hostlink.components.recorder.bags import RosFormat, export_ros
from hostlink.components.recorder.channel import EVENTS, as_text, ros_channel
from hostlink.components.recorder.export import export_csv, file_name
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.components.recorder.plot import PlotLine, draw_fields, draw_map, read_lines, read_paths
from hostlink.components.recorder.reader import McapReader, StoredMessage, contents_of
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import RecordingFailed

BEGIN_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
ODOMETRY = {
    "header": {"seq": 7, "stamp": {"secs": 10, "nsecs": 5}, "frame_id": "odom"},
    "child_frame_id": "base",
    "pose": {"pose": {"position": {"x": 1.5}}, "covariance": [0.25] * 36},
}


@pytest.fixture
def catalog(tmp_path: Path) -> Catalog:
    """Return a catalog with a type that only this user has."""
    folder = tmp_path / "messages" / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Wheel.msg").write_text("string name\nfloat32[] speeds\ngeometry_msgs/Pose2D pose\n")
    return Catalog([tmp_path / "messages"])


@pytest.fixture
def recording(tmp_path: Path, catalog: Catalog) -> Path:
    path = tmp_path / "run.mcap"
    writer = McapWriter(path, metadata={"owner": "test"})
    messages: list[tuple[str, str, dict[str, Any]]] = [
        ("/robot_0/odometry", "geometry_msgs/Pose2D", {"x": 0.5, "y": -1.0, "theta": 2.0}),
        ("/robot_0/odom", "nav_msgs/Odometry", ODOMETRY),
        ("/wheel", "my_msgs/Wheel", {"name": "left", "speeds": [1.0, 2.0], "pose": {"x": 3.0}}),
    ]
    for number in range(5):
        for topic, name, fields in messages:
            type_ = catalog.message(name)
            channel = ros_channel(topic, name, type_, is_latched=False, robot="robot_0", origin="device")
            writer.write(channel, BEGIN_NS + number * STEP_NS, type_.encode(fields))
    writer.write(EVENTS, BEGIN_NS, as_text(b'{"kind": "locked"}'))
    writer.write(ros_channel("/mystery", "my_msgs/Unknown", None, is_latched=False), BEGIN_NS, b"\1")
    writer.close()
    return path


def table(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(file.read_text())))


def test_csv_has_a_table_a_topic_with_its_fields_as_columns(recording: Path, tmp_path: Path) -> None:
    done, lines = export_csv(McapReader(recording), tmp_path / "out", skips_unknown=True)
    assert list(done.left_out) == ["/mystery"]
    assert lines == {"robot_0.odometry.csv": 5, "robot_0.odom.csv": 5, "wheel.csv": 5, "hostlink.events.csv": 1}
    rows = table(tmp_path / "out" / "robot_0.odometry.csv")
    assert rows[1] == {"time_s": "1700000000.100000000", "x": "0.5", "y": "-1.0", "theta": "2.0"}
    odom = table(tmp_path / "out" / "robot_0.odom.csv")[0]
    assert (odom["pose.pose.position.x"], odom["pose.covariance[35]"]) == ("1.5", "0.25")


def test_csv_has_no_formula_and_no_escape_code_of_a_device(tmp_path: Path, catalog: Catalog) -> None:
    path, type_ = tmp_path / "run.mcap", catalog.message("my_msgs/Wheel")
    writer = McapWriter(path, metadata={})
    channel = ros_channel("/wheel", "my_msgs/Wheel", type_, is_latched=False)
    formulas = ['=HYPERLINK("http://x","y")', "+1", "-2", "@SUM(1)", "\n =1"]
    for name in (*formulas, "\t=1", "\x1b[31mred\x1b[0m", "\u202eabc", "left, right"):
        writer.write(channel, BEGIN_NS, type_.encode({"name": name, "pose": {"x": -3.0}}))
    writer.write(EVENTS, BEGIN_NS, as_text(b'{"=1+1": "a\\nb"}'))
    writer.close()
    export_csv(McapReader(path), tmp_path / "out")
    rows = table(tmp_path / "out" / "wheel.csv")
    safe = [f"'{each}" for each in formulas]
    escaped = ["\\t=1", "\\u001b[31mred\\u001b[0m", "\\u202eabc", "left, right"]
    assert [row["name"] for row in rows] == [*safe, *escaped]
    assert {row["pose.x"] for row in rows} == {"-3.0"}
    (event,) = table(tmp_path / "out" / "hostlink.events.csv")
    assert event["'=1+1"] == "a\nb"


def test_ros_1_bag_has_the_same_bytes(recording: Path, tmp_path: Path) -> None:
    done = export_ros(McapReader(recording), tmp_path / "run.bag", RosFormat.ROS1, skips_unknown=True)
    before = {(message.channel.topic, message.payload) for message in McapReader(recording).messages()}
    with Ros1Reader(tmp_path / "run.bag") as bag:
        found = [(connection.topic, bytes(payload)) for connection, _, payload in bag.messages()]
        types = {connection.topic: connection.msgtype for connection in bag.connections}
    assert (done.messages, list(done.left_out)) == (16, ["/mystery"])
    assert set(found) <= before
    assert types["/wheel"] == "my_msgs/msg/Wheel"
    (event,) = (payload for topic, payload in found if topic == EVENTS.topic)
    assert json.loads(event[4:]) == {"kind": "locked"}


@pytest.mark.parametrize("format_", [RosFormat.ROS2_MCAP, RosFormat.ROS2_SQLITE])
def test_ros_2_bag_is_read_by_rosbags_with_the_same_values(recording: Path, tmp_path: Path, format_: RosFormat) -> None:
    done = export_ros(McapReader(recording), tmp_path / "bag", format_, skips_unknown=True)
    store = get_typestore(Stores.ROS2_KILTED)
    with Ros2Reader(tmp_path / "bag") as bag:
        messages = [(connection, stamp_ns, payload) for connection, stamp_ns, payload in bag.messages()]
    assert (done.messages, len(messages), list(done.left_out)) == (16, 16, ["/mystery"])
    connection, stamp_ns, payload = next(each for each in messages if each[0].topic == "/robot_0/odom")
    odometry: Any = store.deserialize_cdr(payload, connection.msgtype)
    assert stamp_ns == BEGIN_NS
    assert (odometry.header.frame_id, odometry.header.stamp.sec, odometry.pose.pose.position.x) == ("odom", 10, 1.5)
    assert odometry.pose.covariance.tolist() == [0.25] * 36
    assert {each.topic for each, _, _ in messages} >= {"/wheel", EVENTS.topic}


def test_ros_2_export_is_decoded_by_mcaps_ros_2_support(recording: Path, tmp_path: Path) -> None:
    """mcap-ros2-support uses its own CDR reader, with the definitions in the file only."""
    export_ros(McapReader(recording), tmp_path / "bag", RosFormat.ROS2_MCAP, skips_unknown=True)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Ros2DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = {
            channel.topic: (schema.name, message) for schema, channel, _, message in reader.iter_decoded_messages()
        }
    assert {name for name, _ in found.values()} >= {"geometry_msgs/msg/Pose2D", "my_msgs/msg/Wheel"}
    assert (found["/robot_0/odometry"][1].x, found["/robot_0/odometry"][1].theta) == (0.5, 2.0)
    odometry = found["/robot_0/odom"][1]
    assert (odometry.header.frame_id, odometry.header.stamp.sec, odometry.pose.pose.position.x) == ("odom", 10, 1.5)
    wheel = found["/wheel"][1]
    assert (wheel.name, list(wheel.speeds), wheel.pose.x) == ("left", [1.0, 2.0], 3.0)


def test_file_itself_is_decoded_by_mcaps_ros_1_support(recording: Path) -> None:
    with recording.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = ["/robot_0/odometry", "/robot_0/odom", "/wheel"]
        found = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages(topics=topics)}
    assert (found["/robot_0/odometry"].x, found["/robot_0/odometry"].theta) == (0.5, 2.0)
    assert found["/robot_0/odom"].header.frame_id == "odom"
    assert (found["/wheel"].name, list(found["/wheel"].speeds), found["/wheel"].pose.x) == ("left", [1.0, 2.0], 3.0)


def test_payloads_that_are_not_messages_are_left_out_and_counted_with_the_reason(
    tmp_path: Path, catalog: Catalog
) -> None:
    text = catalog.message("std_msgs/String")
    bad = b"\xff\xff\xff\xffx"
    path = write(tmp_path / "run.mcap", [("/text", text, each) for each in (bad, text.encode({"data": "a"}), bad)])
    done = export_ros(McapReader(path), tmp_path / "bag", RosFormat.ROS2_MCAP)
    assert (done.messages, list(done.left_out)) == (1, ["/text"])
    assert done.left_out["/text"].startswith("2 messages cannot be decoded, the first: ")


@pytest.mark.parametrize("format_", [*RosFormat, None])
def test_export_without_a_message_fails_and_leaves_nothing(
    tmp_path: Path, catalog: Catalog, format_: RosFormat | None
) -> None:
    text, target = catalog.message("std_msgs/String"), tmp_path / "out"
    for name, messages in (("bad", [("/text", text, b"\xff\xff\xff\xffx")]), ("empty", [])):
        if name == "bad" and format_ is RosFormat.ROS1:
            continue  # the bytes are unchanged
        path = write(tmp_path / f"{name}.mcap", messages)
        with pytest.raises(RecordingFailed, match="has no message to export"):
            export_csv(McapReader(path), target) if format_ is None else export_ros(McapReader(path), target, format_)
        assert not target.exists()


def test_contents_are_counted_by_topic(recording: Path) -> None:
    found = contents_of(recording)
    assert (found.messages, found.seconds, found.metadata, found.damage) == (17, 0.4, {"owner": "test"}, [])
    odometry = next(topic for topic in found.topics if topic.channel.topic == "/robot_0/odometry")
    assert (odometry.messages, odometry.payload_bytes, odometry.rate_hz) == (5, 120, 10.0)


class _WithoutMessages(McapReader):
    """A recording whose channels have no message."""

    def messages(self, *arguments: Any, **options: Any) -> Iterator[StoredMessage]:
        list(super().messages(*arguments, **options))  # finds the channels
        return iter(())


def test_pictures_are_drawn_and_a_wrong_field_names_those_that_are_there(recording: Path, tmp_path: Path) -> None:
    names = ["/robot_0/odometry.x", "/robot_0/odom.pose.pose.position.x", "/robot_0/odom.header.stamp"]
    lines = read_lines(McapReader(recording), names)
    draw_fields(lines, tmp_path / "fields.svg")
    assert {name: len(found) for name, found in lines.items()} == dict.fromkeys(names, 1)
    assert [each.tolist() for each in lines[names[0]][0].points()] == [[0.0, 0.1, 0.2, 0.3, 0.4], [0.5] * 5]
    paths = read_paths(McapReader(recording))
    assert paths == {"/robot_0/odometry": [(0.5, -1.0)] * 5, "/robot_0/odom": [(1.5, 0.0)] * 5}
    draw_map(paths, tmp_path / "map.png")
    assert "<svg" in (tmp_path / "fields.svg").read_text()
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(RecordingFailed, match="available: x, y, theta"):
        read_lines(McapReader(recording), ["/robot_0/odometry.z"])
    with pytest.raises(RecordingFailed, match="/robot_0/odometry has no message in this recording"):
        read_lines(_WithoutMessages(recording), ["/robot_0/odometry.x"])
    with pytest.raises(RecordingFailed, match=r"available: .*/robot_0/odometry"):
        read_lines(McapReader(recording), ["/robot_1/odometry.x"])


MANY = """int8[] few
string[2] names
time at
duration[] spans
uint8[] octets
uint8[70] more
geometry_msgs/Pose2D[] poses
bool flag
"""
FIRST = {"few": [], "names": ["a", 'b,\n"c"'], "at": {"secs": 3, "nsecs": 500_000_000}, "octets": b""}
SECOND = {
    "few": [1, 2, 3],
    "names": ["", "é"],
    "spans": [{"secs": -1, "nsecs": 5}],
    "octets": b"\x00\xff",
    "poses": [{"x": 1.0}, {"x": 2.0}],
    "flag": True,
}


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


def write(path: Path, messages: list[tuple[str, Any, bytes]]) -> Path:
    writer = McapWriter(path, metadata={})
    for number, (topic, type_, payload) in enumerate(messages):
        writer.write(ros_channel(topic, type_.name, type_, is_latched=False), BEGIN_NS + number * STEP_NS, payload)
    writer.close()
    return path


@pytest.fixture
def many(tmp_path: Path) -> Any:
    folder = tmp_path / "types" / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Many.msg").write_text(MANY)
    return Catalog([tmp_path / "types"]).message("my_msgs/Many")


def test_csv_has_a_column_for_every_field_of_any_message(tmp_path: Path, many: Any) -> None:
    path = write(tmp_path / "a.mcap", [("/many", many, many.encode(each)) for each in (FIRST, SECOND)])
    export_csv(McapReader(path), tmp_path / "csv")
    first, second = rows(tmp_path / "csv" / "many.csv")
    assert (first["few[0]"], second["few[2]"]) == ("", "3")
    assert (first["names[1]"], second["names[1]"]) == ('b,\n"c"', "é")
    assert (first["at"], second["flag"]) == ("3.5", "True")
    assert json.loads(second["octets"]) == [0, 255]
    assert len(json.loads(second["more"])) == 70
    assert [each["x"] for each in json.loads(second["poses"])] == [1.0, 2.0]
    assert json.loads(second["spans"]) == [{"secs": -1, "nsecs": 5}]


def test_events_have_a_column_for_every_fact(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "a.mcap", metadata={})
    for facts in ({"kind": "gone", "facts": {}}, {"kind": "locked", "facts": {"reason": "a cat"}}):
        writer.write(EVENTS, BEGIN_NS, as_text(json.dumps(facts).encode()))
    writer.close()
    export_csv(McapReader(tmp_path / "a.mcap"), tmp_path / "csv")
    assert [row["facts.reason"] for row in rows(tmp_path / "csv" / "hostlink.events.csv")] == ["", "a cat"]


def test_every_topic_and_type_has_its_own_file(tmp_path: Path, catalog: Catalog) -> None:
    text, number = (catalog.message(f"std_msgs/{name}") for name in ("String", "UInt8"))
    one, other = text.encode({"data": "a"}), number.encode({"data": 7})
    long = "/" + "x" * 5000
    names = ("/a/b", "/a.b", "/A/b", "/a//b", "..", "/", long)
    path = write(tmp_path / "a.mcap", [*((name, text, one) for name in names), ("/a/b", number, other)])
    _, lines = export_csv(McapReader(path), tmp_path / "csv")
    assert list(lines.values()) == [1] * (len(names) + 1)
    assert sorted(lines) == sorted(file.name for file in (tmp_path / "csv").iterdir())
    assert len({name.lower() for name in lines}) == len(lines)
    assert rows(tmp_path / "csv" / "a.b.csv")[0]["data"] == "a"


def test_recording_may_have_more_topics_than_a_process_may_have_files(tmp_path: Path, catalog: Catalog) -> None:
    number = catalog.message("std_msgs/UInt8")
    assert number is not None
    names = [f"/robot_{each}/number" for each in range(300)]
    of_all = [(name, number, number.encode({"data": turn})) for turn in range(2) for name in names]
    path = write(tmp_path / "a.mcap", of_all)
    few, all_of_them = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, all_of_them))
    try:
        _, lines = export_csv(McapReader(path), tmp_path / "csv")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (few, all_of_them))
    assert list(lines.values()) == [2] * len(names)
    for name in names:
        assert [row["data"] for row in rows(tmp_path / "csv" / f"{file_name(name)}.csv")] == ["0", "1"]


@pytest.mark.slow
@pytest.mark.parametrize("format_", ["rosbag2", "ros1"])
def test_full_disk_is_reported_in_one_line(recording: Path, tmp_path: Path, format_: str) -> None:
    """Files are limited to a kilobyte here. The error differs from that of a full disk, but occurs as late.

    With -B Python writes no bytecode, which would be cut too and fail later programs.
    """
    target = str(tmp_path / "bag")
    words = [sys.executable, "-B", "-m", "hostlink", "export", str(recording), "--skip-unknown"]
    words += ["--to", format_, "-o", target]
    limited = ["sh", "-c", 'ulimit -f 1; exec "$@"', "sh", *words]
    done = subprocess.run(limited, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith(f"hostlink: {target} cannot be written: ")
    assert not Path(target).exists()


def test_line_of_many_points_keeps_its_peaks_in_a_bounded_number() -> None:
    line = PlotLine(100)
    for number in range(100_000):
        line.add(number, 7.0 if number == 54_321 else -3.0 if number == 77_777 else number % 10 / 10)
    times_s, values = line.points()
    assert len(values) < 200
    assert (values.max(), values.min()) == (7.0, -3.0)
    assert (times_s[values.argmax()], times_s[values.argmin()]) == (54_321, 77_777)
    assert times_s.tolist() == sorted(times_s.tolist())


@pytest.mark.long
def test_ros_1_bag_of_many_messages_costs_as_much_memory_as_one_of_few(tmp_path: Path, catalog: Catalog) -> None:
    number = catalog.message("std_msgs/UInt8")
    assert number is not None
    peaks = []
    for count in (40_000, 160_000):
        path = write(tmp_path / f"{count}.mcap", [("/a", number, b"\1")] * count)
        tracemalloc.start()
        assert export_ros(McapReader(path), tmp_path / f"{count}.bag", RosFormat.ROS1).messages == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]
