"""Settings of a robot, as its gate, its feedback and its command topics need them."""

import dataclasses
import functools
import math
from collections.abc import Iterable, Sequence, Set
from typing import Any

from hostlink.core.config import CalibrationConfig, FeedbackConfig, RobotConfig, ThrottleConfig, WheelsConfig
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
from hostlink.core.robot.feedback import Feedback, FeedbackSettings
from hostlink.core.robot.kinematics import SETTINGS as DIMENSIONS
from hostlink.core.robot.kinematics import WHEELS_NEED, AckermannDrive, Drive, drive_of
from hostlink.core.robot.model import CommandKind, CommandSettings, RobotTopicNames
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.core.robot.ros_messages import FrameIds
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import Limits
from hostlink.core.robot.wheel_feedback import WheelSettings
from hostlink.errors import ConfigError

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
