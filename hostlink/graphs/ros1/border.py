"""Border: the topics and services that pass between hub and ROS, as both graphs change."""

from collections.abc import Iterable

from hostlink.graphs.ros1.name_map import NameMap
from hostlink.graphs.ros1.names import Names, is_legal
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.publication import Publication
from hostlink.graphs.ros1.registrations import Kind, Registration
from hostlink.graphs.ros1.service_offer import ServiceOffer
from hostlink.graphs.ros1.subscription import Subscription
from hostlink.graphs.ros1.tcpros import ANY, BadHeader, decode_header
from hostlink.graphs.ros1.wire import Wire
from hostlink.hub.graph import Graph, GraphService, GraphTopic
from hostlink.logs import printable
from hostlink.messages.message_type import MessageType, ServiceType

MAX_NAMED = 1000  # publishers of one topic that the master names

_PublishedTopic = tuple[GraphTopic, MessageType]


class Border:
    """What hostlink publishes, subscribes to and provides in ROS, by its names there."""

    def __init__(self, parts: Parts) -> None:
        self.publications: dict[str, Publication] = {}
        self.subscriptions: dict[str, Subscription] = {}
        self.offers: dict[str, ServiceOffer] = {}
        self._parts = parts
        self._publishers: dict[str, list[str]] = {}  # as the master named them last, of what is subscribed to

    def update(self, graph: Graph, names: NameMap) -> None:
        """Add what has come, close what has gone or is another now."""
        self._update_publications(self._published(graph.topics, names))
        self._update_subscriptions(self._subscribed(graph.topics, names))
        self._update_offers(self._provided(graph.services, names))

    def wanted(self) -> dict[Registration, None]:
        """What the master is to know."""
        found = [Registration(Kind.PUBLISHER, name, each.type.name) for name, each in self.publications.items()]
        found += [
            Registration(Kind.SUBSCRIBER, name, each.topic.type_name or ANY)
            for name, each in self.subscriptions.items()
        ]
        found += [Registration(Kind.SERVICE, name, each.type.name) for name, each in self.offers.items()]
        return dict.fromkeys(found)

    def set_publishers(self, topic: str, uris: list[str], *, is_answer: bool) -> None:
        """Who publishes a topic: as the answer to its registration, or as a change."""
        subscription = self.subscriptions.get(topic)
        if subscription is None:
            return
        self._parts.counts.crowded_out += max(0, len(uris) - MAX_NAMED)
        uris = uris[:MAX_NAMED]
        if is_answer:
            self._publishers[topic] = merge_publishers(self._publishers.get(topic, []), uris)
            subscription.add(uris)
        else:
            self._publishers[topic] = uris
            subscription.update(uris)

    def accept(self, wire: Wire, messages: list[bytes]) -> None:
        """The first message of a node that connects is its header."""
        wire.is_replaceable = False
        try:
            header = decode_header(messages[0])
        except BadHeader as error:
            self._refuse(wire, str(error))
            return
        kind, name = ("topic", header["topic"]) if "topic" in header else ("service", header.get("service", ""))
        found = (self.publications if kind == "topic" else self.offers).get(name)
        if found is None:
            self._refuse(wire, f"{self._parts.node} has no {kind} {printable(name)}")
        else:
            found.accept(wire, header)
            if messages[1:] and not wire.is_closed:
                wire.receive(messages[1:])

    def close(self) -> None:
        """Nothing passes any more."""
        self.update(Graph((), ()), NameMap(Names()))

    def _refuse(self, wire: Wire, reason: str) -> None:
        self._parts.counts.refused_headers += 1
        wire.refuse(reason)

    # -- what is wanted -----------------------------------------------------------------------------------------------

    def _published(self, topics: Iterable[GraphTopic], names: NameMap) -> dict[str, _PublishedTopic]:
        found: dict[str, _PublishedTopic] = {}
        for topic in topics:
            if topic.is_published and topic.type is None:
                self._parts.log_once("ros1.topic_unknown", topic=printable(topic.name), type=printable(topic.type_name))
            elif topic.is_published and topic.type is not None:
                name = self._legal(names.to_ros(topic.name))
                if name:
                    found.setdefault(name, (topic, topic.type))
        return found

    def _subscribed(self, topics: Iterable[GraphTopic], names: NameMap) -> dict[str, GraphTopic]:
        found: dict[str, GraphTopic] = {}
        for topic in topics:
            is_known = topic.type is not None or not topic.type_name
            name = self._legal(names.to_ros(topic.name)) if topic.is_subscribed and is_known else ""
            if name:
                found.setdefault(name, topic)
        return found

    def _provided(self, services: Iterable[GraphService], names: NameMap) -> dict[str, tuple[str, ServiceType]]:
        found: dict[str, tuple[str, ServiceType]] = {}
        for service in services:
            type_ = self._parts.hub.catalog.service(service.type_name)
            name = self._legal(names.to_ros(service.name))
            if type_ is None:
                self._parts.log_once("ros1.service_unknown", service=name, type=printable(service.type_name))
            elif name:
                found.setdefault(name, (service.name, type_))
        return found

    def _legal(self, name: str) -> str:
        if is_legal(name):
            return name
        self._parts.log_once("ros1.name_refused", name=printable(name))
        return ""

    # -- what there is ------------------------------------------------------------------------------------------------

    def _update_publications(self, wanted: dict[str, _PublishedTopic]) -> None:
        for name, publication in list(self.publications.items()):
            topic, type_ = wanted.get(name, (None, None))
            now = None if topic is None else (topic.name, type_, topic.is_latched)
            if now != (publication.topic, publication.type, publication.is_latched):
                self.publications.pop(name).close()
        for name, (topic, type_) in wanted.items():
            if name not in self.publications:
                self.publications[name] = Publication(self._parts, topic.name, name, type_, is_latched=topic.is_latched)

    def _update_subscriptions(self, wanted: dict[str, GraphTopic]) -> None:
        for name, subscription in list(self.subscriptions.items()):
            if not _is_same(subscription.topic, wanted.get(name)):
                self.subscriptions.pop(name).close()
        for name in self._publishers.keys() - wanted.keys():
            del self._publishers[name]
        for name, topic in wanted.items():
            if name not in self.subscriptions:
                subscription = self.subscriptions[name] = Subscription(self._parts, topic, name)
                if name in self._publishers:  # the master knows of this subscription, and does not repeat them
                    subscription.add(self._publishers[name])

    def _update_offers(self, wanted: dict[str, tuple[str, ServiceType]]) -> None:
        for name, offer in list(self.offers.items()):
            if wanted.get(name) != (offer.service, offer.type):
                self.offers.pop(name).close()
        for name, (service, type_) in wanted.items():
            if name not in self.offers:
                self.offers[name] = ServiceOffer(self._parts, service, name, type_)


def merge_publishers(known: list[str], answered: list[str]) -> list[str]:
    """Those that a master has answered with, beside those that one before it has named; the newest are kept."""
    return list(dict.fromkeys((*answered, *known)))[:MAX_NAMED]


def _is_same(before: GraphTopic, now: GraphTopic | None) -> bool:
    """Whether connections to its publishers may stay; a type that nobody had named may have been learned from them."""
    if now is None or (now.name, now.is_velocity) != (before.name, before.is_velocity):
        return False
    return before.type is None or now.type is before.type
