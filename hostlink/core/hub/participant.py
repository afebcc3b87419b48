"""Participant: interface of the hub for everything except devices. Leaving releases everything that it has.

Payloads are bytes, as devices send and receive them. Other languages are translated outside of the hub.
"""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial

from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.hub.byte_budget import OWN_LATCHED_BYTES, SHARES
from hostlink.core.hub.gates import ENDING
from hostlink.core.hub.graph_view import Graph
from hostlink.core.hub.message import PROGRAM_PRIORITY
from hostlink.core.hub.node import Node, Role
from hostlink.core.hub.services import Answer, Notify, Provider
from hostlink.core.hub.shared import Shared
from hostlink.core.hub.subscription import Subscription
from hostlink.core.hub.topic import Receive, Topic
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.messages.message_type import MessageType
from hostlink.core.robot.admission import Command, Freshness
from hostlink.core.robot.events import RobotEvent
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity, Twist
from hostlink.core.runtime.cancellation import expire, within
from hostlink.errors import BadRequest, DeviceGone, NoRole, ServiceFailed, UnknownTopic, WrongType

MAX_ADVERTISED = 256  # topics
MAX_LATCHED = 16  # latched topics; each keeps a message
MAX_SUBSCRIPTIONS = 256
MAX_SERVICES = 64
MAX_CALLS = 64  # of services at once


