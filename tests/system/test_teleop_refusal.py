"""`hostlink teleop` at a robot whose device cannot take a velocity: the person at the keys reads why."""

from hostlink.protocol.frame import Id
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, topic
from tests.support.process import HOSTLINK
from tests.support.screen import screen

REASON = "/robot_0/velocity_commands: frame of 56 bytes, the device takes 40"
SMALL = [
    topic(Id.PUBLISHER, 125, "/robot_0/odometry", "geometry_msgs/Pose2D"),
    topic(Id.SUBSCRIBER, 100, "/robot_0/velocity_commands", "geometry_msgs/Twist", buffer_bytes=40),
]


async def test_the_screen_shows_why_the_robot_neither_drives_nor_stops() -> None:
    async with daemon() as host, fake_device(host.tcp, SMALL), screen() as terminal:
        await terminal.keys(f"{HOSTLINK} teleop robot_0 --url {host.url}", "Enter")
        await terminal.shows("hostlink teleop   robot_0   connected")
        await terminal.keys("Space")
        await terminal.shows(REASON)
        await terminal.keys("w")
        assert "hostlink teleop   robot_0   connected" in await terminal.shows(REASON)
        await terminal.keys("C-c")
        await terminal.shows("bash-")
