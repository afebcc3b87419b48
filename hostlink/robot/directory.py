"""Directory: which device is which robot, and which device is another one that came back."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

VELOCITY_TYPE = "geometry_msgs/Twist"
ODOMETRY_TYPES = ("geometry_msgs/Pose2D", "nav_msgs/Odometry")
RESET_TYPE = "std_msgs/Empty"
_USUAL_NAMES = ("velocity_commands", "cmd_vel")

TopicClaim = tuple[str, str, bool]  # name, type, whether it goes to the device


@dataclass(frozen=True, slots=True)
class RobotTopics:
    """A robot and the topics by which it is driven and read."""

    name: str
    velocity: str
    odometry: str
    odometry_type: str
    reset: str | None


@dataclass(frozen=True, slots=True)
class Accepted:
    """The device may stay; `replaces` is the number of an older link of the same one."""

    robot: RobotTopics | None
    replaces: int | None


@dataclass(frozen=True, slots=True)
class Refused:
    """The device may not stay: its robot's name belongs to another."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Entry:
    address: str
    robot: str | None
    names: frozenset[str]


class Directory:
    """Knows devices by the numbers of their links.

    A device is another's return when address and robot are the same; one that is no robot, when address and topics
    are. Robots of one name at two addresses are a mistake that only configuration can mend.
    """

    def __init__(self, addresses: Mapping[str, str | None]) -> None:
        """`addresses`: robot name -> the peer address or serial port that the configuration gives it."""
        self._names = {address: name for name, address in addresses.items() if address is not None}
        self._entries: dict[int, _Entry] = {}

    def claim(self, link: int, address: str, topics: Sequence[TopicClaim]) -> Accepted | Refused:
        """A device has told its topics (again)."""
        robot = find_robot(topics, self._names.get(address))
        entry = _Entry(address, None if robot is None else robot.name, frozenset(name for name, _, _ in topics))
        replaces = None
        for other_link, other in self._entries.items():
            if other_link == link:
                continue
            if entry.robot is not None and other.robot == entry.robot and other.address != address:
                return Refused(
                    f"two devices claim the robot name {entry.robot}: {other.address} has it, {address} wants it; "
                    f'name one of them in hostlink.toml: [robots.OTHER_NAME] address = "{address}"'
                )
            if other.address == address and other.robot == entry.robot and (entry.robot or other.names == entry.names):
                replaces = other_link
        if replaces is not None:
            del self._entries[replaces]
        self._entries[link] = entry
        return Accepted(robot, replaces)

    def leave(self, link: int) -> None:
        """The device's link is gone."""
        self._entries.pop(link, None)


def find_robot(topics: Sequence[TopicClaim], name: str | None = None) -> RobotTopics | None:
    """A device that takes a Twist and tells a pose is a robot, named by their namespace unless `name` is given."""
    velocities = [topic for topic, type_name, is_to_device in topics if is_to_device and type_name == VELOCITY_TYPE]
    odometries = [
        (topic, type_name)
        for topic, type_name, is_to_device in topics
        if not is_to_device and type_name in ODOMETRY_TYPES
    ]
    pairs = [(velocity, *odometry) for velocity in velocities for odometry in odometries]
    if not pairs:
        return None
    velocity, odometry, odometry_type = min(pairs, key=lambda pair: _unlikelihood(pair[0], pair[1]))
    namespace = _namespace(velocity)
    resets = [
        topic
        for topic, type_name, is_to_device in topics
        if is_to_device and type_name == RESET_TYPE and "reset" in topic and _namespace(topic) == namespace
    ]
    return RobotTopics(
        name or namespace.strip("/").replace("/", "_") or "robot",
        velocity,
        odometry,
        odometry_type,
        next(iter(sorted(resets)), None),
    )


def _namespace(topic: str) -> str:
    return ("/" + topic.lstrip("/~")).rpartition("/")[0]


def _unlikelihood(velocity: str, odometry: str) -> tuple[bool, bool, str]:
    """Small for the pair that a person would choose."""
    return _namespace(velocity) != _namespace(odometry), velocity.rpartition("/")[2] not in _USUAL_NAMES, velocity
