"""Robots of other daemons, without these daemons."""

from typing import Any

from hostlink.core.hub.hub import Hub
from hostlink.core.hub.robot import RemoteRobot
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity


class RecordingHosts:
    """Records what other daemons are sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[Any, ...]] = []

    def drive(
        self,
        _: object,
        velocity: PlanarVelocity,
        *,
        owner: object,
        priority: int,
        received_s: float,  # noqa: ARG002 - as the fleet has it
        epoch: int | None,
        take_over: bool,
    ) -> None:
        self.sent.append(("drive", velocity, owner, priority, epoch, *(["take over"] if take_over else [])))

    def stop(self, name: str | None) -> None:
        self.sent.append(("stop", name))

    def lock(self, name: str, reason: str) -> None:
        self.sent.append(("lock", name, reason))

    def unlock(self, _: object) -> None:
        self.sent.append(("unlock",))

    def release(self, owner: object) -> None:
        self.sent.append(("release", owner))

    async def settled(self) -> None:
        self.sent.append(("settled",))


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


def connected_robot(hub: Hub, name: str, hosts: Any) -> RemoteRobot:
    """A robot of the registry, connected to the daemon `other` and offering its velocity topic."""
    robot = remote_robot(hub, name, hosts)
    hub.robots.put_remote(robot)
    robot.connect(12, 100, hub.robots.new_number)
    robot.offer([(f"/{name}/cmd_vel", TWIST_TYPE)])
    return robot
