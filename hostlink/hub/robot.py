"""Robots as the rest of hostlink uses them: `LocalRobot` has its link here, `RemoteRobot` at another daemon."""

import asyncio
import dataclasses
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
from hostlink.hub.gates import Drivable, Driven, Gates, RemoteHosts
from hostlink.hub.message import Message
from hostlink.hub.node import Node, address_of
from hostlink.hub.robot_events import EventKind
from hostlink.hub.topic import DeviceSubscription
from hostlink.hub.topic_graph import TopicGraph
from hostlink.link.link import Link
from hostlink.logs import printable
from hostlink.robot.admission import EPOCH_BITS, Admission, Command
from hostlink.robot.directory import SURE_S, RobotTopicNames
from hostlink.robot.odometry import READERS, OdometryCorrection, OdometryEstimator, OdometrySnapshot
from hostlink.robot.standstill import OLD_S
from hostlink.robot.state import DEVICE_AWAY, BatteryReading, RobotState, read_battery
from hostlink.robot.velocity import PlanarVelocity
from hostlink.robot.velocity_gate import Limits, VelocityGate

log = structlog.get_logger()


def of_namesake(config: RobotConfig | None) -> RobotConfig:
    """The limits of a robot apply to others that announce the same name; its topics and wheels are its own."""
    if config is None:
        return RobotConfig()
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
    """The correction of the robot's odometry; None: it has none."""
    calibration = config.calibration
    if calibration == CalibrationConfig():
        return None
    return OdometryCorrection(
        calibration.left_factor,
        calibration.right_factor,
        calibration.nominal_separation_m,
        calibration.separation_m,
    )


def limits_of(config: RobotConfig) -> Limits:
    """The limits as the gate has them.

    Raises:
        ConfigError: one of them cannot be kept.
    """
    return Limits(
        max_linear_m_s=config.max_linear_m_s,
        max_angular_rad_s=config.max_angular_rad_s,
        max_wheel_m_s=config.max_wheel_m_s,
        wheel_separation_m=config.wheel_separation_m,
        max_linear_acceleration_m_s2=config.max_linear_acceleration_m_s2,
        max_angular_acceleration_rad_s2=config.max_angular_acceleration_rad_s2,
        max_linear_deceleration_m_s2=config.max_linear_deceleration_m_s2,
        max_angular_deceleration_rad_s2=config.max_angular_deceleration_rad_s2,
    )


LOCK_REASON = "emergency stop"  # where none was given

Follow = Callable[[Message | None], None]


class Robot(Driven):
    """A robot, connected or not. Methods are synchronous; what is asked of another daemon is answered later."""

    host: str | None  # the name of the daemon that has it; None: this one
    also_at: tuple[str, ...]  # other daemons that have a robot of this name
    odometry: "OdometryEstimator | RemoteOdometry"
    followers: dict[Hashable, Follow]  # called after each new pose; the message is None for one of another daemon
    resumed_link: int  # the number of the connection since which no reconnection was an interruption

    @property
    @abstractmethod
    def link(self) -> "Link | RemoteLink | None":
        """The connection of its device; None: its device is not connected."""

    @abstractmethod
    def state(self, now_s: float) -> RobotState:
        """Everything that is shown of it."""

    @abstractmethod
    def command(self, command: Command[PlanarVelocity]) -> PlanarVelocity:
        """Drive for the length of a lease; as `Driven.command`."""

    @abstractmethod
    def answer(self, owner: Hashable) -> Awaitable[PlanarVelocity] | None:
        """What becomes of the newest command of an owner; None: what `command` returned is the answer.

        Raises (when it is awaited):
            DeviceGone: the daemon that has the robot has not answered in time, or its device is not connected.
            CommandRefused, FrameTooLarge, WrongType, UnknownTopic: it has refused the command.
        """

    @abstractmethod
    def limited_by(self, velocity: PlanarVelocity) -> str | None:
        """The setting that slows a velocity down most; None: none does, or another daemon has it."""

    @abstractmethod
    def stop(self) -> None:
        """Stop it, and whatever else its link drives, as fast as decelerations allow, whoever drives.

        Raises:
            HostlinkError: the zero does not fit the device.
        """

    @abstractmethod
    def lock(self, reason: str = LOCK_REASON) -> None:
        """Zero at once, and no command until `unlock`; also while its device is not connected.

        Raises:
            HostlinkError: the zero does not fit the device; the robot is locked all the same.
        """

    @abstractmethod
    def unlock(self) -> None:
        """Let it be driven again; nothing moves by it.

        Raises:
            DeviceGone: it is not known which robot is meant.
        """

    @abstractmethod
    def why_moving(self) -> str:
        """Why it moves although it was sent a stop."""

    @abstractmethod
    def why_unknown(self) -> str:
        """Why its odometry does not say whether it stands."""

    def measured(self, now_s: float) -> OdometrySnapshot | None:
        """The newest odometry that is new enough to say whether it moves; None: there is none."""
        odometry = self.odometry.snapshot(now_s)
        return None if self.link is None or odometry is None or odometry.age_s >= SURE_S else odometry


