"""The graph as one group sees it: topics and services as values, updated from what has changed since."""

import bisect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar
from weakref import WeakValueDictionary

from hostlink.hub.graph_changes import GraphChanges, GraphKind
from hostlink.hub.node import Node, is_of
from hostlink.hub.services import DeviceService, Provider, Services
from hostlink.hub.topic import Topic
from hostlink.hub.topic_graph import TopicGraph
from hostlink.messages.message_type import MessageType

OBSERVERS = "recording"  # a group that receives what there is: no reason to bring a topic from another graph
ROSAPI = "/rosapi/"  # answers about this daemon's graph to clients of rosbridge; another graph has its own


@dataclass(frozen=True, slots=True)
class GraphTopic:
    """A topic, as those see it who do not belong to the group that asks."""

    name: str
    type_name: str  # empty: only subscribers use it, and none named a type
    type: MessageType | None  # None: nobody has a definition
    is_published: bool
    is_subscribed: bool
    is_latched: bool
    is_velocity: bool  # what is published to it drives a robot
    is_derived: bool  # hostlink alone publishes it, from what devices publish


@dataclass(frozen=True, slots=True)
class GraphService:
    """A service that somebody outside of the group answers."""

    name: str
    type_name: str


@dataclass(frozen=True, slots=True)
class Graph:
    """All topics and services that somebody outside of the group uses, by name."""

    topics: tuple[GraphTopic, ...]
    services: tuple[GraphService, ...]


def graph_topic(topic: Topic, group: str) -> GraphTopic | None:
    """The topic as the group sees it; None: nobody outside of it uses it."""
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
        is_derived=bool(topic.publishers) and all(isinstance(key, Node) and key.is_daemon for key in topic.publishers),
    )
    return found if found.is_published or found.is_subscribed else None


def graph_service(name: str, service: DeviceService | Provider, group: str) -> GraphService | None:
    """The service as the group sees it; None: the group answers it itself, or it is no part of another graph."""
    is_shown = not name.startswith(ROSAPI) and not is_of(service.key, group)
    return GraphService(name, service.type_name) if is_shown else None


class _Named(Protocol):
    @property
    def name(self) -> str: ...


Entry = TypeVar("Entry", bound=_Named)


@dataclass(frozen=True, slots=True)
class GraphNews:
    """What has changed since somebody read last."""

    version: int  # for the next reading
    topics: Mapping[str, GraphTopic | None]  # None: it is gone, or nobody outside of the group uses it
    robots: frozenset[str]  # that came, left or were forgotten
    is_whole: bool  # `topics` are all that there are: too much has changed, or it is the first reading


class GraphView:
    """One for all participants of a group."""

    def __init__(self, topics: TopicGraph, services: Services, changes: GraphChanges, group: str) -> None:
        self._all_topics, self._all_services, self._changes, self._group = topics, services, changes, group
        self._version = -1
        self._topics, self._services = _Table[GraphTopic](), _Table[GraphService]()

    def graph(self) -> Graph:
        """What others than this group have; the same object until that changes."""
        self._update()
        return Graph(self._topics.entries(), self._services.entries())

    def topic(self, name: str) -> GraphTopic | None:
        """One of them."""
        self._update()
        return self._topics.get(name)

    def news(self, version: int) -> GraphNews:
        """What has changed after this version, -1 for the first reading."""
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
                self._topics.put(name, self._make_topic(name))
            elif kind is GraphKind.SERVICE:
                self._services.put(name, self._make_service(name))

    def _make_topic(self, name: str) -> GraphTopic | None:
        topic = self._all_topics.find_or_none(name)
        return None if topic is None else graph_topic(topic, self._group)

    def _make_service(self, name: str) -> GraphService | None:
        service = self._all_services.find_or_none(name)
        return None if service is None else graph_service(name, service, self._group)


class _Table(Generic[Entry]):
    """Entries by name, in the order of names; one that comes costs the others nothing but their places."""

    def __init__(self) -> None:
        self._by_name: dict[str, Entry] = {}
        self._names: list[str] = []
        self._entries: tuple[Entry, ...] | None = ()

    def get(self, name: str) -> Entry | None:
        return self._by_name.get(name)

    def names(self) -> list[str]:
        return self._names

    def put(self, name: str, entry: Entry | None) -> None:
        """None: it is gone."""
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


class GraphViews:
    """The views by group, each as long as a participant has it."""

    def __init__(self, topics: TopicGraph, services: Services, changes: GraphChanges) -> None:
        self._parts = topics, services, changes
        self._views: WeakValueDictionary[str, GraphView] = WeakValueDictionary()

    def of(self, group: str) -> GraphView:
        """The group's."""
        view = self._views.get(group)
        if view is None:
            view = self._views[group] = GraphView(*self._parts, group)
        return view
