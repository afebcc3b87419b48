"""AnyRobot: interface of a robot. `LocalRobot` is connected to this daemon, `RemoteRobot` to another one."""

import dataclasses
import functools
import math
import secrets
from abc import abstractmethod
from collections.abc import Awaitable, Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import msgspec
import structlog

from hostlink.config import CalibrationConfig, RobotConfig
from hostlink.errors import BadPayload, CommandRefused, DeviceGone, HostlinkError
from hostlink.hub.gates import Drivable, Gates, RemoteHosts, VelocityTarget
from hostlink.hub.message import Message
from hostlink.hub.node import Node, address_of
from hostlink.hub.robot_events import EventKind
from hostlink.hub.topic import DeviceSubscription
from hostlink.hub.topic_graph import TopicGraph
from hostlink.link.link import Link
from hostlink.logs import printable
from hostlink.loop_time import loop_time_s
from hostlink.robot.admission import EPOCH_BITS, Admission, Command
from hostlink.robot.names import SURE_S, RobotTopicNames
from hostlink.robot.odometry import READERS, OdometryCorrection, OdometryEstimator, OdometrySnapshot
from hostlink.robot.standstill import OLD_S
from hostlink.robot.state import DEVICE_AWAY, BatteryReading, RobotState, read_battery
from hostlink.robot.velocity import PlanarVelocity
from hostlink.robot.velocity_gate import Limits, VelocityGate

log = structlog.get_logger()


_DEFAULTS = RobotConfig()
LIMITS = tuple(each.name for each in dataclasses.fields(Limits) if each.init)  # settings of a robot have the same names


def of_namesake(config: RobotConfig | None) -> RobotConfig:
    """Return the settings of a robot that announces a configured name but is another one: only the limits apply."""
    if config is None:
        return _DEFAULTS
    return dataclasses.replace(
        config,
        address=None,
        odom_topic=None,
        cmd_vel_topic=None,
        cmd_vel_stamped_topic=None,
        odom_frame=None,
        base_frame=None,
        calibration=CalibrationConfig(),
    )


def correction_of(config: RobotConfig) -> OdometryCorrection | None:
    """Return the correction of the robot's odometry; None if it is not calibrated."""
    calibration = config.calibration
    if calibration == CalibrationConfig():
        return None
    return OdometryCorrection(**dataclasses.asdict(calibration))


@functools.lru_cache(maxsize=256)  # most robots have the same settings
def limits_of(config: RobotConfig) -> Limits:
    """Return the limits of a robot's gate.

    Raises:
        ConfigError: a limit is invalid.
    """
    return Limits(**{name: getattr(config, name) for name in LIMITS})


LOCK_REASON = "emergency stop"  # default
MAX_LOCK_REASON = 200  # characters, as many as a fleet passes on; a longer reason ends with an ellipsis

Follow = Callable[[Message | None], None]


def shown_reason(reason: str) -> str:
    """Return the reason of a lock as it is kept: printable, and with an ellipsis if it is cut."""
    if len(reason) <= MAX_LOCK_REASON:
        return printable(reason, MAX_LOCK_REASON)
    return printable(reason[: MAX_LOCK_REASON - 1].rstrip(), MAX_LOCK_REASON) + "…"


