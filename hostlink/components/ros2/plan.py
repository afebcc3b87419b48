"""Plan of the routes between two graphs: names, types, quality of service, and what each graph has decide it. Pure."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.core.messages.ros2_names import is_ros2_name, ros1_type, ros2_type
from hostlink.core.messages.serialisation import CDR

GLOBAL = frozenset({"/tf", "/tf_static", "/clock", "/diagnostics"})  # one for all namespaces, as in ROS 2

STATIC_DEPTH = 100  # transforms of other nodes that never change: each is sent once


def ros2_name(name: str) -> str:
    """The name of a topic or service for rclpy: relative, so that the node's namespace and remappings count."""
    return name if name in GLOBAL else name.removeprefix("/")


def parameter_name(name: str) -> str:
    """`/robot_0/gain` as a parameter of the node: `robot_0.gain`."""
    return name.strip("/").replace("/", ".")


def publisher_qos(topic: str, *, is_latched: bool) -> Qos:
    """Reliable: a best-effort publisher reaches no subscription with default policies, and only a warning says so."""
    return Qos(is_latched=True, depth=STATIC_DEPTH) if topic == "/tf_static" else Qos(is_latched=is_latched)


def subscription_qos(offers: Iterable[Qos]) -> Qos:
    """Return the policies that match every publisher of the topic, and lose no more than they allow."""
    offers = list(offers)
    is_latched = bool(offers) and all(offer.is_latched for offer in offers)
    is_reliable = bool(offers) and all(offer.is_reliable for offer in offers)
    return Qos(is_reliable, is_latched, STATIC_DEPTH) if is_latched else Qos(is_reliable)


TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
_OWN_SERVICE_TYPES = ("rcl_interfaces/", "type_description_interfaces/", "lifecycle_msgs/", "composition_interfaces/")


@dataclass(frozen=True, slots=True)
class PublicationRoute:
    """A topic of the daemon, published in ROS 2."""

    topic: str
    type_name: str  # of the daemon
    is_latched: bool
    is_cdr: bool = False  # the daemon has no definition: the messages are ROS 2's bytes already


@dataclass(frozen=True, slots=True)
class Feed:
    """The messages of a publication: requested from the daemon only while ROS 2 has a subscriber."""

    publication: PublicationRoute


@dataclass(frozen=True, slots=True)
class Reception:
    """Topic of ROS 2, published to the daemon while it has subscribers there."""

    topic: str
    ros2_type: str
    type_name: str  # of the daemon
    qos: Qos


@dataclass(frozen=True, slots=True)
class VelocityInput:
    """A topic of ROS 2 that drives a robot."""

    topic: str
    robot: str
    ros2_type: str


@dataclass(frozen=True, slots=True)
class Server:
    """A service of the daemon, served in ROS 2."""

    service: str
    type_name: str


@dataclass(frozen=True, slots=True)
class Caller:
    """A service of ROS 2, offered to the daemon."""

    service: str
    ros2_type: str


Route = PublicationRoute | Feed | Reception | VelocityInput | Server | Caller


@dataclass(frozen=True, slots=True)
class Ros2Publisher:
    """Publisher of a topic in ROS 2, in another node."""

    type_name: str
    qos: Qos
    gid: bytes = b""


@dataclass(frozen=True, slots=True)
class Ros2Graph:
    """Graph of ROS 2 without the bridge's own node, by names of the daemon."""

    publishers: Mapping[str, tuple[Ros2Publisher, ...]] = field(default_factory=dict)  # by topic
    readers: frozenset[str] = frozenset()  # topics of the bridge that have subscribers
    services: Mapping[str, str] = field(default_factory=dict)  # types by name


@dataclass(frozen=True, slots=True)
class Plan:
    """Routes, and one line for each topic or service that is not mirrored."""

    routes: frozenset[Route]
    problems: tuple[str, ...]


