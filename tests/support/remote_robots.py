"""Robots of other daemons, without these daemons."""

from typing import Any

from hostlink.hub.hub import Hub
from hostlink.hub.robot import RemoteRobot
from hostlink.robot.state import RobotState


def remote_robot(hub: Hub, name: str, hosts: Any = None) -> RemoteRobot:
    """A robot of the daemon `other`, which `hosts` reaches; it is not in the registry yet."""
    known = RobotState(
        name=name,
        velocity_topic=f"/{name}/cmd_vel",
        odometry_topic=f"/{name}/odom",
        odometry_type="geometry_msgs/Pose2D",
    )
    return RemoteRobot(
        name=name, host="other", place="other", known=known, hosts=hosts, gates=hub.gates, graph=hub.topics
    )
