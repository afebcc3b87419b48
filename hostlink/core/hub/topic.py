"""Topics of the graph: publishers, subscribers, latched messages, and the order in which messages are delivered."""

import asyncio
import itertools
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Set
from typing import NamedTuple, Protocol, TypeVar

import structlog

from hostlink.core.hub.byte_budget import ByteBudget
from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.core.hub.node import Node
from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.serialisation import ROS1
from hostlink.core.robot.velocity import Twist
from hostlink.errors import BadRequest, HostlinkError

log = structlog.get_logger()

MAX_NESTED = 8  # nested messages and commands of one sender, each sent in a callback of the one before
MAX_WAITING = 1024  # messages from callbacks that wait for the message before them

Deliver = Callable[[Message], None]
Result = TypeVar("Result")


class _Waiting(NamedTuple):
    deliver: Deliver
    message: Message
    senders: tuple[Hashable, ...]


class Deliveries:
    """Delivery order of a hub: one message at a time. Above MAX_WAITING, one is delivered at once, out of order."""

    def __init__(self) -> None:
        self.out_of_order = 0  # messages delivered before their turn
        self.senders: tuple[Hashable, ...] = ()  # nested senders: each sends in a callback of the one before
        self._waiting: deque[_Waiting] = deque()
        self._is_under_way = False

    def add(self, deliver: Deliver, message: Message) -> None:
        """Deliver a message, now or after those before it."""
        if not self._is_under_way:
            self._is_under_way = True  # the code of `run`, repeated on the path of every message
            try:
                deliver(message)
                if self._waiting:
                    self._drain()
            finally:
                self._is_under_way = False
        elif len(self._waiting) < MAX_WAITING:
            self._waiting.append(_Waiting(deliver, message, self.senders))
        else:
            self.out_of_order += 1
            deliver(message)

    def run(self, work: Callable[[Message], Result], message: Message) -> Result:
        """Run `work` with a message. Messages from its callbacks are delivered afterwards."""
        if self._is_under_way:
            return work(message)
        self._is_under_way = True
        try:
            result = work(message)
            if self._waiting:
                self._drain()
        finally:
            self._is_under_way = False
        return result

    def begin_sending(self, sender: Hashable) -> tuple[Hashable, ...]:
        """Add a sender to `senders`. Return the value before, which the caller restores after sending.

        Raises:
            BadRequest: callbacks of the sender cause each other, MAX_NESTED times.
        """
        senders = self.senders
        if senders and senders.count(sender) >= MAX_NESTED:
            raise BadRequest(f"{sender} sends in a callback what calls it back, again and again")
        self.senders = (*senders, sender)
        return senders

    def _drain(self) -> None:
        senders = self.senders
        try:
            while self._waiting:
                deliver, message, self.senders = self._waiting.popleft()
                deliver(message)
        finally:
            self.senders = senders


Receive = Callable[[Message], None]

PROGRAM_RANK, DAEMON_RANK, DEVICE_RANK = range(3)  # a higher rank decides the type of a topic


class Subscriber(NamedTuple):
    """Subscriber of a topic. `type_name` is empty if it expects no particular type."""

    receive: Receive
    key: Hashable
    type_name: str
    fail: Callable[[Exception], None]  # ends the owner of the callback


class Listener(Protocol):
    """Subscriber of a topic as the topic uses it: a `Subscriber`, or a participant's `Subscription`."""

    @property
    def key(self) -> Hashable: ...

    @property
    def type_name(self) -> str: ...

    def receive(self, message: Message, /) -> None: ...

    def fail(self, error: Exception, /) -> None: ...


class TwistTarget(Protocol):
    """Target of velocities that takes a Twist without a message."""

    def receive_twist(self, twist: Twist, source: Hashable, priority: int, received_s: float) -> None: ...


class DeviceSubscription(NamedTuple):
    """Subscription of a device: of its link, or of a velocity gate. `receive` raises the refusal of a message.

    `target` does the same with a Twist as `receive` with a message that has it; None: only `receive` can.
    """

    receive: Receive
    is_gate: bool
    is_command: bool = False  # each message is an action, such as a reset of odometry
    is_away: bool = False  # the gate of a robot whose device is not connected
    target: TwistTarget | None = None

    @property
    def takes_latched(self) -> bool:
        """Whether latched messages are sent: a velocity or another command would be old."""
        return not (self.is_gate or self.is_command)