# -- of this daemon ---------------------------------------------------------------------------------------------------


@dataclass(eq=False, kw_only=True)
class LocalRobot(Drivable, Robot):
    """It outlives its link: a robot that comes back continues with the same gate, at zero."""

    gate: VelocityGate[PlanarVelocity]
    config: RobotConfig
    odometry: OdometryEstimator
    topics: RobotTopicNames  # as its device names them
    shown: RobotTopicNames  # as the graph names them
    on_lock: "Callable[[LocalRobot], None]"  # it was locked or unlocked: one that is locked is never forgotten
    locked_link: Link | None = None  # the one that it had when it was locked
    is_played: bool = False
    host: None = None
    also_at: tuple[str, ...] = ()
    unreadable: int = 0  # messages of its odometry that are none
    velocities: dict[str, str] = field(default_factory=dict)  # its device's velocity topics as shown, and as named
    heard: frozenset[str] = frozenset()  # topics that its gate subscribes to, also while its device is away
    battery: BatteryReading | None = None  # the newest on this link
    followers: dict[Hashable, Follow] = field(default_factory=dict)

    def state(self, now_s: float) -> RobotState:
        """Everything that is shown of it."""
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

    def answer(self, owner: Hashable) -> None:  # noqa: ARG002 - of another daemon's robot it matters
        """What `command` returned is the answer."""
        return

    def limited_by(self, velocity: PlanarVelocity) -> str | None:
        """The setting that slows a velocity down most."""
        return self.gate.limits.slowest(velocity)

    def stop(self) -> None:
        """Stop it, and robots of its name at other daemons."""
        if self.also_at and self.gates.hosts is not None:
            self.gates.hosts.stop(self.name)
        self.stop_here()

    def stop_here(self) -> None:
        """Stop it alone."""
        self.gates.stop(self.beside)

    def lock(self, reason: str = LOCK_REASON) -> None:
        """Lock it, and robots of its name at other daemons."""
        if self.also_at and self.gates.hosts is not None:
            self.gates.hosts.lock(self.name, printable(reason))
        self.lock_here(reason)

    def lock_here(self, reason: str) -> None:
        """Lock it alone."""
        self.locked_link = self.link
        try:
            self.gates.lock(self.beside, printable(reason))
        finally:
            self.on_lock(self)
            log.warning("robot.locked", robot=self.name, reason=self.gate.lock_reason)
            self.gates.events.note(EventKind.LOCKED, self.name, reason=self.gate.lock_reason)

    def unlock(self) -> None:
        """Let it be driven again; one of its name at another daemon stays as it is."""
        if self.gate.lock_reason is not None:
            log.warning("robot.unlocked", robot=self.name, reason=self.gate.lock_reason)
            self.gates.events.note(EventKind.UNLOCKED, self.name, reason=self.gate.lock_reason)
        self.gates.unlock(self.beside)
        self.on_lock(self)

    def is_surely_there(self) -> bool:
        """Whether a locked robot is on the link on which it was locked, and that link lives."""
        link = self.link
        return link is not None and link is self.locked_link and link.received_at_s > _now_s() - SURE_S

    def why_moving(self) -> str:
        """Why it moves although it was sent a stop."""
        return _why_moving(
            is_played=self.is_played,
            drivers=(each.gate.owner_name for each in self.beside),
            unreachable=self.refusals.cause,
            velocities=(each.gate.current for each in self.beside),
        )

    def why_unknown(self) -> str:
        """Why its odometry does not say whether it stands."""
        link = self.link
        if link is None:
            return "its device is not connected"
        if self.odometry.count == 0:
            return "it sends no odometry"
        if link.silent_s > OLD_S:
            return f"nothing has come from its device for {link.silent_s:.1f} s"
        return "no odometry has come since the stop"

    def receive_odometry(self, message: Message) -> None:
        """A message of its odometry's topic. A pose belongs to the robot of the link by which it came."""
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
        self.odometry.update(reading.pose, now_s=message.at_s, wall_ns=stamp_ns, twist=reading.twist)
        if self.odometry.count > count:
            for follow in tuple(self.followers.values()):  # one may leave meanwhile
                follow(message)

    def receive_battery(self, payload: bytes) -> None:
        """A message of its battery's topic."""
        self.battery = read_battery(payload)


