"""Participant: how everything that is no device takes part in the hub; when it leaves, all that it has goes with it.

Payloads are bytes here, as devices send and receive them; whoever speaks another language translates.
"""

import asyncio
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, ParamSpec

from hostlink.cancellation import expire
from hostlink.errors import BadRequest, DeviceGone, ServiceFailed, UnknownTopic, WrongType
from hostlink.hub.byte_budget import OWN_LATCHED_BYTES, SHARES
from hostlink.hub.gates import ENDING
from hostlink.hub.graph_view import Graph
from hostlink.hub.message import PROGRAM_PRIORITY
from hostlink.hub.node import Node, Role
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import RobotEvent
from hostlink.hub.services import Answer, Notify, Provider
from hostlink.hub.subscription import Subscription, nothing_to_close
from hostlink.hub.topic import Receive, Subscriber, Topic
from hostlink.hub.topic_graph import resolve
from hostlink.messages.message_type import MessageType
from hostlink.robot.admission import Command
from hostlink.robot.velocity import PlanarVelocity

if TYPE_CHECKING:
    from hostlink.hub.hub import Hub

MAX_ADVERTISED = 256  # topics
MAX_LATCHED = 16  # topics; each keeps a message
MAX_SUBSCRIPTIONS = 256
MAX_SERVICES = 64
MAX_CALLS = 64  # of services, under way at once

Given = ParamSpec("Given")


