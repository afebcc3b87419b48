"""RobotTopicPublisher: a robot's topics under the names that ROS programs expect: odom, tf, cmd_vel."""

import asyncio
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import structlog

from hostlink.config import RobotConfig
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.message import Message
from hostlink.hub.robots import Robot
from hostlink.hub.topic_graph import DAEMON, Topic, TopicGraph, resolve
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry_estimator import Twist
from hostlink.robot.ros_messages import FrameIds, odometry_of, transform_of, variances_of
from hostlink.robot.velocity import Velocity

log = structlog.get_logger()

TF_TOPIC = "/tf"
ODOMETRY_TYPE, TF_TYPE = "nav_msgs/Odometry", "tf2_msgs/TFMessage"
TWIST_TYPE, TWIST_STAMPED_TYPE = "geometry_msgs/Twist", "geometry_msgs/TwistStamped"
_NS_PER_S = 1_000_000_000


@dataclass(slots=True)
class _Offer:
    """What one connected robot has by the names of ROS; None: not offered, or a device's own."""

    robot: Robot
    frames: FrameIds
    odom: Topic | None = None
    publishes_tf: bool = False
    commands: dict[str, str] = field(default_factory=dict)  # topic -> type
    wanted: frozenset[str] = frozenset()  # every name that it has, or would have if it were nobody else's
    seen: int = 0  # poses


