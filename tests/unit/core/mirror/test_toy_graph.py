"""A new graph is one adapter of the mirror: this file holds a graph with JSON messages, and its adapter."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.graph_view import GraphTopic
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.message import Message
from hostlink.core.hub.participant import Participant
from hostlink.core.mirror.inbox import ThreadInbox
from hostlink.core.mirror.log_once import LogOnce
from hostlink.core.mirror.mirror import Mirror
from hostlink.errors import HostlinkError
from tests.support.fake_device import CATALOG
from tests.support.participants import text
from tests.support.virtual_loop import run_virtual

STRING = "std_msgs/String"


class ToyGraph:
    """Another graph: its programs publish and read JSON on topics."""

    def __init__(self) -> None:
        self.publishers: dict[str, str] = {}  # types of the topics that programs of this graph publish
        self.readers: dict[str, Callable[[str], None]] = {}  # of what programs of this graph publish
        self.received: list[tuple[str, str]] = []  # by programs of this graph, from hostlink
        self.on_change: Callable[[], None] = lambda: None


# -- the adapter ------------------------------------------------------------------------------------------------------


class ToyBridge:
    """Adapter of the toy graph. It lists topics, opens and closes endpoints, and converts payloads."""

    def __init__(self, hub: Hub, graph: ToyGraph) -> None:
        self._hub, self._graph, self._log_once = hub, graph, LogOnce()
        self._node = hub.join("toy", group="toy")  # what the group publishes is not sent back to it
        self._to_toy = Mirror[str, GraphTopic, ToToy](
            lambda _, topic: ToToy(self._node, graph, topic), self._fail, limit=100
        )
        self._from_toy = Mirror[str, str, FromToy](
            lambda name, type_name: FromToy(self._node, graph, name, type_name), self._fail, limit=100, retry_s=1.0
        )
        self._node.watch_graph(self._list)
        graph.on_change = self._list

    def _list(self) -> None:
        """One of the graphs has changed: want what it has now."""
        self._to_toy.want({each.name: each for each in self._node.graph().topics if each.is_published and each.type})
        self._from_toy.want(dict(self._graph.publishers))

    def _fail(self, name: str, error: Exception) -> None:
        if isinstance(error, HostlinkError):
            self._log_once("ros2.topic_refused", name=name, reason=str(error))
        else:
            self._hub.isolation.crashed("graph", error, graph="toy")

    def close(self) -> None:
        """Leave both graphs."""
        self._to_toy.close()
        self._from_toy.close()
        self._node.leave()


class ToToy:
    """Endpoint for a topic that the hub has: a subscription in the hub."""

    def __init__(self, node: Participant, graph: ToyGraph, topic: GraphTopic) -> None:
        self._graph, self._type = graph, node.message_type(topic.name)
        self.close = node.subscribe(topic.name, self._send).close

    def _send(self, message: Message) -> None:
        self._graph.received.append((message.topic, json.dumps(self._type.decode(message.payload))))


class FromToy:
    """Endpoint for a topic that the toy graph has: a publisher in the hub, fed from the other graph's thread."""

    def __init__(self, node: Participant, graph: ToyGraph, name: str, type_name: str) -> None:
        self._node, self._graph, self._name = node, graph, name
        node.advertise(name, type_name)
        encode = node.message_type(name).encode
        self._inbox = ThreadInbox[str](lambda text: node.publish(name, encode(json.loads(text))), max_waiting=16)
        graph.readers[name] = lambda text: self._inbox.put(name, text)

    def close(self) -> None:
        """Withdraw the topic."""
        del self._graph.readers[self._name]
        self._inbox.close()
        self._node.unadvertise(self._name)


# -- what the mirror does with it -------------------------------------------------------------------------------------


def with_toy(test: Callable[[Hub, ToyGraph, ToyBridge], Any]) -> None:
    async def run() -> None:
        hub, graph = Hub(Config(), CATALOG, reraises=True), ToyGraph()
        bridge = ToyBridge(hub, graph)
        await test(hub, graph, bridge)
        bridge.close()
        assert graph.readers == {}
        assert all(not topic.publishers for topic in hub.topics.all() if topic.name.startswith("/toy"))

    run_virtual(run())


def test_toy_graph_receives_topic_of_hub_until_publisher_leaves() -> None:
    async def test(hub: Hub, graph: ToyGraph, _: ToyBridge) -> None:
        program = hub.join("program")
        program.advertise("/chatter", STRING)
        await asyncio.sleep(0.1)
        program.publish("/chatter", text("one"))
        program.leave()
        await asyncio.sleep(0.1)
        hub.join("another program").subscribe("/chatter", lambda _: None)
        assert graph.received == [("/chatter", '{"data": "one"}')]
        assert "/chatter" not in {topic.name for topic in hub.topics.all() if topic.publishers}

    with_toy(test)


def test_hub_receives_topic_of_toy_graph_until_it_is_withdrawn() -> None:
    async def test(hub: Hub, graph: ToyGraph, _: ToyBridge) -> None:
        received: list[bytes] = []
        hub.join("program").subscribe("/toy/text", lambda message: received.append(message.payload))
        graph.publishers["/toy/text"] = STRING
        graph.on_change()
        graph.readers["/toy/text"]('{"data": "hello"}')
        await asyncio.sleep(0.1)
        assert received == [text("hello")]
        del graph.publishers["/toy/text"]
        graph.on_change()
        assert graph.readers == {}

    with_toy(test)


def test_refused_topic_of_toy_graph_is_logged_once_and_opened_when_it_fits() -> None:
    async def test(hub: Hub, graph: ToyGraph, _: ToyBridge) -> None:
        program = hub.join("program")
        program.advertise("/toy/text", "std_msgs/Bool")
        graph.publishers |= {"/toy/text": STRING, "/toy/other": STRING}
        with capture_logs() as logs:
            graph.on_change()
            await asyncio.sleep(3.0)
        assert [line["name"] for line in logs] == ["/toy/text"]
        assert set(graph.readers) == {"/toy/other"}
        program.leave()
        await asyncio.sleep(5.0)
        assert set(graph.readers) == {"/toy/other", "/toy/text"}

    with_toy(test)
