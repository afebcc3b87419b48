"""Topics of the graph: publishers, subscribers, latched messages, and the order in which messages are delivered."""

import asyncio
import itertools
import time
from collections import deque
from collections.abc import Callable, Hashable
from typing import NamedTuple, TypeVar

import structlog

from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.byte_budget import ByteBudget
from hostlink.hub.message import PROGRAM_PRIORITY, Message
from hostlink.hub.node import Node
from hostlink.messages.message_type import MessageType

log = structlog.get_logger()

MAX_NESTED = 8  # messages and commands of one sender, each sent in a callback that the one before caused
MAX_WAITING = 1024  # messages that callbacks have published, and that wait for the message before them

Deliver = Callable[[Message], None]
Result = TypeVar("Result")


class _Waiting(NamedTuple):
    deliver: Deliver
    message: Message
    senders: tuple[Hashable, ...]


class Deliveries:
    """Of one hub: one message is delivered at a time. Over MAX_WAITING one is delivered at once, before its turn."""

    def __init__(self) -> None:
        self.out_of_order = 0  # messages that were delivered before their turn
        self.senders: tuple[Hashable, ...] = ()  # each sends in a callback that the one before caused
        self._waiting: deque[_Waiting] = deque()
        self._is_under_way = False

    def add(self, deliver: Deliver, message: Message) -> None:
        """Deliver a message, now or after those before it."""
        if not self._is_under_way:
            self._is_under_way = True  # as `run` does, on the path of every message
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
        """Do something with a message; what is to be delivered meanwhile is delivered afterwards."""
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
        """Note that a sender sends from now on; returns the `senders` before, to be restored when it has sent.

        Raises:
            BadRequest: callbacks of the sender have sent too often what calls them back: it would never end.
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

PROGRAM_RANK, DAEMON_RANK, DEVICE_RANK = range(3)  # whose type of a topic precedes another's


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
    is_command: bool = False  # each message is acted on once, as a reset of the odometry
    is_away: bool = False  # the gate of a robot whose device is not connected

    @property
    def takes_latched(self) -> bool:
        """Whether a message from before the subscription is sent: a velocity or another command is old by then."""
        return not (self.is_gate or self.is_command)


class Topic:
    """One name in the graph. Whoever publishes or subscribes is known by a key: a link, or a Node.

    Where a velocity gate subscribes, messages go to the gates alone; what they send to their devices is delivered to
    the other subscribers.
    """

    __slots__ = (
        "_budget", "_deliveries", "_expected", "_is_gated", "_numbers", "_snapshot", "_subscribers",
        "devices", "earlier", "latched", "messages", "name", "publishers", "rank", "type", "type_name",
    )  # fmt: skip

    def __init__(self, name: str, deliveries: Deliveries | None = None, budget: ByteBudget | None = None) -> None:
        """`deliveries` and `budget`: those of the graph, for a topic that is in it."""
        self.name = name
        self.type_name = ""  # until somebody names it
        self.type: MessageType | None = None
        self.rank = PROGRAM_RANK  # of who named the type
        self.messages = 0
        self.publishers: set[Hashable] = set()
        self.earlier: tuple[Hashable, ...] = ()  # who published without it when the newest device subscribed
        self.devices: dict[Hashable, DeviceSubscription] = {}
        self.latched: dict[
            Hashable, bytes | None
        ] = {}  # by publisher: its last message, for later subscribers; newest last
        self._subscribers: dict[int, Subscriber] = {}
        self._numbers = itertools.count()
        self._expected: dict[str, int] = {}  # how many subscribers expect each type
        self._snapshot: tuple[Subscriber, ...] | None = ()  # None: to be made anew, as a message comes
        self._is_gated = False
        self._deliveries = Deliveries() if deliveries is None else deliveries
        self._budget = ByteBudget() if budget is None else budget

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
        """Remove a subscriber; one that is not there is no error."""
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
        """Remove a device or a gate; one that is not there is no error."""
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
    def is_gated(self) -> bool:
        """Whether a velocity gate subscribes: what is published drives a robot."""
        return self._is_gated

    @property
    def has_subscribers(self) -> bool:
        """Whether a message would reach anybody."""
        return bool(self._subscribers or self.devices)

    @property
    def has_device_publisher(self) -> bool:
        """Whether a device publishes it."""
        return any(rank_of(key) == DEVICE_RANK for key in self.publishers)

    @property
    def highest_rank(self) -> int:
        """Of its publishers and devices; a device mostly comes first."""
        ranks = map(rank_of, itertools.chain(self.devices, self.publishers))
        highest = PROGRAM_RANK
        for rank in ranks:
            highest = max(highest, rank)
            if highest == DEVICE_RANK:
                break
        return highest

    def forget_publisher(self, key: Hashable) -> None:
        """`key` publishes no more."""
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
        """Pass a payload to every device and subscriber but its source. `at_s`: loop time of its arrival, if not now.

        Raises:
            HostlinkError: a device, or its gate, refused it; all others have it.
        """
        if not self._subscribers and not self.devices:
            self.messages += 1
            self._keep(payload, source)
            return
        at_s = asyncio.get_running_loop().time() if at_s is None else at_s
        message = Message(
            self.name,
            self.type_name,
            self.type,
            payload,
            source=source,
            stamp_ns=time.time_ns(),
            at_s=at_s,
            priority=priority,
            epoch=epoch,
        )
        refusal = self._deliveries.run(self._pass_to_devices, message) if self.devices else None
        if not self._is_gated:
            self._deliveries.add(self._dispatch, message)
        if refusal is not None:
            raise refusal

    def deliver(self, payload: bytes, *, source: Hashable, at_s: float) -> None:
        """Pass a payload to every subscriber, and to no device."""
        if self._subscribers:
            self._deliveries.add(self._dispatch, self._message(payload, source, at_s))
        else:
            self.messages += 1

    def _message(self, payload: bytes, source: Hashable, at_s: float) -> Message:
        return Message(self.name, self.type_name, self.type, payload, source=source, stamp_ns=time.time_ns(), at_s=at_s)

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
        """For later subscribers, if its source latches, and there is room; else the one before is not kept either."""
        if source in self.latched:
            before = self.latched.pop(source)  # the newest is the last of all
            after = payload if self._budget.can_latch(source, before, payload) else None
            self._budget["latched"].refused += after is None
            self._budget.latch(source, before, after)
            self.latched[source] = after

    def _dispatch(self, message: Message) -> None:
        self.messages += 1
        if self.latched:
            self._keep(message.payload, message.source)  # in its turn: who subscribes before receives it then
        snapshot = self._snapshot
        for subscriber in self.subscribers if snapshot is None else snapshot:
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
        for source, payload in list(self.latched.items()):  # the callback may let one of them leave
            if payload is not None:
                subscriber.receive(self._message(payload, source, at_s))

    def send_latched(self, key: Hashable) -> None:
        """Send the device `key` the last message of every publisher that latches, as far as it can take them."""
        device = self.devices.get(key)
        if device is None or not device.takes_latched or not self.latched:
            return
        at_s = asyncio.get_running_loop().time()
        for source, payload in list(self.latched.items()):
            if payload is not None:
                try:
                    device.receive(self._message(payload, source, at_s))
                except HostlinkError as error:
                    log.debug("message.refused", topic=self.name, reason=str(error))


def rank_of(key: Hashable) -> int:
    if not isinstance(key, Node):
        return DEVICE_RANK
    return DAEMON_RANK if key.is_daemon else PROGRAM_RANK
