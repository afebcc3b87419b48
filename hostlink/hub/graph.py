"""Graph: the topics and services that another graph is to know, as a value."""

from dataclasses import dataclass

from hostlink.hub.node import Node, is_of
from hostlink.hub.services import DeviceService, Provider
from hostlink.hub.topic import Topic
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
