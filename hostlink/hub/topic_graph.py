"""TopicGraph: every topic by name, who publishes it, who subscribes to it."""

import asyncio
import itertools
import time
from collections.abc import Callable, Hashable, Iterable
from typing import NamedTuple

from hostlink.errors import HostlinkError, UnknownTopic, WrongType
from hostlink.hub.message import PROGRAM_PRIORITY, Message
from hostlink.hub.node import Node
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType

Receive = Callable[[Message], None]
Unsubscribe = Callable[[], None]

_PROGRAM_RANK, _DAEMON_RANK, _DEVICE_RANK = range(3)  # whose type of a topic precedes another's


def resolve(name: str) -> str:
    """The full name of a topic or service: `odom`, `/odom` and `~odom` are one."""
    return "/" + name.lstrip("/~")


class Subscriber(NamedTuple):
    """Who receives the messages of a topic, and the type that it expects, if it names one."""

    receive: Receive
    key: Hashable
    type_name: str
    fail: Callable[[Exception], None]  # ends what the callback belongs to


class DeviceSubscription(NamedTuple):
    """A device's end of a topic: its link, or the gate before it. `receive` raises what refuses a message."""

    receive: Receive
    is_gate: bool


class Topic:
    """One name in the graph. Whoever publishes or subscribes is known by a key: a link, or a Node.

    Where a velocity gate subscribes, messages go to the gates alone; what they send to their devices is delivered to
    the other subscribers.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.type_name = ""  # until somebody names it
        self.type: MessageType | None = None
        self.rank = _PROGRAM_RANK  # of who named the type
        self.messages = 0
        self.publishers: set[Hashable] = set()
        self.devices: dict[Hashable, DeviceSubscription] = {}
        self.latched: dict[Hashable, bytes | None] = {}  # by publisher: its last message, for later subscribers
        self._subscribers: dict[int, Subscriber] = {}
        self._numbers = itertools.count()
        self._expected: dict[str, int] = {}  # how many subscribers expect each type
        self._snapshot: tuple[Subscriber, ...] | None = ()  # None: to be made anew, as a message comes
        self._is_gated = False

    @property
    def subscribers(self) -> tuple[Subscriber, ...]:
        """Every subscriber that is no device, oldest first. One that comes or leaves costs the same among many."""
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
        """It may be removed already."""
        gone = self._subscribers.pop(number, None)
        self._snapshot = None
        if gone is not None and gone.type_name:
            self._expected[gone.type_name] -= 1
            if not self._expected[gone.type_name]:
                del self._expected[gone.type_name]

    def add_device(self, key: Hashable, subscription: DeviceSubscription) -> None:
        """A device, or a gate, subscribes."""
        self.devices[key] = subscription
        self._is_gated = any(each.is_gate for each in self.devices.values())

    def remove_device(self, key: Hashable) -> None:
        """It may be removed already."""
        self.devices.pop(key, None)
        self._is_gated = any(each.is_gate for each in self.devices.values())

    @property
    def expected_type(self) -> str:
        """The type that the first subscriber expects that named one; empty: none did."""
        return next(iter(self._expected), "")

    @property
    def is_used(self) -> bool:
        """Whether anybody publishes or subscribes."""
        return bool(self.publishers or self._subscribers or self.devices)

    @property
    def has_subscribers(self) -> bool:
        """Whether a message would reach anybody."""
        return bool(self._subscribers or self.devices)

    @property
    def has_device_publisher(self) -> bool:
        """Whether a device publishes it."""
        return any(_rank(key) == _DEVICE_RANK for key in self.publishers)

    @property
    def highest_rank(self) -> int:
        """Of its publishers and devices; a device mostly comes first."""
        ranks = map(_rank, itertools.chain(self.devices, self.publishers))
        highest = _PROGRAM_RANK
        for rank in ranks:
            highest = max(highest, rank)
            if highest == _DEVICE_RANK:
                break
        return highest

    def forget_publisher(self, key: Hashable) -> None:
        """`key` publishes no more."""
        self.publishers.discard(key)
        self.latched.pop(key, None)

    def publish(
        self,
        payload: bytes,
        *,
        source: Hashable,
        at_s: float | None = None,
        priority: int = PROGRAM_PRIORITY,
    ) -> None:
        """Pass a payload to every device and subscriber but its source. `at_s`: loop time of its arrival, if not now.

        Raises:
            HostlinkError: a device, or its gate, refused it; all others have it.
        """
        if self.latched and source in self.latched:
            self.latched[source] = payload
        if not self._subscribers and not self.devices:
            self.messages += 1
            return
        message = self._message(payload, source, asyncio.get_running_loop().time() if at_s is None else at_s, priority)
        refusal = self._pass_to_devices(message) if self.devices else None
        if not self._is_gated:
            self._dispatch(message)
        if refusal is not None:
            raise refusal

    def deliver(self, payload: bytes, *, source: Hashable, at_s: float) -> None:
        """Pass a payload to every subscriber, and to no device."""
        if self._subscribers:
            self._dispatch(self._message(payload, source, at_s, PROGRAM_PRIORITY))
        else:
            self.messages += 1

    def _message(self, payload: bytes, source: Hashable, at_s: float, priority: int) -> Message:
        return Message(
            self.name,
            self.type_name,
            self.type,
            payload,
            source=source,
            stamp_ns=time.time_ns(),
            at_s=at_s,
            priority=priority,
        )

    def _pass_to_devices(self, message: Message) -> HostlinkError | None:
        refusal = None
        for key, device in list(self.devices.items()):
            if key is not message.source:
                try:
                    device.receive(message)
                except HostlinkError as error:
                    refusal = error
        return refusal

    def _dispatch(self, message: Message) -> None:
        self.messages += 1
        for subscriber in self.subscribers:
            try:
                subscriber.receive(message)
            except Exception as error:  # noqa: BLE001 - a subscriber's crash is neither the device's nor another's
                self._remove(subscriber)
                subscriber.fail(error)

    def _remove(self, subscriber: Subscriber) -> None:
        for number, other in list(self._subscribers.items()):
            if other is subscriber:
                self.remove_subscriber(number)

    def deliver_latched(self, subscriber: Subscriber) -> None:
        """Pass the last message of every publisher that latches; raises what the subscriber's callback raises."""
        at_s = asyncio.get_running_loop().time() if self.latched else 0.0
        for source, payload in self.latched.items():
            if payload is not None:
                subscriber.receive(self._message(payload, source, at_s, PROGRAM_PRIORITY))


