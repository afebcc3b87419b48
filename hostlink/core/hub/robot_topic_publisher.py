"""RobotTopicPublisher: topics of robots under the usual names of ROS: odom, tf, cmd_vel."""

import functools
from collections.abc import Iterable
from dataclasses import dataclass, field

import structlog

from hostlink.core.hub.gates import Echo
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.hub.topic import DeviceSubscription, Topic
from hostlink.core.hub.topic_graph import TopicGraph, resolve
from hostlink.core.messages.catalog import Catalog, to_time
from hostlink.core.messages.message_type import MessageType
from hostlink.core.robot.ros_messages import FrameIds, odometry_of, transform_of, variances_of
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, ZERO
from hostlink.errors import HostlinkError

log = structlog.get_logger()

TF_TOPIC = "/tf"
ODOMETRY_TYPE, TF_TYPE = "nav_msgs/Odometry", "tf2_msgs/TFMessage"


@dataclass(slots=True)
class _Offer:
    """Topics of one robot by the names of ROS; None if not offered, or if a device has the topic itself.

    While its device is not connected, a robot has only its velocity topics: velocities are refused, and the admission
    knows their publishers when the device connects.
    """

    robot: LocalRobot
    frames: FrameIds
    is_away: bool
    odom: Topic | None = None
    publishes_tf: bool = False
    commands: list[str] = field(default_factory=list)  # velocity topics
    wanted: frozenset[str] = frozenset()  # all names that it offers, or would offer if they were free