class AnyRobot(VelocityTarget):
    """Robot, connected or not. Methods are synchronous; another daemon answers later."""

    host: str | None  # name of its daemon; None for this one
    also_at: tuple[str, ...]  # other daemons with a robot of this name
    odometry: "OdometryEstimator | RemoteOdometry"
    followers: dict[Hashable, Follow]  # called after each new pose; the message is None for a remote robot
    resumed_link: int  # number of the connection since which no reconnection was an interruption

    @property
    @abstractmethod
    def link(self) -> "Link | RemoteLink | None":
        """Connection of the device; None if it is not connected."""

    @abstractmethod
    def state(self, now_s: float) -> RobotState:
        """Return the robot's state for all APIs."""

    @abstractmethod
    def command(self, command: Command[PlanarVelocity]) -> PlanarVelocity:
        """Drive for the length of a lease; as `VelocityTarget.command`."""

    @abstractmethod
    def answer(self, owner: Hashable) -> Awaitable[PlanarVelocity] | None:
        """Return the later answer to the newest command of a source; None if `command` has returned it.

        Raises (when it is awaited):
            DeviceGone: the robot's daemon did not answer in time, or its device is not connected.
            CommandRefused, FrameTooLarge, WrongType, UnknownTopic: the robot's daemon refused the command.
        """

    def let_go(self, owner: Hashable, reason: str) -> None:
        """Stop what a source drives, if it is this robot; `reason` is why the source drives no more."""

    @abstractmethod
    def limited_by(self, velocity: PlanarVelocity) -> str | None:
        """Return the setting that slows a velocity down most; None if none does, or for a remote robot."""

    @abstractmethod
    def stop(self, *, by: str | None = None) -> None:
        """Stop the robot and all velocity topics of its link, within the deceleration limits, for every source.

        `by` is who stops it, for refusals.

        Raises:
            HostlinkError: the zero does not fit the device.
        """

    @abstractmethod
    def lock(self, reason: str = LOCK_REASON, *, by: str | None = None) -> None:
        """Send zero at once, and refuse commands until `unlock`, also while the device is not connected.

        `by` is who locks it, for refusals.

        Raises:
            HostlinkError: the zero does not fit the device; the robot is locked nevertheless.
        """

    @abstractmethod
    def unlock(self, *, by: str | None = None) -> None:
        """Admit commands again. Unlocking moves nothing.

        Raises:
            DeviceGone: several robots have this name.
        """

    @abstractmethod
    def why_moving(self) -> str:
        """Return the reason why the robot moves after a stop."""

    @abstractmethod
    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""

    def measured(self, now_s: float) -> OdometrySnapshot | None:
        """Return the newest odometry if it is recent enough to show whether the robot moves; else None."""
        odometry = self.odometry.snapshot(now_s)
        return None if self.link is None or odometry is None or odometry.age_s >= SURE_S else odometry


# -- of this daemon ---------------------------------------------------------------------------------------------------