# -- of another daemon ------------------------------------------------------------------------------------------------


class RobotHosts(RemoteHosts, Protocol):
    """How the daemons that have other robots are reached."""

    def drive(
        self, robot: "RemoteRobot", velocity: PlanarVelocity, *, owner: Hashable, priority: int, epoch: int | None
    ) -> None:
        """Send a command of an owner; what it was refused for is raised by the next one, or by `answer`."""
        ...

    async def answer(self, robot: "RemoteRobot", owner: Hashable) -> PlanarVelocity:
        """The answer to the newest command of an owner: the velocity after the limits."""
        ...

    def unlock(self, robot: "RemoteRobot") -> None:
        """Let it be driven again."""
        ...


class RemoteLink(NamedTuple):
    """The device's connection over there. `number` is one of this daemon's numbers, `own_number` the other's."""

    number: int
    own_number: int


class RemoteOdometry:
    """The newest pose that the other daemon sent. It sends poses as they come while they are read here."""

    def __init__(self) -> None:
        self.read_at_s = -math.inf
        self.count = 0
        self._newest: OdometrySnapshot | None = None
        self._at_s = 0.0

    def update(self, newest: OdometrySnapshot, now_s: float) -> bool:
        """Returns whether it is another pose than before."""
        is_new = self._newest is None or (newest.count, newest.restarts) != (self._newest.count, self._newest.restarts)
        self._newest, self._at_s, self.count = newest, now_s, newest.count
        return is_new

    def snapshot(self, now_s: float) -> OdometrySnapshot | None:
        """The newest pose with its age; None before the first."""
        self.read_at_s = now_s
        if self._newest is None:
            return None
        return dataclasses.replace(self._newest, age_s=self._newest.age_s + now_s - self._at_s)


