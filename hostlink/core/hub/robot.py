"""AnyRobot: interface of a robot. `LocalRobot` is connected to this daemon; `remote_robot.py` has the other kind."""

import dataclasses
import functools
import math
from abc import abstractmethod
from collections.abc import Awaitable, Callable, Hashable, Iterable, Sequence, Set
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import structlog

from hostlink.core.config import CalibrationConfig, FeedbackConfig, RobotConfig, ThrottleConfig, WheelsConfig
from hostlink.core.diagnosis.motion_monitor import RECENT_S, Speed
from hostlink.core.hub.gates import Drivable, VelocityTarget
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import address_of
from hostlink.core.link.link import Link
from hostlink.core.robot.admission import Command
from hostlink.core.robot.command_types import (
    ACKERMANN_TYPES,
    JOINT_STATE_TYPE,
    JOY_TYPE,
    NUMBER_TYPES,
    TEXT_TYPES,
    VECTOR_TYPE,
    AckermannCommand,
    CommandType,
    JoyCommand,
    ThrottleCommand,
    TopicType,
    TwistCommand,
    VectorCommand,
    WheelCommand,
    WheelScale,
    WordCommand,
    Words,
)
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.feedback import Feedback, FeedbackSettings
from hostlink.core.robot.kinematics import SETTINGS as DIMENSIONS
from hostlink.core.robot.kinematics import WHEELS_NEED, AckermannDrive, Drive, drive_of
from hostlink.core.robot.model import CommandKind, CommandSettings, RobotTopicNames
from hostlink.core.robot.names import SURE_S
from hostlink.core.robot.odometry import OdometryCorrection, OdometryEstimator, OdometrySnapshot
from hostlink.core.robot.readings import Flaw, OdometryReading
from hostlink.core.robot.ros_messages import FrameIds
from hostlink.core.robot.standstill import NO_ODOMETRY, OLD_S
from hostlink.core.robot.state import BatteryReading, RobotState, read_battery
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import Limits, VelocityGate
from hostlink.core.robot.wheel_feedback import WheelSettings
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import BadPayload, ConfigError

if TYPE_CHECKING:
    from hostlink.core.hub.device import CommandEndpoint, Device
    from hostlink.core.hub.remote_robot import RemoteLink, RemoteOdometry

log = structlog.get_logger()


_DEFAULTS = RobotConfig()
_TWO_SIDES = ("differential", "skid_steer")
USUAL_SEPARATION_M = 0.2  # of wheels that are driven one by one, and whose separation is not configured
LIMITS = tuple(  # settings of a robot have the same names
    each.name for each in dataclasses.fields(Limits) if each.init and each.name != "drive"
)


def of_namesake(config: RobotConfig | None) -> RobotConfig:
    """Return the settings of a robot that announces a configured name but is another one: only the limits apply."""
    if config is None:
        return _DEFAULTS
    return dataclasses.replace(
        config,
        address=None,
        devices=None,
        command_device=None,
        odom_topic=None,
        cmd_vel_topic=None,
        cmd_vel_stamped_topic=None,
        odom_frame=None,
        base_frame=None,
        encoders=None,
        feedback=FeedbackConfig(),
        calibration=CalibrationConfig(),
    )


def correction_of(config: RobotConfig) -> OdometryCorrection | None:
    """Return the correction of the robot's odometry; None if it is not calibrated."""
    calibration = config.calibration
    if calibration == CalibrationConfig():
        return None
    return OdometryCorrection(**dataclasses.asdict(calibration))


def drive_in(config: RobotConfig, commands: Sequence[TopicType] = ()) -> Drive:
    """Return the drive of a robot: as configured, otherwise as its command needs it.

    Raises:
        ConfigError: a dimension is invalid.
    """
    kinematics: str = config.kinematics
    is_car = config.throttle is not None or any(topic.type_name in ACKERMANN_TYPES for topic in commands)
    if kinematics == "" and is_car:
        kinematics = "ackermann"
    elif kinematics == "" and (config.wheels is not None or config.encoders is not None):
        kinematics = "differential"
    dimensions = {name: getattr(config, name) for name in DIMENSIONS}
    if config.wheels is not None and kinematics in _TWO_SIDES and dimensions["wheel_separation_m"] is None:
        dimensions["wheel_separation_m"] = USUAL_SEPARATION_M
    return _drive_of(kinematics, tuple(dimensions.values()))