class RobotTopicPublisher:
    """Offered while a robot is connected; a name that a device uses for the same is the device's.

    Frame ids stay while a robot is known: the first robot has the plain ones, others have their name in front.
    """

    def __init__(self, configs: Mapping[str, RobotConfig], graph: TopicGraph, catalog: Catalog) -> None:
        self._configs, self._graph = configs, graph
        self._types = {name: _type(catalog, name) for name in (ODOMETRY_TYPE, TF_TYPE, TWIST_TYPE, TWIST_STAMPED_TYPE)}
        self._frames: dict[str, FrameIds] = {}
        self._plain = next(iter(configs)) if len(configs) == 1 else None  # the robot whose frames have no name before
        self._offers: dict[str, _Offer] = {}  # by robot
        self._commands: dict[str, _Offer] = {}  # by topic
        self._wanting: defaultdict[str, dict[str, None]] = defaultdict(dict)  # robots, by the names that they want
        self._tf: Topic | None = None  # while a robot tells its transform

    def update(self, robots: Iterable[Robot], touched: frozenset[str]) -> None:
        """These robots came, left, or their devices have other topics; `touched` are those, by their full names.

        What that changes is offered anew. With a thousand robots, one that comes touches no other.
        """
        changed = {robot.name: robot for robot in robots}
        lost = [self._offers[name] for name in changed if name in self._offers]
        freed = touched.union(*(offer.wanted for offer in lost))
        names = changed.keys() | {name for topic in freed for name in self._wanting.get(topic, ())}
        for name in names:
            offer = self._offers.pop(name, None)
            if offer is not None:
                changed[name] = offer.robot
                self._close(offer)
        if TF_TOPIC in touched:
            self._reopen_tf()
        for name in sorted(changed):
            if changed[name].link is not None:
                self._open(changed[name])
        if not self._offers:
            self._close_tf()

    def command(self, topic: Topic, payload: bytes) -> tuple[Robot, Velocity] | None:
        """The robot and the velocity that a message on this topic means; None: it is no command. BadRequest."""
        offer = self._commands.get(topic.name)
        if offer is None or topic.type_name != offer.commands[topic.name]:
            return None
        type_name = topic.type_name
        message: Mapping[str, Any] = self._types[type_name].decode(payload)
        if type_name == TWIST_STAMPED_TYPE:
            self._check_age(offer.robot, message["header"]["stamp"])
            message = message["twist"]
        return offer.robot, Velocity.from_twist(message)

    def names_of_velocity(self, robot: Robot) -> list[str]:
        """The topics on which a Twist is seen when the robot is driven."""
        offer = self._offers.get(robot.name)
        others = {} if offer is None else offer.commands
        return [robot.shown.velocity, *(name for name, type_name in others.items() if type_name == TWIST_TYPE)]

    def relay(self, robot: Robot, message: Message) -> None:
        """Take a message of a robot's odometry that the robot has seen; tell it to whom it may concern."""
        offer = self._offers.get(robot.name)
        if offer is None or robot.odometry.count == offer.seen:  # what was seen was no pose
            return
        offer.seen = robot.odometry.count
        tf = self._tf if offer.publishes_tf else None
        wanted = ((offer.odom, ODOMETRY_TYPE), (tf, TF_TYPE))
        heard = [(topic, type_name) for topic, type_name in wanted if topic is not None and topic.is_heard]
        view = robot.odometry.snapshot(asyncio.get_running_loop().time()) if heard else None
        if view is None:
            return
        stamp = dict(zip(("secs", "nsecs"), divmod(view["stamp_ns"], _NS_PER_S), strict=True))
        pose, twist = Pose(**view["pose"]), Twist(**view["twist"])
        odometry = odometry_of(pose, twist, offer.frames, stamp, variances_of(message.decoded))
        for topic, type_name in heard:
            fields = odometry if type_name == ODOMETRY_TYPE else transform_of(odometry)
            try:
                topic.publish(self._types[type_name].encode(fields), view["stamp_ns"], source=DAEMON)
            except HostlinkError as error:
                log.debug("message.refused", topic=topic.name, reason=str(error))

    def forget(self, robot: Robot) -> None:
        """The robot is forgotten; the plain frames may be another's."""
        self._frames.pop(robot.name, None)
        if self._plain == robot.name and robot.name not in self._configs:
            self._plain = None

    def _open(self, robot: Robot) -> None:
        offer = self._offers[robot.name] = _Offer(robot, self._frames_of(robot), seen=robot.odometry.count)
        offer.wanted = frozenset(resolve(name) for name in (_odom(robot), *_command_topics(robot)) if name)
        for name in offer.wanted:
            self._wanting[name][robot.name] = None
        offer.odom = self._advertise(_odom(robot), ODOMETRY_TYPE, robot.shown.odometry)
        offer.publishes_tf = robot.config.publish_tf and not self._publishes(robot, TF_TOPIC)
        if offer.publishes_tf and self._tf is None:
            self._tf = self._advertise(TF_TOPIC, TF_TYPE)
        for topic, type_name in _command_topics(robot).items():
            if self._take(topic, type_name):
                offer.commands[resolve(topic)] = type_name
                self._commands[resolve(topic)] = offer

    def _close(self, offer: _Offer) -> None:
        for name in offer.wanted:
            self._wanting[name].pop(offer.robot.name, None)
            if not self._wanting[name]:
                del self._wanting[name]
        if offer.odom is not None:
            self._graph.unadvertise(offer.odom.name, DAEMON)
        for name in offer.commands:
            self._graph.unsubscribe_device(name, DAEMON)
            del self._commands[name]

    def _reopen_tf(self) -> None:
        """A device has begun or ceased to use it: the type may be another."""
        self._close_tf()
        if any(offer.publishes_tf for offer in self._offers.values()):
            self._tf = self._advertise(TF_TOPIC, TF_TYPE)

    def _close_tf(self) -> None:
        if self._tf is not None:
            self._graph.unadvertise(TF_TOPIC, DAEMON)
            self._tf = None

    def _advertise(self, name: str, type_name: str, taken: str = "") -> Topic | None:
        """None for a name that is switched off, that a device publishes itself, or that has another type."""
        known = self._graph.find_or_none(name)
        is_devices = name != TF_TOPIC and known is not None and known.has_device_publisher
        if not name or is_devices or resolve(name) == taken:
            return None
        try:
            return self._graph.advertise(name, DAEMON, type_name=type_name)
        except HostlinkError as error:
            log.warning("topic.refused", topic=name, reason=str(error))
            return None

    def _take(self, name: str, type_name: str) -> bool:
        """False for a name that is switched off, that a device takes itself, that a robot has, or of another type."""
        known = self._graph.find_or_none(name)
        if not name or resolve(name) in self._commands or (known is not None and known.devices):
            return False
        try:
            self._graph.subscribe_device(name, DAEMON, _through_the_gate, type_name=type_name)
        except HostlinkError as error:
            log.warning("topic.refused", topic=name, reason=str(error))
            return False
        return True

    def _publishes(self, robot: Robot, name: str) -> bool:
        topic = self._graph.find_or_none(name)
        return topic is not None and robot.link in topic.publishers

    def _frames_of(self, robot: Robot) -> FrameIds:
        if robot.name not in self._frames:
            if self._plain is None and not self._configs:
                self._plain = robot.name
            prefix = "" if self._plain == robot.name else f"{robot.name}/"
            odom, base = robot.config.odom_frame or f"{prefix}odom", robot.config.base_frame or f"{prefix}base_link"
            self._frames[robot.name] = FrameIds(odom, base)
        return self._frames[robot.name]

    def _check_age(self, robot: Robot, stamp: Mapping[str, int]) -> None:
        limit_s = robot.config.cmd_vel_max_age_s
        stamp_ns = stamp["secs"] * _NS_PER_S + stamp["nsecs"]
        age_s = (time.time_ns() - stamp_ns) / _NS_PER_S
        if limit_s is not None and stamp_ns and age_s > limit_s:
            raise BadRequest(f"{robot.name}: the command is {age_s:.3f} s old, cmd_vel_max_age_s allows {limit_s:g}")


def _odom(robot: Robot) -> str:
    return _chosen(robot.config.odom_topic, f"{robot.name}/odom")


def _command_topics(robot: Robot) -> dict[str, str]:
    return {
        _chosen(robot.config.cmd_vel_topic, f"{robot.name}/cmd_vel"): TWIST_TYPE,
        _chosen(robot.config.cmd_vel_stamped_topic, f"{robot.name}/cmd_vel_stamped"): TWIST_STAMPED_TYPE,
    }


def _through_the_gate(payload: bytes) -> None:
    """The hub makes a command of every message on this topic, and the robot's gate sends it."""


def _chosen(configured: str | None, default: str) -> str:
    return default if configured is None else configured


def _type(catalog: Catalog, name: str) -> MessageType:
    found = catalog.message(name)
    assert found is not None  # noqa: S101 - of the store that the project is built on
    return found
