"""ShownNames: by which names a device's topics and services stand in the graph."""

from hostlink.hub.topic_graph import resolve
from hostlink.robot.directory import RobotTopicNames


class ShownNames:
    """Of one device. Those of a robot that is named otherwise than it announces itself stand under the robot's name.

    `/robot_0/imu` of a robot that is named `a` is `/a/imu`, and so is `imu` of one that has no namespace. Velocity,
    odometry and reset are the robot's wherever they are: `/odom` is `/a/odom`. All else has the name that it
    announces, and is shared with who else uses it, as in ROS.
    """

    def __init__(self, robot: RobotTopicNames | None = None, name: str | None = None) -> None:
        """`name`: what the robot is called here."""
        self._is_renamed = robot is not None and name not in (None, robot.name)
        self._name = name or ""
        namespace = () if robot is None else robot.namespace
        self._prefix = "/" + "".join(f"{part}/" for part in namespace)
        own = () if robot is None else (robot.velocity, robot.odometry, robot.reset)
        self._own = {resolve(topic) for topic in own if topic is not None}

    def of(self, name: str) -> str:
        """The full name in the graph of what the device names so."""
        full = resolve(name)
        if not self._is_renamed:
            return full
        if self._prefix != "/" and full.startswith(self._prefix):
            return f"/{self._name}/{full.removeprefix(self._prefix)}"
        is_relative = self._prefix == "/" and not name.startswith("/")
        return f"/{self._name}{full}" if is_relative or full in self._own else full

    def of_robot(self, robot: RobotTopicNames) -> RobotTopicNames:
        """The robot's topics, by their names in the graph."""
        reset = None if robot.reset is None else self.of(robot.reset)
        return RobotTopicNames(
            self._name or robot.name, self.of(robot.velocity), self.of(robot.odometry), robot.odometry_type, reset
        )
