"""A bag that `hostlink export` made for ROS 2, read by rclpy: its own types, its own CDR."""

import asyncio
import json
from asyncio.subprocess import PIPE
from pathlib import Path

from hostlink.components.recorder.channel import ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.core.messages.catalog import Catalog
from tests.support.process import run
from tests.support.ros2 import PYTHON

BEGIN_NS, COUNT = 1_700_000_000_000_000_000, 5
READ = """
import json, sys
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from geometry_msgs.msg import Pose2D
from nav_msgs.msg import Odometry
TYPES = {"geometry_msgs/msg/Pose2D": Pose2D, "nav_msgs/msg/Odometry": Odometry}
with open(sys.argv[1], "rb") as file:
    rows = [
        (channel.topic, message.log_time, deserialize_message(message.data, TYPES[schema.name]))
        for schema, channel, message in make_reader(file).iter_messages()
    ]
poses = [[message.x, message.theta, at] for topic, at, message in rows if topic == "/robot_0/odometry"]
(odom,) = [message for topic, _, message in rows if topic == "/robot_0/odom"]
facts = [odom.header.frame_id, odom.header.stamp.sec, odom.pose.pose.position.x, list(odom.pose.covariance)]
print(json.dumps({"poses": poses, "odom": facts}))
"""


async def test_rclpy_reads_every_message_of_an_export(tmp_path: Path) -> None:
    catalog, writer = Catalog(), McapWriter(tmp_path / "run.mcap", metadata={})
    header = {"seq": 7, "stamp": {"secs": 10, "nsecs": 5}, "frame_id": "odom"}
    odometry = {"header": header, "pose": {"pose": {"position": {"x": 1.5}}, "covariance": [0.25] * 36}}
    messages = [("/robot_0/odom", "nav_msgs/Odometry", odometry, 0)]
    messages += [
        ("/robot_0/odometry", "geometry_msgs/Pose2D", {"x": number / 10, "theta": 1.5}, number)
        for number in range(COUNT)
    ]
    for topic, name, fields, number in messages:
        type_ = catalog.message(name)
        assert type_ is not None
        writer.write(ros_channel(topic, name, type_, is_latched=False), BEGIN_NS + number, type_.encode(fields))
    writer.close()
    bag = tmp_path / "bag"
    status, _, err = await run("export", str(tmp_path / "run.mcap"), "--to", "ros2", "-o", str(bag))
    assert status == 0, err
    (path,) = await asyncio.to_thread(lambda: list(bag.glob("*.mcap")))
    process = await asyncio.create_subprocess_exec(PYTHON, "-c", READ, str(path), stdout=PIPE, stderr=PIPE)
    async with asyncio.timeout(60):
        out, errors = await process.communicate()
    assert process.returncode == 0, errors.decode()
    assert json.loads(out) == {
        "poses": [[number / 10, 1.5, BEGIN_NS + number] for number in range(COUNT)],
        "odom": ["odom", 10, 1.5, [0.25] * 36],
    }