@functools.lru_cache(maxsize=256)
def _drive_of(kinematics: str, dimensions: tuple[Any, ...]) -> Drive:
    return drive_of(kinematics, dict(zip(DIMENSIONS, dimensions, strict=True)))


@functools.lru_cache(maxsize=256)  # most robots have the same settings
def limits_of(config: RobotConfig, commands: tuple[TopicType, ...] = ()) -> Limits:
    """Return the limits of a robot's gate, with its drive.

    Raises:
        ConfigError: a limit or a dimension of the drive is invalid.
    """
    drive, lacks = drive_in(config, commands), _components_without_field(config, {each.type_name for each in commands})
    return Limits(**{name: getattr(config, name) for name in LIMITS}, drive=drive.without(lacks) if lacks else drive)


def _components_without_field(config: RobotConfig, types: Set[str]) -> list[str]:
    """Return the components of a velocity that a robot's command topics of these types cannot express."""
    if config.joy is not None and JOY_TYPE in types:
        axes = {"linear.y": config.joy.y_axis, "angular.z": config.joy.yaw_axis}
        return [name for name, axis in axes.items() if axis is None]
    if config.vector is not None and VECTOR_TYPE in types:
        fields = {"linear.x": "x", "linear.y": "y", "angular.z": "yaw"}
        return [name for name, each in fields.items() if each not in config.vector.fields]
    is_word = config.words is not None and not types.isdisjoint((*TEXT_TYPES, *NUMBER_TYPES))
    return ["linear.y"] if is_word else []


def frames_of(name: str, config: RobotConfig) -> FrameIds:
    """Return the frame ids of a robot."""
    return FrameIds(config.odom_frame or f"{name}/odom", config.base_frame or f"{name}/base_link")


def command_settings(config: RobotConfig) -> CommandSettings:
    """Return what the settings of a robot say of its command."""
    kinds: dict[CommandKind, tuple[str, ...]] = {}
    if config.wheels is not None:
        kinds[CommandKind.WHEELS] = config.wheels.topics
    if config.joy is not None:
        kinds[CommandKind.JOY] = (config.joy.topic,)
    if config.words is not None:
        kinds[CommandKind.WORDS] = (config.words.topic,)
    if config.throttle is not None:
        kinds[CommandKind.THROTTLE] = config.throttle.topics
    if config.vector is not None:
        kinds[CommandKind.VECTOR] = (config.vector.topic,)
    kind, topics = next(iter(kinds.items()), (None, ()))
    if kind is None and config.command_topic is not None:
        topics = (config.command_topic,)
    is_spatial = config.kinematics == "spatial"
    ignored, locked = frozenset(config.not_commands), frozenset(config.locked_topics)
    return CommandSettings(
        kind,
        topics,
        config.feedback.topic,
        ignored,
        locked,
        is_spatial,
        config.devices or (),
        config.command_device,
        _rests_of(config),
        config.stop_service,
    )


def _rests_of(config: RobotConfig) -> tuple[float, ...]:
    if config.throttle is not None:
        return config.throttle.rest, config.throttle.steering_rest
    return () if config.wheels is None else (config.wheels.rest,) * len(config.wheels.topics)


def wheel_scales(wheels: WheelsConfig, config: RobotConfig, count: int) -> list[WheelScale]:
    """Return how the speed of each wheel becomes its number.

    Raises:
        ConfigError: the settings do not fit the number of wheels, or a dimension is missing.
    """
    directions = wheels.directions or (1.0,) * count
    if len(directions) != count:
        raise ConfigError("wheels", f"{len(directions)} directions for {count} wheels")
    top_m_s = config.max_wheel_m_s or config.max_linear_m_s or 1.0
    if wheels.unit == "pwm":
        scale = _bounded(wheels.full, wheels.rest, top_m_s)
        return [scale._replace(direction=direction) for direction in directions]
    per_m_s = 1.0
    if wheels.unit != "m_s":
        if not config.wheel_radius_m:
            raise ConfigError("wheels", f'unit = "{wheels.unit}" needs wheel_radius_m')
        per_turn = {"rad_s": math.tau, "rpm": 60.0, "ticks_s": wheels.ticks_per_turn}[wheels.unit]
        per_m_s = per_turn / (math.tau * config.wheel_radius_m)
    return [WheelScale(per_m_s, direction, wheels.rest, top=top_m_s) for direction in directions]


