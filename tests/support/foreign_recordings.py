"""Recordings as other programs write them: rosbags, mcap-ros1-support, mcap-ros2-support, and mcap's own writer."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer as McapLibraryWriter
from mcap_ros1.writer import Writer as Ros1SupportWriter
from mcap_ros2.writer import Writer as Ros2SupportWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from hostlink.components.recorder.channel import as_text

COUNT = 300
BEGIN_NS, STEP_NS = 1_700_000_000_000_000_000, 10_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_KILTED)
ODOMETRY = "nav_msgs/msg/Odometry"
SEPARATOR = "=" * 80 + "\n"


def stamp(number: int) -> int:
    return BEGIN_NS + number * STEP_NS


def odometry(store: Any, number: int) -> Any:
    types = store.types
    time = types["builtin_interfaces/msg/Time"](sec=10, nanosec=5)
    seq = {"seq": number} if store is ROS1 else {}
    header = types["std_msgs/msg/Header"](**seq, stamp=time, frame_id="odom")
    point, turn = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
    vector, covariance = types["geometry_msgs/msg/Vector3"], np.full(36, 0.25)
    pose = types["geometry_msgs/msg/Pose"](position=point(number / 10, 2.0, 3.0), orientation=turn(0.0, 0.0, 0.0, 1.0))
    twist = types["geometry_msgs/msg/Twist"](linear=vector(0.5, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0))
    return types[ODOMETRY](
        header=header,
        child_frame_id="base",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
    )


def ros1_bag(folder: Path) -> Path:
    path = folder / "theirs.bag"
    with Ros1Writer(path) as bag:
        connection = bag.add_connection("/odom", ODOMETRY, typestore=ROS1)
        for number in range(COUNT):
            bag.write(connection, stamp(number), ROS1.serialize_ros1(odometry(ROS1, number), ODOMETRY))
    return path


def ros2_bag(folder: Path, plugin: StoragePlugin) -> Path:
    path = folder / "theirs"
    with Ros2Writer(path, version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/odom", ODOMETRY, typestore=ROS2)
        for number in range(COUNT):
            bag.write(connection, stamp(number), ROS2.serialize_cdr(odometry(ROS2, number), ODOMETRY))
    return path


def ros2_sqlite(folder: Path) -> Path:
    return ros2_bag(folder, StoragePlugin.SQLITE3)


def ros2_mcap(folder: Path) -> Path:
    return ros2_bag(folder, StoragePlugin.MCAP)


def ros2_mcap_file(folder: Path) -> Path:
    (path,) = ros2_mcap(folder).glob("*.mcap")
    return path


def ros2_support(folder: Path) -> Path:
    """Return a recording by the library mcap-ros2-support, without an entry of rosbag2."""
    path, (definition, _) = folder / "theirs.mcap", ROS2.generate_msgdef(ODOMETRY, ros_version=2)
    with path.open("wb") as file, Ros2SupportWriter(file) as writer:
        schema = writer.register_msgdef("nav_msgs/msg/Odometry", definition)
        for number in range(COUNT):
            message = odometry(ROS2, number)
            message.pose.covariance = message.twist.covariance = [0.25] * 36
            writer.write_message("/odom", schema, message, stamp(number))
    return path


class _Odometry:
    """Message as genpy generates it: a class with its names, and a method that writes it."""

    _type, _full_text = "nav_msgs/Odometry", ROS1.generate_msgdef(ODOMETRY)[0]

    def __init__(self, number: int) -> None:
        self._number = number

    def serialize(self, file: io.BytesIO) -> None:
        file.write(ROS1.serialize_ros1(odometry(ROS1, self._number), ODOMETRY))


def ros1_support(folder: Path) -> Path:
    """Return a recording by the library mcap-ros1-support, which has no md5 sum."""
    path = folder / "theirs.mcap"
    with path.open("wb") as file, Ros1SupportWriter(file) as writer:
        for number in range(COUNT):
            writer.write_message("/odom", _Odometry(number), stamp(number))
    return path


def mcap_file(path: Path, *channels: tuple[str, str, str, str, bytes, bytes]) -> Path:
    """Write a file with one message for each (topic, encoding, type, language of the schema, schema, payload)."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(file)
        writer.start("", library="theirs")
        for topic, encoding, name, language, schema, payload in channels:
            number = writer.register_channel(topic, encoding, writer.register_schema(name, language, schema))
            writer.add_message(number, BEGIN_NS, payload, BEGIN_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


PROTOBUF = ("/camera", "protobuf", "foxglove.CompressedImage", "protobuf", b"\x0a\xff\x00", b"\x0a\x01")
TEXT = ("/text", "ros1", "std_msgs/String", "ros1msg", b"string data\n", as_text(b"a"))
UNKNOWN = {
    "protobuf": PROTOBUF,
    "cbor": ("/camera", "cbor", "a.B", "jsonschema", b"{}", b"\xa0"),
    "flatbuffer": ("/camera", "flatbuffer", "a.B", "flatbuffer", b"\x01", b"\x01"),
    "no encoding": ("/camera", "", "", "", b"", b"\x01"),
    "ros1 without a definition": ("/camera", "ros1", "a/B", "ros1msg", b"", b"\x01"),
    "ros1 with another's definition": ("/camera", "ros1", "a/B", "protobuf", b"\x01", b"\x01"),
    "cdr without a definition": ("/camera", "cdr", "my_msgs/msg/Own", "ros2msg", b"", b"\0\1\0\0\1"),
    "cdr with a part missing": ("/camera", "cdr", "my_msgs/msg/Own", "ros2msg", b"my_msgs/Other x\n", b"\0\1\0\0\1"),
    "cdr of a definition that is none": ("/camera", "cdr", "my_msgs/msg/Own", "ros2msg", b"!!", b"\0\1\0\0\1"),
    "cdr with wide texts": ("/camera", "cdr", "my_msgs/msg/Own", "ros2msg", b"wstring x\n", b"\0\1\0\0\1"),
}
