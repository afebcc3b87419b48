"""Directory: which device is which robot, and which device is another one that came back."""

import itertools
import re
from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

VELOCITY_TYPE = "geometry_msgs/Twist"
ODOMETRY_TYPES = ("geometry_msgs/Pose2D", "nav_msgs/Odometry")
RESET_TYPE = "std_msgs/Empty"
_USUAL_NAMES = ("velocity_commands", "cmd_vel")  # the likelier first
_DEFAULT_NAME = "robot"
_LONGEST_NAME = 64  # characters; a name goes into logs, paths and labels

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
    """What a device claims to be."""

    address: str
    robot: RobotTopics | None
    announced: Hashable

    @property
    def identity(self) -> tuple[str, Hashable]:
        """What a device has in common with itself before a reconnect."""
        return self.address, self.announced if self.robot is None else self.robot.name


class Directory:
    """Knows devices by the numbers of their links.

    A device is another's return when address and robot are the same; one that is no robot, when address and all that
    it announced are. Robots of one name at two addresses are a mistake that only configuration can mend; a name that
    the configuration gives to an address is nobody else's.
    """

    def __init__(self, addresses: Mapping[str, str | None]) -> None:
        """`addresses`: robot name -> the peer address or serial port that the configuration gives it."""
        self._addresses = {name: address for name, address in addresses.items() if address is not None}
        self._names: defaultdict[str, list[str]] = defaultdict(list)
        for name, address in self._addresses.items():
            self._names[address].append(name)
        self._entries: dict[int, _Entry] = {}

    def claim(
        self, link: int, address: str, topics: Sequence[TopicClaim], *, announced: Hashable = None
    ) -> Accepted | Refused:
        """A device has told its topics (again); `announced` is all that it told, if that is more than the topics."""
        others = {number: entry for number, entry in self._entries.items() if number != link}
        robot = find_robot(topics)
        if robot is not None:
            robot = replace(robot, name=self._configured_name(robot, address, others.values()))
            refusal = self._refusal(robot.name, address, others.values())
            if refusal is not None:
                return refusal
        entry = _Entry(address, robot, announced or frozenset(topics))
        replaces = next((number for number, other in others.items() if other.identity == entry.identity), None)
        if replaces is not None:
            del self._entries[replaces]
        self._entries[link] = entry
        return Accepted(robot, replaces)

    def leave(self, link: int) -> None:
        """The device's link is gone."""
        self._entries.pop(link, None)

    def _configured_name(self, robot: RobotTopics, address: str, others: Iterable[_Entry]) -> str:
        """Its own name if that is configured for the address, else the first that no other robot there has."""
        names = self._names.get(address, [])
        if robot.name in names:
            return robot.name
        taken = {
            other.robot.name for other in others if other.robot is not None and other.robot.velocity != robot.velocity
        }
        return next((name for name in names if name not in taken), robot.name)

    def _refusal(self, name: str, address: str, others: Iterable[_Entry]) -> Refused | None:
        configured = self._addresses.get(name, address)
        if configured != address:
            return Refused(
                f"the robot name {name} belongs to {configured} in hostlink.toml, but {address} wants it; "
                f'correct the address, or name this one: [robots.OTHER_NAME] address = "{address}"'
            )
        for other in others:
            if other.robot is not None and other.robot.name == name and other.address != address:
                return Refused(
                    f"two devices claim the robot name {name}: {other.address} has it, {address} wants it; "
                    f'name one of them in hostlink.toml: [robots.OTHER_NAME] address = "{address}"'
                )
        return None


def find_robot(topics: Sequence[TopicClaim]) -> RobotTopics | None:
    """A device that takes a Twist and tells a pose is a robot, named by their common namespace."""
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
    namespaces = (_namespace(velocity), _namespace(odometry))
    resets = [
        topic
        for topic, type_name, is_to_device in topics
        if is_to_device and type_name == RESET_TYPE and "reset" in _leaf(topic) and _namespace(topic) in namespaces
    ]
    reset = min(resets, key=lambda topic: ("odom" not in _leaf(topic), topic), default=None)
    return RobotTopics(_name(*namespaces), velocity, odometry, odometry_type, reset)


def _parts(topic: str) -> list[str]:
    return [part for part in topic.lstrip("~").split("/") if part]


def _leaf(topic: str) -> str:
    return _parts(topic)[-1] if _parts(topic) else ""


def _namespace(topic: str) -> tuple[str, ...]:
    return tuple(_parts(topic)[:-1])


def _name(velocity: tuple[str, ...], odometry: tuple[str, ...]) -> str:
    """What two namespaces have in common; else the one that there is."""
    pairs = zip(velocity, odometry, strict=False)
    common = [here for here, _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs)]
    name = "_".join(common or velocity or odometry)
    return re.sub(r"\W", "_", name, flags=re.ASCII)[:_LONGEST_NAME] or _DEFAULT_NAME


def _unlikelihood(velocity: str, odometry: str) -> tuple[int, bool, bool, str, str]:
    """Small for the pair that a person would choose."""
    leaf = _leaf(velocity)
    rank = _USUAL_NAMES.index(leaf) if leaf in _USUAL_NAMES else len(_USUAL_NAMES)
    is_apart = _namespace(velocity) != _namespace(odometry)
    return rank, is_apart, "odom" not in _leaf(odometry), velocity, odometry