class TopicGraph:
    """All topics of all devices and participants. A topic lives as long as somebody uses it."""

    def __init__(self, catalog: Catalog) -> None:
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
        topic = self._open(name, subscriber.type_name, _PROGRAM_RANK)
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
        topic = self._open(name, type_name, _rank(key))
        topic.publishers.add(key)
        self._note(key, topic)
        if is_latched:
            topic.latched.setdefault(key)
        return topic

    def subscribe_device(self, name: str, key: Hashable, subscription: DeviceSubscription, *, type_name: str) -> Topic:
        """Note that the device `key` subscribes, and not to what was latched: an old command is no command.

        Raises:
            WrongType: it is in use with another type.
        """
        topic = self._open(name, type_name, _rank(key))
        topic.add_device(key, subscription)
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
        topic = self._topics.get(resolved) or Topic(resolved)
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
        """Somebody left: a topic without users goes; one that has subscribers alone has the type that they expect."""
        if self._topics.get(topic.name) is not topic:
            return
        topic.rank = topic.highest_rank
        if not topic.is_used:
            del self._topics[topic.name]
        elif not topic.publishers and not topic.devices:
            expected = topic.expected_type
            topic.type = self._catalog.message(expected) if expected else None
            topic.type_name = expected if topic.type is None else topic.type.name


def _rank(key: Hashable) -> int:
    if not isinstance(key, Node):
        return _DEVICE_RANK
    return _DAEMON_RANK if key.is_daemon else _PROGRAM_RANK
