"""Settings of the daemon: one frozen dataclass for each part, read once from a TOML file and the flags."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import ipaddress
import itertools
import math
import re
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import msgspec

from hostlink.core.runtime.text_file import decoded, read_bytes
from hostlink.core.runtime.topic_names import plain_name
from hostlink.errors import ConfigError

MAX_PORT = 0xFFFF
MAX_FILE_BYTES = 64 * 1024 * 1024  # 20,000 robots need two; a device file such as /dev/zero is endless
MOST_CALIBRATION = 2.0  # a robot whose wheels differ more has wrong constants


_EVERY_ADDRESS = ("0.0.0.0", "::", "")  # noqa: S104 - compared with
Table = TypeVar("Table")
AT_ONCE = {"is_applied_at_once": True}  # metadata of a component's setting that a reload changes without a restart
_OF_TABLES = "component_settings"  # field of `Config`, not a key of the file

ParameterScalar = bool | int | float | str
ParameterValue = ParameterScalar | list[ParameterScalar]

AUTO = "auto"  # as the protocol of a serial port: rosserial or micro-ROS, as its bytes tell

MAX_WHEELS = 8
MAX_WORD_BYTES = 1024  # a stop of the guardian has four times as many, and a board takes 512 by default
MAX_JOY = 64  # axes and buttons of a Joy
MAX_RESUME_S = 60.0  # after a longer absence the robot may have been carried to another place

MAX_DEVICES = 8  # of one robot


@dataclass(frozen=True, slots=True, kw_only=True)
class TcpConfig:
    """TCP port for devices."""

    host: str = "0.0.0.0"  # noqa: S104 - devices come from the network; the API is what stays on loopback
    port: int = 11411  # the port of every rosserial TCP client
    allow: tuple[str, ...] = ()  # networks that may connect, such as "192.168.4.0/24"; empty: all
    max_connections: int = 256  # a quarter of the usual descriptor limit of a process
    max_connections_per_address: int = 64  # a fleet behind one address, such as the simulated one
    key_file: Path | None = None  # key that devices must prove, as the project's ESP8266 firmware can
    keyless: tuple[str, ...] = ()  # with key_file: networks of devices that need no key
    protocol: str = "rosserial"  # that the devices speak: docs/protocols.md
    mdns: bool = False  # advertise this port in the local network as _rosserial._tcp

    def __post_init__(self) -> None:
        check_networks(allow=self.allow, keyless=self.keyless)
        if min(self.max_connections, self.max_connections_per_address) < 1:
            raise ValueError("a bound on connections must be at least 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class UdpConfig:
    """UDP port for devices."""

    host: str = "0.0.0.0"  # noqa: S104 - devices come from the network; the API is what stays on loopback
    port: int = 11411  # the default of rosserial_server
    allow: tuple[str, ...] = ()  # networks that may send; empty: all
    trusted: tuple[str, ...] = ()  # networks without forged source addresses; others get no more bytes than they send
    devices: tuple[str, ...] = ()  # "HOST:PORT" of devices that wait until the host has sent a datagram
    max_connections: int = 256  # sessions; half of them of unverified addresses
    max_connections_per_address: int = 64
    key_file: Path | None = None
    keyless: tuple[str, ...] = ()
    protocol: str = "rosserial"

    def __post_init__(self) -> None:
        check_networks(allow=self.allow, trusted=self.trusted, keyless=self.keyless)
        if self.max_connections < 2 or self.max_connections_per_address < 1:  # noqa: PLR2004 - each kind has its half
            raise ValueError("max_connections must be at least 2, max_connections_per_address 1")
        self.device_addresses()

    def device_addresses(self) -> list[tuple[str, int]]:
        """Host and port of each of `devices`.

        Raises:
            ValueError: an entry has no IP address, or no port.
        """
        return [device_address(text) for text in self.devices]


ROSSERIAL, MICRO_ROS = "rosserial", "micro-ros"  # protocols, as settings name them


@dataclass(frozen=True, slots=True, kw_only=True)
class MicroRosUdpConfig:
    """UDP port for micro-ROS boards, which can prove no key."""

    host: str = "127.0.0.1"  # closed to the network until another address is configured
    port: int = 8888  # of the micro-ROS agent
    allow: tuple[str, ...] = ()  # as those of UdpConfig
    trusted: tuple[str, ...] = ("127.0.0.0/8", "::1/128")  # the system lets no such source address in
    max_connections: int = 256
    max_connections_per_address: int = 64

    def __post_init__(self) -> None:
        self.listening()

    def listening(self) -> UdpConfig:
        """Return the settings of the port.

        Raises:
            ValueError: as from UdpConfig.
        """
        return UdpConfig(**_fields_of(self), protocol=MICRO_ROS)


@dataclass(frozen=True, slots=True, kw_only=True)
class MicroRosTcpConfig:
    """TCP port for micro-ROS boards."""

    host: str = "127.0.0.1"
    port: int = 8888
    allow: tuple[str, ...] = ()
    max_connections: int = 256
    max_connections_per_address: int = 64

    def __post_init__(self) -> None:
        self.listening()

    def listening(self) -> TcpConfig:
        """Return the settings of the port.

        Raises:
            ValueError: as from TcpConfig.
        """
        return TcpConfig(**_fields_of(self), protocol=MICRO_ROS)


def _fields_of(config: MicroRosUdpConfig | MicroRosTcpConfig) -> dict[str, Any]:
    return {each.name: getattr(config, each.name) for each in dataclasses.fields(config)}


@dataclass(frozen=True, slots=True, kw_only=True)
class MicroRosConfig:
    """Ports for micro-ROS boards, besides serial ports."""

    udp: MicroRosUdpConfig | None = None  # None: no port
    tcp: MicroRosTcpConfig | None = None
    velocity_stream: Literal[0, 1] = 0  # 1: for clients that refuse messages without a number


_RATE_IN_PATH = re.compile(r"(.+):(\d{3,9})")  # "/dev/ttyUSB0:115200"; a name in by-path ends with ":1.0-port0"


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialConfig:
    """Serial port of one device."""

    path: str | None = None  # "/dev/ttyACM0", or a pattern that matches one port: "/dev/serial/by-id/usb-Arduino*"
    usb_serial: str | None = None  # alternative: serial number of the USB device, independent of the port's name
    baud: int | tuple[int, ...] = 57600  # rosserial's default; several rates are tried in turn until frames arrive
    baud_try_s: float = 4.5  # for each rate; the host requests topics every 2 s, so twice at each rate
    on_open: Literal["leave", "reset"] = "leave"  # DTR line of the board: leave it, or reset the board
    dtr: bool = True  # lines while the port is open; both on hold some boards in reset, for example an ESP32-CAM-MB
    rts: bool = True
    protocol: str = AUTO

    def __post_init__(self) -> None:
        if (self.path is None) == (self.usb_serial is None):
            raise ValueError("a serial port needs either path or usb_serial")
        if self.baud == ():
            raise ValueError("a serial port needs a baud rate")
        if self.path is not None and (found := _RATE_IN_PATH.fullmatch(self.path)):
            raise ValueError(f"the baud rate is a setting of its own: path = {found[1]!r}, baud = {found[2]}")
        if self.on_open == "reset" and not self.dtr:
            raise ValueError('on_open = "reset" needs dtr = true')

    @property
    def name(self) -> str:
        """Name of the port that does not change when it is plugged in again; `address` of a robot refers to it."""
        return self.usb_serial or self.path or ""

    @property
    def bauds(self) -> tuple[int, ...]:
        """Baud rates to try."""
        return (self.baud,) if isinstance(self.baud, int) else self.baud


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """Supervision and pacing of one link."""

    silence_timeout_s: float | None = 5.0  # for a device that requests the time every 2.5 s: two requests were missed
    idle_timeout_s: float | None = 11.0  # for other devices; without time answers a device stops sending after 11 s
    write_timeout_s: float = 5.0  # a socket that accepts nothing for two time requests of its device is dead
    uart_bytes_s: int | None = None  # None: not paced; 3840 for the paper's robot (38400 baud)
    max_topics: int = 256  # per device, including services; rosserial's library has 25 of each kind by default
    forget_robot_after_s: float = 600.0  # for an unconfigured and unlocked robot after it has disconnected

    def __post_init__(self) -> None:
        if self.max_topics < 1 or not self.forget_robot_after_s >= 0:
            raise ValueError("max_topics must be at least 1, forget_robot_after_s zero or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig:
    """Difference between the true wheels and the device's constants; `hostlink calibrate` measures it."""

    left_factor: float = 1.0  # true radius of the left wheel, divided by the device's value
    right_factor: float = 1.0
    nominal_separation_m: float = 0.210  # device's value; the paper's robot
    separation_m: float = 0.210  # true value

    def __post_init__(self) -> None:
        factors = (self.left_factor, self.right_factor, self.separation_m / max(self.nominal_separation_m, 1e-3))
        if not all(1 / MOST_CALIBRATION <= factor <= MOST_CALIBRATION for factor in factors):
            raise ValueError(f"a calibration may change a value by a factor of at most {MOST_CALIBRATION:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelsConfig:
    """Topics by which the wheels of a robot are driven, instead of a velocity."""

    topics: tuple[str, ...]  # one for each wheel in the drive's order; or one array; or one JointState
    joints: tuple[str, ...] = ()  # names of a JointState, in the drive's order
    unit: Literal["rad_s", "m_s", "rpm", "ticks_s", "pwm"] = "m_s"
    directions: tuple[float, ...] = ()  # 1 or -1 for each wheel; empty: all forwards
    ticks_per_turn: float = 0.0  # of unit = "ticks_s"
    full: float = 255.0  # of unit = "pwm": added to `rest` at the robot's fastest wheel speed, 500 of an ESC
    rest: float = 0.0  # number at rest, for example 1500 of an ESC

    def __post_init__(self) -> None:
        if not self.topics:
            raise ValueError(
                'wheels.topics must name the topics of the wheels, for example ["lmotor_cmd", "rmotor_cmd"]'
            )
        _check_names("wheels.topics", self.topics)
        _check_unique("wheels.joints", self.joints, "joint")
        if len("".join(self.joints).encode()) > MAX_WORD_BYTES:
            raise ValueError(f"the names in wheels.joints have more than {MAX_WORD_BYTES} bytes: shorten them")
        if self.unit == "ticks_s" and self.ticks_per_turn <= 0:
            raise ValueError('wheels.unit "ticks_s" needs ticks_per_turn above zero')
        if not all(abs(each) == 1 for each in self.directions):
            raise ValueError("wheels.directions must be 1 or -1 for each wheel")
        if not 0 < self.full < math.inf:
            advice = "; a wheel that turns the other way has -1 in wheels.directions" if self.full < 0 else ""
            raise ValueError(f"wheels.full must be a finite number above zero, not {self.full:g}{advice}")
        _check_range("wheels.full", self.full, "wheels.rest", self.rest, is_bounded=self.unit == "pwm")


@dataclass(frozen=True, slots=True, kw_only=True)
class ThrottleConfig:
    """Topics with a number for the throttle and one for the steering of a car, instead of a velocity."""

    topics: tuple[str, ...]  # throttle, steering
    unit: Literal["m_s", "pwm"] = "m_s"  # of the throttle
    full: float = 255.0  # of unit = "pwm": added to `rest` at the highest speed; below zero: it is reversed
    rest: float = 0.0  # of the throttle
    steering_full: float | None = None  # added to steering_rest at max_steering_rad to the left; None: the angle in rad
    steering_rest: float = 0.0  # number straight ahead

    def __post_init__(self) -> None:
        if len(self.topics) != _PAIR or len(set(map(plain_name, self.topics))) != _PAIR:
            raise ValueError('throttle.topics must be two, for example ["throttle", "steering"]')
        _check_names("throttle.topics", self.topics)
        full, steering_full = self.full, self.steering_full
        _check_range("throttle.full", full, "throttle.rest", self.rest, is_bounded=self.unit == "pwm")
        _check_range(
            "throttle.steering_full",
            1.0 if steering_full is None else steering_full,
            "throttle.steering_rest",
            self.steering_rest,
            is_bounded=steering_full is not None,
        )


def _check_range(full_name: str, full: float, rest_name: str, rest: float, *, is_bounded: bool) -> None:
    """Check the numbers of a motor: `rest` at rest, and `full` more or less than that at full speed.

    Raises:
        ValueError: there are no such numbers, or they go beyond zero while that at rest does not.
    """
    for name, number in ((full_name, full), (rest_name, rest)):
        if not math.isfinite(number):
            raise ValueError(f"{name} must be a finite number, not {number}")
    if full == 0:
        raise ValueError(f"{full_name} must be a finite number, not zero")
    if is_bounded and rest > 0 and abs(full) > rest:
        lowest, highest, advice = rest - abs(full), rest + abs(full), f"; choose at most {rest:g}"
        if rest < full < 2 * rest:
            advice = f"; for {2 * rest - full:g} to {full:g} with rest = {rest:g} set full = {full - rest:g}"
        raise ValueError(
            f"{full_name} is added to {rest_name} and subtracted from it: {lowest:g} to {highest:g}{advice}"
        )


Unit = Literal["ticks", "rad", "m", "ticks/s", "rad/s", "rpm", "m/s"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodersConfig:
    """Reports of a robot's wheels: counts, angles or speeds. The host integrates them to its odometry."""

    topics: tuple[str, ...] = ()  # one for each wheel, such as ["left_ticks", "right_ticks"]
    topic: str | None = None  # alternative: one topic with an array, or a JointState
    joints: tuple[str, ...] = ()  # of the JointState: its names of the wheels
    wheels: tuple[str, ...] = ()  # the wheel of each topic, value or joint; empty: in the order of the drive's wheels
    directions: tuple[Literal[1, -1], ...] = ()  # -1: the count falls when the robot drives forward
    unit: Unit = "ticks"
    counts: Literal["absolute", "differences"] = "absolute"  # differences: since the message before
    ticks_per_turn: float | None = None  # of the wheel, with the gear between motor and wheel
    wheel_radius_m: float | None = None

    def __post_init__(self) -> None:
        if bool(self.topics) == (self.topic is not None):
            raise ValueError("encoders need either topics (one for each wheel) or topic (an array or a JointState)")
        if len(set(map(plain_name, self.topics))) < len(self.topics) or len(self.topics) > MAX_WHEELS:
            raise ValueError(f"topics must be at most {MAX_WHEELS} different names")
        _check_names("encoders.topics", self.topics)
        _check_names("encoders.topic", () if self.topic is None else (self.topic,))
        _check_unique("encoders.joints", self.joints, "joint")
        _check_unique("encoders.wheels", self.wheels, "wheel")
        for name, value in (("ticks_per_turn", self.ticks_per_turn), ("wheel_radius_m", self.wheel_radius_m)):
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"{name} must be a finite number above zero, not {value}")
        if self.counts == "differences" and self.unit not in ("ticks", "rad", "m"):
            raise ValueError(f'counts = "differences" does not fit unit = "{self.unit}", which is a speed')
        counts = {len(each) for each in (self.topics, self.joints, self.wheels, self.directions) if each}
        if len(counts) > 1:
            raise ValueError("topics, joints, wheels and directions must have one entry for each wheel")


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedbackConfig:
    """Topic of the device that tells how the robot moves, where its type and name do not."""

    topic: str | None = None  # None: recognised; "": none of its topics tells it


@dataclass(frozen=True, slots=True, kw_only=True)
class VectorConfig:
    """Topic of type geometry_msgs/Vector3 by which a robot is driven, in m/s and rad/s."""

    topic: str = "cmd"
    fields: tuple[Literal["x", "y", "yaw", ""], ...] = ("x", "y", "yaw")  # what its x, y and z are; "": always 0

    def __post_init__(self) -> None:
        used = [each for each in self.fields if each]
        if len(self.fields) > _COMPONENTS or len(set(used)) < len(used) or not used:
            raise ValueError('vector.fields must be one to three of "x", "y" and "yaw", for example ["x", "yaw"]')
        if used == ["yaw"]:
            raise ValueError('vector.fields must have "x" or "y": with "yaw" alone the robot only turns')
        _check_names("vector.topic", (self.topic,))


@dataclass(frozen=True, slots=True, kw_only=True)
class JoyConfig:
    """Topic of type sensor_msgs/Joy by which a robot is driven. Axes and buttons are numbered from 0."""

    topic: str = "joy"
    x_axis: int = 1  # forwards
    y_axis: int | None = None  # to the left; None: the robot has no such axis
    yaw_axis: int | None = 0  # counter-clockwise
    axes: int = 8  # number of axes that are sent
    buttons: int = 11
    button: int | None = None  # pressed while the robot is driven

    def __post_init__(self) -> None:
        used = [each for each in (self.x_axis, self.y_axis, self.yaw_axis, self.button) if each is not None]
        if not all(0 <= each < MAX_JOY for each in (*used, self.axes, self.buttons)):
            raise ValueError(f"axes and buttons of joy must be 0 to {MAX_JOY - 1}")
        for kind, count, numbers in (
            ("axes", self.axes, (self.x_axis, self.y_axis, self.yaw_axis)),
            ("buttons", self.buttons, (self.button,)),
        ):
            highest = max((each for each in numbers if each is not None), default=-1)
            if highest >= count:
                raise ValueError(f"joy.{kind} = {count} are numbered 0 to {count - 1}: for {highest} set {highest + 1}")
        _check_names("joy.topic", (self.topic,))
        _check_different("axis", {name: getattr(self, name) for name in _JOY_AXES}, "joy")


@dataclass(frozen=True, slots=True, kw_only=True)
class WordsConfig:
    """Topic of type std_msgs/String by which a robot is driven, and its words."""

    topic: str
    forward: str
    backward: str
    left: str
    right: str
    stop: str

    def __post_init__(self) -> None:
        _check_names("words.topic", (self.topic,))
        if not self.stop:
            raise ValueError("words.stop must not be empty: it is what stops the robot")
        if self.stop in (self.forward, self.backward, self.left, self.right):
            raise ValueError(f"words.stop must differ from the words that move the robot: {self.stop!r}")
        _check_different("word", {name: getattr(self, name) for name in _DIRECTIONS}, "words")
        for name in (*_DIRECTIONS, "stop"):
            if len(getattr(self, name).encode()) > MAX_WORD_BYTES:
                raise ValueError(f"words.{name} has more than {MAX_WORD_BYTES} bytes: shorten it")


def _check_names(where: str, names: tuple[str, ...]) -> None:
    """Check names of topics, services or devices.

    Raises:
        ValueError: one is empty, or is there twice.
    """
    if not all(name.strip("/ ") for name in names):
        raise ValueError(f"{where} must not have an empty name: write the name, or remove it")
    _check_unique(where, tuple(map(plain_name, names)), "topic")


def _check_unique(where: str, names: tuple[str, ...], what: str) -> None:
    twice = next((name for number, name in enumerate(names) if name in names[:number]), None)
    if twice is not None:
        raise ValueError(f"{where} names one {what} twice: {twice!r}")


def _check_different(what: str, settings: dict[str, Any], where: str) -> None:
    """Check that no value is that of two settings.

    Raises:
        ValueError: a value is that of two settings.
    """
    names: dict[Any, str] = {}
    for name, value in settings.items():
        if value is not None and names.setdefault(value, name) != name:
            both = f"{where}.{names[value]} and {where}.{name}"
            raise ValueError(f"{both} are one {what}, {value!r}: give each its own")


_PAIR = 2  # throttle and steering
_WITHOUT_Y = ("differential", "skid_steer", "ackermann")
_DIRECTIONS = ("forward", "backward", "left", "right")
_JOY_AXES = ("x_axis", "y_axis", "yaw_axis")
_COMPONENTS = 3  # of a Vector3


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotConfig:
    """Device and limits of one robot. The limits apply to every source of commands."""

    address: str | None = None  # peer address or serial port of its device
    # Instead of an address: its devices, for example motors on one, encoders on another.
    devices: tuple[str, ...] | None = None
    command_device: str | None = None  # the one of its devices that is commanded, if several take a velocity
    uart_bytes_s: int | None = None
    # The drive (robot/kinematics): it refuses velocities that it cannot have. "": planar, which takes every velocity.
    # "spatial": all six numbers of a Twist pass; it is not a robot of the plane, but it is stopped and locked.
    kinematics: Literal[
        "", "planar", "differential", "skid_steer", "mecanum", "omni3", "omni4", "ackermann", "spatial"
    ] = ""
    wheel_radius_m: float | None = None
    wheel_separation_m: float | None = None  # between left and right wheels
    separation_factor: float | None = None  # skid_steer: effective separation divided by that of the wheels; None: 1
    wheelbase_m: float | None = None  # between front and rear axle; None: ackermann has that of a small car
    max_steering_rad: float | None = None
    wheel_distance_m: float | None = None  # omni: from the centre to each wheel
    wheel_angles_deg: tuple[float, ...] | None = None  # omni: place of each wheel, counter-clockwise from the front
    max_wheel_m_s: float | None = None
    max_linear_m_s: float = 1.0  # for a small robot; a faster one needs its own setting
    max_angular_rad_s: float = 4.0
    max_linear_acceleration_m_s2: float | None = None
    max_angular_acceleration_rad_s2: float | None = None
    max_linear_deceleration_m_s2: float | None = None  # None: a stop is immediate
    max_angular_deceleration_rad_s2: float | None = None
    odometry_after_restart: Literal["continue", "restart"] = "continue"  # REP 105: an odometry does not jump
    odom_topic: str | None = None  # topic name: None is the usual name below the robot's, "" disables the topic
    cmd_vel_topic: str | None = None
    cmd_vel_stamped_topic: str | None = None  # separate topic, because one topic has one type
    cmd_vel_max_age_s: float | None = None  # None: clocks differ, so the lease starts at the arrival of the command
    odom_frame: str | None = None  # None: "<robot>/odom"; Nav2 and rviz use "odom" by default
    base_frame: str | None = None  # None: "<robot>/base_link"
    # For a device that keeps its own constants.
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    publish_tf: bool = True  # false if another node publishes the transform between these frames
    resume_after_reconnect_s: float = 0.0  # a program that continues to command may continue after a shorter absence
    # What commands the robot; topics are as its device names them. Without any of them it is recognised.
    command_topic: str | None = None  # a Twist, TwistStamped or AckermannDrive with a name that tells nothing
    wheels: WheelsConfig | None = None
    joy: JoyConfig | None = None
    words: WordsConfig | None = None
    throttle: ThrottleConfig | None = None
    vector: VectorConfig | None = None
    not_commands: tuple[str, ...] = ()  # topics that command no motion, with any name and type
    locked_topics: tuple[str, ...] = ()  # further topics that a lock refuses, for example of servos
    stop_service: str | None = None  # std_srvs/Empty or Trigger of the device that is called with each zero
    # What tells of its motion; without either it is recognised.
    encoders: EncodersConfig | None = None
    feedback: FeedbackConfig = field(default_factory=FeedbackConfig)

    def __post_init__(self) -> None:
        names = ("command_topic", "wheels", "joy", "words", "throttle", "vector")
        ways = {name: getattr(self, name) for name in names}
        given = [name for name, each in ways.items() if each is not None]
        if len(given) > 1:
            raise ValueError(f"{given[0]} and {given[1]} are two ways to command one robot: choose one")
        if self.kinematics == "spatial" and given and given != ["command_topic"]:
            advice = "choose another kinematics, or command_topic"
            raise ValueError(f'kinematics = "spatial" passes the six numbers of a Twist, not {given[0]}: {advice}')
        if self.throttle is not None and self.kinematics not in ("", "ackermann"):
            raise ValueError(f'throttle is the command of a car: it does not fit kinematics = "{self.kinematics}"')
        commands = {self.command_topic} if given == ["command_topic"] else set[str | None]()
        for name in given:
            commands |= {getattr(ways[name], "topic", None), *getattr(ways[name], "topics", ())}
        plain = {plain_name(topic) for topic in commands if topic is not None}
        excluded = sorted(topic for topic in self.not_commands if plain_name(topic) in plain)
        if excluded:
            raise ValueError(
                f"{excluded[0]!r} is the command of the robot and one of not_commands: remove it from one of them"
            )
        for name in ("command_topic", "stop_service"):
            value = getattr(self, name)
            _check_names(name, () if value is None else (value,))
        _check_names("not_commands", self.not_commands)
        _check_names("locked_topics", self.locked_topics)
        if self.vector is not None and self.kinematics in _WITHOUT_Y and "x" not in self.vector.fields:
            raise ValueError(f'vector.fields must have "x": kinematics = "{self.kinematics}" cannot move sideways')
        devices = self.devices or ()
        if not all(place.strip("/ ") for place in devices):
            raise ValueError("devices must not have an empty name: write an address, a port or a name")
        if self.devices is not None and not devices:
            raise ValueError("devices must not be empty: name the robot's boards, or remove the line")
        if self.address is not None and devices:
            raise ValueError("address and devices are two ways to say where the robot is: choose one")
        if len(set(devices)) < len(devices) or len(devices) > MAX_DEVICES:
            raise ValueError(f"devices must be at most {MAX_DEVICES} different addresses, ports or names")
        if self.command_device is not None and self.command_device not in devices:
            raise ValueError(f"command_device {self.command_device!r} must be one of the devices")
        if self.encoders is not None and self.feedback.topic is not None:
            raise ValueError("set either encoders or feedback.topic: a robot's motion is known by one of them")
        if not 0 <= self.resume_after_reconnect_s <= MAX_RESUME_S:
            raise ValueError(f"resume_after_reconnect_s must be a number from 0 to {MAX_RESUME_S:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """All settings of hostlink.toml."""

    tcp: TcpConfig = field(default_factory=TcpConfig)
    udp: UdpConfig | None = None  # None: no UDP port
    micro_ros: MicroRosConfig = field(default_factory=MicroRosConfig)
    serial: tuple[SerialConfig, ...] = ()
    link: LinkConfig = field(default_factory=LinkConfig)
    robots: dict[str, RobotConfig] = field(default_factory=dict)
    parameters: dict[str, ParameterValue] = field(default_factory=dict)
    message_folders: tuple[Path, ...] = ()
    guardian: bool = True  # run a second process that stops the robots when the daemon died or hangs
    components: dict[str, bool] = field(default_factory=dict)  # whether each component runs: docs/components.md
    component_settings: dict[str, Any] = field(default_factory=dict)  # by name, of the tables that the file has

    def __post_init__(self) -> None:
        owners = {place: name for name, robot in self.robots.items() for place in robot.devices or ()}
        for name, robot in self.robots.items():
            for place in robot.devices or (() if robot.address is None else (robot.address,)):
                if owners.get(place, name) != name:
                    both = " and of ".join(sorted((f"robots.{name}", f"robots.{owners[place]}")))
                    raise ValueError(f"{place} is a device of {both}: remove it from one of them")

    def table(self, name: str, kind: type[Table]) -> Table:
        """Return the settings of a component's table; the default ones if the file has no such table."""
        found = self.component_settings.get(name)
        return kind() if found is None else typing.cast("Table", found)

    def with_tables(self, **tables: Any) -> Self:
        """Return the settings with these tables of components."""
        return dataclasses.replace(self, component_settings={**self.component_settings, **tables})


def load(
    path: Path,
    *,
    settings_type: Callable[[str], type | None] = lambda _: None,
    table_names: Callable[[], Iterable[str]] = tuple,
) -> Config:
    """Read and validate a TOML file. Paths in it are relative to its folder.

    `settings_type` returns the type of a component's table by its name; None if no component has such a table.
    `table_names` returns the names of the tables that components have besides those of their own names.

    Raises:
        ConfigError: the file cannot be read or a setting is wrong; it names file, key and the nearest known key.
    """
    try:
        data = read_bytes(path, MAX_FILE_BYTES)
        if len(data) > MAX_FILE_BYTES:
            raise ConfigError(str(path), f"has more than {MAX_FILE_BYTES} bytes")
        raw = msgspec.toml.decode(decoded(data))
    except OSError as error:
        raise ConfigError(str(path), error.strerror or str(error)) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), f"is not TOML: {error}") from error
    except RecursionError:
        raise ConfigError(str(path), "is not a settings file: nested too deeply") from None
    kinds = {name: settings_type(name) for name in raw if name not in _hints(Config)}
    tables = {name: raw.pop(name) for name, kind in kinds.items() if kind is not None}
    if _OF_TABLES in raw:
        raise ConfigError(str(path), f"unknown key {_OF_TABLES}; each component has a table of its own name")
    _refuse_unknown_keys(raw, Config, str(path), "", also=table_names)
    for name, table in tables.items():
        _refuse_unknown_keys(table, kinds[name], str(path), f"{name}.")

    def read_path(_: type, value: object) -> Path:  # the one type that msgspec does not know
        if not isinstance(value, str):
            raise ValueError(f"a path is a text in quotes, not {value}")  # noqa: TRY004 - msgspec adds the place
        try:
            return path.parent / Path(value).expanduser()
        except RuntimeError as error:  # there is no such user
            raise ValueError(f"{value!r}: {error}") from error

    try:
        config = msgspec.convert(raw, Config, dec_hook=read_path)
    except msgspec.ValidationError as error:
        raise ConfigError(str(path), _named(str(error), raw)) from error
    settings = {}
    for name, table in tables.items():
        try:
            settings[name] = msgspec.convert(table, kinds[name], dec_hook=read_path)
        except msgspec.ValidationError as error:
            problem = str(error)
            place = problem.replace("`$", f"`$.{name}") if "`$" in problem else f"{problem} - at `$.{name}`"
            raise ConfigError(str(path), place) from error
    return dataclasses.replace(config, component_settings=settings)


