"""RemoteRobot: a robot whose gate is not here. A component announces it, and is asked to drive and to stop it."""

import dataclasses
import math
import re
import secrets
from collections.abc import Awaitable, Callable, Hashable, Iterable
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import structlog

from hostlink.core.hub.gates import Gates
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node
from hostlink.core.hub.providers import Provision
from hostlink.core.hub.robot import LOCK_REASON, AnyRobot, Follow, reason_for_motion, shown_reason
from hostlink.core.hub.topic import DeviceSubscription
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.robot.admission import EPOCH_BITS, Admission, Command
from hostlink.core.robot.feedback import FeedbackKind
from hostlink.core.robot.odometry import OdometrySnapshot, aged_rate_hz
from hostlink.core.robot.standstill import NO_ODOMETRY
from hostlink.core.robot.state import DEVICE_AWAY, RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import BadRequest, CommandRefused, DeviceGone, HostlinkError, RefusalKind

if TYPE_CHECKING:
    from hostlink.core.hub.robots import Robots

log = structlog.get_logger()

MAX_REMOTE = 4096  # robots of all components


class RemoteLink(NamedTuple):
    """Connection of a device of another host. `number` is of this daemon, `own_number` of its host."""

    number: int
    own_number: int


class RemoteOdometry:
    """Newest pose of a robot of another host."""

    def __init__(self) -> None:
        self.read_at_s = -math.inf
        self.count = 0
        self._newest: OdometrySnapshot | None = None
        self._at_s = 0.0

    def withdraw(self) -> None:
        """Drop the newest pose: the robot's host has dropped it, too."""
        self._newest = None

    def update(self, newest: OdometrySnapshot, now_s: float) -> bool:
        """Set the newest pose. Return whether it differs from the one before."""
        is_new = self._newest is None or (newest.count, newest.restarts) != (self._newest.count, self._newest.restarts)
        self._newest, self._at_s, self.count = newest, now_s, newest.count
        return is_new

    def snapshot(self, now_s: float) -> OdometrySnapshot | None:
        """Return the newest pose with its age; None before the first."""
        self.read_at_s = now_s
        if self._newest is None:
            return None
        age_s = self._newest.age_s + now_s - self._at_s
        return dataclasses.replace(self._newest, age_s=age_s, rate_hz=aged_rate_hz(self._newest.rate_hz, age_s))


