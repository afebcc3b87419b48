"""LocalRobot: a robot whose device connects to this daemon."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import structlog

from hostlink.core.config import RobotConfig
from hostlink.core.diagnosis.motion_monitor import RECENT_S, Speed
from hostlink.core.hub.any_robot import LOCK_REASON, AnyRobot, Follow, reason_for_motion, shown_reason
from hostlink.core.hub.gates import Connection, Drivable
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import address_of
from hostlink.core.hub.robot_settings import frames_of
from hostlink.core.link.link import Link
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.feedback import Feedback
from hostlink.core.robot.model import RobotTopicNames
from hostlink.core.robot.names import SURE_S
from hostlink.core.robot.odometry import OdometryEstimator
from hostlink.core.robot.readings import Flaw, OdometryReading
from hostlink.core.robot.ros_messages import FrameIds
from hostlink.core.robot.standstill import NO_ODOMETRY, OLD_S
from hostlink.core.robot.state import BatteryReading, RobotState, read_battery
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import VelocityGate
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import BadPayload

log = structlog.get_logger()


@dataclass(eq=False, kw_only=True)
class LocalRobot(Drivable, AnyRobot):
    """Robot of this daemon. It outlives its link: after a reconnection it continues with the same gate, at zero."""

    gate: VelocityGate[PlanarVelocity]
    config: RobotConfig
    odometry: OdometryEstimator
    feedback: Feedback
    topics: RobotTopicNames  # names that the device uses
    shown: RobotTopicNames  # names in the graph
    on_lock: "Callable[[LocalRobot], None]"  # called after a lock or unlock: a locked robot is never forgotten
    locked_link: Link | None = None  # link at the time of the lock
    parts: tuple[Connection, ...] = ()  # its other devices, if it consists of several
    candidates: tuple[Connection, ...] = ()  # while its device is away: those without a robot that may be it
    last_link: int = 0  # number of the link of its last device that was no recording
    last_address: str = ""  # of this device
    feedback_links: dict[tuple[str, str], Link] | None = None  # of each topic of its feedback; None: its own link
    has_had_device: bool = False  # one that is not a recording
    host: None = None
    also_at: tuple[str, ...] = ()
    unreadable: int = 0  # messages of its odometry that could not be decoded
    velocities: dict[str, str] = field(default_factory=dict)  # velocity topics: name in the graph -> device's name
    heard: frozenset[str] = frozenset()  # topics of its gate, also while its device is not connected
    battery: BatteryReading | None = None  # newest reading on this link
    followers: dict[Hashable, Follow] = field(default_factory=dict)

    @property
    def beside(self) -> list[Drivable]:
        """All velocity topics of its devices."""
        return [*super().beside, *(drivable for part in self.parts for drivable in part.drivables)]

    @property
    def frames(self) -> FrameIds:
        """Frame ids of its odometry and of its body."""
        return frames_of(self.name, self.config)

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
            command_type=shown.velocity_type,
            feedback=self.feedback.kind,
            is_played=self.is_played,
            holder=None if driver is None else str(driver.source),
            holder_address=None if driver is None else address_of(driver.source) or None,
            priority=None if driver is None else driver.priority,
            lock_reason=admission.lock_reason,
            epoch=admission.epoch,
            unreachable=self._unreachable,
            wheel_separation_m=self.config.wheel_separation_m,
            kinematics=admission.kinematics,
            lease_s=admission.lease_s,
            velocity=gate.current,
            odometry=self.odometry.snapshot(now_s),
            battery_v=None if battery is None else battery.voltage_v,
            battery_percent=None if battery is None else battery.percent,
            signal_dbm=None if monitor is None else monitor.signal_dbm(now_s),
            device_errors=() if connection is None else self._device_errors(connection),
            firmware=None if monitor is None else monitor.firmware,
        )

    @property
    def _unreachable(self) -> str | None:
        """Return why it cannot be driven or stopped although a device of it is connected; None if it can."""
        if self.connection is None:
            return self.refusals.cause or self.admission.missing or self._why_no_candidate or None
        return self.refusals.cause or self.admission.missing or self.no_stop or None

    @property
    def is_away_and_locked(self) -> bool:
        """Whether it is locked and its device is not connected, so that its lock holds for what may be it."""
        return self.connection is None and self.gate.lock_reason is not None

    @property
    def _why_no_candidate(self) -> str:
        """Return what the devices that may be this robot lack; empty if there are no such devices."""
        peers = " and ".join(each.link.peer for each in self.candidates)
        return peers and f"{peers}, which may be its device, takes no velocity of it"

    def _device_errors(self, connection: Connection) -> tuple[str, ...]:
        """Return the codes of the findings of all its devices."""
        findings = (each.code for device in (connection, *self.parts) for each in device.diagnosis.findings)
        return tuple(dict.fromkeys(findings))

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
        if self.also_at:
            self.gates.providers.stop(self.name)
        self.stop_here(by=by)

    def stop_here(self, *, by: str | None = None) -> None:
        """Stop only this robot."""
        try:
            self.gates.stop(self._stopped, by=by)
        finally:
            self._stop_unguarded()

    def lock(self, reason: str = LOCK_REASON, *, by: str | None = None) -> None:
        """Lock the robot, and robots of its name at other daemons."""
        if self.also_at:
            self.gates.providers.lock(self.name, shown_reason(reason))
        self.lock_here(reason, by=by)

    def lock_here(self, reason: str, *, by: str | None = None) -> None:
        """Lock only this robot."""
        self.locked_link = self.link
        try:
            self.gates.lock(self._stopped, shown_reason(reason), by=by)
        finally:
            self._stop_unguarded()
            self.on_lock(self)
            log.warning("robot.locked", robot=self.name, reason=self.gate.lock_reason)
            self.gates.events.note(EventKind.LOCKED, self.name, reason=self.gate.lock_reason)

    @property
    def devices(self) -> tuple[Connection, ...]:
        """Connected devices of this robot, and those that may be it."""
        others = (*self.parts, *self.candidates)
        return others if self.connection is None else (self.connection, *others)

    @property
    def _stopped(self) -> list[Drivable]:
        """All velocity topics of its devices, and of those that may be it."""
        return [*self.beside, *(drivable for each in self.candidates for drivable in each.drivables)]

    def _stop_unguarded(self) -> None:
        """Send zero to what else its devices take that looks like a command."""
        for device in self.devices:
            device.stop_unguarded()

    @property
    def unguarded_endpoints(self) -> list[CommandEndpoint]:
        """Return what else its devices take that looks like a command, after a stop or a lock."""
        found = (each for device in self.devices for each in device.unguarded_endpoints())
        return [each._replace(robot=self.name) for each in found]

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
        return reason_for_motion(
            is_played=self.is_played,
            drivers=(each.gate.owner_name for each in self.beside),
            unreachable=self.refusals.cause and f"its device cannot receive the stop: {self.refusals.cause}",
            velocities=(each.gate.current for each in self.beside),
        )

    @property
    def answer_s(self) -> float:
        """Seconds that the robot's device took to answer the host; 0 if that is not known."""
        return 0.0 if self.link is None else self.link.session.device_clock.answer_s or 0.0

    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""
        link = self.link
        if link is None or self.admission.missing:
            return self.admission.missing or self._why_no_candidate or "its device is not connected"
        if not self.feedback.topics:
            cause = self.refusals.cause
            return NO_ODOMETRY if cause is None else f"its device cannot receive the stop: {cause}"
        flawed = self.flawed_poses(loop_time_s())
        if flawed:
            return f"it sent {flawed} in the last {RECENT_S:.0f} s"
        if self.odometry.count == 0:
            return "it sends no odometry"
        if link.silent_s > OLD_S:
            return f"nothing has come from its device for {link.silent_s:.1f} s"
        return "no odometry has come since the stop"

    def flawed_poses(self, now_s: float) -> str:
        """Return what is wrong with the poses of the last half minute, such as "10 poses with NaN"; empty: nothing."""
        return "" if self.connection is None else self.connection.diagnosis.monitor.motion.evidence(now_s).without_pose

    def receive_feedback(self, topic: str, message: Message) -> None:
        """Receive a message of a topic of its feedback, by the device's name of it.

        Messages that did not arrive on the link that it reads are ignored.
        """
        key = (topic, message.type_name)
        link = self.link if self.feedback_links is None else self.feedback_links.get(key)
        if message.source is not link or key not in self.feedback.topics:
            return
        odometry = self.odometry
        count, ignored, restarts = odometry.count, odometry.ignored, odometry.restarts
        try:
            reading = self.feedback.read(topic, message.payload, now_s=message.at_s)
        except BadPayload as error:
            self.unreadable += 1
            log.debug("odometry.unreadable", robot=self.name, reason=str(error))
            return
        if reading is None:
            return
        stamp_ns = message.stamp_ns
        if reading.stamp_ns is not None and link is not None:  # by the device's clock
            stamp_ns = link.session.device_clock.to_host_ns(reading.stamp_ns, stamp_ns)
        if Flaw.SENT_BACK in reading.flaws:  # so were the poses before, by which that is known
            odometry.withdraw()
        odometry.update(
            reading.pose,
            now_s=message.at_s,
            wall_ns=stamp_ns,
            twist=reading.twist,
            is_stamped=bool(reading.stamp_ns),
            is_moving=reading.is_moving,
        )
        is_jump = not reading.is_empty and (odometry.ignored, odometry.restarts) != (ignored, restarts)
        self._judge(reading, message.at_s, is_jump=is_jump)
        if odometry.count > count:
            for follow in tuple(self.followers.values()):  # one may leave meanwhile
                follow(message)

    def _judge(self, reading: OdometryReading, now_s: float, *, is_jump: bool = False) -> None:
        """Let the diagnosis of the link judge a reading, also against the velocity that the device was sent."""
        if self.connection is None:
            return
        monitor = self.connection.diagnosis.monitor.motion
        monitor.observe(reading.flaws, now_s, frame_id=reading.frame_id, is_jump=is_jump)
        sent = self.gate.current
        commanded = Speed(sent.x_m_s, sent.yaw_rad_s)
        if not monitor.is_due(commanded, now_s):
            return
        measured = None if sent.is_zero else self.odometry.snapshot(now_s)
        if measured is not None and measured.twist is not None:
            twist = measured.twist
            monitor.compare(commanded, Speed(twist.x_m_s, twist.yaw_rad_s), now_s)
        elif sent.is_zero:
            monitor.compare(Speed(), Speed(), now_s)

    def receive_battery(self, payload: bytes) -> None:
        """Receive a message of the battery's topic."""
        self.battery = read_battery(payload)
