"""Recorder: participant that passes topics, events of robots, log lines and parameters to a sink."""

import dataclasses
import fnmatch
from collections import defaultdict
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

import msgspec

from hostlink.components.recorder.channel import (
    DEVICE,
    EVENTS,
    HOSTLINK,
    LOG,
    PARAMETERS,
    VELOCITY,
    Channel,
    Sink,
    as_text,
    ros_channel,
)
from hostlink.core.host import OBSERVERS, GraphTopic, Host, Message, RobotEvent, Subscription
from hostlink.core.mirror.mirror import Mirror
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.core.runtime import logs
from hostlink.errors import HostlinkError

_ENCODER = msgspec.json.Encoder(enc_hook=str)
RETRY_S = 1.0  # of a topic whose type has changed while it was subscribed to
GROUP = OBSERVERS  # a subscription of a recorder alone does not make a topic worth recording


@dataclasses.dataclass(frozen=True, slots=True)
class TopicSelection:
    """Topics and robots to record."""

    topics: tuple[str, ...] = ()  # names, or patterns with *; empty: all
    robots: tuple[str, ...] = ()  # only topics and events of these; empty: of all robots and of none
    # Only what is published here: no topics of other daemons and graphs, which would then be transferred all the time,
    # and none that hostlink derives from others, such as odom and tf.
    is_local: bool = False

    def has(self, topic: str, robot: str) -> bool:
        """Whether a topic of this robot, or of no robot, is recorded."""
        is_named = not self.topics or any(fnmatch.fnmatchcase(topic, pattern) for pattern in self.topics)
        return is_named and self.has_robot(robot)

    def has_robot(self, robot: str) -> bool:
        """Whether events of this robot are recorded."""
        return not self.robots or robot in self.robots


class Recorder:
    """Recorder of the selected topics and events, from `start` to `stop`."""

    def __init__(self, host: Host, sink: Sink, selection: TopicSelection) -> None:
        self._host, self._sink, self._selection = host, sink, selection
        self._participant = host.join_as_observer(group=GROUP)
        self._subscriptions = Mirror[str, GraphTopic, Subscription](
            self._subscribe, self._fail, retry_s=RETRY_S, is_same=_is_same
        )
        self._names = _NamesByRobot()
        self._version = -1  # of the graph
        self._parameters: dict[str, Any] | None = None

    @property
    def topics(self) -> list[str]:
        """Topics that are recorded now."""
        return sorted(self._subscriptions.endpoints)

    def start(self) -> None:
        self._participant.observe(self._receive_event)
        self._participant.watch_graph(self._follow_graph)
        logs.listeners[self] = self._receive_line
        self._follow_graph()

    def stop(self) -> None:
        """Stop recording. Nothing more is put into the sink."""
        logs.listeners.pop(self, None)
        self._subscriptions.close()
        self._participant.leave()

    def note_parameters(self, stamp_ns: int) -> None:
        """Record the parameters if they have changed."""
        if self._parameters != self._host.parameters:
            self._parameters = dict(self._host.parameters)
            self._put_json(PARAMETERS, stamp_ns, self._parameters, "")

    def _follow_graph(self) -> None:
        """Subscribe to new topics, and unsubscribe from those that no other participant uses."""
        news = self._participant.view.news(self._version)
        self._version = news.version
        changed = dict(news.topics)
        if news.is_whole:
            changed |= dict.fromkeys(self._subscriptions.wanted.keys() - changed.keys())
        for name, topic in changed.items():
            self._names.put(name, is_there=topic is not None)
        for name in self._names.of(news.robots) - changed.keys():  # the robot of these topics may have changed
            changed[name] = self._participant.view.topic(name)
        for name, topic in changed.items():
            self._subscriptions.put(name, topic if topic is not None and self._is_wanted(topic) else None)

    def _is_wanted(self, topic: GraphTopic) -> bool:
        if not topic.type_name or (self._selection.is_local and topic.is_derived):
            return False
        source = self._host.topic_source(topic.name)
        return not (self._selection.is_local and source.is_elsewhere) and self._selection.has(topic.name, source.robot)

    def _subscribe(self, _: str, topic: GraphTopic) -> Subscription:
        source = self._host.topic_source(topic.name)
        channel = ros_channel(
            topic.name,
            topic.type_name,
            topic.type,
            is_latched=topic.is_latched,
            robot=source.robot,
            origin=VELOCITY
            if topic.is_velocity
            else DEVICE
            if source.is_device
            else HOSTLINK
            if topic.is_derived
            else "",
            encoding=topic.encoding,
        )
        self._sink.announce(channel)
        return self._participant.subscribe(
            topic.name,
            _Track(self._sink, channel, source.robot, topic.type_name).receive,
            type_name=topic.type_name,
        )

    def _fail(self, topic: str, error: Exception) -> None:
        """Ignore a WrongType: the type has changed meanwhile, and another change follows."""
        if not isinstance(error, HostlinkError):
            self._host.crashed("participant", error, participant=GROUP, topic=topic)

    def _receive_event(self, event: RobotEvent) -> None:
        if event.robot and not self._selection.has_robot(event.robot):
            return
        facts: dict[str, object] = {}
        for name, value in event.facts.items():
            if isinstance(value, PlanarVelocity):
                facts[name] = _shown(value)
            elif isinstance(value, Twist):
                facts[name] = value._asdict()
            elif name != "address":  # the file may be given to others
                facts[name] = value
        shown = {"kind": event.kind._value_, "robot": event.robot, "facts": facts}
        self._put_json(EVENTS, event.stamp_ns, shown, event.robot)

    def _receive_line(self, stamp_ns: int, line: Mapping[str, object]) -> None:
        self._put_json(LOG, stamp_ns, line, str(line.get("robot", "")))

    def _put_json(self, channel: Channel, stamp_ns: int, value: object, robot: str) -> None:
        self._sink.put(channel, stamp_ns, as_text(_ENCODER.encode(value)), robot)


