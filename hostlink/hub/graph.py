"""Graph: the topics and services that another graph is to know, as a value."""

from collections.abc import Hashable
from dataclasses import dataclass

from hostlink.hub.node import Node
from hostlink.hub.services import Services
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


def graph_of(topics: TopicGraph, services: Services, group: str) -> Graph:
    """What others than this group have."""
    seen_topics = (_graph_topic(topic, group) for topic in topics.all())
    return Graph(
        tuple(topic for topic in seen_topics if topic.is_published or topic.is_subscribed),
        tuple(
            GraphService(name, type_name)
            for name, type_name in services.all()
            if not name.startswith(ROSAPI) and not _is_of(services.find(name).key, group)
        ),
    )


def _graph_topic(topic: Topic, group: str) -> GraphTopic:
    publishers = [key for key in topic.publishers if not _is_of(key, group)]
    subscribers = [each.key for each in topic.subscribers if not _is_of(each.key, OBSERVERS)]
    return GraphTopic(
        topic.name,
        topic.type_name,
        topic.type,
        is_published=bool(publishers),
        is_subscribed=bool(topic.devices) or any(not _is_of(key, group) for key in subscribers),
        is_latched=any(key in topic.latched for key in publishers),
        is_velocity=topic.is_gated,
        is_derived=bool(topic.publishers) and all(isinstance(key, Node) and key.is_daemon for key in topic.publishers),
    )


def _is_of(key: Hashable, group: str) -> bool:
    return bool(group) and isinstance(key, Node) and key.group == group
