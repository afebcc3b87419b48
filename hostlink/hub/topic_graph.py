"""TopicGraph: every topic by name, who publishes it, who subscribes to it, which devices take it."""

import itertools
import time
from collections.abc import Callable, Hashable, Iterable
from typing import NamedTuple

from hostlink.errors import HostlinkError, UnknownTopic, WrongType
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import Message
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType

Deliver = Callable[[Message], None]
Unsubscribe = Callable[[], None]
SendToDevice = Callable[[bytes], None]

DAEMON = "hostlink"  # the key of what the daemon itself publishes
_CLIENT_RANK, _DAEMON_RANK, _DEVICE_RANK = range(3)  # whose word on the type of a topic goes before another's


def resolve(name: str) -> str:
    """The full name of a topic or service: `odom`, `/odom` and `~odom` are one."""
    return "/" + name.lstrip("/~")


class Subscriber(NamedTuple):
    """Somebody who hears a topic, and the type that he expects, if he says."""

    deliver: Deliver
    key: Hashable
    type_name: str


class Topic:
    """One name in the graph. Whoever publishes or takes it is known by a key: a link, or the name of a client."""

    def __init__(self, name: str, isolation: Isolation) -> None:
        self.name = name
        self._isolation = isolation
        self.type_name = ""  # until somebody says
        self.type: MessageType | None = None
        self.rank = _CLIENT_RANK  # of who said the type
        self.messages = 0
        self.publishers: set[Hashable] = set()
        self._subscribers: dict[int, Subscriber] = {}
        self._numbers = itertools.count()
        self._expected: dict[str, int] = {}  # how many subscribers expect each type
        self._snapshot: tuple[Subscriber, ...] | None = ()  # None: to be made anew, as a message comes
        self.devices: dict[Hashable, SendToDevice] = {}
        self.latched: dict[Hashable, bytes | None] = {}  # by publisher: its last message, for programs that come later

    @property
    def subscribers(self) -> tuple[Subscriber, ...]:
        """Everybody who subscribed, in that order. Who comes or goes costs the same however many there are."""
        if self._snapshot is None:
            self._snapshot = tuple(self._subscribers.values())
        return self._snapshot

    def add_subscriber(self, subscriber: Subscriber) -> int:
        """Returns the number by which it is removed."""
        number = next(self._numbers)
        self._subscribers[number], self._snapshot = subscriber, None
        if subscriber.type_name:
            self._expected[subscriber.type_name] = self._expected.get(subscriber.type_name, 0) + 1
        return number

    def remove_subscriber(self, number: int) -> None:
        """It may be gone already."""
        gone = self._subscribers.pop(number, None)
        self._snapshot = None
        if gone is not None and gone.type_name:
            self._expected[gone.type_name] -= 1
            if not self._expected[gone.type_name]:
                del self._expected[gone.type_name]

    @property
    def expected_type(self) -> str:
        """What those who subscribed take it for, the first who said; empty: nobody did."""
        return next(iter(self._expected), "")

    @property
    def is_used(self) -> bool:
        """Whether anybody still means this topic."""
        return bool(self.publishers or self._subscribers or self.devices)

    @property
    def is_heard(self) -> bool:
        """Whether a message would reach anybody."""
        return bool(self._subscribers or self.devices)

    @property
    def has_device_publisher(self) -> bool:
        """Whether a device publishes it."""
        return any(_rank(key) == _DEVICE_RANK for key in self.publishers)

    @property
    def highest_rank(self) -> int:
        """Of who publishes or takes it; a device is mostly the first that is looked at."""
        owners = itertools.chain(self.devices, self.publishers)
        if any(not isinstance(key, str) for key in owners):
            return _DEVICE_RANK
        return _DAEMON_RANK if DAEMON in self.publishers or DAEMON in self.devices else _CLIENT_RANK

    def forget_publisher(self, key: Hashable) -> None:
        """`key` publishes no more."""
        self.publishers.discard(key)
        self.latched.pop(key, None)

    def publish(self, payload: bytes, stamp_ns: int, *, source: Hashable) -> None:
        """Hand a payload to every device and client but its source; raises the last error of a device afterwards."""
        refusal: HostlinkError | None = None
        if source in self.latched:
            self.latched[source] = payload
        for key, send in self.devices.items():
            if key is not source:
                try:
                    send(payload)
                except HostlinkError as error:
                    refusal = error
        self.deliver(payload, stamp_ns)
        if refusal is not None:
            raise refusal

    def deliver(self, payload: bytes, stamp_ns: int) -> None:
        """Hand a payload to everybody who subscribed."""
        self.messages += 1
        if self.subscribers:
            message = Message(self.name, self.type_name, self.type, payload, stamp_ns)
            for subscriber in self.subscribers:
                try:
                    subscriber.deliver(message)
                except Exception as error:  # noqa: BLE001 - a subscriber's crash is neither the device's nor another's
                    self._remove(subscriber)
                    self._isolation.crashed("subscriber", error, topic=self.name, subscriber=str(subscriber.key))

    def _remove(self, subscriber: Subscriber) -> None:
        for number, other in list(self._subscribers.items()):
            if other is subscriber:
                self.remove_subscriber(number)


