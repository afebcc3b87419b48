"""FleetExports: the topics of the robots here, for other daemons. A message travels while one of them subscribes."""

from dataclasses import dataclass, field
from functools import partial

from hostlink.errors import HostlinkError
from hostlink.graphs.zenoh.fleet_drivers import FleetDrivers
from hostlink.graphs.zenoh.fleet_messages import MAX_TOPICS, Topics, TopicState, encode
from hostlink.graphs.zenoh.fleet_post import GROUP, Post
from hostlink.graphs.zenoh.fleet_states import fleet_name, is_shareable
from hostlink.graphs.zenoh.roster import Roster
from hostlink.graphs.zenoh.session import Publisher, Query, Sample
from hostlink.hub.graph import GraphTopic
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.hub.subscription import Subscription


@dataclass(slots=True, eq=False)
class _Outgoing:
    """One topic that others may subscribe."""

    topic: str  # as it is named here
    publisher: Publisher
    subscription: Subscription | None = None

    def forward(self, message: Message) -> None:
        self.publisher.put(message.payload)


@dataclass(slots=True, eq=False)
class _Export:
    """The topics of one robot."""

    participant: Participant
    outgoing: dict[str, _Outgoing] = field(default_factory=dict)


class FleetExports:
    """Robots' topics are shared below their names, in which a robot's own topics get a place if they are elsewhere."""

    def __init__(self, hub: Hub, post: Post, drivers: FleetDrivers, roster: Roster) -> None:
        self.number = 0  # of the list, another one after each change
        self._hub, self._post, self._drivers, self._roster = hub, post, drivers, roster
        self._exports: dict[str, _Export] = {}
        self._list: bytes | None = None  # as it is answered; None: nobody has requested it since the last change
        self._topics: dict[str, tuple[TopicState, str]] = {}  # with their names here, by the name that others know

    def update(self, topics: tuple[GraphTopic, ...]) -> None:
        """The graph has changed."""
        found = self._find(topics)
        if len(found) > MAX_TOPICS:
            self._post.counts["unshared_topics"] += len(found) - MAX_TOPICS
            found = dict(list(found.items())[:MAX_TOPICS])
        if found == self._topics:
            return
        self._topics, self._list, self.number = found, None, self.number + 1
        robots = {state.robot for state, _ in found.values()}
        for robot in self._exports.keys() - robots:
            self._close(self._exports.pop(robot))
        for robot in robots:
            self._offer(robot)

    def answer(self, query: Query) -> None:
        """Somebody wants the list."""
        if self._list is None:
            states = tuple(state for state, _ in self._topics.values())
            self._list = encode(Topics(number=self.number, topics=states))
        query.reply(self._list)
        query.close()

    def receive(self, sample: Sample) -> None:
        """A program of another daemon publishes to a device here."""
        sender = self._post.keys.sender(sample.key, is_addressed=True)
        neighbour = None if sender is None else self._roster.find(sender)
        known = self._topics.get(self._post.keys.topic(sample.key, is_addressed=True))
        if neighbour is None or known is None or not known[0].is_subscribed or known[0].is_velocity:
            self._post.counts["unannounced"] += 1
            return
        try:
            self._drivers.publish(neighbour, known[1], sample.payload)
        except HostlinkError:
            self._post.counts["refused"] += 1

    def close(self) -> None:
        """Share nothing any more."""
        for export in self._exports.values():
            self._close(export)
        self._exports.clear()

    def _find(self, topics: tuple[GraphTopic, ...]) -> dict[str, tuple[TopicState, str]]:
        robots = {robot.name: robot for robot in self._hub.robots.here() if is_shareable(robot)}
        own = {
            name: robot
            for robot in robots.values()
            for name in (robot.shown.velocity, robot.shown.odometry, robot.shown.reset)
            if name is not None
        }
        found = {}
        for topic in topics:
            robot = robots.get(topic.name.split("/")[1]) if topic.name.count("/") > 1 else None
            robot = robot or own.get(topic.name)
            is_there = robot is not None and (robot.link is not None or topic.is_velocity)
            if robot is not None and is_there and topic.type_name:
                name = fleet_name(robot, topic.name)
                state = TopicState(
                    robot=robot.name,
                    name=name,
                    type=topic.type_name,
                    is_published=topic.is_published,
                    is_subscribed=bool(self._hub.topics.find(topic.name).devices),
                    is_velocity=topic.is_velocity,
                )
                found[name] = (state, topic.name)
        return found

    def _offer(self, robot: str) -> None:
        """Publish the robot's topics, each when somebody subscribes."""
        if robot not in self._exports:
            self._exports[robot] = _Export(self._hub.join(f"fleet {robot}", group=GROUP))
        export = self._exports[robot]
        wanted = {
            name: topic
            for name, (state, topic) in self._topics.items()
            if state.robot == robot and (state.is_published or state.is_velocity)
        }
        for name in export.outgoing.keys() - wanted.keys():
            _stop(export.outgoing.pop(name))
        for name in wanted.keys() - export.outgoing.keys():
            publisher = self._post.session.declare_publisher(
                self._post.keys.key("out", self._post.me, *name.strip("/").split("/"))
            )
            outgoing = export.outgoing[name] = _Outgoing(wanted[name], publisher)
            publisher.watch(partial(self._demand, export, outgoing))

    def _demand(self, export: _Export, outgoing: _Outgoing, is_wanted: bool) -> None:
        """Somebody elsewhere subscribes now, or nobody any more."""
        if is_wanted and outgoing.subscription is None and not export.participant.has_left:
            try:
                outgoing.subscription = export.participant.subscribe(outgoing.topic, outgoing.forward)
            except HostlinkError:
                self._post.counts["refused"] += 1
        elif not is_wanted and outgoing.subscription is not None:
            outgoing.subscription.close()
            outgoing.subscription = None

    def _close(self, export: _Export) -> None:
        for outgoing in export.outgoing.values():
            _stop(outgoing)
        export.participant.leave()


def _stop(outgoing: _Outgoing) -> None:
    if outgoing.subscription is not None:
        outgoing.subscription.close()
    outgoing.publisher.close()
