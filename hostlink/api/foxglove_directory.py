"""FoxgloveDirectory: channels, services and nodes that every Foxglove client receives.

They are collected once for all clients after a change of the graph, and only when a client reads them.
"""

import itertools
import os
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import msgspec

from hostlink.api.foxglove_protocol import ROS1, ROS1_SCHEMA
from hostlink.api.views import node_name, receivers
from hostlink.hub.graph_view import Graph
from hostlink.hub.hub import Hub
from hostlink.messages.message_type import MessageType, ServiceType

Names = Mapping[str, tuple[str, ...]]
_Entry = TypeVar("_Entry")


class Channel(NamedTuple):
    """A topic as it is advertised."""

    id: int
    topic: str
    type: MessageType
    json: msgspec.Raw


class Service(NamedTuple):
    """A service as it is advertised."""

    id: int
    name: str
    type: ServiceType
    json: msgspec.Raw


@dataclass(frozen=True, slots=True)
class Offers:
    """All channels and services by id. An id is never reused."""

    channels: Mapping[int, Channel]
    services: Mapping[int, Service]
    undefined: tuple[tuple[str, str], ...]  # topics that no client can decode, and their types


@dataclass(frozen=True, slots=True)
class ConnectionGraph:
    """Nodes of the graph by what they publish, subscribe to and provide."""

    publishers: Names
    subscribers: Names
    providers: Names


class FoxgloveDirectory:
    """Channels, services and nodes of the graph, for all clients."""

    def __init__(self, hub: Hub) -> None:
        self.session_id = os.urandom(8).hex()  # tells a client that reconnects whether the daemon was restarted
        self._hub = hub
        self._participant = hub.join_daemon()
        self._numbers = itertools.count(1)
        self._channels: dict[Hashable, Channel] = {}
        self._services: dict[Hashable, Service] = {}
        self._offers: Offers | None = None
        self._nodes: ConnectionGraph | None = None
        self._participant.watch_graph(self._forget)

    def offers(self) -> Offers:
        """Return the present channels and services: the same object until they may have changed."""
        if self._offers is None:
            self._offers = self._make_offers(self._participant.graph())
        return self._offers

    def connection_graph(self) -> ConnectionGraph:
        """Return the present nodes."""
        if self._nodes is None:
            self._nodes = self._make_nodes()
        return self._nodes

    def _forget(self) -> None:
        self._offers = self._nodes = None

    def _make_offers(self, graph: Graph) -> Offers:
        topics = [topic for topic in graph.topics if topic.type_name and (topic.is_published or topic.is_velocity)]
        channels: dict[Hashable, tuple[str, MessageType]] = {
            (topic.name, topic.type.md5): (topic.name, topic.type) for topic in topics if topic.type is not None
        }
        typed = ((each.name, self._hub.services.type_of(each.name)) for each in graph.services)
        services: dict[Hashable, tuple[str, ServiceType]] = {
            (name, type_.name, type_.md5): (name, type_) for name, type_ in typed if type_ is not None
        }
        self._channels = _renewed(self._channels, channels, lambda offer: _channel(next(self._numbers), *offer))
        self._services = _renewed(self._services, services, lambda offer: _service(next(self._numbers), *offer))
        return Offers(
            {channel.id: channel for channel in self._channels.values()},
            {service.id: service for service in self._services.values()},
            tuple((topic.name, topic.type_name) for topic in topics if topic.type is None),
        )

    def _make_nodes(self) -> ConnectionGraph:
        topics, services = self._hub.topics.all(), self._hub.services
        providers: defaultdict[str, set[str]] = defaultdict(set)
        for name, _ in services.all():
            providers[name].add(self._node(services.find(name).key))
        return ConnectionGraph(
            _sorted({topic.name: set(map(self._node, topic.publishers)) for topic in topics}),
            _sorted({topic.name: set(map(self._node, receivers(topic))) for topic in topics}),
            _sorted(providers),
        )

    def _node(self, key: Hashable) -> str:
        return node_name(self._hub, key)


_Offer = TypeVar("_Offer")


def _renewed(
    before: Mapping[Hashable, _Entry], offers: Mapping[Hashable, _Offer], make: Callable[[_Offer], _Entry]
) -> dict[Hashable, _Entry]:
    """Return an entry for each offer, reusing the entry and id of one that existed before."""
    return {key: before[key] if key in before else make(offer) for key, offer in offers.items()}


def _channel(number: int, topic: str, type_: MessageType) -> Channel:
    advertised = {
        "id": number,
        "topic": topic,
        "encoding": ROS1,
        "schemaName": type_.name,
        "schema": type_.full_definition,
        "schemaEncoding": ROS1_SCHEMA,
    }
    return Channel(number, topic, type_, msgspec.Raw(msgspec.json.encode(advertised)))


def _service(number: int, name: str, type_: ServiceType) -> Service:
    advertised = {
        "id": number,
        "name": name,
        "type": type_.name,
        "request": _schema(f"{type_.name}_Request", type_.request),
        "response": _schema(f"{type_.name}_Response", type_.response),
        "requestSchema": type_.request.full_definition,  # for older clients
        "responseSchema": type_.response.full_definition,
    }
    return Service(number, name, type_, msgspec.Raw(msgspec.json.encode(advertised)))


def _schema(name: str, type_: MessageType) -> dict[str, str]:
    return {"encoding": ROS1, "schemaName": name, "schemaEncoding": ROS1_SCHEMA, "schema": type_.full_definition}


def _sorted(nodes: Mapping[str, set[str]]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(sorted(found)) for name, found in nodes.items() if found}
