"""GraphView: topics and services as one group sees them, as values that are updated from the latest changes."""

import bisect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from hostlink.core.hub.graph_changes import GraphChanges, GraphKind
from hostlink.core.hub.node import Node, is_of
from hostlink.core.hub.services import DeviceService, Provider, Services
from hostlink.core.hub.topic import Topic
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.serialisation import ROS1

OBSERVERS = "recording"  # group whose subscriptions do not import a topic from another graph
ROSAPI = "/rosapi/"  # services about this daemon's graph, for clients of rosbridge only


@dataclass(frozen=True, slots=True)
class GraphTopic:
    """Topic as it is outside of the requesting group."""

    name: str
    type_name: str  # empty: it has only subscribers, and none named a type
    type: MessageType | None  # None: the type has no definition here
    is_published: bool
    is_subscribed: bool
    is_latched: bool
    is_velocity: bool  # its messages drive a robot
    is_derived: bool  # only hostlink publishes it, from messages of devices
    has_device: bool = False  # a device subscribes to it
    encoding: str = ROS1  # serialisation of its messages; another one only if its type has no definition


@dataclass(frozen=True, slots=True)
class GraphService:
    """Service that is provided outside of the requesting group."""

    name: str
    type_name: str


@dataclass(frozen=True, slots=True)
class Graph:
    """All topics and services outside of the requesting group, by name."""

    topics: tuple[GraphTopic, ...]
    services: tuple[GraphService, ...]


def is_derived(topic: Topic) -> bool:
    """Whether hostlink itself publishes a topic, and nothing else does."""
    return bool(topic.publishers) and all(isinstance(key, Node) and key.is_daemon for key in topic.publishers)


def is_imported(topic: Topic) -> bool:
    """Whether only other graphs publish a topic."""
    return bool(topic.publishers) and all(isinstance(key, Node) and key.group for key in topic.publishers)


def graph_topic(topic: Topic | None, group: str) -> GraphTopic | None:
    """Return the topic as the group sees it; None if there is none, or none with a user outside of the group."""
    if topic is None:
        return None
    publishers = [key for key in topic.publishers if not is_of(key, group)]
    subscribers = [each.key for each in topic.subscribers if not is_of(each.key, OBSERVERS)]
    found = GraphTopic(
        topic.name,
        topic.type_name,
        topic.type,
        is_published=bool(publishers),
        is_subscribed=bool(topic.devices) or any(not is_of(key, group) for key in subscribers),
        is_latched=any(key in topic.latched for key in publishers),
        is_velocity=topic.is_gated,
        is_derived=is_derived(topic),
        has_device=bool(topic.devices),
        encoding=topic.encoding,
    )
    return found if found.is_published or found.is_subscribed else None


def graph_service(service: DeviceService | Provider | None, group: str) -> GraphService | None:
    """Return the service as the group sees it; None if there is none, of the group itself, or one of ROSAPI."""
    if service is None or service.name.startswith(ROSAPI) or is_of(service.key, group):
        return None
    return GraphService(service.name, service.type_name)


class _Named(Protocol):
    @property
    def name(self) -> str: ...


Entry = TypeVar("Entry", bound=_Named)


@dataclass(frozen=True, slots=True)
class GraphNews:
    """Changes since a version."""

    version: int  # for the next reading
    topics: Mapping[str, GraphTopic | None]  # None: removed, or without a user outside of the group
    robots: frozenset[str]  # names that were added, disconnected or forgotten
    is_whole: bool  # `topics` has all topics: it is the first reading, or too much has changed


class GraphView:
    """View of the graph for all participants of one group."""

    def __init__(self, topics: TopicGraph, services: Services, changes: GraphChanges, group: str) -> None:
        self._all_topics, self._all_services, self._changes, self._group = topics, services, changes, group
        self._version = -1
        self._topics, self._services = _Table[GraphTopic](), _Table[GraphService]()

    def graph(self) -> Graph:
        """Return the topics and services outside of the group."""
        self._update()
        return Graph(self._topics.entries(), self._services.entries())

    def topic(self, name: str) -> GraphTopic | None:
        """Return one topic of the view; None if it has none of this name."""
        self._update()
        return self._topics.get(name)

    def news(self, version: int) -> GraphNews:
        """Return the changes after a version; -1 for the first reading."""
        self._update()
        changed = None if version < 0 else self._changes.since(version)
        if changed is None:
            topics: dict[str, GraphTopic | None] = {topic.name: topic for topic in self._topics.entries()}
            return GraphNews(self._version, topics, frozenset(), is_whole=True)
        names = [name for kind, name in changed if kind is GraphKind.TOPIC]
        robots = frozenset(name for kind, name in changed if kind is GraphKind.ROBOT)
        return GraphNews(self._version, {name: self._topics.get(name) for name in names}, robots, is_whole=False)

    def _update(self) -> None:
        changed = None if self._version < 0 else self._changes.since(self._version)
        self._version = self._changes.version
        if changed is None:
            changed = [(GraphKind.TOPIC, name) for name in {*self._topics.names(), *self._all_topics.names()}]
            changed += [(GraphKind.SERVICE, name) for name in {*self._services.names(), *self._all_services.names()}]
        for kind, name in changed:
            if kind is GraphKind.TOPIC:
                self._topics.put(name, graph_topic(self._all_topics.find_or_none(name), self._group))
            elif kind is GraphKind.SERVICE:
                self._services.put(name, graph_service(self._all_services.find_or_none(name), self._group))


class _Table(Generic[Entry]):
    """Entries sorted by name. An insertion only moves the others."""

    def __init__(self) -> None:
        self._by_name: dict[str, Entry] = {}
        self._names: list[str] = []
        self._entries: tuple[Entry, ...] | None = ()

    def get(self, name: str) -> Entry | None:
        return self._by_name.get(name)

    def names(self) -> list[str]:
        return self._names

    def put(self, name: str, entry: Entry | None) -> None:
        """Set or replace an entry; None removes it."""
        before = self._by_name.get(name)
        if entry == before:
            return
        self._entries = None
        if entry is None:
            del self._by_name[name]
            del self._names[bisect.bisect_left(self._names, name)]
            return
        if before is None:
            bisect.insort(self._names, name)
        self._by_name[name] = entry

    def entries(self) -> tuple[Entry, ...]:
        if self._entries is None:
            self._entries = tuple(map(self._by_name.__getitem__, self._names))
        return self._entries
