"""TopicGraph: every topic by name; a topic lives as long as somebody uses it."""

import asyncio
from collections.abc import Callable, Hashable, Iterable

from hostlink.errors import UnknownTopic, WrongType
from hostlink.hub.byte_budget import ByteBudget
from hostlink.hub.graph_changes import GraphChanges, GraphKind
from hostlink.hub.topic import DEVICE_RANK, PROGRAM_RANK, Deliveries, DeviceSubscription, Subscriber, Topic, rank_of
from hostlink.messages.catalog import Catalog
from hostlink.robot.admission import EarlierCommands

Unsubscribe = Callable[[], None]


def resolve(name: str) -> str:
    """The full name of a topic or service: `odom`, `/odom` and `~odom` are one."""
    full = "/" + name.lstrip("/~")
    return name if full == name else full  # a thousand robots keep their names once


class TopicGraph:
    """All topics of all devices and participants."""

    def __init__(self, catalog: Catalog, changes: GraphChanges | None = None, budget: ByteBudget | None = None) -> None:
        """`changes` are told of every topic, publisher and subscriber that comes or goes."""
        self.earlier = EarlierCommands()  # who publishes to topics that do not exist, or without being a publisher
        self.deliveries = Deliveries()
        self.budget = ByteBudget() if budget is None else budget
        self._changes = GraphChanges() if changes is None else changes
        self._catalog = catalog
        self._topics: dict[str, Topic] = {}
        self._of_key: dict[Hashable, dict[str, Topic]] = {}  # what each publishes, or subscribes as a device

    def all(self) -> list[Topic]:
        """Every topic, by name."""
        return [self._topics[name] for name in sorted(self._topics)]

    def names(self) -> Iterable[str]:
        """Of every topic, in no order."""
        return self._topics.keys()

    def find(self, name: str) -> Topic:
        """The topic of that name.

        Raises:
            UnknownTopic: nobody uses one.
        """
        topic = self.find_or_none(name)
        if topic is None:
            raise UnknownTopic("topic", name, self._topics)
        return topic

    def find_or_none(self, name: str) -> Topic | None:
        """The topic of that name, if anybody uses one."""
        return self._topics.get(resolve(name))

    def subscribe(self, name: str, subscriber: Subscriber) -> Unsubscribe:
        """Deliver what was latched, and every message from now on; call what is returned to end it.

        Raises:
            WrongType: it is in use with another type.
        """
        topic = self._open(name, subscriber.type_name, PROGRAM_RANK)
        number = topic.add_subscriber(subscriber)
        try:
            topic.deliver_latched(subscriber)
        except Exception as error:  # noqa: BLE001 - as with every later message
            subscriber.fail(error)

        def unsubscribe() -> None:
            topic.remove_subscriber(number)
            self._settle(topic)

        return unsubscribe

    def advertise(self, name: str, key: Hashable, *, type_name: str, is_latched: bool = False) -> Topic:
        """Note that `key` publishes the topic.

        Raises:
            WrongType: it is in use with another type.
        """
        topic = self._open(name, type_name, rank_of(key))
        topic.publishers.add(key)
        self._note(key, topic)
        if is_latched:
            topic.latched.setdefault(key)
        return topic

    def subscribe_device(self, name: str, key: Hashable, subscription: DeviceSubscription, *, type_name: str) -> Topic:
        """Note that the device `key` subscribes, and send it what was latched, but for commands.

        Raises:
            WrongType: it is in use with another type.
        """
        topic = self._open(name, type_name, rank_of(key))
        if not self.earlier.is_empty:
            topic.earlier = self.earlier.sources(topic.name, asyncio.get_running_loop().time())
        topic.add_device(key, subscription)
        self._note(key, topic)
        topic.send_latched(key)
        return topic

    def send_latched(self, key: Hashable) -> None:
        """Send the device `key` again what was latched of the topics to which it subscribes: it may have restarted."""
        for topic in list(self._of_key.get(key, {}).values()):
            topic.send_latched(key)

    def unadvertise(self, name: str, key: Hashable) -> None:
        """`key` publishes the topic no more."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.forget_publisher(key)
            self._unnote(key, topic)
            self._settle(topic)

    def unsubscribe_device(self, name: str, key: Hashable) -> None:
        """The device `key` subscribes no more."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.remove_device(key)
            self._unnote(key, topic)
            self._settle(topic)

    def leave(self, key: Hashable) -> None:
        """`key` publishes no more, and is no device any more."""
        for topic in self._of_key.pop(key, {}).values():
            topic.forget_publisher(key)
            topic.remove_device(key)
            self._settle(topic)

    def devices_against(self, name: str, type_name: str) -> set[Hashable]:
        """The links that use a topic with another type than this."""
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

    def _open(self, name: str, type_name: str, rank: int) -> Topic:
        resolved = resolve(name)
        topic = self._topics.get(resolved) or Topic(resolved, self.deliveries, self.budget)
        type_ = self._catalog.message(type_name) if type_name else None
        plain_name = type_.name if type_ is not None else type_name
        if plain_name and plain_name != topic.type_name:
            if topic.type_name and rank <= topic.rank:
                raise WrongType(resolved, topic.type_name, plain_name)
            for key in [key for key in topic.publishers if rank_of(key) < rank]:  # they meant another topic
                topic.forget_publisher(key)
                self._unnote(key, topic)
            topic.type_name, topic.type, topic.rank = plain_name, type_, rank
        elif plain_name:
            topic.rank = max(topic.rank, rank)
        self._topics[resolved] = topic
        self._changes.note(GraphKind.TOPIC, resolved)
        return topic

    def _settle(self, topic: Topic) -> None:
        """Somebody left: a topic without users goes; one that has subscribers alone has the type that they expect."""
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
