"""The bridge to ROS 2 by rmw_zenoh's protocol: what is in the hub is in that graph, and the other way round."""

import asyncio
import contextlib
import re
import socket
from collections import Counter
from collections.abc import AsyncIterator, Container
from typing import Final

import structlog

from hostlink.config import ZenohConfig
from hostlink.errors import HostlinkError
from hostlink.graphs.ros2_types import Ros2Message, Ros2Types, ros1_type
from hostlink.graphs.zenoh.rmw_endpoints import (
    GROUP,
    CalledService,
    Offered,
    OfferedService,
    Publication,
    Published,
    RmwNode,
)
from hostlink.graphs.zenoh.rmw_graph import RemoteGraph
from hostlink.graphs.zenoh.rmw_protocol import OWN_ENCLAVE, SPACE, EndpointToken, Kind, NodeToken, is_hidden, is_name
from hostlink.graphs.zenoh.rmw_publishers import Publishers, Subscription, Wanted
from hostlink.graphs.zenoh.session import Session, Token
from hostlink.hub.graph_view import GraphService, GraphTopic
from hostlink.hub.hub import Hub
from hostlink.mirror.log_once import LogOnce
from hostlink.mirror.mirror import Mirror
from hostlink.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE

MAX_CALLED_SERVICES: Final = 256
TROUBLE_INTERVAL_S: Final = 10.0
SLICE_S: Final = 0.003  # of declarations: a hundred robots that come at once cost a second of Zenoh's
TROUBLE: Final = frozenset(  # counts of what was lost, by cause
    {
        "crowded_calls", "crowded_publishers", "crowded_services", "crowded_tokens", "failed_calls",
        "failed_endpoints", "late",
        "malformed_from_ros2", "malformed_to_ros2", "malformed_tokens", "other_type", "unidentified", "unsigned",
    }
)  # fmt: skip
UNKNOWN: Final = "ros2.type_unknown"  # of most types of a large graph: they are no robot's here
REFUSED_NAME: Final = "ROS 2 allows letters, digits and _ in names"
OWN_PACKAGES: Final = ("rcl_interfaces/", "type_description_interfaces/")  # services that every node of ROS 2 has

log = structlog.get_logger()

_Declared = Wanted | Published | Offered
_Endpoint = Subscription | Publication | OfferedService


class UnusableType(Exception):
    """A service's type is unknown here or has another definition, which was logged."""


