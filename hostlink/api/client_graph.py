"""ClientGraph: the graph as a client sees it that is no member of its group: a bridge to another graph."""

from typing import TypedDict

import msgspec

from hostlink.api.outgoing import ClientQueue, Outgoing
from hostlink.api.request import Request
from hostlink.hub.graph_view import Graph, GraphTopic
from hostlink.hub.participant import Participant
from hostlink.hub.robot import LocalRobot
from hostlink.hub.robot_topic_publisher import command_topics
from hostlink.hub.robots import Robots
from hostlink.hub.topic_graph import resolve
from hostlink.robot.velocity import TWIST_TYPE


class GraphTopicView(TypedDict):
    """A topic, with what others than the group do with it."""

    name: str
    type: str
    published: bool
    subscribed: bool
    latched: bool
    velocity: bool


class GraphServiceView(TypedDict):
    """A service."""

    name: str
    type: str


class GraphRobotView(TypedDict):
    """A robot of this daemon, and the topics that drive it; `link` is null while its device is not connected."""

    name: str
    link: int | None
    velocity_topics: dict[str, str]  # types by name


class ClientGraph:
    """Sends the whole graph after each change; the daemon notes changes every 50 ms at most."""

    def __init__(self, participant: Participant, robots: Robots, queue: ClientQueue) -> None:
        self._participant, self._robots, self._queue = participant, robots, queue
        self._sent = b""

    def watch(self, _: Request) -> None:
        """Send `graph` now and after every change.

        Raises:
            BadRequest: it has left.
        """
        self._sent = b""
        self._participant.watch_graph(self._send)

    def _send(self) -> None:
        graph = self._participant.graph()
        data = msgspec.json.encode({"op": "graph", **graph_view(graph), "robots": self._robot_views(graph)})
        if data != self._sent:
            self._sent = data
            self._queue.put_result(Outgoing(data))

    def _robot_views(self, graph: Graph) -> list[GraphRobotView]:
        gated = {topic.name for topic in graph.topics if topic.is_velocity}
        return [
            {
                "name": robot.name,
                "link": None if robot.link is None else robot.link.number,
                "velocity_topics": _velocity_topics(robot, gated),
            }
            for robot in self._robots.here()
        ]


def graph_view(graph: Graph) -> dict[str, object]:
    """Topics and services."""
    services: list[GraphServiceView] = [{"name": each.name, "type": each.type_name} for each in graph.services]
    return {"topics": [_topic_view(topic) for topic in graph.topics], "services": services}


def _topic_view(topic: GraphTopic) -> GraphTopicView:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "published": topic.is_published,
        "subscribed": topic.is_subscribed,
        "latched": topic.is_latched,
        "velocity": topic.is_velocity,
    }


def _velocity_topics(robot: LocalRobot, gated: set[str]) -> dict[str, str]:
    named = {resolve(name): type_name for name, type_name in command_topics(robot).items() if name}
    topics = {robot.shown.velocity: TWIST_TYPE} | named
    return {name: type_name for name, type_name in topics.items() if name in gated}