class Participant(Node):
    """Participant for one program, or for one part of the daemon.

    A failure of one of its callbacks ends the participant, and nothing else; it is counted and logged. A part of the
    daemon is not ended: an emergency stop that failed once is better than none.
    """

    def __init__(
        self,
        shared: Shared,
        name: str,
        *,
        role: Role = Role.DRIVE,
        priority: int = PROGRAM_PRIORITY,
        is_daemon: bool = False,
        group: str = "",
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        """`priority` is that of its velocities. `on_end` is called when a failure ends the participant.

        `group` is the bridge to another graph, such as ROS 2, to which it belongs. It does not receive messages of the
        group.
        """
        super().__init__(name, is_daemon=is_daemon, group=group)
        self.role, self.priority = role, priority
        self.has_left = False
        self.view = shared.view(group)  # of the graph, with the changes since a version
        self._shared, self._on_end = shared, on_end
        self._advertised: dict[str, bool] = {}  # topic -> whether it is latched
        self._subscriptions: dict[Subscription, None] = {}
        self._services: set[str] = set()
        self._followed: set[AnyRobot] = set()
        self._calls: set[asyncio.Timeout] = set()
        self._freshness = Freshness()  # of all its commands that tell when they were sent
        self.on_left: Callable[[Participant], object] | None = None  # called once it has left

    # -- topics -------------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type_name: str, *, is_latched: bool = False) -> Topic:
        """Advertise a topic. With `is_latched`, the last message is kept for later subscribers.

        Raises:
            BadRequest: the type is unknown, the role does not allow it, or there are too many topics.
            WrongType: the topic is in use with another type.
        """
        self.check(Role.DRIVE, "advertise")
        name = resolve(topic)
        if self._shared.catalog.message(type_name) is None:
            raise BadRequest(f"unknown type {type_name}; put its .msg into a folder named in message_folders")
        is_latched = is_latched or self._advertised.get(name, False)
        latched = {each for each, is_kept in self._advertised.items() if is_kept}
        if not self.is_daemon and len(self._advertised.keys() | {name}) > MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} topics advertised")
        if is_latched and len(latched | {name}) > MAX_LATCHED:
            raise BadRequest(f"more than {MAX_LATCHED} latched topics")
        found = self._shared.topics.advertise(name, self, type_name=type_name, is_latched=is_latched)
        self._advertised[name] = is_latched
        return found

    def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic. Do nothing if it was not advertised."""
        self._advertised.pop(resolve(topic), None)
        self._shared.topics.unadvertise(topic, self)

    def message_type(self, topic: str, type_name: str = "") -> MessageType:
        """Return the type of a topic's messages: that of the topic if it has one, else the one of this name.

        Raises:
            UnknownTopic: neither the topic nor the type is known.
            WrongType: the topic has another type, or one without a definition.
        """
        known = self._shared.topics.find_or_none(topic)
        named = self._shared.catalog.message(type_name) if type_name else None
        if known is None and named is None:
            raise UnknownTopic("topic", topic, self._shared.topics.names())
        if known is not None and known.type_name and named is not None and known.type_name != named.name:
            raise WrongType(known.name, known.type_name, named.name)
        found = known.type if known is not None and known.type_name else named
        if found is None:
            raise WrongType(topic, "a type with a definition", type_name or "none")
        return found

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        priority: int | None = None,
        at_s: float | None = None,
        epoch: int | None = None,
    ) -> None:
        """Publish a payload. A velocity is a command at this priority, with this epoch.

        `at_s` is the earliest time at which this daemon may have received it; None means now.

        Raises:
            BadRequest: the role does not allow it, or callbacks publish in an endless loop.
            DeviceGone: the daemon stops.
            CommandRefused: a robot's admission has refused the velocity.
            FrameTooLarge, WrongType: the message does not fit a device; all others have received it.
            BadRequest: the message was delivered, but there is no room to latch it.
        """
        self.check(Role.DRIVE, "publish")
        if self._shared.gates.is_closed:
            raise DeviceGone(topic, ENDING)
        known = self._shared.topics.find_or_none(topic)
        if known is None or self not in known.publishers:
            self.note_publishing(topic)
        if known is not None:
            before = known.latched.get(self)
            is_kept = self not in known.latched or self._shared.topics.budget.can_latch(self, before, payload)
            wanted_priority = self.priority if priority is None else priority
            deliveries = self._shared.topics.deliveries
            senders = deliveries.begin_sending(self)
            try:
                known.publish(payload, source=self, priority=wanted_priority, at_s=at_s, epoch=epoch)
            finally:
                deliveries.senders = senders
            if not is_kept:
                raise BadRequest(
                    f"{known.name}: delivered, but not kept for later subscribers: a participant may latch "
                    f"{OWN_LATCHED_BYTES} bytes, all together {SHARES['latched']}"
                )

    def publish_twist(
        self, topic: str, twist: Twist, *, priority: int | None = None, at_s: float | None = None
    ) -> bool:
        """Publish a Twist that is not encoded, if one robot is all that receives it: its gate, of this daemon.

        Return False and do nothing in every other case: `publish` then does the same, or says why not.

        Raises:
            CommandRefused: the robot's admission has refused the velocity.
            HostlinkError: the velocity does not fit the device, which is stopped.
        """
        topics = self._shared.topics
        known = topics.find_or_none(topic)
        target = None if known is None or known.type_name != TWIST_TYPE else known.target
        if known is None or target is None or self in known.latched:
            return False
        if self.has_left or self.role < Role.DRIVE or self._shared.gates.is_closed:
            return False
        if self not in known.publishers:  # as `note_publishing`
            topics.earlier.note(known.name, self, asyncio.get_running_loop().time())
        senders = topics.deliveries.begin_sending(self)
        try:
            target.receive_twist(
                twist,
                self,
                self.priority if priority is None else priority,
                asyncio.get_running_loop().time() if at_s is None else at_s,
            )
        finally:
            topics.deliveries.senders = senders
        return True

    def note_publishing(self, topic: str) -> None:
        """Note a publisher of a topic without subscribers. It does not drive a device that subscribes later."""
        self._shared.topics.earlier.note(resolve(topic), self, asyncio.get_running_loop().time())

    def subscribe(
        self,
        topic: str,
        receive: Receive,
        *,
        type_name: str = "",
        interval_s: float = 0.0,
        queue_length: int = 0,
        on_throttled: Callable[[], None] = lambda: None,
    ) -> Subscription:
        """Call `receive` with latched messages and with every message from now on, at most one in `interval_s`.

        Between two of them, the newest `queue_length` messages wait for `flush`, and `on_throttled` is called for each.

        Raises:
            BadRequest: the participant has left, or has too many subscriptions.
            WrongType: the topic is in use with another type.
        """
        self.check(Role.READ, "subscribe")
        if not self.is_daemon and len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            raise BadRequest(f"more than {MAX_SUBSCRIPTIONS} subscriptions")
        subscription = Subscription(
            receive,
            on_throttled,
            interval_s=interval_s,
            queue_length=queue_length,
            group=self.group,
            share=self._shared.topics.budget["held_back"],
            owner=self,
            type_name=type_name,
        )
        self._subscriptions[subscription] = None
        try:
            subscription.enter(*self._shared.topics.subscribe(topic, subscription))
        except WrongType:
            del self._subscriptions[subscription]
            raise
        if self.has_left:  # a latched message ended it
            subscription.close()
        return subscription

    def unsubscribe(self, subscription: Subscription, topic: Topic, number: int) -> None:
        """Remove a closed subscription from the topic, where it has this number."""
        self._shared.topics.unsubscribe(topic, number)
        self._subscriptions.pop(subscription, None)

    def flush(self, now_s: float) -> float | None:
        """Deliver waiting messages that are due. Return the time at which the next one is due."""
        next_s = None
        try:
            for subscription in list(self._subscriptions):
                due_s = subscription.flush(now_s) if subscription.waiting else None
                if due_s is not None and (next_s is None or due_s < next_s):
                    next_s = due_s
        except Exception as error:  # noqa: BLE001 - as for every message
            self.fail(error)
            return None
        return next_s

    # -- services -----------------------------------------------------------------------------------------------------

    def provide(
        self,
        service: str,
        type_name: str,
        answer: Answer,
        *,
        notify: Notify | None = None,
        is_reading: bool = False,
        ignores_request: bool = False,
    ) -> None:
        """Provide a service. The newest provider of a name gets the calls.

        `notify` is called with a text when another provider gets the calls. `is_reading`: a call changes nothing.
        `ignores_request`: a call with unknown fields is answered, too.

        Raises:
            BadRequest: the role does not allow it, there are too many services, or the name is the daemon's own.
        """
        self.check(Role.DRIVE, "advertise_service")
        name = resolve(service)
        if not self.is_daemon and len(self._services | {name}) > MAX_SERVICES:
            raise BadRequest(f"more than {MAX_SERVICES} services")
        provider = Provider(
            name,
            type_name,
            self,
            answer,
            notify,
            fail=self.fail,
            is_reading=is_reading,
            ignores_request=ignores_request,
        )
        self._shared.services.provide(provider)
        self._services.add(name)

    def withdraw(self, service: str) -> None:
        """Stop providing a service. Do nothing if it was not provided."""
        self._services.discard(resolve(service))
        self._shared.services.withdraw(service, self)

    async def call(
        self, service: str, request: Mapping[str, object], *, timeout_s: float | None = None
    ) -> Mapping[str, object]:
        """Call a service of any provider.

        Raises:
            UnknownTopic: the service has no provider.
            WrongType, BadRequest, BadPayload: request or answer has a wrong type, or the role does not allow the call.
            ServiceFailed, DeviceBusy, DeviceGone, FrameTooLarge: the call failed.
        """
        self.check(Role.READ, "call_service")
        if self.role < Role.DRIVE and not self._shared.services.is_reading(service):
            raise NoRole("the token may only read: it may call only services that read; use one with the role drive")
        if len(self._calls) >= MAX_CALLS:
            raise BadRequest(f"more than {MAX_CALLS} calls under way")
        try:
            return await within(None, self._shared.services.call(service, request, timeout_s=timeout_s), self._calls)
        except TimeoutError:
            raise ServiceFailed(service, f"{self.name} has left") from None

    # -- robots -------------------------------------------------------------------------------------------------------

    def drive(
        self,
        robot: AnyRobot,
        velocity: PlanarVelocity,
        *,
        priority: int | None = None,
        received_s: float | None = None,
        sent_s: float | None = None,
        epoch: int | None = None,
        is_planar: bool = True,
        take_over: bool = False,
        reason: str = "",
    ) -> PlanarVelocity:
        """Drive for the length of a lease. Return the velocity after the limits.

        `received_s`, `sent_s`, `epoch`, `is_planar` and `take_over` are those of a `Command`; `received_s` is now if it
        is None.
        `reason` of a zero: why this participant drives no more.

        Raises:
            NoRole: this participant may not drive.
            CommandRefused: the robot's admission has refused the command.
            FrameTooLarge, WrongType, UnknownTopic: the command does not fit the device, which is stopped.
            DeviceGone: the daemon of the robot does not answer.
        """
        self.check(Role.DRIVE, "drive")
        now_s = asyncio.get_running_loop().time()
        received_s = now_s if received_s is None else received_s
        if sent_s is not None:  # all robots have the sender's one clock: an old command moves none that is new to it
            received_s = min(received_s, now_s - self._freshness.late_s(sent_s, now_s))
        command = Command(
            velocity,
            self,
            self.priority if priority is None else priority,
            received_s,
            sent_s,
            epoch,
            is_planar=is_planar,
            take_over=take_over,
        )
        deliveries = self._shared.topics.deliveries
        senders = deliveries.begin_sending(self)
        try:
            if reason and velocity.is_zero and is_planar:
                robot.let_go(self, reason)
            return robot.command(command)
        finally:
            deliveries.senders = senders

    async def driven(self, robot: AnyRobot, limited: PlanarVelocity) -> PlanarVelocity:
        """Return the answer to the newest `drive`: `limited` for a robot of this daemon.

        Raises:
            DeviceGone: the daemon that has the robot has not answered in time, or its device is not connected.
            CommandRefused, FrameTooLarge, WrongType, UnknownTopic: it has refused the command.
        """
        answer = robot.answer(self)
        return limited if answer is None else await answer

    def follow(self, robot: AnyRobot, receive: Callable[[], None]) -> None:
        """Call `receive` after each new pose of the robot, until the participant leaves.

        Raises:
            BadRequest: the participant has left.
        """
        self.check(Role.READ, "follow")

        robot.followers[self] = lambda _: self._notify(receive)
        self._followed.add(robot)

    # -- the graph ----------------------------------------------------------------------------------------------------

    def graph(self) -> Graph:
        """Return the topics and services outside of its group."""
        return self.view.graph()

    def watch_graph(self, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and soon after every change of topics, services and robots, until it leaves.

        Raises:
            BadRequest: the participant has left.
        """
        self.check(Role.READ, "watch_graph")

        self._shared.changes.watch(self, partial(self._notify, on_change))

    def observe(self, receive: Callable[[RobotEvent], None]) -> None:
        """Call `receive` with every event of robots and links, until the participant leaves.

        Raises:
            BadRequest: the participant has left.
        """
        self.check(Role.READ, "observe")
        self._shared.events.observe(self, partial(self._notify, receive))

    def _notify(self, callback: Callable[..., None], *given: object) -> None:
        """Call a callback. An exception ends this participant, and does not reach the caller."""
        try:
            callback(*given)
        except Exception as error:  # noqa: BLE001 - as for every message
            self.fail(error)

    # -- its end ------------------------------------------------------------------------------------------------------

    def check(self, role: Role, what: str) -> None:
        """Check that the participant has this role.

        Raises:
            BadRequest: the participant has left.
            NoRole: its role is lower.
        """
        if self.has_left:
            raise BadRequest(f"{what}: {self.name} has left")
        if self.role < role:
            raise NoRole(f"{what}: the token may only read; use one with the role drive")

    def fail(self, error: Exception) -> None:
        """Count a failure of a callback, and end the participant."""
        if not self.is_daemon:
            self.leave()
            self._on_end()
        self._shared.isolation.crashed("participant", error, participant=self.name)

    def leave(self) -> None:
        """Release everything: its robots stop, its services are withdrawn, its calls fail."""
        if self.has_left:
            return
        self.has_left = True
        for subscription in self._subscriptions:
            subscription.is_closed = True  # it does not receive its own last zero
        self._shared.gates.release(self)
        for subscription in list(self._subscriptions):
            subscription.close()
        for robot in self._followed:
            robot.followers.pop(self, None)
        self._shared.changes.unwatch(self)
        self._shared.events.leave(self)
        self._shared.topics.leave(self)
        self._shared.services.leave(self)
        for end in self._calls:
            expire(end)
        self._advertised.clear()
        self._services.clear()
        self._followed.clear()
        if self.on_left is not None:
            self.on_left(self)