@dataclass(eq=False, kw_only=True)
class LocalRobot(Drivable, AnyRobot):
    """Robot of this daemon. It outlives its link: after a reconnection it continues with the same gate, at zero."""

    gate: VelocityGate[PlanarVelocity]
    config: RobotConfig
    odometry: OdometryEstimator
    topics: RobotTopicNames  # names that the device uses
    shown: RobotTopicNames  # names in the graph
    on_lock: "Callable[[LocalRobot], None]"  # called after a lock or unlock: a locked robot is never forgotten
    locked_link: Link | None = None  # link at the time of the lock
    has_had_device: bool = False  # one that is not a recording
    host: None = None
    also_at: tuple[str, ...] = ()
    unreadable: int = 0  # messages of its odometry that could not be decoded
    velocities: dict[str, str] = field(default_factory=dict)  # velocity topics: name in the graph -> device's name
    heard: frozenset[str] = frozenset()  # topics of its gate, also while its device is not connected
    battery: BatteryReading | None = None  # newest reading on this link
    followers: dict[Hashable, Follow] = field(default_factory=dict)

    @property
    def is_played(self) -> bool:
        """Whether its device is a recording."""
        return self.connection is not None and self.connection.diagnosis.is_played

    def state(self, now_s: float) -> RobotState:
        """Return the robot's state for all APIs."""
        gate, shown, connection, battery = self.gate, self.shown, self.connection, self.battery
        driver, admission = gate.driver, gate.admission
        monitor = None if connection is None else connection.diagnosis.monitor
        return RobotState(
            name=self.name,
            also_at=self.also_at,
            link=None if connection is None else connection.link.number,
            frames=None if connection is None else connection.link.session.counts.frames_from_device,
            velocity_topic=shown.velocity,
            odometry_topic=shown.odometry,
            odometry_type=shown.odometry_type,
            reset_topic=shown.reset,
            is_played=self.is_played,
            holder=None if driver is None else str(driver.source),
            holder_address=None if driver is None else address_of(driver.source) or None,
            priority=None if driver is None else driver.priority,
            lock_reason=admission.lock_reason,
            epoch=admission.epoch,
            unreachable=self.refusals.cause,
            wheel_separation_m=self.config.wheel_separation_m,
            kinematics=admission.kinematics,
            lease_s=admission.lease_s,
            velocity=gate.current,
            odometry=self.odometry.snapshot(now_s),
            battery_v=None if battery is None else battery.voltage_v,
            battery_percent=None if battery is None else battery.percent,
            signal_dbm=None if monitor is None else monitor.signal_dbm(now_s),
            device_errors=() if connection is None else tuple(each.code for each in connection.diagnosis.findings),
            firmware=None if monitor is None else monitor.firmware,
        )

    def answer(self, owner: Hashable) -> None:  # noqa: ARG002 - used by RemoteRobot
        """Return None: `command` has returned the answer."""
        return

    def let_go(self, owner: Hashable, reason: str) -> None:
        """Stop what a source drives, if it is this robot; `reason` is why the source drives no more."""
        self.gates.let_go(self.beside, owner, reason)

    def limited_by(self, velocity: PlanarVelocity) -> str | None:
        """Return the setting that slows a velocity down most; None if none does."""
        return self.gate.limits.slowest(velocity)

    def stop(self, *, by: str | None = None) -> None:
        """Stop the robot, and robots of its name at other daemons."""
        if self.also_at and self.gates.hosts is not None:
            self.gates.hosts.stop(self.name)
        self.stop_here(by=by)

    def stop_here(self, *, by: str | None = None) -> None:
        """Stop only this robot."""
        self.gates.stop(self.beside, by=by)

    def lock(self, reason: str = LOCK_REASON, *, by: str | None = None) -> None:
        """Lock the robot, and robots of its name at other daemons."""
        if self.also_at and self.gates.hosts is not None:
            self.gates.hosts.lock(self.name, shown_reason(reason))
        self.lock_here(reason, by=by)

    def lock_here(self, reason: str, *, by: str | None = None) -> None:
        """Lock only this robot."""
        self.locked_link = self.link
        try:
            self.gates.lock(self.beside, shown_reason(reason), by=by)
        finally:
            self.on_lock(self)
            log.warning("robot.locked", robot=self.name, reason=self.gate.lock_reason)
            self.gates.events.note(EventKind.LOCKED, self.name, reason=self.gate.lock_reason)

    def unlock(self, *, by: str | None = None) -> None:
        """Admit commands again. Robots of its name at other daemons are not unlocked."""
        if self.gate.lock_reason is not None:
            log.warning("robot.unlocked", robot=self.name, reason=self.gate.lock_reason)
            self.gates.events.note(EventKind.UNLOCKED, self.name, reason=self.gate.lock_reason)
        self.gates.unlock(self.beside, by=by)
        self.on_lock(self)

    def is_surely_there(self) -> bool:
        """Whether a locked robot still has the link on which it was locked, and the device sends on it."""
        link = self.link
        return link is not None and link is self.locked_link and link.received_at_s > loop_time_s() - SURE_S

    def why_moving(self) -> str:
        """Return the reason why the robot moves after a stop."""
        return _why_moving(
            is_played=self.is_played,
            drivers=(each.gate.owner_name for each in self.beside),
            unreachable=self.refusals.cause,
            velocities=(each.gate.current for each in self.beside),
        )

    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""
        link = self.link
        if link is None:
            return "its device is not connected"
        if self.odometry.count == 0:
            return "it sends no odometry"
        if link.silent_s > OLD_S:
            return f"nothing has come from its device for {link.silent_s:.1f} s"
        return "no odometry has come since the stop"

    def receive_odometry(self, message: Message) -> None:
        """Receive a message of the odometry topic. Messages that did not arrive on the robot's own link are ignored."""
        link = None if self.connection is None else self.connection.link
        if message.source is not link or message.type_name != self.topics.odometry_type:
            return
        count = self.odometry.count
        try:
            reading = READERS[message.type_name](message.payload)
        except BadPayload as error:
            self.unreadable += 1
            log.debug("odometry.unreadable", robot=self.name, reason=str(error))
            return
        stamp_ns = message.stamp_ns
        if reading.stamp_ns is not None and link is not None:  # by the device's clock
            stamp_ns = link.session.device_clock.to_host_ns(reading.stamp_ns, stamp_ns)
        is_stamped = bool(reading.stamp_ns)
        self.odometry.update(
            reading.pose, now_s=message.at_s, wall_ns=stamp_ns, twist=reading.twist, is_stamped=is_stamped
        )
        if self.odometry.count > count:
            for follow in tuple(self.followers.values()):  # one may leave meanwhile
                follow(message)

    def receive_battery(self, payload: bytes) -> None:
        """Receive a message of the battery's topic."""
        self.battery = read_battery(payload)


# -- of another daemon ------------------------------------------------------------------------------------------------