def planned(graph: Mapping[str, Any], ros2: Ros2Graph) -> Plan:
    """The routes that these two graphs need; `graph` is the daemon's `watch_graph`."""
    routes: set[Route] = set()
    problems: list[str] = []
    for topic in graph["topics"]:
        if not is_ros2_name(topic["name"]):
            problems.append(f"{topic['name']}: ROS 2 allows no such name, so the topic stays out of it")
        elif not topic["velocity"]:
            routes.update(_published(topic, ros2))
            routes.update(_received(topic, ros2, problems))
    routes.update(_velocity_inputs(graph["robots"], ros2))
    routes.update(_services(graph["services"], ros2))
    return Plan(frozenset(routes), tuple(problems))


def watched_topics(graph: Mapping[str, Any]) -> list[str]:
    """The topics whose publishers in ROS 2 the plan depends on."""
    received = [topic["name"] for topic in graph["topics"] if topic["subscribed"] and is_ros2_name(topic["name"])]
    driven = [name for robot in graph["robots"] for name in robot["velocity_topics"] if is_ros2_name(name)]
    return list(dict.fromkeys(received + driven))


def publisher_keys(ros2: Ros2Graph) -> frozenset[bytes | str]:
    """The gids of all publishers, and the topics that have one: by one of them a message says who has sent it."""
    gids = (publisher.gid for publishers in ros2.publishers.values() for publisher in publishers)
    return frozenset(gids) | {topic for topic, publishers in ros2.publishers.items() if publishers}


def _published(topic: Mapping[str, Any], ros2: Ros2Graph) -> Iterable[Route]:
    if topic["published"] and topic["type"] and topic["name"] != "/rosout":
        is_cdr = topic.get("encoding") == CDR
        publication = PublicationRoute(topic["name"], topic["type"], topic["latched"], is_cdr=is_cdr)
        yield publication
        if topic["latched"] or topic["name"] in ros2.readers:
            yield Feed(publication)


def _received(topic: Mapping[str, Any], ros2: Ros2Graph, problems: list[str]) -> Iterable[Route]:
    publishers = ros2.publishers.get(topic["name"], ()) if topic["subscribed"] else ()
    if not publishers or topic["name"] == "/rosout":
        return
    offered = sorted({publisher.type_name for publisher in publishers})
    type_name = topic["type"] or ros1_type(offered[0])
    if len(offered) > 1 or offered[0] != ros2_type(type_name):
        problems.append(f"{topic['name']}: {type_name} here, {' and '.join(offered)} in ROS 2: it is not received")
        return
    if topic.get("encoding") == CDR:
        problems.append(f"{topic['name']}: {type_name} has no definition here: it is not received from ROS 2")
        return
    qos = subscription_qos(publisher.qos for publisher in publishers)
    yield Reception(topic["name"], offered[0], type_name, qos)


def _velocity_inputs(robots: Iterable[Mapping[str, Any]], ros2: Ros2Graph) -> Iterable[Route]:
    used: set[str] = set()
    for robot in robots:
        for topic, type_name in robot["velocity_topics"].items():
            if topic not in used and is_ros2_name(topic):
                used.add(topic)
                yield VelocityInput(topic, robot["name"], _velocity_type(type_name, ros2.publishers.get(topic, ())))


def _velocity_type(type_name: str, publishers: Iterable[Ros2Publisher]) -> str:
    """Nav2 sends TwistStamped on `cmd_vel` since Kilted; where both are sent, the topic's own type counts."""
    own = ros2_type(type_name)
    offered = {publisher.type_name for publisher in publishers} & {TWIST, TWIST_STAMPED}
    return own if not offered or own in offered else offered.pop()


def _services(services: Iterable[Mapping[str, Any]], ros2: Ros2Graph) -> Iterable[Route]:
    names = {service["name"] for service in services}
    for service in services:
        if service["type"] and is_ros2_name(service["name"]):
            yield Server(service["name"], service["type"])
    for name, type_name in ros2.services.items():
        if name not in names and not type_name.startswith(_OWN_SERVICE_TYPES):
            yield Caller(name, type_name)
