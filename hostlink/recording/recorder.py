"""Recorder: a participant that passes what it receives to a sink: topics, events of robots, log lines, parameters."""

import dataclasses
import fnmatch
import functools
from collections.abc import Hashable, Mapping
from typing import Any

import msgspec

from hostlink import logs
from hostlink.errors import WrongType
from hostlink.hub.graph import OBSERVERS, GraphTopic
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.node import Node
from hostlink.hub.robot_events import RobotEvent
from hostlink.hub.subscription import Subscription
from hostlink.recording.channel import DEVICE, EVENTS, HOSTLINK, LOG, PARAMETERS, VELOCITY, Channel, Sink, ros_channel
from hostlink.robot.velocity import Velocity

GROUP = OBSERVERS  # what recorders subscribe to is not worth recording for that alone


@dataclasses.dataclass(frozen=True, slots=True)
class Selection:
    """What is recorded."""

    topics: tuple[str, ...] = ()  # names, or patterns with *; none: all
    robots: tuple[str, ...] = ()  # topics and events of these alone; none: of all, and of nobody
    has_remote: bool = True  # also what other daemons and graphs publish, which then travels all the time
    has_derived: bool = True  # also what hostlink makes of other topics, as odom and tf

    def has(self, topic: str, robot: str) -> bool:
        """Whether a topic of this robot, or of none, is recorded."""
        is_named = not self.topics or any(fnmatch.fnmatchcase(topic, pattern) for pattern in self.topics)
        return is_named and self.has_robot(robot)

    def has_robot(self, robot: str) -> bool:
        """Whether what happens to this robot is recorded."""
        return not self.robots or robot in self.robots


class Recorder:
    """From `start` to `stop`."""

    def __init__(self, hub: Hub, sink: Sink, selection: Selection) -> None:
        self._hub, self._sink, self._selection = hub, sink, selection
        self._participant = hub.join_daemon(group=GROUP)
        self._subscriptions: dict[GraphTopic, Subscription] = {}
        self._parameters: dict[str, Any] | None = None

    @property
    def topics(self) -> list[str]:
        """What it records at present."""
        return sorted(topic.name for topic in self._subscriptions)

    def start(self) -> None:
        """Record from now on."""
        self._participant.observe(self._receive_event)
        self._participant.watch_graph(self._follow_graph)
        logs.listeners[self] = self._receive_line
        self._follow_graph()

    def stop(self) -> None:
        """Nothing more is put into the sink."""
        logs.listeners.pop(self, None)
        self._participant.leave()

    def note_parameters(self, stamp_ns: int) -> None:
        """Record the parameters if they have changed."""
        if self._parameters != self._hub.parameters:
            self._parameters = dict(self._hub.parameters)
            self._put_json(PARAMETERS, stamp_ns, self._parameters, "")

    def _follow_graph(self) -> None:
        """Subscribe to the topics that came, and not to those that nobody else uses any more."""
        wanted = {_fixed(topic): topic for topic in self._participant.graph().topics if self._is_wanted(topic)}
        for key in self._subscriptions.keys() - wanted.keys():
            self._subscriptions.pop(key).close()
        for key, topic in wanted.items():
            if key not in self._subscriptions:
                self._subscribe(key, topic)

    def _is_wanted(self, topic: GraphTopic) -> bool:
        if not topic.type_name or (topic.is_derived and not self._selection.has_derived):
            return False
        if not self._selection.has_remote and self._is_remote(topic.name):
            return False
        return self._selection.has(topic.name, self._robot_of(topic.name))

    def _subscribe(self, key: GraphTopic, topic: GraphTopic) -> None:
        robot = self._robot_of(topic.name)
        channel = ros_channel(
            topic.name,
            topic.type_name,
            topic.type,
            is_latched=topic.is_latched,
            robot=robot,
            origin=self._origin_of(topic),
        )
        self._sink.announce(channel)
        receive = functools.partial(self._receive, channel, robot)
        try:
            self._subscriptions[key] = self._participant.subscribe(topic.name, receive, type_name=topic.type_name)
        except WrongType:  # it has changed since; the next change comes soon
            return

    def _robot_of(self, topic: str) -> str:
        """By its name, or by the device that publishes it."""
        first = topic.lstrip("/").partition("/")[0]
        found = self._hub.topics.find_or_none(topic)
        users: tuple[Hashable, ...] = () if found is None else (*found.publishers, *found.devices)
        robots = [robot for robot in map(self._hub.robots.of_link, users) if robot is not None]
        return robots[0].name if len(robots) == 1 else first if self._is_robot(first) else ""

    def _origin_of(self, topic: GraphTopic) -> str:
        if topic.is_velocity:
            return VELOCITY
        found = self._hub.topics.find_or_none(topic.name)
        is_device = found is not None and found.has_device_publisher
        return DEVICE if is_device else HOSTLINK if topic.is_derived else ""

    def _is_remote(self, topic: str) -> bool:
        """Whether it comes from another graph alone, and no device uses it; or from another daemon."""
        name = topic.lstrip("/").partition("/")[0]
        found = self._hub.topics.find_or_none(topic)
        if found is not None and found.publishers and not found.devices and all(map(_is_of_graph, found.publishers)):
            return True
        return name in self._hub.robots.remote and self._hub.robots.get_here(name) is None

    def _is_robot(self, name: str) -> bool:
        return any(robot.name == name for robot in self._hub.robots.all())

    def _receive(self, channel: Channel, robot: str, message: Message) -> None:
        self._sink.put(channel, message.stamp_ns, message.payload, robot)

    def _receive_event(self, event: RobotEvent) -> None:
        if event.robot and not self._selection.has_robot(event.robot):
            return
        facts = {name: _fact(value) for name, value in event.facts.items()}
        shown = {"kind": event.kind.value, "robot": event.robot, "facts": facts}
        self._put_json(EVENTS, event.stamp_ns, shown, event.robot)

    def _receive_line(self, stamp_ns: int, line: Mapping[str, object]) -> None:
        self._put_json(LOG, stamp_ns, line, str(line.get("robot", "")))

    def _put_json(self, channel: Channel, stamp_ns: int, value: object, robot: str) -> None:
        self._sink.put(channel, stamp_ns, msgspec.json.encode(value, enc_hook=str), robot)


def _fixed(topic: GraphTopic) -> GraphTopic:
    """What a channel is made of: who else subscribes changes nothing."""
    return dataclasses.replace(topic, type=None, is_published=True, is_subscribed=True, is_derived=False)


def _fact(value: object) -> object:
    return value._asdict() if isinstance(value, Velocity) else value


def _is_of_graph(key: Hashable) -> bool:
    """Whether it stands for another graph."""
    return isinstance(key, Node) and bool(key.group)
