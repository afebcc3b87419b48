"""A daemon that is in a graph of ROS 1 loads nothing once it runs."""

import asyncio
import signal
import sys
from pathlib import Path

from tests.support.fake_device import pose, robot_topics
from tests.support.process import HOSTLINK, serve
from tests.support.ros1.debian import graph, living_device

TRACED = (sys.executable, "-X", "importtime", HOSTLINK)


async def test_in_a_graph_nothing_is_imported_once_the_node_has_started(tmp_path: Path) -> None:
    log = tmp_path / "log"
    async with (
        graph(tmp_path) as ros,
        serve("--ros1", ros.url, log=log, program=TRACED) as daemon,
        living_device(daemon.tcp, robot_topics()) as robot,
        ros.node("listen", "/robot_0/odometry", "geometry_msgs/Pose2D") as listener,
        ros.node("drive", "/robot_0/velocity_commands", "0.2", "20"),
        ros.node("call", "/robot_0/lock", "std_srvs/Trigger", "") as caller,
    ):
        await caller.read("answered")
        for _ in range(20):
            await robot.send(pose(1.0))
            await asyncio.sleep(0.05)
        await listener.read("message")
        assert await daemon.end(signal.SIGTERM) == 0
    late = log.read_text().split("ros1.master_found")[1].splitlines()
    assert [line for line in late if line.startswith("import time")] == []
