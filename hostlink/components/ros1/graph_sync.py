"""GraphSync: the adapter that mirrors topics and services between the hub and ROS 1."""

import asyncio
from collections.abc import Callable, Iterable
from operator import itemgetter
from typing import NamedTuple

from hostlink.components.ros1.connections import Wire
from hostlink.components.ros1.local_node import LocalNode, RegistrationKind
from hostlink.components.ros1.names import NameMap, NameResolver, is_legal
from hostlink.components.ros1.services import FAILURES, ForeignService, ServiceOffer, find_type
from hostlink.components.ros1.tcpros import ANY, BadHeader, Header, decode_header
from hostlink.components.ros1.topics import RosPublication, RosPublisher
from hostlink.core.host import Graph, GraphTopic
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.core.mirror.mirror import Mirror, Served
from hostlink.core.runtime.logs import printable
from hostlink.errors import HostlinkError, ServiceFailed

MAX_NAMED = 1000  # publishers of one topic that the master names
MAX_PUBLISHERS = 64  # of one topic, to which this node connects
MAX_SERVICES = 512  # of other nodes
AT_ONCE = 4  # nodes whose services' types are requested
OF_EVERY_NODE = ("/get_loggers", "/set_logger_level")  # services for ROS tools, never called by hostlink
FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 8.0  # until a publisher is connected again
UNDEFINED = "no definition here, so ROS 1 cannot read it; put its .msg into a folder named in message_folders"
SERVICE_RETRY_S = 10.0  # until a node that did not announce the type of its service is asked again


class _Published(NamedTuple):
    """A topic of the hub that is published in ROS."""

    topic: str
    type: MessageType
    is_latched: bool


class _Offered(NamedTuple):
    """A service of the hub that is provided in ROS."""

    service: str
    type: ServiceType


class _Subscription:
    """Endpoint for a topic that the hub subscribes to: connections to the nodes that publish it, by their addresses."""

    def __init__(self, topic: GraphTopic, disconnect: Callable[[str], None]) -> None:
        self.topic = topic
        self.publishers: dict[str, RosPublisher] = {}
        self.is_registered = False  # the master has answered
        self._disconnect = disconnect

    def drop(self, uri: str) -> None:
        """Disconnect a publisher. What it drives stops at once, before its task ends."""
        self.publishers.pop(uri).close()
        self._disconnect(uri)

    def close(self) -> None:
        """Disconnect all publishers."""
        for uri in list(self.publishers):
            self.drop(uri)