class _Track:
    """Receiver of one topic's messages."""

    __slots__ = ("_channel", "_robot", "_sink", "_type_name")

    def __init__(self, sink: Sink, channel: Channel, robot: str, type_name: str) -> None:
        self._sink, self._channel, self._robot, self._type_name = sink, channel, robot, type_name

    def receive(self, message: Message) -> None:
        is_same = message.type_name == self._type_name and message.encoding == self._channel.encoding
        if is_same:  # otherwise the graph reports the change soon
            self._sink.put(self._channel, message.stamp_ns, message.payload, self._robot)


class _NamesByRobot:
    """Names of topics by their first part, which may be a robot's name."""

    def __init__(self) -> None:
        self._names: defaultdict[str, dict[str, None]] = defaultdict(dict)  # a set of five has 700 bytes

    def put(self, name: str, *, is_there: bool) -> None:
        first = _first_part(name)
        if is_there:
            self._names[first][name] = None
        elif first in self._names:
            self._names[first].pop(name, None)
            if not self._names[first]:
                del self._names[first]

    def of(self, robots: Iterable[str]) -> set[str]:
        """Return the topics whose first part is one of these names."""
        return {name for robot in robots for name in self._names.get(robot, ())}


def _first_part(name: str) -> str:
    return name.lstrip("/").partition("/")[0]


_facts_of_channel = attrgetter("name", "type_name", "encoding", "is_latched", "is_velocity")


def _is_same(before: GraphTopic, now: GraphTopic) -> bool:
    """Whether two topics have the same channel. Other subscribers do not change it."""
    return bool(_facts_of_channel(before) == _facts_of_channel(now))


def _shown(velocity: PlanarVelocity) -> dict[str, float]:
    """Return the named fields; several times as fast as `_asdict`, and called for each command."""
    x_m_s, y_m_s, yaw_rad_s = velocity
    return {"linear_x_m_s": x_m_s, "linear_y_m_s": y_m_s, "angular_z_rad_s": yaw_rad_s}
