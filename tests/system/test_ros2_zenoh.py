"""`hostlink serve` as a node of ROS 2 over Zenoh, by its settings alone."""

import asyncio
import signal
from pathlib import Path

import aiohttp

from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.process import Process, free_port, serve
from tests.support.rmw import TWIST, ros2_peer
from tests.support.waiting import TIMEOUT_S


async def wait_for_a_command_from_ros2(process: Process) -> None:
    count, text = 'hostlink_graph_events_total{graph="ros2",what="from_ros2"}', ""
    async with aiohttp.ClientSession() as session, asyncio.timeout(TIMEOUT_S):
        while count not in text:
            async with session.get(f"{process.url}/metrics") as response:
                text = await response.text()


async def test_a_daemon_is_a_node_of_ros_2_by_its_settings(tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    settings = tmp_path / "hostlink.toml"
    settings.write_text(
        f'[zenoh]\nros2 = true\nfleet = false\nname = "lab"\nmulticast = false\nlisten = ["tcp/{address}"]\n'
    )
    async with (
        serve("--config", str(settings)) as process,
        ros2_peer(address) as peer,  # before the device, which says nothing meanwhile: it would be taken for gone
        fake_device(process.tcp, robot_topics()) as device,
    ):
        await peer.request("echo", "subscribed", topic="/robot_0/odom", type="nav_msgs/msg/Odometry")
        # A publisher that is met within 3 s of the start may be in the middle of a motion: it must stop first.
        await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields={}, hz=20)
        await wait_for_a_command_from_ros2(process)
        await peer.request("end_stream", "ended", topic="/robot_0/cmd_vel")
        fields = {"linear": {"x": 0.2}}
        await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        await device.send(pose(0.5))
        assert (await peer.read("message"))["pose"]["pose"]["position"]["x"] == 0.5
        assert await process.end(signal.SIGTERM) == 0
        while (await device.velocity())[0] != 0:
            pass
    assert [line["node"] for line in process.log if line["event"] == "ros2.joined"] == ["/hostlink_lab"]
