"""`hostlink serve` as a node of ROS 2 over Zenoh, by its settings alone."""

import signal
from pathlib import Path

import aiohttp
import pytest

from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.process import free_port, serve
from tests.support.rmw import TWIST, ros2_peer


@pytest.mark.alone
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
        fields = {"linear": {"x": 0.2}}
        await peer.request("stream", "streaming", topic="/robot_0/cmd_vel", type=TWIST, fields=fields, hz=20)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        await device.send(pose(0.5))
        assert (await peer.read("message"))["pose"]["pose"]["position"]["x"] == 0.5
        async with aiohttp.ClientSession() as session, session.get(f"{process.url}/metrics") as response:
            assert 'hostlink_graph_events_total{graph="ros2",what="from_ros2"}' in await response.text()
        assert await process.end(signal.SIGTERM) == 0
        while (await device.velocity())[0] != 0:
            pass
    assert [line["node"] for line in process.log if line["event"] == "ros2.joined"] == ["/hostlink_lab"]
