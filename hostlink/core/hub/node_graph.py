"""NodeGraph: topics, services and their nodes as values, for components that show the whole graph."""

from collections.abc import Hashable, Iterable
from typing import TYPE_CHECKING, NamedTuple

from hostlink.core.hub.graph_view import is_derived
from hostlink.core.hub.robot_topic_publisher import command_topics
from hostlink.core.hub.topic import Topic
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.core.robot.velocity import TWIST_TYPE
from hostlink.core.robot.views import TopicView

if TYPE_CHECKING:
    from hostlink.core.hub.hub import Hub

Names = dict[str, set[str]]  # of nodes, by name of a topic or service


class KnownTopic(NamedTuple):
    """Name and type of a topic."""

    name: str
    type_name: str  # empty: it has only subscribers, and none named a type
    type: MessageType | None  # None: the type has no definition here
    is_published: bool


class VelocityTopic(NamedTuple):
    """A topic whose messages drive a robot."""

    name: str
    type_name: str
    type: MessageType | None  # None: the type has no definition here


class RobotTopics(NamedTuple):
    """Velocity topics of a robot of this daemon, and the number of its device's connection (None: it has none)."""

    name: str
    link: int | None
    velocity_topics: dict[str, str]  # types by name


class NodeGraph:
    """The whole graph of this daemon. A node is the daemon, a device (by its robot's name) or a program."""

    def __init__(self, hub: "Hub") -> None:
        self._topics, self._services, self._robots, self._daemon = hub.topics, hub.services, hub.robots, hub.node.name

    # -- topics -------------------------------------------------------------------------------------------------------

    def topics(self) -> list[KnownTopic]:
        """Return all topics by name."""
        return [_known(topic) for topic in self._topics.all()]

    def topic(self, name: str) -> KnownTopic | None:
        """Return the topic of this name; None if it does not exist."""
        found = self._topics.find_or_none(name)
        return None if found is None else _known(found)

    def velocity_topic(self, name: str) -> VelocityTopic | None:
        """Return the topic of this name if its messages drive a robot; else None."""
        found = self._topics.find_or_none(name)
        return VelocityTopic(found.name, found.type_name, found.type) if found is not None and found.is_gated else None

    def topic_views(self) -> list[TopicView]:
        """Return all topics as the API shows them."""
        return [
            {
                "name": topic.name,
                "type": topic.type_name,
                "publishers": len(topic.publishers),
                "subscribers": len(topic.subscribers) + len(topic.devices),
                "messages": topic.messages,
                "is_derived": is_derived(topic),
            }
            for topic in self._topics.all()
        ]

    def robots(self) -> list[RobotTopics]:
        """Return the robots of this daemon by name, connected or not yet forgotten, with their velocity topics."""
        found = []
        for robot in self._robots.here():
            named = {resolve(name): type_name for name, type_name in command_topics(robot).items() if name}
            topics = {robot.shown.velocity: TWIST_TYPE} | named
            found.append(RobotTopics(robot.name, None if robot.link is None else robot.link.number, topics))
        return found

    # -- services -----------------------------------------------------------------------------------------------------

    def services(self) -> list[tuple[str, str]]:
        """Return (name, type) of all services."""
        return self._services.all()

    def service_type(self, name: str) -> ServiceType | None:
        """Return the type of a service; None if it has no definition.

        Raises:
            UnknownTopic: the service does not exist.
        """
        return self._services.type_of(name)

    # -- nodes --------------------------------------------------------------------------------------------------------

    def nodes(self) -> set[str]:
        """Return the names of all nodes."""
        keys = {key for topic in self._topics.all() for key in (*topic.publishers, *_receivers(topic))}
        return {f"/{self._daemon}", *map(self._node, keys), *(self.provider(name) for name, _ in self._services.all())}

    def publishers(self, topic: str) -> set[str]:
        """Return the nodes that publish a topic.

        Raises:
            UnknownTopic: the topic does not exist.
        """
        return set(map(self._node, self._topics.find(topic).publishers))

    def subscribers(self, topic: str) -> set[str]:
        """Return the nodes that receive a topic's messages.

        Raises:
            UnknownTopic: the topic does not exist.
        """
        return set(map(self._node, _receivers(self._topics.find(topic))))

    def provider(self, service: str) -> str:
        """Return the node that gets the calls of a service; empty if the service does not exist."""
        found = self._services.find_or_none(service)
        return "" if found is None else self._node(found.key)

    def by_node(self) -> tuple[Names, Names, Names]:
        """Return the nodes that publish and receive each topic, and that provide each service."""
        topics = self._topics.all()
        return (
            {topic.name: set(map(self._node, topic.publishers)) for topic in topics},
            {topic.name: set(map(self._node, _receivers(topic))) for topic in topics},
            {name: {self.provider(name)} for name, _ in self._services.all()},
        )

    def _node(self, key: Hashable) -> str:
        """Return the name of a node: a robot's name, a device's link, or a client's number."""
        robot = self._robots.of_link(key)
        return f"/{str(key).split(' (', maxsplit=1)[0].replace(' ', '_') if robot is None else robot.name}"


def _known(topic: Topic) -> KnownTopic:
    return KnownTopic(topic.name, topic.type_name, topic.type, is_published=bool(topic.publishers))


def _receivers(topic: Topic) -> Iterable[Hashable]:
    """Return the keys of the devices and clients that receive the topic's messages."""
    return (*topic.devices, *(subscriber.key for subscriber in topic.subscribers))