class RemoteRobot(AnyRobot):
    """Robot of another host, a daemon or a program, which has its gate and its lease, and describes its state.

    Messages on its velocity topics here are commands, as for a robot of this daemon. The admission here decides about
    commands from here, before its provider sends them. Its component updates it.
    """

    link: RemoteLink | None = None
    odometry: RemoteOdometry
    host: str

    def __init__(
        self,
        known: RobotState,
        *,
        host: str,
        place: Hashable,
        provision: Provision,
        gates: Gates,
        graph: TopicGraph,
        new_number: Callable[[], int],
    ) -> None:
        """`known` is its state, and has its name. `host` names its host; `place` identifies it: names may repeat."""
        self.name, self.known, self.host, self.place, self.provision = known.name, known, host, place, provision
        self.also_at = ()  # if any, it is not driven from here
        self.resumed_link = 0
        self.odometry = RemoteOdometry()
        self.followers: dict[Hashable, Follow] = {}
        self.admission = Admission(self.name, epoch=secrets.randbits(EPOCH_BITS), sees_bunches=False)
        self._gates, self._graph, self._new_number = gates, graph, new_number
        self._epoch: int | None = None  # of its host's admission
        self._node = Node(f"{self.name} at {host}")  # key of the subscriptions to its velocity topics
        self._velocities: frozenset[tuple[str, str]] = frozenset()
        self._has_left = False

    # -- as every robot -----------------------------------------------------------------------------------------------

    def state(self, now_s: float) -> RobotState:
        """Return the robot's state for all APIs, with the link number and the epoch of this daemon."""
        return msgspec.structs.replace(
            self.known,
            host=self.host,
            also_at=self.also_at,
            link=None if self.link is None else self.link.number,
            lock_reason=self.admission.lock_reason,
            epoch=self.admission.epoch,
            odometry=self.odometry.snapshot(now_s),
            **(DEVICE_AWAY if self.link is None else {}),
        )

    def command(self, command: Command[PlanarVelocity]) -> PlanarVelocity:
        """Send a command to the robot's host if it is admitted here. Return the sent velocity.

        Raises:
            CommandRefused: the command is not admitted, or the previous one of this source was refused.
            DeviceGone: several robots have this name, or the robot's host does not answer.
            FrameTooLarge, WrongType: the answer to the previous command of this source.
        """
        now_s = loop_time_s()
        command = self._gates.timed(self.name, command, now_s)
        self._check_unique()
        decision = self.admission.decide(command, now_s)
        is_zero = command.velocity.is_zero and command.is_planar
        if decision.is_admitted or (is_zero and decision.kind is RefusalKind.HELD):  # it lets go there, too
            lease = None if command.velocity.is_zero else self.admission.driver("", now_s)
            began_s = command.received_s if lease is None else lease.deadline_s - self.admission.lease_s
            self.provision.drive(
                self,
                command.velocity,
                owner=command.source,
                priority=command.priority,
                received_s=began_s,
                epoch=None if command.epoch is None else self._epoch,
                take_over=command.take_over,
            )
        if decision.kind is not None:
            raise CommandRefused(self.name, decision.kind, decision.reason, holder=decision.holder, by=decision.by)
        return command.velocity

    def answer(self, owner: Hashable) -> Awaitable[PlanarVelocity]:
        """Return its host's answer to the newest command of a source."""
        return self.provision.answer(self, owner)

    def limited_by(self, velocity: PlanarVelocity) -> None:  # noqa: ARG002 - used by LocalRobot
        """Return None: the limits are at the robot's host."""
        return

    def stop(self, *, by: str | None = None) -> None:  # noqa: ARG002 - used by LocalRobot
        """Stop the robots of this name at other hosts.

        Raises:
            DeviceGone: its component announces it no longer.
        """
        self._check_there()
        self._gates.providers.stop(self.name)

    def lock(self, reason: str = LOCK_REASON, *, by: str | None = None) -> None:  # noqa: ARG002 - used by LocalRobot
        """Lock the robots of this name at other hosts.

        Raises:
            DeviceGone: its component announces it no longer.
        """
        self._check_there()
        self._gates.providers.lock(self.name, shown_reason(reason))

    def unlock(self, *, by: str | None = None) -> None:  # noqa: ARG002 - used by LocalRobot
        """Unlock the robot.

        Raises:
            DeviceGone: several robots have this name, or its host is not reached.
        """
        self._check_unique()
        self.provision.unlock(self)

    def why_moving(self) -> str:
        """Return the reason why the robot moves after a stop."""
        known = self.known
        return reason_for_motion(
            is_played=known.is_played,
            drivers=(known.holder,),
            unreachable=known.unreachable,
            velocities=(known.velocity,),
        )

    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""
        if self.link is None:
            return "its device is not connected"
        if self.known.feedback is FeedbackKind.NONE:
            cause = self.known.unreachable
            return NO_ODOMETRY if cause is None else cause
        if self.odometry.count == 0:
            return "it sends no odometry"
        return f"no odometry of it has come from {self.host} since the stop"

    # -- for its component --------------------------------------------------------------------------------------------

    def is_followed(self, within_s: float) -> bool:
        """Whether its poses are followed here, or one was read within this time."""
        return bool(self.followers) or loop_time_s() < self.odometry.read_at_s + within_s

    def update(self, known: RobotState, *, epoch: int | None) -> None:
        """Set the state from the robot's host. An interruption there is one here.

        `epoch` is None if the host has no epochs.
        """
        self.known = known
        self.admission.lease_s = known.lease_s
        self.note_epoch(epoch, lock_reason=known.lock_reason)
        if known.odometry is None:
            self.odometry.withdraw()
        elif self.odometry.update(known.odometry, loop_time_s()):
            for follow in tuple(self.followers.values()):
                follow(None)

    def note_epoch(self, epoch: int | None, *, lock_reason: str | None) -> None:
        """Note epoch and lock of its host's admission."""
        admission, now_s = self.admission, loop_time_s()
        if lock_reason is not None and admission.lock_reason != lock_reason:
            admission.lock(lock_reason, now_s)
        elif lock_reason is None and admission.lock_reason is not None:
            admission.unlock(now_s)
        elif self._epoch is not None and epoch is not None and epoch > self._epoch:
            admission.interrupt(now_s)
        if epoch is not None:  # a state may be older than an answer
            self._epoch = epoch if self._epoch is None else max(epoch, self._epoch)

    def note_answer(self, owner: Hashable, epoch: int | None, *, is_refused: bool) -> None:
        """Note its host's answer to a command of a source. A refused source keeps the robot from no driver here."""
        self.note_epoch(epoch, lock_reason=self.admission.lock_reason)
        if is_refused:
            self.admission.end_drives(owner)

    def connect(self, own_number: int | None, epoch: int | None) -> None:
        """Set the number of its device's connection at its host; None if it has none.

        The host decides whether a reconnection is an interruption: then its `epoch` differs.
        """
        if own_number is None:
            if self.link is not None:
                self.admission.disconnect(loop_time_s())
            self.link = None
        elif self.link is None or self.link.own_number != own_number:
            self.link = RemoteLink(self._new_number(), own_number)
            is_resumed = epoch is not None and epoch == self._epoch
            self.admission.resume_after_reconnect_s = math.inf if is_resumed else 0.0
            if self.admission.connect(loop_time_s()):
                self.resumed_link = self.link.number
            self._epoch = epoch  # also if it is lower: the host may have restarted

    def offer(self, velocities: Iterable[tuple[str, str]]) -> None:
        """Subscribe to these velocity topics, by name and type, while no device here has them."""
        wanted = frozenset(velocities)
        if self._velocities == wanted:
            return
        self._graph.leave(self._node)
        before, self._velocities = self._velocities, wanted
        for name, type_name in wanted:
            subscription = DeviceSubscription(self._receive, is_gate=True)
            try:
                topic = self._graph.subscribe_device(name, self._node, subscription, type_name=type_name)
            except HostlinkError as error:
                log.warning("topic.refused", topic=name, reason=str(error))
            else:
                if (name, type_name) not in before:
                    self.join(topic)

    def is_read(self, topic: str) -> bool:
        """Whether a velocity topic of it has subscribers here, apart from the robot itself."""
        known = self._graph.find_or_none(topic)
        return known is not None and bool(known.subscribers)

    def show(self, topic: str, payload: bytes) -> None:
        """Show what its gate has sent to the device to the subscribers of a velocity topic here. It drives nothing."""
        known = self._graph.find_or_none(topic)
        if known is not None and any(topic == name for name, _ in self._velocities):
            known.deliver(payload, source=self, at_s=loop_time_s())

    # -- its end ------------------------------------------------------------------------------------------------------

    def release_driver(self) -> None:
        """Tell its host that the source here that drives it has left: it stops."""
        lease = self.admission.driver("", loop_time_s())
        if lease is not None:
            source = lease.source
            self.admission.withdraw(source)
            self.provision.order(lambda provider: provider.release(source))

    def leave(self) -> None:
        """Leave the graph: its component announces it no longer."""
        self._has_left = True
        self._graph.leave(self._node)

    def _receive(self, message: Message) -> None:
        """Receive a velocity that was published here.

        Raises:
            HostlinkError: as from `command`; also if a device here has the same topic.
        """
        if sum(not device.is_away for device in self._graph.find(message.topic).devices.values()) > 1:
            raise DeviceGone(self.name, f"{message.topic} is a topic here and at {self.host}")
        self.receive(message)

    def _check_there(self) -> None:
        if self._has_left:
            raise DeviceGone(self.name, f"{self.host} is gone")

    def _check_unique(self) -> None:
        """Refuse a request that could mean either of two robots, or one that is not announced any longer.

        Raises:
            DeviceGone: several hosts have a robot of this name, or none has.
        """
        self._check_there()
        if self.also_at:
            places = ", ".join((self.host, *self.also_at))
            raise DeviceGone(self.name, f"several robots have this name, at {places}; rename all but one of them")