class RmwBridge:
    """Keeps both graphs equal while the session lives. `counts`: messages both ways, and what was lost by cause."""

    def __init__(self, hub: Hub, session: Session, types: Ros2Types, token: NodeToken) -> None:
        """`token`: of the node that this daemon is.

        Raises:
            ConfigError: the session is closed.
        """
        self._node = RmwNode(hub, session, types, token)
        self.counts = self._node.counts
        self._log_once = LogOnce(self.counts, at_info=(UNKNOWN,), by=("name", "type"))
        self._remote = RemoteGraph(token.domain, self.counts)
        self._publishers = Publishers(self._node, self._remote, self._log_once)
        self._endpoints: Mirror[_Declared, _Declared, _Endpoint] = Mirror(
            lambda _, each: self._declare(each), self._fail, slice_s=SLICE_S
        )
        self._called = Mirror[EndpointToken, EndpointToken, CalledService](
            lambda _, each: self._call(each),
            self._fail_call,
            limit=MAX_CALLED_SERVICES,
            on_crowded=lambda _: self.counts.update(("crowded_services",)),
        )
        self._participant = hub.join("ros2", group=GROUP)
        self._declared = [
            session.declare_token(token.encode()),
            session.subscribe_tokens(f"{SPACE}/{token.domain}/**", self._receive_token),
        ]
        self._participant.watch_graph(self._update)

    def close(self) -> None:
        """Leave both graphs: what ROS 2 drives stops."""
        self._publishers.clear()
        self._participant.leave()
        self._endpoints.close()
        self._called.close()
        for each in self._declared:
            each.close()
        self._remote.clear()

    # -- from ROS 2 ---------------------------------------------------------------------------------------------------

    def _receive_token(self, token: Token) -> None:
        if not token.is_alive:
            self._remove(token.key)
            return
        added = self._remote.add(token.key)
        if not isinstance(added, EndpointToken):
            return
        if added.kind is Kind.PUBLISHER:
            self._publishers.add(added, token.key)
            self._check_hash(added)
        elif added.kind is Kind.SERVER and not is_hidden(added.name) and not added.type_name.startswith(OWN_PACKAGES):
            self._called.put(added, added)

    def _remove(self, key: str) -> None:
        removed = self._remote.remove(key)
        if removed is None:
            return
        self._publishers.remove(removed)
        if isinstance(removed.token, EndpointToken):
            self._called.put(removed.token, None)

    def _check_hash(self, token: EndpointToken) -> None:
        """Log a type whose definition there is another: none of its messages arrives."""
        known = self._node.types.message(ros1_type(token.type_name))
        if known is not None and known.type_hash != token.type_hash:
            self._log_difference(token, known.type_hash, topic=token.name)

    def _log_difference(self, token: EndpointToken, here: str, **facts: str) -> None:
        self._log_once("ros2.type_differs", name=token.type_name, **facts, here=here, there=token.type_hash)

    def _call(self, token: EndpointToken) -> CalledService:
        name = ros1_type(token.type_name)
        known, type_ = self._node.hub.catalog.service(name), self._node.types.service(name)
        if known is None or type_ is None:
            self._log_once(UNKNOWN, name=token.type_name, service=token.name)
            raise UnusableType(token.type_name)
        if type_.type_hash != token.type_hash:
            self._log_difference(token, type_.type_hash, service=token.name)
            raise UnusableType(token.type_name)
        return CalledService(self._node, token, known, type_)

    def _fail_call(self, token: EndpointToken, error: Exception) -> None:
        if isinstance(error, HostlinkError):
            self._log_once("ros2.service_refused", name=token.name, type=token.type_name, reason=str(error))
        elif not isinstance(error, UnusableType):
            self._fail(token, error)

    def _fail(self, _: object, error: Exception) -> None:
        """A ConfigError of the session: it is closed."""
        if isinstance(error, HostlinkError):
            self.counts["failed_endpoints"] += 1
        else:
            self._node.hub.isolation.crashed("graph", error, graph="ros2")

    # -- from the hub -------------------------------------------------------------------------------------------------

    def _update(self) -> None:
        """The hub's graph has changed: declare what is new, withdraw what is gone."""
        graph = self._participant.graph()
        topics = [(topic, type_) for topic in graph.topics if (type_ := self._type(topic)) is not None]
        stamped = {each.name for each in graph.topics if each.is_velocity and each.type_name == TWIST_STAMPED_TYPE}
        wanted: list[_Declared] = [
            each for topic, type_ in topics if topic.is_subscribed for each in self._wanted(topic, type_, stamped)
        ]
        wanted += [
            Published(topic.name, topic.type_name, type_, topic.is_latched)
            for topic, type_ in topics
            if topic.is_published and not topic.is_velocity
        ]
        wanted += [each for service in graph.services if (each := self._service(service)) is not None]
        self._endpoints.want({each: each for each in wanted})
        self._publishers.advertise_all()

    def _declare(self, each: _Declared) -> _Endpoint:
        match each:
            case Wanted():
                return Subscription(self._node, each, self._publishers)
            case Published():
                return Publication(self._node, each)
            case Offered():
                return OfferedService(self._node, each)

    def _wanted(self, topic: GraphTopic, type_: Ros2Message, stamped_topics: Container[str]) -> list[Wanted]:
        """A robot's velocity is received as a Twist and as a TwistStamped, by the same name.

        `stamped_topics`: velocities whose type is TwistStamped in the hub.
        """
        if not topic.is_velocity:
            has_history = any(
                each.token.qos.is_transient_local for each in self._remote.publishers((topic.name, type_.name))
            )
            return [Wanted(topic.name, type_, topic.name, has_history=has_history)]
        wanted = [Wanted(topic.name, type_, topic.name, is_velocity=True)]
        stamped = self._node.types.message(TWIST_STAMPED_TYPE)
        if topic.type_name == TWIST_TYPE and stamped is not None:
            beside = f"{topic.name}_stamped"  # the robot's own topic of that type, which checks the age of commands
            is_there = beside in stamped_topics
            target = beside if is_there else topic.name
            wanted.append(Wanted(topic.name, stamped, target, is_velocity=True, is_stripped=not is_there))
        return wanted

    def _type(self, topic: GraphTopic) -> Ros2Message | None:
        """What the topic is in ROS 2; None: it cannot be there, which is logged once."""
        if not topic.type_name or is_hidden(topic.name) or self._is_elsewhere(topic.name):
            return None
        if not is_name(topic.name):
            self._log_once("ros2.topic_refused", name=topic.name, reason=REFUSED_NAME)
            return None
        found = self._node.types.message(topic.type_name)
        if found is None:
            self._log_once(UNKNOWN, name=topic.type_name, topic=topic.name)
        return found

    def _is_elsewhere(self, name: str) -> bool:
        """Whether it is of a robot of another daemon, which shows it in ROS 2 by itself."""
        robot = name.split("/")[1]
        remote = self._node.hub.robots.remote.get(robot)
        return remote is not None and self._node.hub.robots.find(robot) is remote

    def _service(self, service: GraphService) -> Offered | None:
        if is_hidden(service.name) or self._is_elsewhere(service.name):
            return None
        if not is_name(service.name):
            self._log_once("ros2.service_refused", name=service.name, reason=REFUSED_NAME)
            return None
        known, found = self._node.hub.catalog.service(service.type_name), self._node.types.service(service.type_name)
        if known is None or found is None:
            self._log_once(UNKNOWN, name=service.type_name, service=service.name)
            return None
        return Offered(service.name, known, found)


