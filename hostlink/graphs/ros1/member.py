"""Member: this node in the graph: its parts, and what the master and other nodes may call of it."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import Any

from hostlink.graphs.ros1.graph_sync import GraphSync
from hostlink.graphs.ros1.names import NameMap, Names
from hostlink.graphs.ros1.parameters import MasterParameters
from hostlink.graphs.ros1.parts import GROUP, Parts
from hostlink.graphs.ros1.registrar import Registrar
from hostlink.graphs.ros1.tcpros import ANY
from hostlink.graphs.ros1.wire import Wire
from hostlink.hub.graph_view import Graph
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.hub.robot_topic_publisher import own_topics
from hostlink.hub.stops import own_services
from hostlink.messages.catalog import CLOCK, CLOCK_TYPE, decode_clock

HEADER_TIMEOUT_S = 5.0  # for whoever connects
CRASHED = "a fault of hostlink"


class Member:
    """`ended` has the reason once somebody has shut it down."""

    def __init__(self, parts: Parts, names: Names, tcpros_address: tuple[str, int], service_uri: str) -> None:
        """`tcpros_address` and `service_uri`: where other nodes connect for topics and for services."""
        self.tcpros_address = tcpros_address
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._parts, self._names = parts, names
        self._sync = GraphSync(parts)
        self._parameters = MasterParameters(parts, names, self._follow_parameters)
        self._sim_time = SimTime(parts.hub)
        self._registrar = Registrar(
            parts,
            self._sync,
            self._parameters,
            service_uri,
            on_services=lambda found: self._sync.update_services(found, self._name_map()),
            on_collision=self.shut_down,
        )

    @contextlib.asynccontextmanager
    async def taking_part(self) -> AsyncIterator[None]:
        """In the hub and in ROS, for the length of the block."""
        hub = self._parts.hub
        watcher = hub.join(GROUP, group=GROUP, on_end=lambda: self.shut_down(CRASHED))
        watcher.watch_graph(lambda: self._update(watcher.graph()))
        hub.links.parameter_source = self._parameters
        hub.counts.graphs[GROUP] = self._parts.counts.as_dict
        try:
            yield
        finally:
            hub.links.parameter_source = None
            self._sim_time.update(is_wanted=False)
            watcher.leave()
            self._sync.close()
            await self._registrar.end()

    async def keep_registered(self) -> None:
        """Until it is cancelled."""
        try:
            await self._registrar.run()
        finally:
            self.shut_down(CRASHED)  # where it ends by itself

    def make_wire(self) -> Wire:
        """For a node that connects; it is cut if it does not send its header."""

        def receive(messages: list[bytes]) -> None:
            self._sync.accept(wire, messages)

        def cut_silent() -> None:
            if wire.receive is receive and not wire.is_closed:
                self._parts.counts.refused_headers += 1
                wire.close()

        wire = Wire(self._parts.hub, receive)
        asyncio.get_running_loop().call_later(HEADER_TIMEOUT_S, cut_silent)
        return wire

    def _update(self, graph: Graph) -> None:
        """The hub has changed."""
        self._sync.update(graph, self._name_map())
        self._registrar.note_change()

    def _name_map(self) -> NameMap:
        hub = self._parts.hub
        links = hub.links
        away = (robot for robot in hub.robots.here() if robot.link is None)
        announced = [(name, shown) for robot in away for shown, name in robot.velocities.items()]
        announced += [(info.name, links.shown_name(link, info.name)) for link in links.all() for info in link.topics]
        return NameMap(self._names, announced, _own_names(hub))

    def _follow_parameters(self) -> None:
        self._sim_time.update(is_wanted=self._parameters.is_sim_time)

    # -- what others call ---------------------------------------------------------------------------------------------

    @property
    def master_uri(self) -> str:
        return self._parts.master.uri

    def shut_down(self, reason: str) -> None:
        """End the node, and nothing else."""
        if not self.ended.done():
            self.ended.set_result(reason)

    def publications(self) -> list[list[str]]:
        """(topic, type) of each."""
        return [[name, each.type.name] for name, each in self._sync.publications.items()]

    def subscriptions(self) -> list[list[str]]:
        """(topic, type) of each."""
        return [[name, each.topic.type_name or ANY] for name, each in self._sync.subscriptions.items()]

    def bus_info(self) -> list[list[object]]:
        """Number, the other node, direction, protocol, topic, whether it is connected."""
        found: list[tuple[str, str, str, bool]] = []
        for name, publication in self._sync.publications.items():
            found += [(node, "o", name, True) for node in publication.subscribers.values()]
        for name, subscription in self._sync.subscriptions.items():
            found += [(each.uri, "i", name, each.is_connected) for each in subscription.publishers.values()]
        return [[number, other, way, "TCPROS", name, ok] for number, (other, way, name, ok) in enumerate(found)]

    def has_publication(self, topic: str) -> bool:
        """Whether this node publishes it."""
        return topic in self._sync.publications

    def update_publishers(self, topic: str, uris: list[str]) -> None:
        """The master names all who publish it."""
        self._sync.set_publishers(topic, uris, is_answer=False)

    def update_parameter(self, key: str, value: Any) -> None:
        """The master reports a change."""
        self._parameters.update(key, value)


def _own_names(hub: Hub) -> list[str]:
    """What hostlink itself names after its robots; of those of other daemons all that is below their names."""
    found = [name for robot in hub.robots.here() for name in (*own_topics(robot), *own_services(robot.name))]
    found += [name for robot in hub.robots.remote for name in own_services(robot)]
    if hub.robots.remote:
        found += [name[1:] for name in hub.topics.names() if name.split("/", 2)[1] in hub.robots.remote]
    return found


class SimTime:
    """The time of /clock for devices, while /use_sim_time is true.

    It subscribes as a program of the hub does, so that it comes from wherever it is published.
    """

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._participant: Participant | None = None
        self._now_ns = 0  # as every node of ROS has it before the first message

    def update(self, *, is_wanted: bool) -> None:
        """Begin or end, if that is a change."""
        if is_wanted == (self._participant is not None):
            return
        if self._participant is not None:
            self._participant.leave()
            self._participant = None
            self._hub.links.wall_ns = time.time_ns
            return
        self._now_ns = 0
        self._participant = self._hub.join("ros1 clock")
        self._participant.subscribe(CLOCK, self._receive, type_name=CLOCK_TYPE)
        self._hub.links.wall_ns = self._read_ns

    def _read_ns(self) -> int:
        return self._now_ns

    def _receive(self, message: Message) -> None:
        now_ns = decode_clock(message.payload)
        if now_ns is not None:
            self._now_ns = now_ns
