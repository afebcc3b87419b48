"""TopicGraph: every topic by name, who publishes it, who subscribes to it, which devices take it."""

from collections.abc import Callable, Hashable

from hostlink.errors import HostlinkError, UnknownTopic, WrongType
from hostlink.hub.message import Message
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType

Deliver = Callable[[Message], None]
Unsubscribe = Callable[[], None]
SendToDevice = Callable[[bytes], None]


def resolve(name: str) -> str:
    """The full name of a topic or service: `odom`, `/odom` and `~odom` are one."""
    return "/" + name.lstrip("/~")


class Topic:
    """One name in the graph. Whoever publishes or takes it is known by a key: a link or a client's name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.type_name = ""  # until somebody says
        self.type: MessageType | None = None
        self.messages = 0
        self.publishers: set[Hashable] = set()
        self.subscribers: tuple[Deliver, ...] = ()
        self.devices: dict[Hashable, SendToDevice] = {}

    @property
    def is_used(self) -> bool:
        """Whether anybody still means this topic."""
        return bool(self.publishers or self.subscribers or self.devices)

    def spread(self, payload: bytes, stamp_ns: int, *, source: Hashable) -> None:
        """Hand a payload to every device and client but its source; raises the last error of a device afterwards."""
        refusal: HostlinkError | None = None
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
            for deliver in self.subscribers:
                deliver(message)


class TopicGraph:
    """All topics of all devices and clients. A topic lives as long as somebody uses it."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._topics: dict[str, Topic] = {}

    def all(self) -> list[Topic]:
        """Every topic, by name."""
        return [self._topics[name] for name in sorted(self._topics)]

    def find(self, name: str) -> Topic:
        """The topic of that name; UnknownTopic if nobody uses one."""
        topic = self.find_or_none(name)
        if topic is None:
            raise UnknownTopic("topic", name, tuple(self._topics))
        return topic

    def find_or_none(self, name: str) -> Topic | None:
        """The topic of that name, if anybody uses one."""
        return self._topics.get(resolve(name))

    def subscribe(self, name: str, deliver: Deliver, *, type_name: str = "") -> Unsubscribe:
        """Deliver every message of the topic from now on; call what is returned to end it."""
        topic = self._open(name, type_name)
        topic.subscribers += (deliver,)

        def unsubscribe() -> None:
            topic.subscribers = tuple(other for other in topic.subscribers if other is not deliver)
            self._drop_unused(topic)

        return unsubscribe

    def advertise(self, name: str, key: Hashable, *, type_name: str) -> Topic:
        """Note that `key` publishes the topic; WrongType if it is in use with another type."""
        topic = self._open(name, type_name)
        topic.publishers.add(key)
        return topic

    def take(self, name: str, key: Hashable, send: SendToDevice, *, type_name: str) -> Topic:
        """Note that the device `key` takes the topic."""
        topic = self._open(name, type_name)
        topic.devices[key] = send
        return topic

    def unadvertise(self, name: str, key: Hashable) -> None:
        """`key` publishes the topic no more."""
        topic = self.find_or_none(name)
        if topic is not None:
            topic.publishers.discard(key)
            self._drop_unused(topic)

    def leave(self, key: Hashable) -> None:
        """`key` is gone: it publishes and takes nothing any more."""
        for topic in list(self._topics.values()):
            topic.publishers.discard(key)
            topic.devices.pop(key, None)
            self._drop_unused(topic)

    def _open(self, name: str, type_name: str) -> Topic:
        resolved = resolve(name)
        topic = self._topics.get(resolved) or Topic(resolved)
        type_ = self._catalog.message(type_name) if type_name else None
        plain_name = type_.name if type_ is not None else type_name
        if plain_name and not topic.type_name:
            topic.type_name, topic.type = plain_name, type_
        elif plain_name and topic.type_name != plain_name:
            raise WrongType(resolved, topic.type_name, plain_name)
        self._topics[resolved] = topic
        return topic

    def _drop_unused(self, topic: Topic) -> None:
        if not topic.is_used and self._topics.get(topic.name) is topic:
            del self._topics[topic.name]
