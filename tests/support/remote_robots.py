"""Robots of other hosts, without these hosts."""

from collections.abc import Awaitable, Hashable
from typing import Any

from hostlink.core.hub.hub import Hub
from hostlink.core.hub.providers import Provision, RobotProvider
from hostlink.core.hub.remote_robot import RemoteRobot
from hostlink.core.robot.admission import Command
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity


class RecordingHosts(RobotProvider):
    """Records what other daemons are sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[Any, ...]] = []

    def drive(self, robot: RemoteRobot, command: Command[PlanarVelocity]) -> None:  # noqa: ARG002 - as the fleet has it
        facts = (command.velocity, command.source, command.priority, command.epoch)
        self.sent.append(("drive", *facts, *(["take over"] if command.take_over else [])))

    def answer(self, robot: RemoteRobot, owner: Hashable) -> Awaitable[PlanarVelocity]:
        raise AssertionError(f"{robot.name} is asked for no answer to {owner}")

    def stop(self, name: str | None) -> None:
        self.sent.append(("stop", name))

    def lock(self, name: str | None, reason: str) -> None:
        self.sent.append(("lock", name, reason))

    def unlock(self, robot: RemoteRobot) -> None:  # noqa: ARG002 - as the fleet has it
        self.sent.append(("unlock",))

    def unlock_all(self) -> None:
        self.sent.append(("unlock all",))

    def release(self, owner: Hashable) -> None:
        self.sent.append(("release", owner))

    async def settled(self) -> list[CommandEndpoint]:
        self.sent.append(("settled",))
        return []


def reach(hub: Hub, hosts: RobotProvider) -> Provision:
    """Let stops and locks of the hub reach a provider."""
    provision = provision_of(hosts)
    hub.gates.providers.add(provision)
    return provision


def provision_of(hosts: RobotProvider) -> Provision:
    def fail(error: Exception) -> None:
        raise error

    return Provision(hosts, "fleet", fail)


def remote_robot(hub: Hub, name: str, hosts: Any = None) -> RemoteRobot:
    """A robot of the daemon `other`, which `hosts` reaches; it is not in the registry yet."""
    known = RobotState(
        name=name,
        velocity_topic=f"/{name}/cmd_vel",
        odometry_topic=f"/{name}/odom",
        odometry_type="geometry_msgs/Pose2D",
    )
    return RemoteRobot(
        known,
        host="other",
        place="other",
        provision=provision_of(hosts),
        gates=hub.gates,
        graph=hub.topics,
        new_number=hub.robots.new_number,
    )


def connected_robot(hub: Hub, name: str, hosts: Any) -> RemoteRobot:
    """A robot of the registry, connected to the daemon `other` and offering its velocity topic."""
    robot = remote_robot(hub, name, hosts)
    hub.robots.put_remote(robot)
    robot.connect(12, 100)
    robot.offer([(f"/{name}/cmd_vel", TWIST_TYPE)])
    return robot
