"""FleetTopics: the topics of robots, both ways: those here for other daemons, and theirs in the graph here."""

from hostlink.errors import BadPayload
from hostlink.graphs.zenoh.fleet_drivers import FleetDrivers
from hostlink.graphs.zenoh.fleet_exports import FleetExports
from hostlink.graphs.zenoh.fleet_imports import FleetImports
from hostlink.graphs.zenoh.fleet_messages import Topics, TopicState, decode
from hostlink.graphs.zenoh.fleet_post import GROUP, Post
from hostlink.graphs.zenoh.roster import Neighbour, Roster
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.hub.robot import RemoteRobot

TOPICS_TIMEOUT_S = 2.0


class FleetTopics:
    """A daemon's list of topics has a number, which comes with its state; the list is fetched when that changes."""

    def __init__(self, hub: Hub, post: Post, drivers: FleetDrivers, roster: Roster) -> None:
        self.exports = FleetExports(hub, post, drivers, roster)
        self._hub, self._post, self._roster = hub, post, roster
        self._imports = FleetImports(hub, post)
        self._participant = hub.join("fleet", role=Role.READ, group=GROUP)
        self._lists: dict[str, dict[str, list[TopicState]]] = {}  # by daemon and robot
        self._fetching: set[str] = set()

    def begin(self) -> None:
        """Follow the graph from now on."""
        self._participant.watch_graph(self._update)

    def end(self) -> None:
        """Share nothing any more."""
        self._participant.leave()
        self._imports.hide_all()
        self.exports.close()

    def show(self, robot: RemoteRobot, neighbour: Neighbour) -> None:
        """Put the robot's topics into the graph, as far as they are known."""
        topics = self._lists.get(neighbour.sender.zid, {}).get(robot.name)
        if topics is not None:
            self._imports.show(robot, neighbour, topics)

    def hide(self, name: str) -> None:
        """A robot's topics are no more."""
        self._imports.hide(name)

    def lose(self, zid: str) -> None:
        """A daemon is gone."""
        self._lists.pop(zid, None)

    async def fetch(self, neighbour: Neighbour, number: int) -> bool:
        """Fetch a daemon's list; returns whether it came. Without an answer the next state is the next try."""
        sender = neighbour.sender
        if sender.zid in self._fetching:
            return False
        self._fetching.add(sender.zid)
        try:
            answers = await self._post.session.get(self._post.keys.key("topics", sender), timeout_s=TOPICS_TIMEOUT_S)
        finally:
            self._fetching.discard(sender.zid)
        if not answers or self._roster.find(sender) is not neighbour:
            return False
        try:
            listed = decode(answers[0].payload, Topics)
        except BadPayload:
            self._post.counts["malformed"] += 1
            return False
        neighbour.topics = number
        by_robot: dict[str, list[TopicState]] = {name: [] for name in neighbour.robots}
        for topic in listed.topics:
            by_robot.setdefault(topic.robot, []).append(topic)
        self._lists[sender.zid] = by_robot
        return True

    def demand(self) -> None:
        """Subscribe elsewhere what is subscribed here."""
        self._imports.update(self._participant.graph().topics)

    def _update(self) -> None:
        topics = self._participant.graph().topics
        self.exports.update(topics)
        self._imports.update(topics)
