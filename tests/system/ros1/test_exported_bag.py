"""A bag that `hostlink export` made, read by Debian's rosbag: its own command, and its Python."""

import asyncio
import json
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import Any

from hostlink.components.recorder.channel import EVENTS, as_text, ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.core.messages.catalog import Catalog
from tests.support.process import run
from tests.support.ros1.debian import PYTHON
from tests.support.waiting import TIMEOUT_S

BEGIN_NS, STEP_NS, COUNT = 1_700_000_000_000_000_000, 100_000_000, 20
READ = """
import json, sys, rosbag
with rosbag.Bag(sys.argv[1]) as bag:
    rows = [(topic, message, at.to_nsec()) for topic, message, at in bag.read_messages()]
    types = {topic: info.msg_type for topic, info in bag.get_type_and_topic_info().topics.items()}
poses = [(message.x, message.theta, at) for topic, message, at in rows if topic == "/robot_0/odometry"]
(odom,) = [message for topic, message, _ in rows if topic == "/robot_0/odom"]
(event,) = [message for topic, message, _ in rows if topic == "/hostlink/events"]
pose = odom.pose.pose.position
print(json.dumps({"types": types, "poses": poses, "frame": odom.header.frame_id, "x": pose.x, "event": event.data}))
"""


def recording(path: Path) -> Path:
    catalog, writer = Catalog(), McapWriter(path, metadata={})

    def write(topic: str, name: str, fields: dict[str, Any], stamp_ns: int) -> None:
        type_ = catalog.message(name)
        assert type_ is not None
        channel = ros_channel(topic, name, type_, is_latched=False, robot="robot_0", origin="device")
        writer.write(channel, stamp_ns, type_.encode(fields))

    for number in range(COUNT):
        fields = {"x": number / 10, "y": 0.0, "theta": 1.5}
        write("/robot_0/odometry", "geometry_msgs/Pose2D", fields, BEGIN_NS + number * STEP_NS)
    header = {"seq": 7, "stamp": {"secs": 10, "nsecs": 5}, "frame_id": "odom"}
    odometry = {"header": header, "pose": {"pose": {"position": {"x": 1.5}}}}
    write("/robot_0/odom", "nav_msgs/Odometry", odometry, BEGIN_NS)
    writer.write(EVENTS, BEGIN_NS, as_text(b'{"kind": "locked"}'))
    writer.close()
    return path


async def of_debian(folder: Path, *words: str) -> str:
    """The output of a program of the system's Python, which has none of the test's own."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "ROS_HOME": str(folder)}
    process = await asyncio.create_subprocess_exec(PYTHON, *words, stdout=PIPE, stderr=PIPE, env=environment)
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await process.communicate()
    assert process.returncode == 0, err.decode()
    return out.decode()


async def test_rosbag_reads_every_message_of_an_export(tmp_path: Path) -> None:
    source, bag = recording(tmp_path / "run.mcap"), tmp_path / "run.bag"
    status, _, err = await run("export", str(source), "--to", "ros1", "-o", str(bag))
    assert status == 0, err
    info = await of_debian(tmp_path, "/usr/bin/rosbag", "info", str(bag))
    assert f"messages:    {COUNT + 2}" in info
    assert "/robot_0/odometry" in info
    assert "geometry_msgs/Pose2D [938fa65709584ad8e77d238529be13b8]" in info
    found = json.loads(await of_debian(tmp_path, "-c", READ, str(bag)))
    assert found["types"] == {
        "/robot_0/odometry": "geometry_msgs/Pose2D",
        "/robot_0/odom": "nav_msgs/Odometry",
        "/hostlink/events": "std_msgs/String",
    }
    assert found["poses"] == [[number / 10, 1.5, BEGIN_NS + number * STEP_NS] for number in range(COUNT)]
    assert (found["frame"], found["x"], json.loads(found["event"])) == ("odom", 1.5, {"kind": "locked"})
