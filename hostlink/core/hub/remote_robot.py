"""RemoteRobot: a robot whose gate is not here. A component announces it, and is asked to drive and to stop it."""

import math
import secrets
from collections.abc import Awaitable, Callable, Hashable, Iterable

import msgspec
import structlog

from hostlink.core.hub.any_robot import LOCK_REASON, AnyRobot, Follow, reason_for_motion, shown_reason
from hostlink.core.hub.gates import Gates
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node
from hostlink.core.hub.providers import ProvidedRobot, Provision
from hostlink.core.hub.remote_state import RemoteLink, RemoteOdometry
from hostlink.core.hub.topic import DeviceSubscription
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.robot.admission import EPOCH_BITS, Admission, Command
from hostlink.core.robot.feedback import FeedbackKind
from hostlink.core.robot.standstill import NO_ODOMETRY
from hostlink.core.robot.state import DEVICE_AWAY, RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import CommandRefused, DeviceGone, HostlinkError, RefusalKind

log = structlog.get_logger()


class RemoteRobot(AnyRobot, ProvidedRobot):
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
            epoch = None if command.epoch is None else self._epoch
            self.provision.drive(self, command._replace(received_s=began_s, epoch=epoch))
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
            admission.unlock(now_s, came_s=self._gates.came_s(now_s))
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
            now_s = loop_time_s()
            if self.admission.connect(now_s, came_s=self._gates.came_s(now_s)):
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
