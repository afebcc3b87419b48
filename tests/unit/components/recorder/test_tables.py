"""Recordings as numpy arrays."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hostlink.recording
from hostlink.components.recorder.channel import EVENTS, as_text, ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import RecordingFailed
from tests.support.fake_device import message_type

CATALOG = Catalog()
BEGIN_NS = 1_700_000_000_000_000_000


def write(path: Path, *messages: tuple[str, str, dict[str, Any]], is_finished: bool = True) -> None:
    """Write (topic, type, fields) at intervals of a tenth of a second."""
    writer = McapWriter(path, metadata={"owner": "test"})
    for number, (topic, type_name, fields) in enumerate(messages):
        type_ = message_type(type_name)
        channel = ros_channel(topic, type_name, type_, is_latched=False)
        writer.write(channel, BEGIN_NS + number * 100_000_000, type_.encode(fields))
    writer.end_chunk()
    writer.close() if is_finished else writer.abandon()


def test_field_is_a_column_and_time_counts_from_the_beginning(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write(path, *(("/odometry", "geometry_msgs/Pose2D", {"x": 0.5 * number}) for number in range(4)))
    table = hostlink.recording.read(path)["/odometry"]
    assert list(table) == ["x", "y", "theta"]
    np.testing.assert_array_equal(table["x"], [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(table.time_s, [0.0, 0.1, 0.2, 0.3])
    assert table["x"].dtype == np.float64
    assert "4 geometry_msgs/Pose2D" in repr(table)


def test_nested_fields_arrays_times_and_texts(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    fields = {
        "header": {"stamp": {"secs": 10, "nsecs": 500_000_000}, "frame_id": "odom"},
        "pose": {"pose": {"position": {"x": 2.0}}, "covariance": list(range(36))},
    }
    write(path, ("/odom", "nav_msgs/Odometry", fields), ("/odom", "nav_msgs/Odometry", fields))
    table = hostlink.recording.read(str(path))["/odom"]
    assert table["header.stamp"].tolist() == [10.5, 10.5]
    assert table["header.frame_id"].tolist() == ["odom", "odom"]
    assert table["pose.pose.position.x"].tolist() == [2.0, 2.0]
    assert table["pose.covariance"].shape == (2, 36)


def test_arrays_of_several_lengths_are_lists(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    lengths = ([1.0], [1.0, 2.0], [])
    write(path, *(("/scan", "sensor_msgs/LaserScan", {"ranges": ranges}) for ranges in lengths))
    assert hostlink.recording.read(path)["/scan"]["ranges"].tolist() == [[1.0], [1.0, 2.0], []]


def test_missing_fields_of_events_are_none(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = McapWriter(path, metadata={})
    for payload in (b'{"kind": "locked", "facts": {"reason": "a"}}', b'{"kind": "gone"}', b"[]", b"\xff"):
        writer.write(EVENTS, BEGIN_NS, as_text(payload))
    writer.close()
    tables = hostlink.recording.read(path)
    assert tables[EVENTS.topic]["facts.reason"].tolist() == ["a", None]
    assert tables.undecoded == {EVENTS.topic: 2}


def test_undecodable_messages_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = McapWriter(path, metadata={})
    writer.write(ros_channel("/mystery", "my_msgs/Unknown", None, is_latched=False), BEGIN_NS, b"\0")
    pose = CATALOG.message("geometry_msgs/Pose2D")
    writer.write(ros_channel("/short", "geometry_msgs/Pose2D", pose, is_latched=False), BEGIN_NS, b"\0")
    writer.close()
    tables = hostlink.recording.read(path)
    assert (len(tables), tables.undecoded) == (0, {"/mystery": 1, "/short": 1})


def test_unfinished_file_is_read_and_reported(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write(path, ("/a", "geometry_msgs/Pose2D", {}), ("/b", "geometry_msgs/Pose2D", {}), is_finished=False)
    tables = hostlink.recording.read(path, topics=("/b",))
    assert (list(tables), tables.damage) == (["/b"], ["the file was not finished"])
    assert tables["/b"].time_s.tolist() == [0.1]
    assert tables.metadata == {"owner": "test"}


def test_missing_topic_names_the_existing_ones(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write(path, ("/a", "geometry_msgs/Pose2D", {}))
    with pytest.raises(KeyError, match="available: /a"):
        hostlink.recording.read(path)["/b"]
    with pytest.raises(RecordingFailed, match="No such file"):
        hostlink.recording.read(tmp_path / "none.mcap")