@contextlib.asynccontextmanager
async def ros2_bridged(hub: Hub, session: Session, config: ZenohConfig) -> AsyncIterator[RmwBridge]:
    """Be a node of the ROS 2 graph for the length of the block.

    Raises:
        ConfigError: the session is closed.
    """
    types = await asyncio.to_thread(Ros2Types, hub.catalog, config.ros_distribution)
    name = re.sub(r"\W", "_", config.name or socket.gethostname(), flags=re.ASCII)
    token = NodeToken(config.ros_domain_id, session.zid, 0, "/", f"hostlink_{name}", OWN_ENCLAVE)
    bridge = RmwBridge(hub, session, types, token)
    hub.counts.graphs["ros2"] = lambda: bridge.counts
    log.info("ros2.joined", node=token.full_name, domain=token.domain, distribution=config.ros_distribution)
    try:
        async with asyncio.TaskGroup() as tasks:
            watcher = tasks.create_task(_log_trouble(bridge.counts), name="ros2 trouble")
            try:
                yield bridge
            finally:
                watcher.cancel()
    finally:
        bridge.close()
        log.info("ros2.left", **bridge.counts)


async def _log_trouble(counts: Counter[str]) -> None:
    """One line in ten seconds about what was lost since the last."""
    before: Counter[str] = Counter()
    while True:
        await asyncio.sleep(TROUBLE_INTERVAL_S)
        lost = {cause: count - before[cause] for cause, count in counts.items() if cause in TROUBLE}
        before = Counter(counts)
        if any(lost.values()):
            log.warning("ros2.trouble", **{cause: count for cause, count in lost.items() if count})