_NOBODY: frozenset[Hashable] = frozenset()  # shared by topics without a publisher: an empty set has 216 bytes


class Topic:
    """Topic of the graph. Publishers and subscribers have a key: a link, or a Node.

    If a velocity gate subscribes, messages are passed to the gates only; the other subscribers receive the velocities
    that the gates send to their devices.
    """

    __slots__ = (
        "_budget", "_deliveries", "_expected", "_number", "_snapshot", "_subscribers", "_wall_ns",
        "devices", "earlier", "encoding", "is_gated", "latched", "messages", "name", "publishers", "rank", "target",
        "type", "type_name",
    )  # fmt: skip

    def __init__(
        self,
        name: str,
        deliveries: Deliveries | None = None,
        budget: ByteBudget | None = None,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """`deliveries`, `budget` and `wall_ns`, the time of day, are those of the graph."""
        self.name = name
        self._wall_ns = wall_ns
        self.type_name = ""  # until a publisher or subscriber names it
        self.type: MessageType | None = None
        self.encoding = ROS1  # serialisation of its messages; another one only if its type has no definition
        self.rank = PROGRAM_RANK  # of the user that named the type
        self.messages = 0
        self.publishers: Set[Hashable] = _NOBODY
        self.earlier: tuple[Hashable, ...] = ()  # publishers without `advertise` from before the newest device
        self.devices: dict[Hashable, DeviceSubscription] = {}
        self.latched: dict[Hashable, bytes | None] = {}  # last message of each publisher that latches; newest last
        self._subscribers: dict[int, Listener] = {}
        self._number = 0  # of the next subscriber
        self._expected: dict[str, int] = {}  # number of subscribers that expect each type
        self._snapshot: tuple[Listener, ...] | None = ()  # None: made again for the next message
        self.is_gated = False  # a velocity gate subscribes, so that messages drive a robot
        self.target: TwistTarget | None = None  # the gate that is its only device
        self._deliveries = Deliveries() if deliveries is None else deliveries
        self._budget = ByteBudget() if budget is None else budget

    @property
    def subscribers(self) -> tuple[Listener, ...]:
        """All subscribers except devices, oldest first. Adding and removing cost the same among many."""
        if self._snapshot is None:
            self._snapshot = tuple(self._subscribers.values())
        return self._snapshot

    def add_subscriber(self, subscriber: Listener) -> int:
        """Add a subscriber. Return the number for `remove_subscriber`."""
        number = self._number
        self._number += 1
        self._subscribers[number], self._snapshot = subscriber, None
        if subscriber.type_name:
            self._expected[subscriber.type_name] = self._expected.get(subscriber.type_name, 0) + 1
        return number

    def remove_subscriber(self, number: int) -> None:
        """Remove a subscriber. Do nothing if it was removed already."""
        gone = self._subscribers.pop(number, None)
        self._snapshot = None
        if gone is not None and gone.type_name:
            self._expected[gone.type_name] -= 1
            if not self._expected[gone.type_name]:
                del self._expected[gone.type_name]

    def add_device(self, key: Hashable, subscription: DeviceSubscription) -> None:
        """Add a device or a gate."""
        self.devices[key] = subscription
        self._note_devices()

    def remove_device(self, key: Hashable) -> None:
        """Remove a device or a gate. Do nothing if it is not subscribed."""
        self.devices.pop(key, None)
        self._note_devices()

    def _note_devices(self) -> None:
        devices = list(self.devices.values())
        self.is_gated = any(each.is_gate for each in devices)
        self.target = devices[0].target if len(devices) == 1 else None

    @property
    def expected_type(self) -> str:
        """Type that the first subscriber with a type expects; empty if none has one."""
        return next(iter(self._expected), "")

    @property
    def is_used(self) -> bool:
        """Whether the topic has a publisher or subscriber."""
        return bool(self.publishers or self._subscribers or self.devices)

    @property
    def has_subscribers(self) -> bool:
        """Whether the topic has a subscriber or a device."""
        return bool(self._subscribers or self.devices)

    @property
    def has_device_publisher(self) -> bool:
        """Whether a device publishes the topic."""
        return any(rank_of(key) == DEVICE_RANK for key in self.publishers)

    @property
    def highest_rank(self) -> int:
        """Highest rank of its publishers and devices. Devices are searched first, because most topics have one."""
        ranks = map(rank_of, itertools.chain(self.devices, self.publishers))
        highest = PROGRAM_RANK
        for rank in ranks:
            highest = max(highest, rank)
            if highest == DEVICE_RANK:
                break
        return highest

    def add_publisher(self, key: Hashable) -> None:
        """Add a publisher. Do nothing if it publishes already."""
        if isinstance(self.publishers, set):
            self.publishers.add(key)
        else:
            self.publishers = {key}

    def forget_publisher(self, key: Hashable) -> None:
        """Remove a publisher and its latched message."""
        if isinstance(self.publishers, set):
            self.publishers.discard(key)
        self._budget.latch(key, self.latched.pop(key, None), None)

    def publish(
        self,
        payload: bytes,
        *,
        source: Hashable,
        at_s: float | None = None,
        priority: int = PROGRAM_PRIORITY,
        epoch: int | None = None,
    ) -> None:
        """Pass a payload to all devices and subscribers except its source. `at_s` is the loop time of its arrival.

        Raises:
            HostlinkError: a device or its gate refused the message; all others have received it.
        """
        if not self._subscribers and not self.devices:
            self.messages += 1
            self._keep(payload, source)
            return
        at_s = asyncio.get_running_loop().time() if at_s is None else at_s
        message = self._message(payload, source, at_s, priority, epoch)
        refusal = self._deliveries.run(self._pass_to_devices, message) if self.devices else None
        if not self.is_gated:
            self._deliveries.add(self._dispatch, message)
        if refusal is not None:
            raise refusal

    def deliver(self, payload: bytes, *, source: Hashable, at_s: float) -> None:
        """Pass a payload to all subscribers, but to no device."""
        if self._subscribers:
            self._deliveries.add(self._dispatch, self._message(payload, source, at_s))
        else:
            self.messages += 1

    def _message(
        self,
        payload: bytes,
        source: Hashable,
        at_s: float,
        priority: int = PROGRAM_PRIORITY,
        epoch: int | None = None,
    ) -> Message:
        """Return a message of the topic as it is now."""
        return Message(
            self.name,
            self.type_name,
            self.type,
            payload,
            source=source,
            stamp_ns=self._wall_ns(),
            at_s=at_s,
            priority=priority,
            epoch=epoch,
            encoding=self.encoding,
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

    def _keep(self, payload: bytes, source: Hashable) -> None:
        """Latch a message if its source latches. Without room, the previous one is dropped, too."""
        if source in self.latched:
            before = self.latched.pop(source)  # the newest is the last one
            after = payload if self._budget.can_latch(source, before, payload) else None
            self._budget["latched"].refused += after is None
            self._budget.latch(source, before, after)
            self.latched[source] = after

    def _dispatch(self, message: Message) -> None:
        self.messages += 1
        if self.latched:
            self._keep(message.payload, message.source)  # in its turn: earlier subscribers receive it below
        snapshot = self._snapshot
        for subscriber in self.subscribers if snapshot is None else snapshot:
            try:
                subscriber.receive(message)
            except Exception as error:  # noqa: BLE001 - a subscriber's crash affects no device and no other subscriber
                self._remove(subscriber)
                subscriber.fail(error)

    def _remove(self, subscriber: Listener) -> None:
        for number, other in list(self._subscribers.items()):
            if other is subscriber:
                self.remove_subscriber(number)

    def deliver_latched(self, subscriber: Listener) -> None:
        """Pass all latched messages to a subscriber. An exception of its callback is raised."""
        for message in self._latched_messages():
            subscriber.receive(message)

    def send_latched(self, key: Hashable) -> None:
        """Send all latched messages to the device `key`, except those that it refuses."""
        device = self.devices.get(key)
        if device is not None and device.takes_latched:
            for message in self._latched_messages():
                try:
                    device.receive(message)
                except HostlinkError as error:
                    log.debug("message.refused", topic=self.name, reason=str(error))

    def _latched_messages(self) -> Iterator[Message]:
        for source, payload in list(self.latched.items()):  # a callback may let one of them leave
            if payload is not None:
                yield self._message(payload, source, asyncio.get_running_loop().time())


def rank_of(key: Hashable) -> int:
    if not isinstance(key, Node):
        return DEVICE_RANK
    return DAEMON_RANK if key.is_daemon else PROGRAM_RANK
