"""Subscription: one topic that somebody here subscribes to, from each node of ROS that publishes it."""

from collections.abc import Iterable

from hostlink.graphs.ros1.parts import Parts, Spawned
from hostlink.graphs.ros1.publisher import Publisher
from hostlink.hub.graph import GraphTopic
from hostlink.logs import printable

MAX_PUBLISHERS = 64  # of one topic


class Subscription:
    """It keeps a connection to each publisher that the master names. Its own node is none of them."""

    def __init__(self, parts: Parts, topic: GraphTopic, name: str) -> None:
        """`name`: of the topic in ROS."""
        self.topic, self.name = topic, name
        self.publishers: dict[str, Publisher] = {}  # by where their slave API answers
        self._parts = parts
        self._tasks: dict[str, Spawned] = {}
        self._is_registered = False

    def add(self, uris: Iterable[str]) -> None:
        """The master has answered the registration: these publish, and may have done so for long.

        A master that has begun anew knows few of them; the others are still connected.
        """
        for uri in uris:
            self._add(uri, is_new=self._is_registered)
        self._is_registered = True

    def update(self, uris: list[str]) -> None:
        """The master reports who publishes from now on: those that came have just begun."""
        for uri in [uri for uri in self.publishers if uri not in uris]:
            self._remove(uri)
        for uri in uris:
            self._add(uri, is_new=self._is_registered)

    def close(self) -> None:
        """Nobody here subscribes any more."""
        for uri in list(self.publishers):
            self._remove(uri)

    def _add(self, uri: str, *, is_new: bool) -> None:
        if uri == self._parts.uri or uri in self.publishers:
            return
        if len(self.publishers) >= MAX_PUBLISHERS or len(self._parts.publishers) >= self._parts.max_publishers:
            self._parts.counts.crowded_out += 1
            return
        publisher = self.publishers[uri] = Publisher(self._parts, self.topic, self.name, uri, is_new=is_new)
        self._parts.publishers.add(publisher)
        name = f"ROS 1 publisher {printable(uri)}"
        self._tasks[uri] = self._parts.spawn(publisher.run(), name=name)

    def _remove(self, uri: str) -> None:
        publisher = self.publishers.pop(uri)
        self._parts.publishers.discard(publisher)
        publisher.close()
        self._tasks.pop(uri).cancel()