class RobotHosts(RemoteHosts, Protocol):
    """Interface to the daemons of remote robots."""

    def drive(
        self,
        robot: "RemoteRobot",
        velocity: PlanarVelocity,
        *,
        owner: Hashable,
        priority: int,
        received_s: float,
        epoch: int | None,
    ) -> None:
        """Send a command of a source, which lasts for a lease from `received_s` on.

        Its refusal is raised by the next command, or by `answer`.
        """
        ...

    def answer(self, robot: "RemoteRobot", owner: Hashable) -> Awaitable[PlanarVelocity]:
        """Return the later answer to the newest command of a source until now: the velocity after the limits."""
        ...

    def unlock(self, robot: "RemoteRobot") -> None:
        """Unlock a robot."""
        ...


class RemoteLink(NamedTuple):
    """Connection of a device at another daemon. `number` is of this daemon, `own_number` of the other one."""

    number: int
    own_number: int


class RemoteOdometry:
    """Newest pose from another daemon, which sends all poses while they are read here."""

    def __init__(self) -> None:
        self.read_at_s = -math.inf
        self.count = 0
        self._newest: OdometrySnapshot | None = None
        self._at_s = 0.0

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
        return dataclasses.replace(self._newest, age_s=self._newest.age_s + now_s - self._at_s)


