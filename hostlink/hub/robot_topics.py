"""RobotTopics: the topics by which ROS programs know a robot, whatever its device calls them: odom, tf, cmd_vel."""

import asyncio
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import structlog

from hostlink.config import RobotConfig
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.message import Message
from hostlink.hub.robots import Robot
from hostlink.hub.subscriptions import DAEMON, Topic, TopicGraph, resolve
from hostlink.link.link import Link
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType
from hostlink.robot.directory import RobotTopics as DeviceTopics
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry import Twist
from hostlink.robot.ros_messages import Frames, odometry_of, transform_of, variances_of
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
    link: Link
    topics: DeviceTopics
    frames: Frames
    odom: Topic | None = None
    tf: Topic | None = None
    commands: dict[str, str] = field(default_factory=dict)  # topic -> type
    wanted: frozenset[str] = frozenset()  # every name that it has, or would have if it were nobody else's
    seen: int = 0  # poses


class RobotTopics:
    """Offered while a robot is connected; a name that a device uses for the same is the device's.

    Frames never change while the daemon runs: the only robot has the plain ones, others have their name before them.
    """

    def __init__(self, configs: Mapping[str, RobotConfig], graph: TopicGraph, catalog: Catalog) -> None:
        self._configs, self._graph = configs, graph
        self._types = {name: _type(catalog, name) for name in (ODOMETRY_TYPE, TF_TYPE, TWIST_TYPE, TWIST_STAMPED_TYPE)}
        self._frames: dict[str, Frames] = {}
        self._offers: dict[str, _Offer] = {}  # by the topic of the device's odometry
        self._commands: dict[str, _Offer] = {}  # by topic

    def update(self, robots: Iterable[Robot], touched: frozenset[str]) -> None:
        """A device came, left or has other topics, `touched` by their full names: offer anew what that changes.

        With a thousand robots, one that comes touches no other.
        """
        before, self._offers = self._offers, {}
        there = {resolve(robot.topics.odometry): robot for robot in robots if robot.link is not None}
        lost = [offer for topic, offer in before.items() if not _is_there(offer, there.get(topic))]
        freed = touched.union(*(offer.wanted - {TF_TOPIC} for offer in lost))
        kept = {
            topic: offer
            for topic, offer in before.items()
            if _is_there(offer, there.get(topic)) and offer.wanted.isdisjoint(freed)
        }
        self._close([offer for topic, offer in before.items() if topic not in kept], is_last=not kept)
        for topic, robot in there.items():
            if topic in kept:
                self._offers[topic] = kept[topic]
            elif robot.link is not None:
                frames, seen = self._frames_of(robot.name), robot.odometry.count
                offer = self._offers[topic] = _Offer(robot, robot.link, robot.topics, frames, seen=seen)
                self._open(offer, self._configs.get(robot.name, RobotConfig()))

    def command(self, topic: str, payload: bytes) -> tuple[Robot, Velocity] | None:
        """The robot and the velocity that a message on this topic means; None: it is no command. BadRequest."""
        offer = self._commands.get(topic)
        if offer is None:
            return None
        type_name = offer.commands[topic]
        message: Mapping[str, Any] = self._types[type_name].decode(payload)
        if type_name == TWIST_STAMPED_TYPE:
            self._check_age(offer.robot.name, message["header"]["stamp"])
            message = message["twist"]
        return offer.robot, Velocity.from_twist(message)

    def names_of_velocity(self, robot: Robot) -> list[str]:
        """The topics on which a Twist is seen when the robot is driven."""
        offer = self._offers.get(resolve(robot.topics.odometry))
        others = {} if offer is None else offer.commands
        return [
            resolve(robot.topics.velocity),
            *(name for name, type_name in others.items() if type_name == TWIST_TYPE),
        ]

    def relay(self, message: Message) -> None:
        """Take a message of a device's odometry that its robot has seen; tell it to whom it may concern."""
        offer = self._offers.get(message.topic)
        if offer is None or offer.robot.odometry.count == offer.seen:  # what was seen was no pose
            return
        offer.seen = offer.robot.odometry.count
        heard = [topic for topic in (offer.odom, offer.tf) if topic is not None and topic.is_heard]
        view = offer.robot.odometry.snapshot(asyncio.get_running_loop().time()) if heard else None
        if view is None:
            return
        stamp = dict(zip(("secs", "nsecs"), divmod(view["stamp_ns"], _NS_PER_S), strict=True))
        pose, twist = Pose(**view["pose"]), Twist(**view["twist"])
        odometry = odometry_of(pose, twist, offer.frames, stamp, variances_of(message.decoded))
        for topic in heard:
            fields = odometry if topic is offer.odom else transform_of(odometry)
            try:
                topic.spread(self._types[topic.type_name].encode(fields), view["stamp_ns"], source=DAEMON)
            except HostlinkError as error:
                log.debug("message.refused", topic=topic.name, reason=str(error))

    def _open(self, offer: _Offer, config: RobotConfig) -> None:
        name = offer.robot.name
        odom = _chosen(config.odom_topic, f"{name}/odom")
        commands = {
            _chosen(config.cmd_vel_topic, f"{name}/cmd_vel"): TWIST_TYPE,
            _chosen(config.cmd_vel_stamped_topic, f"{name}/cmd_vel_stamped"): TWIST_STAMPED_TYPE,
        }
        offer.wanted = frozenset(resolve(wanted) for wanted in (odom, TF_TOPIC, *commands) if wanted)
        offer.odom = self._advertise(odom, ODOMETRY_TYPE, {resolve(offer.robot.topics.odometry)})
        if config.publish_tf and not self._publishes(offer.robot, TF_TOPIC):
            offer.tf = self._advertise(TF_TOPIC, TF_TYPE, set())
        for topic, type_name in commands.items():
            if self._take(topic, type_name):
                offer.commands[resolve(topic)] = type_name
                self._commands[resolve(topic)] = offer

    def _close(self, offers: Iterable[_Offer], *, is_last: bool) -> None:
        """`is_last`: nobody is left who tells the transforms."""
        for offer in offers:
            if offer.odom is not None:
                self._graph.unadvertise(offer.odom.name, DAEMON)
            if offer.tf is not None and is_last:
                self._graph.unadvertise(offer.tf.name, DAEMON)
            for name in offer.commands:
                self._graph.untake(name, DAEMON)
                del self._commands[name]

    def _advertise(self, name: str, type_name: str, taken: set[str]) -> Topic | None:
        """None for a name that is switched off, that a device publishes itself, or that has another type."""
        known = self._graph.find_or_none(name)
        is_devices = name != TF_TOPIC and known is not None and known.has_device_publisher
        if not name or is_devices or resolve(name) in taken:
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
            self._graph.take(name, DAEMON, _through_the_gate, type_name=type_name)
        except HostlinkError as error:
            log.warning("topic.refused", topic=name, reason=str(error))
            return False
        return True

    def _publishes(self, robot: Robot, name: str) -> bool:
        topic = self._graph.find_or_none(name)
        return topic is not None and robot.link in topic.publishers

    def _frames_of(self, name: str) -> Frames:
        if name not in self._frames:
            config = self._configs.get(name, RobotConfig())
            is_only = set(self._configs) == {name} or not (self._configs or self._frames)
            prefix = "" if is_only else f"{name}/"
            self._frames[name] = Frames(config.odom_frame or f"{prefix}odom", config.base_frame or f"{prefix}base_link")
        return self._frames[name]

    def _check_age(self, name: str, stamp: Mapping[str, int]) -> None:
        limit_s = self._configs.get(name, RobotConfig()).cmd_vel_max_age_s
        stamp_ns = stamp["secs"] * _NS_PER_S + stamp["nsecs"]
        age_s = (time.time_ns() - stamp_ns) / _NS_PER_S
        if limit_s is not None and stamp_ns and age_s > limit_s:
            raise BadRequest(f"{name}: the command is {age_s:.3f} s old, cmd_vel_max_age_s allows {limit_s:g}")


def _is_there(offer: _Offer, robot: Robot | None) -> bool:
    """Whether it is still the same robot by the same device."""
    return robot is offer.robot and robot.link is offer.link and robot.topics == offer.topics


def _through_the_gate(payload: bytes) -> None:
    """The hub makes a command of every message on this topic, and the robot's gate sends it."""


def _chosen(configured: str | None, default: str) -> str:
    return default if configured is None else configured


def _type(catalog: Catalog, name: str) -> MessageType:
    found = catalog.message(name)
    assert found is not None  # noqa: S101 - of the store that the project is built on
    return found