def throttle_scales(
    throttle: ThrottleConfig, config: RobotConfig, drive: AckermannDrive
) -> tuple[WheelScale, WheelScale]:
    """Return how the speed of a car becomes the number of its throttle, and its steering angle that of the steering."""
    top_m_s = config.max_wheel_m_s or config.max_linear_m_s or 1.0
    forwards = WheelScale(1.0, rest=throttle.rest, top=top_m_s)
    angle = WheelScale(1.0, rest=throttle.steering_rest, top=drive.max_steering_rad)
    if throttle.unit == "pwm":
        forwards = _bounded(throttle.full, throttle.rest, top_m_s)
    if throttle.steering_full is not None:
        angle = _bounded(throttle.steering_full, throttle.steering_rest, drive.max_steering_rad)
    return forwards, angle


def _bounded(full: float, rest: float, at: float) -> WheelScale:
    """Return the scale that adds `full` to `rest` at a value of `at`, and more at no other."""
    return WheelScale(full / at, 1.0, rest, rest - abs(full), rest + abs(full), at)


def feedback_of(topics: RobotTopicNames, sent: Iterable[TopicType], config: RobotConfig) -> Feedback:
    """Return what tells of a robot's motion, of the topics that its device sends.

    Raises:
        ConfigError: the settings do not fit the topics or the drive.
    """
    settings = FeedbackSettings(topic=topics.odometry or "", encoders=_encoders_of(config))
    return Feedback(sent, settings, drive_in(config, topics.commands))


def _encoders_of(config: RobotConfig) -> WheelSettings | None:
    if config.encoders is None:
        return None
    fields = dataclasses.asdict(config.encoders)
    return WheelSettings(**fields | {"wheel_radius_m": fields["wheel_radius_m"] or config.wheel_radius_m})


def encoders_lack(config: RobotConfig) -> list[str]:
    """Return the settings of its encoders without which a robot has no pose."""
    encoders = _encoders_of(config)
    return encoders.lacking.split(" and ") if encoders is not None and encoders.lacking else []


def commands_of(
    topics: Sequence[TopicType], config: RobotConfig, *, kind: CommandKind = CommandKind.TWIST, frame_id: str = ""
) -> CommandType:
    """Return the encoder of a robot's command topics.

    Raises:
        ConfigError: the settings do not fit the types of the topics.
    """
    drive, full = (
        drive_in(config, topics),
        PlanarVelocity(config.max_linear_m_s, config.max_linear_m_s, config.max_angular_rad_s),
    )
    if kind is CommandKind.WHEELS and config.wheels is not None:
        count = 1 if len(topics) == 1 and topics[0].type_name in NUMBER_TYPES else len(drive.wheels)
        if not count:
            raise ConfigError("wheels", _why_no_wheels(drive, config))
        scales = wheel_scales(config.wheels, config, count)
        return WheelCommand(topics, drive, scales, joints=config.wheels.joints)
    if kind is CommandKind.JOY and config.joy is not None:
        joy = config.joy
        axes = (joy.x_axis, joy.y_axis, joy.yaw_axis)
        return JoyCommand(
            topics[0], axes=axes, full=full, axis_count=joy.axes, button_count=joy.buttons, button=joy.button
        )
    if kind is CommandKind.WORDS and config.words is not None:
        words = config.words
        return WordCommand(topics[0], Words(words.forward, words.backward, words.left, words.right, words.stop), full)
    if kind is CommandKind.THROTTLE and config.throttle is not None and isinstance(drive, AckermannDrive):
        return ThrottleCommand(topics, drive, *throttle_scales(config.throttle, config, drive))
    if kind is CommandKind.VECTOR and config.vector is not None:
        return VectorCommand(topics[0], config.vector.fields)
    if topics[0].type_name in ACKERMANN_TYPES and isinstance(drive, AckermannDrive):
        return AckermannCommand(topics[0], drive, frame_id)
    return TwistCommand(topics[0], frame_id)


def lacking(drive: Drive, config: RobotConfig) -> list[str]:
    """Return the settings without which the speeds of a drive's wheels are not known."""
    return [name for name in WHEELS_NEED.get(drive.kinematics, ()) if getattr(config, name) is None]