@dataclass(eq=False, kw_only=True)
class RemoteRobot(Robot):
    """A robot as the daemon that has it describes it. Its gate and its lease are there.

    Whoever publishes here on one of its velocity topics commands it, as with a robot that is here.
    """

    name: str
    host: str
    place: Hashable  # which daemon that is: names may repeat
    known: RobotState  # as it was sent last
    hosts: RobotHosts
    gates: Gates
    graph: TopicGraph
    link: RemoteLink | None = None
    also_at: tuple[str, ...] = ()  # then it is not driven from here
    resumed_link: int = 0
    odometry: RemoteOdometry = field(default_factory=RemoteOdometry)
    followers: dict[Hashable, Follow] = field(default_factory=dict)
    admission: Admission = field(init=False)  # of commands that are sent there from here
    _epoch: int | None = None  # of the admission there
    _node: Node = field(init=False)  # subscribes to its velocity topics
    _velocities: frozenset[tuple[str, str]] = frozenset()

    def __post_init__(self) -> None:
        self.admission = Admission(self.name, epoch=secrets.randbits(EPOCH_BITS))
        self._node = Node(f"{self.name} at {self.host}")

    def state(self, now_s: float) -> RobotState:
        """Everything that is shown of it, with the numbers and the epoch that programs here know."""
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
        """Send a command to the daemon that has the robot, if it is admitted here; returns it as it was sent.

        Raises:
            CommandRefused: it is not admitted; or as the answer to the command of its source before this one.
            DeviceGone: it is not known which robot is meant, or its daemon does not answer.
            FrameTooLarge, WrongType: so was the command of its source before this one answered.
        """
        command = self.gates.timed(self.name, command)
        self._check_unique()
        decision = self.admission.decide(command, _now_s())
        if decision.kind is not None:
            raise CommandRefused(self.name, decision.kind, decision.reason, holder=decision.holder)
        epoch = None if command.epoch is None else self._epoch
        self.hosts.drive(self, command.velocity, owner=command.source, priority=command.priority, epoch=epoch)
        return command.velocity

    def answer(self, owner: Hashable) -> Awaitable[PlanarVelocity]:
        """What the other daemon answers to the newest command of an owner."""
        return self.hosts.answer(self, owner)

    def limited_by(self, velocity: PlanarVelocity) -> None:  # noqa: ARG002 - of one that is here it matters
        """Its limits are at its daemon."""
        return

    def stop(self) -> None:
        """Stop whatever has its name, wherever it is, but here."""
        if self.gates.hosts is not None:
            self.gates.hosts.stop(self.name)

    def lock(self, reason: str = LOCK_REASON) -> None:
        """Lock whatever has its name, wherever it is, but here."""
        if self.gates.hosts is not None:
            self.gates.hosts.lock(self.name, printable(reason))

    def unlock(self) -> None:
        """Let it be driven again.

        Raises:
            DeviceGone: it is not known which robot is meant.
        """
        self._check_unique()
        self.hosts.unlock(self)

    def why_moving(self) -> str:
        """Why it moves although it was sent a stop."""
        known = self.known
        return _why_moving(
            is_played=known.is_played,
            drivers=(known.holder,),
            unreachable=known.unreachable,
            velocities=(known.velocity,),
        )

    def why_unknown(self) -> str:
        """Why its odometry does not say whether it stands."""
        if self.link is None:
            return "its device is not connected"
        if self.odometry.count == 0:
            return "it sends no odometry"
        return f"no odometry of it has come from {self.host} since the stop"

    def update(self, known: RobotState, *, epoch: int | None) -> None:
        """Its daemon describes it as this now: what was interrupted there is interrupted here.

        `epoch`: None: its daemon knows no epochs.
        """
        self.known = known
        self.admission.lease_s = known.lease_s
        self.note_epoch(epoch, lock_reason=known.lock_reason)
        if known.odometry is not None and self.odometry.update(known.odometry, _now_s()):
            for follow in tuple(self.followers.values()):
                follow(None)

    def note_epoch(self, epoch: int | None, *, lock_reason: str | None) -> None:
        """Note what the other daemon says of its admission."""
        admission, now_s = self.admission, _now_s()
        if lock_reason is not None and admission.lock_reason != lock_reason:
            admission.lock(lock_reason, now_s)
        elif lock_reason is None and admission.lock_reason is not None:
            admission.unlock(now_s)
        elif self._epoch is not None and epoch is not None and epoch > self._epoch:
            admission.interrupt(now_s)
        if epoch is not None:  # a state may be older than an answer
            self._epoch = epoch if self._epoch is None else max(epoch, self._epoch)

    def connect(self, own_number: int | None, epoch: int | None, new_number: Callable[[], int]) -> None:
        """Its device has this connection over there; None: none. `new_number`: for one more connection.

        Whether a reconnection is an interruption is decided there: then its `epoch` is another.
        """
        if own_number is None:
            if self.link is not None:
                self.admission.disconnect(_now_s())
            self.link = None
        elif self.link is None or self.link.own_number != own_number:
            self.link = RemoteLink(new_number(), own_number)
            is_resumed = epoch is not None and epoch == self._epoch
            self.admission.resume_after_reconnect_s = math.inf if is_resumed else 0.0
            if self.admission.connect(_now_s()):
                self.resumed_link = self.link.number
            self._epoch = epoch  # it may have another beginning

    def offer(self, velocities: Iterable[tuple[str, str]]) -> None:
        """It is driven by these topics, by name and type, while no device here has them."""
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
        """No other daemon has it any more."""
        self.graph.leave(self._node)

    def _receive(self, message: Message) -> None:
        """A velocity that was published here.

        Raises:
            HostlinkError: as `command`; also where a device here has the same topic.
        """
        if sum(not device.is_away for device in self.graph.find(message.topic).devices.values()) > 1:
            raise DeviceGone(self.name, f"{message.topic} is a topic here and at {self.host}")
        self.receive(message)

    def _check_unique(self) -> None:
        """Refuse what could mean either of two robots.

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


def _now_s() -> float:
    return asyncio.get_running_loop().time()