class Participant(Node):
    """One program, or one part of the daemon.

    A callback of it that fails ends it: that is counted and logged, and touches no link and no other participant. A
    part of the daemon stays: an emergency stop that has failed once is better than none.
    """

    def __init__(
        self,
        hub: "Hub",
        name: str,
        *,
        role: Role = Role.DRIVE,
        priority: int = PROGRAM_PRIORITY,
        is_daemon: bool = False,
        group: str = "",
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        """`priority`: of its velocities; `on_end`: called when a failure ends it.

        `group`: the bridge to another graph, as ROS 2, of which it is a part. What the group publishes is not received.
        """
        super().__init__(name, is_daemon=is_daemon, group=group)
        self.role, self.priority = role, priority
        self.has_left = False
        self.view = hub.views.of(group)  # of the graph; its news cost what has changed
        self._hub, self._on_end = hub, on_end
        self._advertised: dict[str, bool] = {}  # whether it is latched, by topic
        self._subscriptions: dict[Subscription, None] = {}
        self._services: set[str] = set()
        self._followed: set[Robot] = set()
        self._calls: set[asyncio.Timeout] = set()

    # -- topics -------------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type_name: str, *, is_latched: bool = False) -> Topic:
        """Note that it publishes the topic; with `is_latched` its last message is kept for later subscribers.

        Raises:
            BadRequest: nobody knows the type, it may not publish, or it has too many topics.
            WrongType: the topic is in use with another type.
        """
        self.check(Role.DRIVE, "advertise")
        name = resolve(topic)
        if self._hub.catalog.message(type_name) is None:
            raise BadRequest(f"unknown type {type_name}; put its .msg into a folder named in message_folders")
        is_latched = is_latched or self._advertised.get(name, False)
        latched = {each for each, is_kept in self._advertised.items() if is_kept}
        if not self.is_daemon and len(self._advertised.keys() | {name}) > MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} topics advertised")
        if is_latched and len(latched | {name}) > MAX_LATCHED:
            raise BadRequest(f"more than {MAX_LATCHED} latched topics")
        found = self._hub.topics.advertise(name, self, type_name=type_name, is_latched=is_latched)
        self._advertised[name] = is_latched
        return found

    def unadvertise(self, topic: str) -> None:
        """It publishes the topic no more; one that it did not advertise is no error."""
        self._advertised.pop(resolve(topic), None)
        self._hub.topics.unadvertise(topic, self)

    def message_type(self, topic: str, type_name: str = "") -> MessageType:
        """The type of a topic's messages: as it is known, else the one of this name.

        Raises:
            UnknownTopic: neither the topic nor the type is known.
            WrongType: the topic has another type, or one without a definition.
        """
        known = self._hub.topics.find_or_none(topic)
        named = self._hub.catalog.message(type_name) if type_name else None
        if known is None and named is None:
            raise UnknownTopic("topic", topic, self._hub.topics.names())
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
        """Send a payload to all who subscribe; a velocity is a command at this priority, with this epoch.

        `at_s` is the earliest time at which this daemon may have received it; None: now.

        Raises:
            BadRequest: it may not publish, or its own callback has sent this too often.
            DeviceGone: the daemon stops.
            CommandRefused: a robot's admission has refused the velocity.
            FrameTooLarge, WrongType: it does not fit a device; all others have it.
            BadRequest: it is latched, and was delivered, but cannot be kept: there is too much.
        """
        self.check(Role.DRIVE, "publish")
        if self._hub.gates.is_closed:
            raise DeviceGone(topic, ENDING)
        known = self._hub.topics.find_or_none(topic)
        if known is None or self not in known.publishers:
            self.note_publishing(topic)
        if known is not None:
            before = known.latched.get(self)
            is_kept = self not in known.latched or self._hub.topics.budget.can_latch(self, before, payload)
            wanted_priority = self.priority if priority is None else priority
            deliveries = self._hub.topics.deliveries
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

    def note_publishing(self, topic: str) -> None:
        """Note that it publishes what nobody can receive yet: it does not drive a device that subscribes later."""
        self._hub.topics.earlier.note(resolve(topic), self, asyncio.get_running_loop().time())

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
        """Call `receive` with what was latched and every message from now on, at most one in `interval_s`.

        In between the newest `queue_length` are held for `flush`, and `on_throttled` is called for each.

        Raises:
            BadRequest: it has left, or has too many subscriptions.
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
            share=self._hub.topics.budget["held_back"],
        )
        self._subscriptions[subscription] = None
        subscriber = Subscriber(subscription.receive, self, type_name, self.fail)
        try:
            unsubscribe = self._hub.topics.subscribe(topic, subscriber)
        except WrongType:
            del self._subscriptions[subscription]
            raise

        def close() -> None:
            subscription.end()
            subscription.close = nothing_to_close  # else the two keep each other until the garbage collector comes
            unsubscribe()
            self._subscriptions.pop(subscription, None)

        subscription.close = close
        if self.has_left:  # what was latched ended it
            close()
        return subscription

    def flush(self, now_s: float) -> float | None:
        """Deliver what subscriptions held back until now; returns when the next is due."""
        next_s = None
        try:
            for subscription in list(self._subscriptions):
                due_s = subscription.flush(now_s) if subscription.waiting else None
                if due_s is not None and (next_s is None or due_s < next_s):
                    next_s = due_s
        except Exception as error:  # noqa: BLE001 - as when a message comes
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
    ) -> None:
        """Answer the calls of a service; the newest offer of a name counts.

        `notify` is called with a text when another gets the calls; `is_reading`: a call changes nothing.

        Raises:
            BadRequest: it may not serve, has too many services, or the name is the daemon's own.
        """
        self.check(Role.DRIVE, "advertise_service")
        name = resolve(service)
        if not self.is_daemon and len(self._services | {name}) > MAX_SERVICES:
            raise BadRequest(f"more than {MAX_SERVICES} services")
        provider = Provider(name, type_name, self, answer, notify, fail=self.fail, is_reading=is_reading)
        self._hub.services.provide(provider)
        self._services.add(name)

    def withdraw(self, service: str) -> None:
        """Answer it no more; one that it did not provide is no error."""
        self._services.discard(resolve(service))
        self._hub.services.withdraw(service, self)

    async def call(
        self, service: str, request: Mapping[str, object], *, timeout_s: float | None = None
    ) -> Mapping[str, object]:
        """Call a service, whoever provides it.

        Raises:
            UnknownTopic: nobody provides it.
            WrongType, BadRequest, BadPayload: request or answer is not of its type, or it may not call it.
            ServiceFailed, DeviceBusy, DeviceGone, FrameTooLarge: it was not done.
        """
        self.check(Role.READ, "call_service")
        if self.role < Role.DRIVE and not self._hub.services.is_reading(service):
            raise BadRequest("the token may only read: it may call no service but those of rosapi")
        if len(self._calls) >= MAX_CALLS:
            raise BadRequest(f"more than {MAX_CALLS} calls under way")
        try:
            async with asyncio.timeout(None) as end:  # `leave` sets it
                self._calls.add(end)
                try:
                    return await self._hub.services.call(service, request, timeout_s=timeout_s)
                finally:
                    self._calls.discard(end)
        except TimeoutError:
            raise ServiceFailed(service, f"{self.name} has left") from None

    # -- robots -------------------------------------------------------------------------------------------------------

    def drive(
        self,
        robot: Robot,
        velocity: PlanarVelocity,
        *,
        priority: int | None = None,
        received_s: float | None = None,
        sent_s: float | None = None,
        epoch: int | None = None,
    ) -> PlanarVelocity:
        """Drive for the length of a lease; returns the velocity after the limits.

        `received_s`, `sent_s` and `epoch` are those of a `Command`; `received_s` is now if it is None.

        Raises:
            BadRequest: this participant may not drive.
            CommandRefused: the robot's admission has refused the command.
            FrameTooLarge, WrongType, UnknownTopic: the command does not fit the device; then nobody drives.
            DeviceGone: another daemon has the robot, and does not answer.
        """
        self.check(Role.DRIVE, "drive")
        command = Command(
            velocity,
            self,
            self.priority if priority is None else priority,
            asyncio.get_running_loop().time() if received_s is None else received_s,
            sent_s,
            epoch,
        )
        deliveries = self._hub.topics.deliveries
        senders = deliveries.begin_sending(self)
        try:
            return robot.command(command)
        finally:
            deliveries.senders = senders

    async def driven(self, robot: Robot, limited: PlanarVelocity) -> PlanarVelocity:
        """What became of the newest `drive`, which returned `limited`: for a robot that is here, just that.

        Raises:
            DeviceGone: the daemon that has the robot has not answered in time, or its device is not connected.
            CommandRefused, FrameTooLarge, WrongType, UnknownTopic: it has refused the command.
        """
        answer = robot.answer(self)
        return limited if answer is None else await answer

    def follow(self, robot: Robot, receive: Callable[[], None]) -> None:
        """Call `receive` after each new pose of the robot, whatever its topic is, until it leaves.

        Raises:
            BadRequest: it has left.
        """
        self.check(Role.READ, "follow")

        notify = self._failing_alone(receive)
        robot.followers[self] = lambda _: notify()
        self._followed.add(robot)

    # -- the graph ----------------------------------------------------------------------------------------------------

    def graph(self) -> Graph:
        """The topics and services of all who do not belong to its group."""
        return self.view.graph()

    def watch_graph(self, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and soon after every change of topics, services and robots, until it leaves.

        Raises:
            BadRequest: it has left.
        """
        self.check(Role.READ, "watch_graph")

        self._hub.changes.watch(self, self._failing_alone(on_change))

    def observe(self, receive: Callable[[RobotEvent], None]) -> None:
        """Call `receive` for all that happens to robots and links, until it leaves.

        Raises:
            BadRequest: it has left.
        """
        self.check(Role.READ, "observe")
        self._hub.events.observe(self, self._failing_alone(receive))

    def _failing_alone(self, callback: Callable[Given, None]) -> Callable[Given, None]:
        """What the callback raises ends this participant, and is nothing to whoever calls it."""

        def guarded(*args: Given.args, **kwargs: Given.kwargs) -> None:
            try:
                callback(*args, **kwargs)
            except Exception as error:  # noqa: BLE001 - as when a message comes
                self.fail(error)

        return guarded

    # -- its end ------------------------------------------------------------------------------------------------------

    def check(self, role: Role, what: str) -> None:
        """Refuse what is not allowed.

        Raises:
            BadRequest: it has left, or its role is less.
        """
        if self.has_left:
            raise BadRequest(f"{what}: {self.name} has left")
        if self.role < role:
            raise BadRequest(f"{what}: the token may only read")

    def fail(self, error: Exception) -> None:
        """A callback of it has failed: it is counted, and ends."""
        if not self.is_daemon:
            self.leave()
            self._on_end()
        self._hub.isolation.crashed("participant", error, participant=self.name)

    def leave(self) -> None:
        """Take back all that it has: what it drove stops, what it provided is no more, its calls fail."""
        if self.has_left:
            return
        self.has_left = True
        for subscription in self._subscriptions:
            subscription.is_closed = True  # its own zero is nothing to it any more
        self._hub.gates.release(self)
        for subscription in list(self._subscriptions):
            subscription.close()
        for robot in self._followed:
            robot.followers.pop(self, None)
        self._hub.changes.unwatch(self)
        self._hub.events.leave(self)
        self._hub.topics.leave(self)
        self._hub.services.leave(self)
        for end in self._calls:
            expire(end)
        self._advertised.clear()
        self._services.clear()
        self._followed.clear()