def _why_no_wheels(drive: Drive, config: RobotConfig) -> str:
    missing = lacking(drive, config)
    if missing:
        needed = " and ".join(missing)
        return f'kinematics = "{drive.kinematics}" needs {needed}, without which the speeds of its wheels are not known'
    known = ", ".join(f'"{each}"' for each in WHEELS_NEED)
    return f'kinematics = "{config.kinematics}" has no wheels: choose the drive of the robot, one of {known}'


def check_command(config: RobotConfig) -> None:
    """Check the settings of a robot's command as far as they tell without its device, which has the types.

    Raises:
        ConfigError: they fit no device.
    """
    number = next(iter(NUMBER_TYPES))
    encoders = _encoders_of(config)
    if encoders is not None and not encoders.lacking:
        drive, type_name = drive_in(config), JOINT_STATE_TYPE if encoders.joints and encoders.topic else number
        feedback = Feedback(((name, type_name) for name in encoders.names), FeedbackSettings(encoders=encoders), drive)
        is_counted = bool(encoders.topics or encoders.joints or encoders.wheels)  # an array tells its number itself
        if drive.wheels and is_counted and feedback.lacks:
            raise ConfigError("encoders", f"a pose needs {feedback.lacks}")
    if config.throttle is not None:
        commands_of([TopicType(topic, number) for topic in config.throttle.topics], config, kind=CommandKind.THROTTLE)
    wheels = config.wheels
    if wheels is None:
        return
    if len(wheels.topics) > 1 or wheels.joints:
        type_name = number if len(wheels.topics) > 1 else JOINT_STATE_TYPE
        commands_of([TopicType(topic, type_name) for topic in wheels.topics], config, kind=CommandKind.WHEELS)
    else:  # one number, or an array of them
        wheel_scales(wheels, config, len(wheels.directions) or 1)


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

    @property
    def unguarded_endpoints(self) -> "list[CommandEndpoint]":
        """Return what else its devices take that looks like a command, after a stop or a lock; none of a remote one."""
        return []

    @abstractmethod
    def stop(self, *, by: str | None = None) -> None:
        """Stop the robot and all velocity topics of its devices, within the deceleration limits, for every source.

        What else its devices take that looks like a command is sent a zero, if its type has one.
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
    parts: "tuple[Device, ...]" = ()  # its other devices, if it consists of several
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
        """Return why it cannot be driven or stopped although its device is connected; None if it can."""
        if self.connection is None:
            return self.refusals.cause
        return self.refusals.cause or self.admission.missing or self.no_stop or None

    def _device_errors(self, connection: "Device") -> tuple[str, ...]:
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
            self.gates.stop(self.beside, by=by)
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
            self.gates.lock(self.beside, shown_reason(reason), by=by)
        finally:
            self._stop_unguarded()
            self.on_lock(self)
            log.warning("robot.locked", robot=self.name, reason=self.gate.lock_reason)
            self.gates.events.note(EventKind.LOCKED, self.name, reason=self.gate.lock_reason)

    @property
    def devices(self) -> "tuple[Device, ...]":
        """Connected devices of this robot."""
        return self.parts if self.connection is None else (self.connection, *self.parts)

    def _stop_unguarded(self) -> None:
        """Send zero to what else its devices take that looks like a command."""
        for device in self.devices:
            device.stop_unguarded()

    @property
    def unguarded_endpoints(self) -> "list[CommandEndpoint]":
        """Return what else its devices take that looks like a command, after a stop or a lock."""
        return [each for device in self.devices for each in device.unguarded_endpoints()]

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

    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""
        link = self.link
        if link is None or self.admission.missing:
            return self.admission.missing or "its device is not connected"
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


def reason_for_motion(
    *,
    is_played: bool,
    drivers: Iterable[str | None],
    unreachable: str | None,
    velocities: Iterable[PlanarVelocity | Any],
) -> str:
    """Return the reason why a robot moves after a stop."""
    driver = next(filter(None, drivers), None)
    if is_played:
        return "it is a recording, which obeys nobody"
    if driver is not None:
        return f"driven by {driver}"
    if unreachable is not None:
        return unreachable
    if not all(velocity.is_zero for velocity in velocities):
        return "it slows down within its deceleration limits"
    return "the stop was sent, and its device has not obeyed it yet"