class RemoteRobots:
    """Robots that one run of a component announces. They are withdrawn with the run."""

    def __init__(self, robots: "Robots", gates: Gates, graph: TopicGraph, provision: Provision) -> None:
        """Reach the provider from now on."""
        self._robots, self._gates, self._graph, self._provision = robots, gates, graph, provision
        self._has_ended = False
        self._has_lost = False  # robots that it announced until the end
        gates.providers.add(provision)

    def announce(self, known: RobotState, *, host: str, place: Hashable = "") -> RemoteRobot:
        """Announce a robot, which is not connected yet. Its name is that of `known`.

        An earlier robot of this name is replaced: its drivers still drive it. `host` names its host, as users see it.

        Raises:
            BadRequest: the run has ended, the name is invalid, another component announces it, or there are too many.
        """
        name = known.name
        before = self._robots.remote.get(name)
        if self._has_ended:
            raise BadRequest(f"robot {name}: the run of {self._provision.name} has ended")
        if re.fullmatch(r"\w{1,64}", name, re.ASCII) is None:
            raise BadRequest(f"robot {name!r}: a name has 1 to 64 letters, digits and _")
        if before is not None and before.provision is not self._provision:
            raise BadRequest(f"robot {name}: {before.provision.name} announces it already")
        if before is None and len(self._robots.remote) >= MAX_REMOTE:
            raise BadRequest(f"robot {name}: more than {MAX_REMOTE} robots are announced")
        robot = RemoteRobot(
            known,
            host=host,
            place=place,
            provision=self._provision,
            gates=self._gates,
            graph=self._graph,
            new_number=self._robots.new_number,
        )
        if before is not None:
            robot.admission = before.admission
        self._robots.put_remote(robot)
        return robot

    def get(self, name: str) -> RemoteRobot | None:
        """Return the robot of this name; None if the run announces none."""
        robot = self._robots.remote.get(name)
        return robot if robot is not None and robot.provision is self._provision else None

    def all(self) -> list[RemoteRobot]:
        """Return all robots of the run."""
        return [each for each in self._robots.remote.values() if each.provision is self._provision]

    def withdraw(self, name: str) -> None:
        """Announce a robot no longer. Do nothing if the run announces none of this name."""
        if self.get(name) is not None:
            self._robots.pop_remote(name)

    def withdraw_all(self) -> None:
        """Announce no robot any longer. What a source here drives is released."""
        for robot in self.all():
            self._has_lost = True
            robot.release_driver()
            self._robots.pop_remote(robot.name)

    def close(self, *, is_resumed: bool) -> None:
        """Withdraw all robots; the provider is not reached again. Called by the daemon at the end of the run.

        `is_resumed`: another run follows. Until then a stop or a lock of all is an error, if there was a robot.
        """
        self._has_ended = True
        self.withdraw_all()
        if is_resumed and self._has_lost:
            self._provision.has_ended = True
        else:
            self._gates.providers.remove(self._provision)