@dataclass(eq=False, kw_only=True)
class RemoteRobot(AnyRobot):
    """Robot of another daemon, which has its gate and its lease, and describes its state.

    Messages on its velocity topics here are commands, as for a robot of this daemon.
    """

    name: str
    host: str
    place: Hashable  # identity of the daemon: names may repeat
    known: RobotState  # newest state from its daemon
    hosts: RobotHosts
    gates: Gates
    graph: TopicGraph
    link: RemoteLink | None = None
    also_at: tuple[str, ...] = ()  # if any, it is not driven from here
    resumed_link: int = 0
    odometry: RemoteOdometry = field(default_factory=RemoteOdometry)
    followers: dict[Hashable, Follow] = field(default_factory=dict)
    admission: Admission = field(init=False)  # of commands from here
    _epoch: int | None = None  # of its daemon's admission
    _node: Node = field(init=False)  # key of the subscriptions to its velocity topics
    _velocities: frozenset[tuple[str, str]] = frozenset()

    def __post_init__(self) -> None:
        self.admission = Admission(self.name, epoch=secrets.randbits(EPOCH_BITS), sees_bunches=False)
        self._node = Node(f"{self.name} at {self.host}")

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
        """Send a command to the robot's daemon if it is admitted here. Return the sent velocity.

        Raises:
            CommandRefused: the command is not admitted, or the previous one of this source was refused.
            DeviceGone: several robots have this name, or the robot's daemon does not answer.
            FrameTooLarge, WrongType: the answer to the previous command of this source.
        """
        now_s = loop_time_s()
        command = self.gates.timed(self.name, command, now_s)
        self._check_unique()
        decision = self.admission.decide(command, now_s)
        if decision.kind is not None:
            raise CommandRefused(self.name, decision.kind, decision.reason, holder=decision.holder, by=decision.by)
        lease = self.admission.driver("", now_s)  # None for a zero
        began_s = command.received_s if lease is None else lease.deadline_s - self.admission.lease_s
        self.hosts.drive(
            self,
            command.velocity,
            owner=command.source,
            priority=command.priority,
            received_s=began_s,
            epoch=None if command.epoch is None else self._epoch,
        )
        return command.velocity

    def answer(self, owner: Hashable) -> Awaitable[PlanarVelocity]:
        """Return the other daemon's answer to the newest command of a source."""
        return self.hosts.answer(self, owner)

    def limited_by(self, velocity: PlanarVelocity) -> None:  # noqa: ARG002 - used by LocalRobot
        """Return None: the limits are at the robot's daemon."""
        return

    def stop(self, *, by: str | None = None) -> None:  # noqa: ARG002 - used by LocalRobot
        """Stop the robots of this name at other daemons."""
        if self.gates.hosts is not None:
            self.gates.hosts.stop(self.name)

    def lock(self, reason: str = LOCK_REASON, *, by: str | None = None) -> None:  # noqa: ARG002 - used by LocalRobot
        """Lock the robots of this name at other daemons."""
        if self.gates.hosts is not None:
            self.gates.hosts.lock(self.name, shown_reason(reason))

    def unlock(self, *, by: str | None = None) -> None:  # noqa: ARG002 - used by LocalRobot
        """Unlock the robot.

        Raises:
            DeviceGone: several robots have this name.
        """
        self._check_unique()
        self.hosts.unlock(self)

    def why_moving(self) -> str:
        """Return the reason why the robot moves after a stop."""
        known = self.known
        return _why_moving(
            is_played=known.is_played,
            drivers=(known.holder,),
            unreachable=known.unreachable,
            velocities=(known.velocity,),
        )

    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""
        if self.link is None:
            return "its device is not connected"
        if self.odometry.count == 0:
            return "it sends no odometry"
        return f"no odometry of it has come from {self.host} since the stop"

    def update(self, known: RobotState, *, epoch: int | None) -> None:
        """Set the state from the robot's daemon. An interruption there is one here.

        `epoch` is None if that daemon has no epochs.
        """
        self.known = known
        self.admission.lease_s = known.lease_s
        self.note_epoch(epoch, lock_reason=known.lock_reason)
        if known.odometry is not None and self.odometry.update(known.odometry, loop_time_s()):
            for follow in tuple(self.followers.values()):
                follow(None)

    def note_epoch(self, epoch: int | None, *, lock_reason: str | None) -> None:
        """Note epoch and lock of the other daemon's admission."""
        admission, now_s = self.admission, loop_time_s()
        if lock_reason is not None and admission.lock_reason != lock_reason:
            admission.lock(lock_reason, now_s)
        elif lock_reason is None and admission.lock_reason is not None:
            admission.unlock(now_s)
        elif self._epoch is not None and epoch is not None and epoch > self._epoch:
            admission.interrupt(now_s)
        if epoch is not None:  # a state may be older than an answer
            self._epoch = epoch if self._epoch is None else max(epoch, self._epoch)

    def connect(self, own_number: int | None, epoch: int | None, new_number: Callable[[], int]) -> None:
        """Set the device's connection at the other daemon; None if it has none. `new_number` numbers a new connection.

        The other daemon decides whether a reconnection is an interruption: then its `epoch` differs.
        """
        if own_number is None:
            if self.link is not None:
                self.admission.disconnect(loop_time_s())
            self.link = None
        elif self.link is None or self.link.own_number != own_number:
            self.link = RemoteLink(new_number(), own_number)
            is_resumed = epoch is not None and epoch == self._epoch
            self.admission.resume_after_reconnect_s = math.inf if is_resumed else 0.0
            if self.admission.connect(loop_time_s()):
                self.resumed_link = self.link.number
            self._epoch = epoch  # also if it is lower: the other daemon may have restarted

    def offer(self, velocities: Iterable[tuple[str, str]]) -> None:
        """Subscribe to these velocity topics, by name and type, while no device here has them."""
        wanted = frozenset(velocities)
        if self._velocities == wanted:
            return
        self.graph.leave(self._node)
        before, self._velocities = self._velocities, wanted
        for name, type_name in wanted:
            subscription = DeviceSubscription(self._receive, is_gate=True)
            try:
                topic = self.graph.subscribe_device(name, self._node, subscription, type_name=type_name)
            except HostlinkError as error:
                log.warning("topic.refused", topic=name, reason=str(error))
            else:
                if (name, type_name) not in before:
                    self.join(topic)

    def leave(self) -> None:
        """Leave the graph: no other daemon has the robot."""
        self.graph.leave(self._node)

    def _receive(self, message: Message) -> None:
        """Receive a velocity that was published here.

        Raises:
            HostlinkError: as from `command`; also if a device here has the same topic.
        """
        if sum(not device.is_away for device in self.graph.find(message.topic).devices.values()) > 1:
            raise DeviceGone(self.name, f"{message.topic} is a topic here and at {self.host}")
        self.receive(message)

    def _check_unique(self) -> None:
        """Refuse a request that could mean either of two robots.

        Raises:
            DeviceGone: robots of several daemons have this name.
        """
        if self.also_at:
            places = ", ".join((self.host, *self.also_at))
            raise DeviceGone(self.name, f"several robots have this name, at {places}; rename all but one of them")


def _why_moving(
    *,
    is_played: bool,
    drivers: Iterable[str | None],
    unreachable: str | None,
    velocities: Iterable[PlanarVelocity | Any],
) -> str:
    driver = next(filter(None, drivers), None)
    if is_played:
        return "it is a recording, which obeys nobody"
    if driver is not None:
        return f"driven by {driver}"
    if unreachable is not None:
        return f"its device cannot receive the stop: {unreachable}"
    if not all(velocity.is_zero for velocity in velocities):
        return "it slows down within its deceleration limits"
    return "the stop was sent, and its device has not obeyed it yet"
