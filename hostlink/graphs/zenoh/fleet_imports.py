"""FleetImports: the topics of robots of other daemons, in the graph here. One is subscribed there while it is here."""

import asyncio
from dataclasses import dataclass, field
from functools import partial

import structlog

from hostlink.errors import HostlinkError
from hostlink.graphs.zenoh.fleet_messages import TopicState
from hostlink.graphs.zenoh.fleet_post import GROUP, Post
from hostlink.graphs.zenoh.roster import Neighbour
from hostlink.graphs.zenoh.session import Declaration
from hostlink.hub.graph import GraphTopic
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.participant import MAX_ADVERTISED, Participant
from hostlink.hub.robot import RemoteRobot
from hostlink.hub.subscription import Subscription

log = structlog.get_logger()

MAX_WAITING = 64  # messages of one topic; the oldest goes
MAX_MESSAGE_BYTES = 64 * 1024  # what a device sends is much smaller
MAX_LOGGED = 64  # topics that cannot be shown


@dataclass(slots=True, eq=False)
class _Import:
    """The topics of one robot."""

    neighbour: Neighbour
    participant: Participant
    listed: list[TopicState] = field(default_factory=list)
    topics: dict[str, TopicState] = field(default_factory=dict)
    to_device: dict[str, Subscription] = field(default_factory=dict)  # what programs here publish
    subscriptions: dict[str, Declaration] = field(default_factory=dict)  # at the other daemon


class FleetImports:
    """A robot's topics are below its name, whatever the other daemon sends; no other name is used."""

    def __init__(self, hub: Hub, post: Post) -> None:
        self._hub, self._post = hub, post
        self._imports: dict[str, _Import] = {}
        self._logged: set[str] = set()

    def show(self, robot: RemoteRobot, neighbour: Neighbour, topics: list[TopicState]) -> None:
        """A robot's topics as its daemon lists them now."""
        shown = self._imports.get(robot.name)
        if shown is None or shown.neighbour is not neighbour:
            self.hide(robot.name)
            participant = self._hub.join(f"{robot.name} at {neighbour.sender.name}", group=GROUP)
            shown = self._imports[robot.name] = _Import(neighbour, participant)
        if shown.listed is topics:
            return
        shown.listed = topics
        own = {topic.name: topic for topic in topics if topic.name.startswith(f"/{robot.name}/")}
        self._post.counts["foreign_topics"] += len(topics) - len(own)
        wanted = dict(list(own.items())[:MAX_ADVERTISED])
        robot.offer((each.name, each.type) for each in wanted.values() if each.is_velocity)
        for name, topic in list(shown.topics.items()):
            if wanted.get(name) != topic:
                self._hide_topic(shown, name)
        for name, topic in wanted.items():
            if name not in shown.topics:
                shown.topics[name] = topic
                self._show_topic(shown, topic)

    def hide(self, robot: str) -> None:
        """It is gone, or known from another daemon."""
        shown = self._imports.pop(robot, None)
        if shown is not None:
            for declaration in shown.subscriptions.values():
                declaration.close()
            shown.participant.leave()

    def hide_all(self) -> None:
        """The fleet ends here."""
        for robot in list(self._imports):
            self.hide(robot)

    def update(self, topics: tuple[GraphTopic, ...]) -> None:
        """The graph has changed: subscribe elsewhere what is subscribed here."""
        subscribed = {topic.name for topic in topics if topic.is_subscribed and not topic.is_velocity}
        for shown in self._imports.values():
            for name, topic in shown.topics.items():
                is_wanted = self._is_read(name) if topic.is_velocity else name in subscribed
                if is_wanted and (topic.is_published or topic.is_velocity):
                    self._subscribe(shown, topic)
                elif name in shown.subscriptions:
                    shown.subscriptions.pop(name).close()

    def _hide_topic(self, shown: _Import, name: str) -> None:
        del shown.topics[name]
        shown.participant.unadvertise(name)
        if name in shown.to_device:
            shown.to_device.pop(name).close()
        if name in shown.subscriptions:
            shown.subscriptions.pop(name).close()

    def _show_topic(self, shown: _Import, topic: TopicState) -> None:
        try:
            if topic.is_velocity:
                return
            if topic.is_published:
                shown.participant.advertise(topic.name, topic.type)
            if topic.is_subscribed:
                publish = partial(self._publish, shown.neighbour)
                subscription = shown.participant.subscribe(topic.name, publish, type_name=topic.type)
                shown.to_device[topic.name] = subscription
        except HostlinkError as error:
            self._post.counts["refused_topics"] += 1
            if topic.name not in self._logged and len(self._logged) < MAX_LOGGED:
                self._logged.add(topic.name)
                log.warning("fleet.topic_refused", topic=topic.name, reason=str(error))

    def _publish(self, neighbour: Neighbour, message: Message) -> None:
        """A program here publishes what a device over there subscribes."""
        key = self._post.keys.key(
            "publish", self._post.me, *message.topic.strip("/").split("/"), to=neighbour.sender.zid
        )
        self._post.session.put(key, message.payload)

    def _subscribe(self, shown: _Import, topic: TopicState) -> None:
        if topic.name in shown.subscriptions:
            return
        key = self._post.keys.key("out", shown.neighbour.sender, *topic.name.strip("/").split("/"))
        deliver = self._deliver_velocity if topic.is_velocity else partial(self._deliver, shown)
        shown.subscriptions[topic.name] = self._post.session.subscribe(
            key,
            lambda sample: deliver(topic.name, sample.payload),
            max_bytes=MAX_MESSAGE_BYTES,
            max_waiting=MAX_WAITING,
        )

    def _is_read(self, topic: str) -> bool:
        """Whether anybody here subscribes to a velocity topic of a robot elsewhere, apart from the robot itself."""
        known = self._hub.topics.find_or_none(topic)
        return known is not None and bool(known.subscribers)

    def _deliver_velocity(self, topic: str, payload: bytes) -> None:
        """What the other daemon's gate sent to the device, for whoever subscribes here."""
        known = self._hub.topics.find_or_none(topic)
        if known is not None:
            known.deliver(payload, source=self, at_s=asyncio.get_running_loop().time())

    def _deliver(self, shown: _Import, topic: str, payload: bytes) -> None:
        try:
            shown.participant.publish(topic, payload)
        except HostlinkError:
            self._post.counts["refused"] += 1
