"""Recordings that a test writes, for tests that play them."""

from collections.abc import Iterable
from pathlib import Path

from hostlink.cli import play
from hostlink.components.recorder.channel import DEVICE, VELOCITY, Channel, ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.fake_device import CATALOG

FORWARD = PlanarVelocity(x_m_s=0.2)
PLAYBACK = play.Playback(rate=1.0, start_s=0.0, is_looped=False, is_stepped=False)
POSE = bytes(24)


def channel(name: str, type_name: str, origin: str, robot: str = "robot_0") -> Channel:
    type_ = CATALOG.message(type_name)
    return ros_channel(name, type_name, type_, is_latched=False, robot=robot, origin=origin)


COMMANDS = channel("/robot_0/velocity_commands", "geometry_msgs/Twist", VELOCITY)
ODOMETRY = channel("/robot_0/odometry", "geometry_msgs/Pose2D", DEVICE)


def recording(folder: Path, messages: Iterable[tuple[float, Channel, bytes]], channels: Iterable[Channel] = ()) -> Path:
    """Write messages at times in seconds. `channels` are announced first."""
    path = folder / "run.mcap"
    writer = McapWriter(path, metadata={})
    for each in channels:
        writer.announce(each)
    for at_s, of, payload in messages:
        writer.write(of, 10**18 + int(at_s * 1e9), payload)
    writer.close()
    return path
