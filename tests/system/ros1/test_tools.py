"""Debian's tools of ROS with the daemon: rostopic, rosnode and rosservice."""

import asyncio
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.fake_device import FakeDevice, pose, repeating, robot_topics
from tests.support.process import Process
from tests.support.ros1.debian import Graph, graph, living_device
from tests.support.waiting import TIMEOUT_S

ODOMETRY, VELOCITY = "/robot_0/odometry", "/robot_0/velocity_commands"


@dataclass
class Scene:
    """A master, the daemon and one robot, which publishes its pose at 20 Hz."""

    ros: Graph
    daemon: Process
    robot: FakeDevice


@pytest.fixture
async def scene(tmp_path: Path) -> AsyncIterator[Scene]:
    async with (
        graph(tmp_path) as ros,
        ros.daemon() as daemon,
        living_device(daemon.tcp, robot_topics()) as robot,
        repeating(robot, pose(1.5), interval_s=0.05),
    ):
        await ros.listed(ODOMETRY)
        yield Scene(ros, daemon, robot)


@pytest.mark.long
async def test_rostopic_lists_describes_measures_and_prints_what_a_device_publishes(scene: Scene) -> None:
    topics = await scene.ros.lines("rostopic", "list")
    assert {ODOMETRY, VELOCITY, "/robot_0/odom", "/robot_0/cmd_vel", "/tf", "/rosout"} <= set(topics)
    assert await scene.ros.lines("rostopic", "type", ODOMETRY) == ["geometry_msgs/Pose2D"]
    info = "\n".join(await scene.ros.lines("rostopic", "info", VELOCITY))
    assert "Type: geometry_msgs/Twist" in info
    assert re.search(r"Subscribers:\s*\n\* /hostlink \(http://127.0.0.1:\d+/\)", info)
    _, out = await scene.ros.run("timeout", "-s", "INT", "3", "rostopic", "hz", "-w", "20", ODOMETRY)
    rates = [float(rate) for rate in re.findall(r"average rate: ([\d.]+)", out)]
    assert rates, out
    assert 15 < rates[-1] < 25
    assert "x: 1.5" in await scene.ros.lines("rostopic", "echo", "-n", "1", ODOMETRY)


async def test_rostopic_drives_a_robot(scene: Scene) -> None:
    status, out = await scene.ros.run("rostopic", "pub", "-1", VELOCITY, "geometry_msgs/Twist", "{linear: {x: 0.25}}")
    assert status == 0, out
    assert await scene.robot.velocity_other_than((0.0, 0.0)) == (0.25, 0.0)
    assert await scene.robot.velocity_other_than((0.25, 0.0)) == (0.0, 0.0)


@pytest.mark.long
async def test_rosnode_and_rosservice_find_the_daemon_and_rosnode_kill_ends_its_graph_part_alone(scene: Scene) -> None:
    services = await scene.ros.lines("rosservice", "list")
    assert "/robot_0/lock" in services, services
    assert await scene.ros.lines("rosservice", "type", "/robot_0/lock") == ["std_srvs/Trigger"]
    assert await scene.ros.lines("rosservice", "node", "/robot_0/lock") == ["/hostlink"]
    assert "success: True" in await scene.ros.lines("rosservice", "call", "/robot_0/lock")
    assert "/hostlink" in await scene.ros.lines("rosnode", "list")
    info = "\n".join(await scene.ros.lines("rosnode", "info", "/hostlink"))
    assert f"* {ODOMETRY} [geometry_msgs/Pose2D]" in info
    assert f"* {VELOCITY} [" in info
    assert "* /robot_0/lock" in info
    assert "Pid:" in info
    assert "xmlrpc reply from" in "\n".join(await scene.ros.lines("rosnode", "ping", "-c", "2", "/hostlink"))

    assert "killed" in "\n".join(await scene.ros.lines("rosnode", "kill", "/hostlink"))
    ended = await scene.daemon.read_log("ros1.ended")
    assert "/rosnode" in ended["reason"]
    await scene.ros.listed(ODOMETRY, is_there=False)
    async with asyncio.timeout(TIMEOUT_S):
        while "/hostlink" in await scene.ros.lines("rosnode", "list"):
            continue
    status, out = await scene.ros.run("rosnode", "ping", "-c", "1", "/hostlink")
    assert "unknown node" in out, (status, out)
    assert scene.daemon.child.returncode is None
    await scene.robot.send(pose(2.0))