class RobotTopicPublisher:
    """Publisher of the topics of all known robots. A device's own topic of such a name has precedence.

    A robot that is not connected gives up a name for a device or a connected robot.

    Frame ids begin with the robot's name unless configured otherwise. They never depend on the order of connections.
    """

    def __init__(self, graph: TopicGraph, node: Node, catalog: Catalog) -> None:
        """`node` is the key of the publishers and subscribers."""
        self._graph, self._node = graph, node
        self._types = {name: _type(catalog, name) for name in (ODOMETRY_TYPE, TF_TYPE)}
        self._offers: dict[str, _Offer] = {}  # by name of the robot
        self._commands: set[str] = set()  # velocity topics of all offers
        self._candidates: dict[str, tuple[str, ...]] = {}  # topic -> robots that would offer it
        self._tf: Topic | None = None  # while a robot publishes its transform

    def update(self, robots: Iterable[LocalRobot], touched: frozenset[str]) -> None:
        """Update robots that connected, disconnected or have other topics; `touched` are full names of those topics.

        Only affected robots are updated: with a thousand robots, a new one affects no other.
        """
        changed = {robot.name: robot for robot in robots}
        lost = [self._offers[name] for name in changed if name in self._offers]
        freed = touched.union(*(offer.wanted for offer in lost))
        names = changed.keys() | {name for topic in freed for name in self._candidates.get(topic, ())}
        for topic in {resolve(name) for robot in changed.values() if robot.link for name in own_topics(robot)}:
            names |= {name for name in self._candidates.get(topic, ()) if self._offers[name].is_away}
        for name in names:
            offer = self._offers.pop(name, None)
            if offer is not None:
                changed[name] = offer.robot
                self._close(offer)
        if TF_TOPIC in touched:
            self._reopen_tf()
        for name in sorted(changed, key=lambda name: (changed[name].link is None, name)):
            self._open(changed[name])
        if not any(offer.publishes_tf for offer in self._offers.values()):
            self._close_tf()

    def forget(self, robot: LocalRobot) -> None:
        """Remove the topics of a forgotten robot."""
        offer = self._offers.pop(robot.name, None)
        if offer is not None:
            self._close(offer)
            self.update((), offer.wanted)

    def _relay(self, offer: _Offer, message: Message | None) -> None:
        """Publish odometry and transform of a new pose, if they have subscribers."""
        if message is None:
            return
        odom, tf = offer.odom, self._tf if offer.publishes_tf else None
        if (odom is None or not odom.has_subscribers) and (tf is None or not tf.has_subscribers):
            return
        topics = [topic for topic in (odom, tf) if topic is not None and topic.has_subscribers]
        estimate = offer.robot.odometry.snapshot(message.at_s)
        if estimate is None or estimate.pose is None:
            return
        stamp = to_time(estimate.stamp_ns)
        odometry = odometry_of(
            estimate.pose, estimate.twist or ZERO, offer.frames, stamp, variances_of(message.decoded)
        )
        for topic in topics:
            fields = odometry if topic is offer.odom else transform_of(odometry)
            type_name = ODOMETRY_TYPE if topic is offer.odom else TF_TYPE
            try:
                topic.publish(self._types[type_name].encode(fields), source=self._node, at_s=message.at_s)
            except HostlinkError as error:
                log.debug("message.refused", topic=topic.name, reason=str(error))

    def _open(self, robot: LocalRobot) -> None:
        is_away = robot.link is None
        offer = self._offers[robot.name] = _Offer(robot, robot.frames, is_away)
        commands = command_topics(robot)
        if is_away:
            commands = dict.fromkeys(robot.velocities, TWIST_TYPE) | dict(robot.shown.commands) | commands
        offer.wanted = frozenset(map(resolve, filter(None, commands if is_away else own_topics(robot))))
        for name in offer.wanted:
            self._candidates[name] = (*self._candidates.get(name, ()), robot.name)
        if not is_away:
            self._advertise_poses(offer)
        for topic, type_name in commands.items():
            if self._subscribe(robot, topic, type_name):
                offer.commands.append(resolve(topic))
                self._commands.add(resolve(topic))
        self._note_heard(offer)

    def _advertise_poses(self, offer: _Offer) -> None:
        robot = offer.robot
        if robot.shown.odometry is None:
            return
        offer.odom = self._advertise(_odom(robot), ODOMETRY_TYPE, robot.shown.odometry)
        offer.publishes_tf = robot.config.publish_tf and not self._publishes(robot, TF_TOPIC)
        if offer.publishes_tf and self._tf is None:
            self._tf = self._advertise(TF_TOPIC, TF_TYPE)
        robot.followers[self] = functools.partial(self._relay, offer)

    def _note_heard(self, offer: _Offer) -> None:
        """Note the publishers of topics to which the robot's gates have just subscribed: they began before."""
        robot = offer.robot
        heard = frozenset(offer.commands)
        heard |= {name for name in robot.velocities if self._is_gate_of(robot, name)}
        for name in heard - robot.heard:
            robot.join(self._graph.find(name))
        robot.heard = heard

    def _is_gate_of(self, robot: LocalRobot, name: str) -> bool:
        topic = self._graph.find_or_none(name)
        return topic is not None and robot.link in topic.devices

    def _close(self, offer: _Offer) -> None:
        for name in offer.wanted:
            others = tuple(each for each in self._candidates.pop(name) if each != offer.robot.name)
            if others:
                self._candidates[name] = others
        offer.robot.followers.pop(self, None)
        if offer.odom is not None:
            self._graph.unadvertise(offer.odom.name, self._node)
        for name in offer.commands:
            self._graph.unsubscribe_device(name, self._node)
            if not offer.is_away:  # otherwise a device that connected has the name now
                offer.robot.echoes.pop(name, None)
            self._commands.discard(name)

    def _reopen_tf(self) -> None:
        """Advertise /tf again after a device began or ended to use it: the type may have changed."""
        self._close_tf()
        if any(offer.publishes_tf for offer in self._offers.values()):
            self._tf = self._advertise(TF_TOPIC, TF_TYPE)

    def _close_tf(self) -> None:
        if self._tf is not None:
            self._graph.unadvertise(TF_TOPIC, self._node)
            self._tf = None

    def _advertise(self, name: str, type_name: str, own: str = "") -> Topic | None:
        """Advertise a topic; None if it is turned off, published by a device, or has another type."""
        known = self._graph.find_or_none(name)
        is_devices = name != TF_TOPIC and known is not None and known.has_device_publisher
        if not name or is_devices or resolve(name) == own:
            return None
        try:
            return self._graph.advertise(name, self._node, type_name=type_name)
        except HostlinkError as error:
            log.warning("topic.refused", topic=name, reason=str(error))
            return None

    def _subscribe(self, robot: LocalRobot, name: str, type_name: str) -> bool:
        """Subscribe a gate; False if the topic is turned off, has another user, or has another type."""
        known = self._graph.find_or_none(name)
        if not name or resolve(name) in self._commands or (known is not None and known.devices):
            return False
        is_away = robot.link is None
        receive = functools.partial(self._receive_alone, robot) if is_away else robot.receive
        subscription = DeviceSubscription(receive, is_gate=True, is_away=is_away, target=None if is_away else robot)
        try:
            topic = self._graph.subscribe_device(name, self._node, subscription, type_name=type_name)
        except HostlinkError as error:
            log.warning("topic.refused", topic=name, reason=str(error))
            return False
        if type_name == TWIST_TYPE and not is_away:
            robot.echoes[topic.name] = Echo(topic)
        return True

    def _receive_alone(self, robot: LocalRobot, message: Message) -> None:
        """Yield to another gate of the topic: the device may be connected to another daemon."""
        if len(self._graph.find(message.topic).devices) == 1:
            robot.receive(message)

    def _publishes(self, robot: LocalRobot, name: str) -> bool:
        topic = self._graph.find_or_none(name)
        return topic is not None and robot.link in topic.publishers


def _odom(robot: LocalRobot) -> str:
    return _chosen(robot.config.odom_topic, f"{robot.name}/odom")


def own_topics(robot: LocalRobot) -> list[str]:
    """Return the configured names of all topics that hostlink offers for a robot."""
    odom = "" if robot.shown.odometry is None else _odom(robot)
    return [name for name in (odom, *command_topics(robot)) if name]


def command_topics(robot: LocalRobot) -> dict[str, str]:
    """Return further names of the velocity topic, with their types. An empty name is turned off."""
    return {
        _chosen(robot.config.cmd_vel_topic, f"{robot.name}/cmd_vel"): TWIST_TYPE,
        _chosen(robot.config.cmd_vel_stamped_topic, f"{robot.name}/cmd_vel_stamped"): TWIST_STAMPED_TYPE,
    }


def twist_topic(robot: LocalRobot) -> str:
    """Return the full name of a topic on which the velocities of a robot are Twists."""
    if robot.shown.velocity_type == TWIST_TYPE:
        return robot.shown.velocity
    return resolve(next(iter(command_topics(robot))))


def _chosen(configured: str | None, default: str) -> str:
    return default if configured is None else configured


def _type(catalog: Catalog, name: str) -> MessageType:
    found = catalog.message(name)
    assert found is not None  # noqa: S101 - part of every installed type store
    return found