def _named(problem: str, raw: Any) -> str:
    """Return a problem with the name of its robot, of which msgspec tells only that it is one of the robots."""
    place = "$.robots[...]"
    if place not in problem:
        return problem
    for name, robot in raw["robots"].items():
        try:
            msgspec.convert(robot, RobotConfig)
        except msgspec.ValidationError:
            return problem.replace(place, f"$.robots.{name}")
    return problem


def is_address(text: str) -> bool:
    """Whether `text` is a whole IP address."""
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def is_place(text: str) -> bool:
    """Whether `text` is a whole IP address, or one with a port."""
    try:
        device_address(text)
    except ValueError:
        return is_address(text)
    return True


def device_address(text: str) -> tuple[str, int]:
    """Return the IP address and the port of HOST:PORT.

    Raises:
        ValueError: it is something else.
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) <= MAX_PORT:
        raise ValueError(f"{text!r} is not HOST:PORT of a device, such as 192.168.4.7:11411")
    return str(ipaddress.ip_address(host.strip("[]"))), int(port)


def check_networks(**settings: tuple[str, ...]) -> None:
    """Check that each entry of these settings is an address or a network.

    Raises:
        ValueError: an entry is something else.
    """
    for key, networks in settings.items():
        for network in networks:
            try:
                ipaddress.ip_network(network)
            except ValueError as error:
                raise ValueError(f"{key}: {error}; write an address, or a network such as 192.168.4.0/24") from error


def check_port(setting: str, port: int) -> None:
    """Check the number of a port to listen on.

    Raises:
        ConfigError: it is not one.
    """
    if not 0 <= port <= MAX_PORT:
        raise ConfigError(setting, f"{port} is not a port; choose 0 (any free one) to {MAX_PORT}")


def check_ports(config: Config, others: Mapping[str, tuple[str, int]] | None = None) -> None:
    """Check that no two listeners have one port. `others` are host and TCP port of those of components, by table.

    Raises:
        ConfigError: two have.
    """
    boards = config.micro_ros
    tcp = {"tcp": config.tcp, "micro_ros.tcp": boards.tcp}
    udp = {"udp": config.udp, "micro_ros.udp": boards.udp}
    _differ("TCP", {**{table: (part.host, part.port) for table, part in tcp.items() if part}, **(others or {})})
    _differ("UDP", {table: (part.host, part.port) for table, part in udp.items() if part})


def _differ(kind: str, listeners: Mapping[str, tuple[str, int]]) -> None:
    for (first, (host, port)), (second, (its_host, its_port)) in itertools.combinations(listeners.items(), 2):
        overlap = host == its_host or host in _EVERY_ADDRESS or its_host in _EVERY_ADDRESS
        if port == its_port != 0 and overlap:
            raise ConfigError(f"{second}.port", f"{kind} port {port} is that of [{first}], too; give each its own")


@functools.cache
def _hints(part: type) -> dict[str, Any]:
    """Type hints of a dataclass.

    Cached, because Python compiles them at every call, which 20,000 robots would notice.
    """
    return typing.get_type_hints(part)


def _refuse_unknown_keys(
    raw: Any, wanted: Any, file: str, prefix: str, *, also: Callable[[], Iterable[str]] = tuple
) -> None:
    """Check every key of the tables that the dataclasses describe. An unknown key is an error, which names others."""
    if type(None) in typing.get_args(wanted):
        wanted = typing.get_args(wanted)[0]
    if dataclasses.is_dataclass(wanted) and isinstance(raw, dict):
        hints = _hints(typing.cast("type", wanted))
        for key, value in raw.items():
            if key not in hints:
                known = sorted({*hints, *also()} - {_OF_TABLES})
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
                raise ConfigError(file, f"unknown key {prefix}{key}; {hint}")
            _refuse_unknown_keys(value, hints[key], file, f"{prefix}{key}.")
        return
    inner = typing.get_args(wanted)
    if typing.get_origin(wanted) is dict and isinstance(raw, dict):
        for key, value in raw.items():
            _refuse_unknown_keys(value, inner[1], file, f"{prefix}{key}.")
    elif typing.get_origin(wanted) is tuple and isinstance(raw, list):
        for number, value in enumerate(raw):
            _refuse_unknown_keys(value, inner[0], file, f"{prefix}{number}.")