class TopicGraph:
    """All topics of all devices and clients. A topic lives as long as somebody uses it."""

    def __init__(self, catalog: Catalog, isolation: Isolation | None = None) -> None:
        self._catalog = catalog
        self._isolation = Isolation(reraises=True) if isolation is None else isolation
        self._topics: dict[str, Topic] = {}
        self._of_key: dict[Hashable, dict[str, Topic]] = {}  # what each publishes or takes, by name

    def all(self) -> list[Topic]:
        """Every topic, by name."""
        return [self._topics[name] for name in sorted(self._topics)]

    def names(self) -> Iterable[str]:
        """Of every topic, in no order."""
        return self._topics.keys()

    def find(self, name: str) -> Topic:
        """The topic of that name; UnknownTopic if nobody uses one."""
        topic = self.find_or_none(name)
        if topic is None:
            raise UnknownTopic("topic", name, self._topics)
        return topic

    def find_or_none(self, name: str) -> Topic | None:
        """The topic of that name, if anybody uses one."""
        return self._topics.get(resolve(name))

    def subscribe(self, name: str, deliver: Deliver, *, type_name: str = "", key: Hashable = DAEMON) -> Unsubscribe:
        """Deliver what was latched, and every message from now on; call what is returned to end it."""
        topic = self._open(name, type_name, _CLIENT_RANK)
        number = topic.add_subscriber(Subscriber(deliver, key, type_name))
        for payload in topic.latched.values():
            if payload is not None:
                deliver(Message(topic.name, topic.type_name, topic.type, payload, time.time_ns()))

        def unsubscribe() -> None:
            topic.remove_subscriber(number)
            self._settle(topic)

        return unsubscribe

    def advertise(self, name: str, key: Hashable, *, type_name: str, is_latched: bool = False) -> Topic:
        """Note that `key` publishes the topic; WrongType if it is in use with another type."""
        topic = self._open(name, type_name, _rank(key))
        topic.publishers.add(key)
        self._note(key, topic)
        if is_latched:
            topic.latched.setdefault(key)
        return topic

    def subscribe_device(self, name: str, key: Hashable, send: SendToDevice, *, type_name: str) -> Topic:
        """Note that the device `key` takes the topic. It gets nothing of before: an old command is no command."""
        topic = self._open(name, type_name, _rank(key))
        topic.devices[key] = send
        self._note(key, topic)
        return topic

    def unadvertise(self, name: str, key: Hashable) -> None:
        """`key` publishes the topic no more."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.forget_publisher(key)
            self._unnote(key, topic)
            self._settle(topic)

    def unsubscribe_device(self, name: str, key: Hashable) -> None:
        """`key` takes the topic no more."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.devices.pop(key, None)
            self._unnote(key, topic)
            self._settle(topic)

    def leave(self, key: Hashable) -> None:
        """`key` is gone: it publishes and takes nothing any more."""
        for topic in self._of_key.pop(key, {}).values():
            topic.forget_publisher(key)
            topic.devices.pop(key, None)
            self._settle(topic)

    def _note(self, key: Hashable, topic: Topic) -> None:
        self._of_key.setdefault(key, {})[topic.name] = topic

    def _unnote(self, key: Hashable, topic: Topic) -> None:
        held = self._of_key.get(key, {})
        if key not in topic.publishers and key not in topic.devices:
            held.pop(topic.name, None)
        if not held:
            self._of_key.pop(key, None)

    def _open(self, name: str, type_name: str, rank: int) -> Topic:
        resolved = resolve(name)
        topic = self._topics.get(resolved) or Topic(resolved, self._isolation)
        type_ = self._catalog.message(type_name) if type_name else None
        plain_name = type_.name if type_ is not None else type_name
        if plain_name and plain_name != topic.type_name:
            if topic.type_name and rank <= topic.rank:
                raise WrongType(resolved, topic.type_name, plain_name)
            for key in [key for key in topic.publishers if _rank(key) < rank]:  # they meant another topic
                topic.forget_publisher(key)
                self._unnote(key, topic)
            topic.type_name, topic.type, topic.rank = plain_name, type_, rank
        elif plain_name:
            topic.rank = max(topic.rank, rank)
        self._topics[resolved] = topic
        return topic

    def _settle(self, topic: Topic) -> None:
        """Somebody left: a topic without users goes, one that is only waited for has the type that is waited for."""
        if self._topics.get(topic.name) is not topic:
            return
        topic.rank = topic.highest_rank
        if not topic.is_used:
            del self._topics[topic.name]
        elif not topic.publishers and not topic.devices:
            wanted = topic.expected_type
            topic.type = self._catalog.message(wanted) if wanted else None
            topic.type_name = wanted if topic.type is None else topic.type.name


def _rank(key: Hashable) -> int:
    if not isinstance(key, str):
        return _DEVICE_RANK
    return _DAEMON_RANK if key == DAEMON else _CLIENT_RANK
