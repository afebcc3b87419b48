"""TopicGraph: all topics by name. A topic exists as long as it has a publisher or subscriber."""

import asyncio
import time
from collections.abc import Callable, Hashable, Iterable

from hostlink.core.hub.byte_budget import ByteBudget
from hostlink.core.hub.graph_changes import GraphChanges, GraphKind
from hostlink.core.hub.topic import DEVICE_RANK, PROGRAM_RANK, Deliveries, DeviceSubscription, Listener, Topic, rank_of
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.serialisation import ROS1
from hostlink.core.robot.admission import EarlierCommands
from hostlink.errors import UnknownTopic, WrongType


def resolve(name: str) -> str:
    """Return the full name of a topic or service: `odom`, `/odom` and `~odom` are one."""
    full = "/" + name.lstrip("/~")
    return name if full == name else full  # a thousand robots keep their names once


class TopicGraph:
    """All topics of devices and participants."""

    def __init__(
        self,
        catalog: Catalog,
        changes: GraphChanges | None = None,
        budget: ByteBudget | None = None,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """`changes` is notified of every added and removed topic, publisher and subscriber.

        `wall_ns` returns the time of day for the stamps of messages.
        """
        self._wall_ns = wall_ns
        self.earlier = EarlierCommands()  # publishers of topics that do not exist, or without `advertise`
        self.deliveries = Deliveries()
        self.budget = ByteBudget() if budget is None else budget
        self._changes = GraphChanges() if changes is None else changes
        self._catalog = catalog
        self._topics: dict[str, Topic] = {}
        self._of_key: dict[Hashable, dict[str, Topic]] = {}  # topics of each publisher and device

    def all(self) -> list[Topic]:
        """Return all topics, by name."""
        return [self._topics[name] for name in sorted(self._topics)]

    def names(self) -> Iterable[str]:
        """Return the names of all topics, in no order."""
        return self._topics.keys()

    def find(self, name: str) -> Topic:
        """Return the topic of this name.

        Raises:
            UnknownTopic: it does not exist.
        """
        topic = self.find_or_none(name)
        if topic is None:
            raise UnknownTopic("topic", name, self._topics)
        return topic

    def find_or_none(self, name: str) -> Topic | None:
        """Return the topic of this name; None if it does not exist."""
        return self._topics.get(resolve(name))

    def subscribe(self, name: str, subscriber: Listener) -> tuple[Topic, int]:
        """Add a subscriber, and deliver latched messages to it. Return the arguments for `unsubscribe`.

        Raises:
            WrongType: the topic is in use with another type.
        """
        topic = self._open(name, subscriber.type_name, PROGRAM_RANK, None)
        number = topic.add_subscriber(subscriber)
        try:
            topic.deliver_latched(subscriber)
        except Exception as error:  # noqa: BLE001 - as for every later message
            subscriber.fail(error)
        return topic, number

    def unsubscribe(self, topic: Topic, number: int) -> None:
        """Remove the subscriber that has this number at the topic. Do nothing if it was removed already."""
        topic.remove_subscriber(number)
        self._settle(topic)

    def advertise(
        self, name: str, key: Hashable, *, type_name: str, is_latched: bool = False, raw_encoding: str = ROS1
    ) -> Topic:
        """Add `key` as a publisher of the topic. `raw_encoding`: that of its messages if the type has no definition.

        Raises:
            WrongType: the topic is in use with another type or encoding.
        """
        topic = self._open(name, type_name, rank_of(key), raw_encoding)
        topic.add_publisher(key)
        self._note(key, topic)
        if is_latched:
            topic.latched.setdefault(key)
        return topic

    def subscribe_device(
        self,
        name: str,
        key: Hashable,
        subscription: DeviceSubscription,
        *,
        type_name: str,
        raw_encoding: str = ROS1,
    ) -> Topic:
        """Add the device `key` as a subscriber, and send it latched messages unless they are commands.

        `raw_encoding` is that of the messages which it takes if the type has no definition.

        Raises:
            WrongType: the topic is in use with another type or encoding.
        """
        topic = self._open(name, type_name, rank_of(key), raw_encoding)
        if not self.earlier.is_empty:
            topic.earlier = self.earlier.sources(topic.name, asyncio.get_running_loop().time())
        topic.add_device(key, subscription)
        self._note(key, topic)
        topic.send_latched(key)
        return topic

    def send_latched(self, key: Hashable) -> None:
        """Send latched messages of its topics to the device `key` again: it may have restarted."""
        for topic in list(self._of_key.get(key, {}).values()):
            topic.send_latched(key)

    def unadvertise(self, name: str, key: Hashable) -> None:
        """Remove `key` as a publisher of the topic."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.forget_publisher(key)
            self._unnote(key, topic)
            self._settle(topic)

    def unsubscribe_device(self, name: str, key: Hashable) -> None:
        """Remove the device `key` as a subscriber."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.remove_device(key)
            self._unnote(key, topic)
            self._settle(topic)

    def leave(self, key: Hashable) -> None:
        """Remove `key` from all topics, as publisher and device."""
        for topic in self._of_key.pop(key, {}).values():
            topic.forget_publisher(key)
            topic.remove_device(key)
            self._settle(topic)

    def devices_against(self, name: str, type_name: str) -> set[Hashable]:
        """Return the links that use a topic with another type than this."""
        topic = self.find_or_none(name)
        if topic is None or topic.type_name == type_name:
            return set()
        return {key for key in (*topic.publishers, *topic.devices) if rank_of(key) == DEVICE_RANK}

    def _note(self, key: Hashable, topic: Topic) -> None:
        self._of_key.setdefault(key, {})[topic.name] = topic

    def _unnote(self, key: Hashable, topic: Topic) -> None:
        used = self._of_key.get(key, {})
        if key not in topic.publishers and key not in topic.devices:
            used.pop(topic.name, None)
        if not used:
            self._of_key.pop(key, None)

    def _open(self, name: str, type_name: str, rank: int, raw_encoding: str | None) -> Topic:
        """Return the topic of a name for a user with this type. `raw_encoding`: None for one that takes either."""
        resolved = resolve(name)
        topic = self._topics.get(resolved) or Topic(resolved, self.deliveries, self.budget, self._wall_ns)
        type_ = self._catalog.message(type_name) if type_name else None
        plain_name = type_.name if type_ is not None else type_name
        encoding = ROS1 if type_ is not None else raw_encoding or topic.encoding
        if plain_name and (plain_name != topic.type_name or encoding != topic.encoding):
            if topic.type_name and rank <= topic.rank:
                if plain_name == topic.type_name:
                    raise WrongType(resolved, f"{plain_name} as {topic.encoding}", f"{plain_name} as {encoding}")
                raise WrongType(resolved, topic.type_name, plain_name)
            for key in [key for key in topic.publishers if rank_of(key) < rank]:  # they publish another type
                topic.forget_publisher(key)
                self._unnote(key, topic)
            topic.type_name, topic.type, topic.encoding, topic.rank = plain_name, type_, encoding, rank
        elif plain_name:
            topic.rank = max(topic.rank, rank)
        self._topics[resolved] = topic
        self._changes.note(GraphKind.TOPIC, resolved)
        return topic

    def _settle(self, topic: Topic) -> None:
        """Remove a topic without users. With subscribers only, give it the type that they expect."""
        if self._topics.get(topic.name) is not topic:
            return
        self._changes.note(GraphKind.TOPIC, topic.name)
        topic.rank = topic.highest_rank
        if not topic.is_used:
            del self._topics[topic.name]
        elif not topic.publishers and not topic.devices:
            expected = topic.expected_type
            topic.type = self._catalog.message(expected) if expected else None
            topic.type_name = expected if topic.type is None else topic.type.name
            topic.encoding = ROS1