class GraphSync:
    """Mirrors the hub's topics and services into ROS by their names there, and ROS's services into the hub."""

    def __init__(self, node: LocalNode) -> None:
        self._node = node
        self._named: dict[str, list[str]] = {}  # publishers as the master named them last, of what is subscribed to
        self._room = asyncio.Semaphore(AT_ONCE)
        self._publications = Mirror[str, _Published, RosPublication](
            lambda name, wanted: RosPublication(node, wanted.topic, name, wanted.type, is_latched=wanted.is_latched),
            self._fail,
        )
        self._offers = Mirror[str, _Offered, ServiceOffer](
            lambda name, wanted: ServiceOffer(node, wanted.service, name, wanted.type), self._fail
        )
        self._subscriptions = Mirror[str, GraphTopic, _Subscription](self._subscribe, self._fail, is_same=_is_same)
        self._connections: Mirror[tuple[str, str], RosPublisher, Served[tuple[str, str]]] = Mirror.of_tasks(
            lambda _, publisher: publisher.receive(),
            lambda work: node.spawn(work, name="ROS 1 publisher"),
            self._fail_publisher,
            limit=node.config.max_connections,
            group_of=itemgetter(0),
            group_limit=MAX_PUBLISHERS,
            retry_s=FIRST_RETRY_S,
            longest_s=LONGEST_RETRY_S,
            on_crowded=self._count_crowded,
        )
        self._services: Mirror[tuple[str, str], str, Served[tuple[str, str]]] = Mirror.of_tasks(
            self._provide,
            lambda work: node.spawn(work, name="ROS 1 service"),
            self._fail_service,
            limit=MAX_SERVICES,
            retry_s=SERVICE_RETRY_S,
            on_crowded=self._count_crowded,
        )
        # Endpoints by their names in ROS.
        self.publications, self.offers = self._publications.endpoints, self._offers.endpoints
        self.subscriptions = self._subscriptions.endpoints

    def update(self, graph: Graph, names: NameMap) -> None:
        """Follow a change of the hub's graph."""
        self._publications.want(self._published(graph.topics, names))
        subscribed = self._subscribed(graph.topics, names)
        self._named = {name: uris for name, uris in self._named.items() if name in subscribed}
        self._subscriptions.want(subscribed)
        self._offers.want(self._offered(graph, names))

    def update_services(self, nodes: dict[str, str], names: NameMap) -> None:
        """Follow a change of the services in ROS. `nodes`: the provider of each; a new provider is a new service."""
        found = {(name, node) for name, node in nodes.items() if node != self._node.name}
        self._services.want({key: names.to_hub(key[0]) for key in sorted(found) if not key[0].endswith(OF_EVERY_NODE)})

    def set_publishers(self, topic: str, uris: list[str], *, is_answer: bool) -> None:
        """Update the publishers of a topic, from the answer to its registration or from a change.

        A restarted master knows few publishers, so an answer removes none.
        """
        subscription = self.subscriptions.get(topic)
        if subscription is None:
            return
        self._node.counts.crowded_out += max(0, len(uris) - MAX_NAMED)
        before = self._named.get(topic, [])
        is_new = subscription.is_registered and len(before) < MAX_NAMED  # of a full list others were left out
        named = self._named[topic] = merge_publishers(before if is_answer else [], uris)
        for uri in subscription.publishers.keys() - set(named):
            subscription.drop(uri)
        self._connect(topic, subscription, named, is_new=is_new)
        subscription.is_registered = subscription.is_registered or is_answer

    def wanted(self) -> dict[tuple[RegistrationKind, str], str]:
        """Return the type of each name to register. Services are first: once the node is listed, it answers calls."""
        found = {(RegistrationKind.SERVICE, name): each.type.name for name, each in self.offers.items()}
        found |= {(RegistrationKind.PUBLISHER, name): each.type.name for name, each in self.publications.items()}
        found |= {
            (RegistrationKind.SUBSCRIBER, name): each.topic.type_name or ANY
            for name, each in self.subscriptions.items()
        }
        return found

    def accept(self, wire: Wire, messages: list[bytes]) -> None:
        """Read the header of a node that connects, which is its first message."""
        wire.is_replaceable = False
        try:
            header = decode_header(messages[0])
            self._endpoint(header).accept(wire, header)
        except BadHeader as error:
            self._node.counts.refused_headers += 1
            wire.refuse(str(error))
        if messages[1:] and not wire.is_closed:
            wire.receive(messages[1:])

    def _endpoint(self, header: Header) -> RosPublication | ServiceOffer:
        kind, name = ("topic", header["topic"]) if "topic" in header else ("service", header.get("service", ""))
        found = (self.publications if kind == "topic" else self.offers).get(name)
        if found is None:
            raise BadHeader(f"{self._node.name} has no {kind} {printable(name)}")
        return found

    def close(self) -> None:
        self.update(Graph((), ()), NameMap(NameResolver()))
        for mirror in (self._publications, self._offers, self._connections, self._services):
            mirror.close()

    # -- what is wanted -----------------------------------------------------------------------------------------------

    def _published(self, topics: Iterable[GraphTopic], names: NameMap) -> dict[str, _Published]:
        found: dict[str, _Published] = {}
        for topic in topics:
            if topic.is_published and topic.type is None:
                self._node.log_once("ros1.topic_unknown", topic=topic.name, type=topic.type_name, reason=UNDEFINED)
            elif topic.is_published and topic.type is not None:
                name = self._legal(names.to_ros(topic.name))
                if name:
                    found.setdefault(name, _Published(topic.name, topic.type, topic.is_latched))
        return found

    def _subscribed(self, topics: Iterable[GraphTopic], names: NameMap) -> dict[str, GraphTopic]:
        found: dict[str, GraphTopic] = {}
        for topic in topics:
            is_known = topic.type is not None or not topic.type_name
            name = self._legal(names.to_ros(topic.name)) if topic.is_subscribed and is_known else ""
            if name:
                found.setdefault(name, topic)
        return found

    def _offered(self, graph: Graph, names: NameMap) -> dict[str, _Offered]:
        found: dict[str, _Offered] = {}
        for service in graph.services:
            type_ = self._node.host.messages.service(service.type_name)
            name = self._legal(names.to_ros(service.name))
            if type_ is None:
                self._node.log_once("ros1.service_unknown", service=name, type=service.type_name)
            elif name:
                found.setdefault(name, _Offered(service.name, type_))
        return found

    def _legal(self, name: str) -> str:
        if is_legal(name):
            return name
        self._node.log_once("ros1.name_refused", name=name)
        return ""

    # -- publishers of other nodes ------------------------------------------------------------------------------------

    def _subscribe(self, name: str, topic: GraphTopic) -> _Subscription:
        subscription = _Subscription(topic, lambda uri: self._connections.put((name, uri), None))
        if name in self._named:  # the master knows of an earlier subscription, and does not repeat its publishers
            self._connect(name, subscription, self._named[name], is_new=False)
            subscription.is_registered = True
        return subscription

    def _connect(self, name: str, subscription: _Subscription, uris: Iterable[str], *, is_new: bool) -> None:
        """`is_new`: they came after the subscription, so what they publish first is new."""
        for uri in uris:
            if uri != self._node.uri and uri not in subscription.publishers:
                publisher = RosPublisher(self._node, subscription.topic, name, uri, is_new=is_new)
                subscription.publishers[uri] = publisher
                self._connections.put((name, uri), publisher)

    # -- services of other nodes --------------------------------------------------------------------------------------

    async def _provide(self, key: tuple[str, str], service: str) -> None:
        """Find the type of a service, and provide it here until this is cancelled."""
        name, _ = key
        async with self._room:
            type_name, md5 = await find_type(self._node, name)
        type_ = self._node.host.messages.service(type_name)
        if type_ is None or type_.md5 != md5:
            raise ServiceFailed(name, f"no definition of {type_name} with md5 {md5}")
        provided = ForeignService(self._node, service, name, type_)
        try:
            await asyncio.Event().wait()
        finally:
            provided.close()

    # -- bounds and failures ------------------------------------------------------------------------------------------

    def _count_crowded(self, _: object) -> None:
        self._node.counts.crowded_out += 1

    def _fail(self, key: str, error: Exception) -> None:
        """A publication or an offer only waits for connections: what it raises is a fault of hostlink."""
        self._node.host.crashed("ros1", error, name=printable(key))

    def _fail_publisher(self, key: tuple[str, str], error: Exception) -> None:
        self._log_failure("ros1.publisher_failed", error, topic=key[0], uri=key[1])

    def _fail_service(self, key: tuple[str, str], error: Exception) -> None:
        self._log_failure("ros1.service_unusable", error, service=key[0], node=key[1])

    def _log_failure(self, event: str, error: Exception, **facts: str) -> None:
        if isinstance(error, (*FAILURES, HostlinkError)):
            self._node.log_once(event, **facts, reason=str(error) or type(error).__name__)
        else:
            self._node.host.crashed("ros1", error, **{name: printable(text) for name, text in facts.items()})


def merge_publishers(known: list[str], answered: list[str]) -> list[str]:
    """Merge the publishers that a master names now with those that an earlier one named, the newest first."""
    return list(dict.fromkeys((*answered, *known)))[:MAX_NAMED]


def _is_same(before: GraphTopic, now: GraphTopic) -> bool:
    """Whether connections to publishers may stay. An unknown type may have been learned from them."""
    is_known = before.type is None or now.type is before.type
    return is_known and (now.name, now.is_velocity) == (before.name, before.is_velocity)
