"""Ways to command a robot: each encodes a velocity as the messages that drive it, and zero as those that stop it. Pure.

Layouts: rosserial and ROS 1 serialisation, which are the same.
"""

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, Generic, NamedTuple, TypeVar

from hostlink.core.robot.kinematics import AckermannDrive, Drive, Steering
from hostlink.core.robot.velocity import (
    TWIST_STAMPED_TYPE,
    TWIST_TYPE,
    ZERO,
    AnyVelocity,
    PlanarVelocity,
    Twist,
)
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, ConfigError, WrongType

ACKERMANN_TYPE: Final = "ackermann_msgs/AckermannDrive"
ACKERMANN_STAMPED_TYPE: Final = "ackermann_msgs/AckermannDriveStamped"
JOY_TYPE, JOINT_STATE_TYPE, STRING_TYPE = "sensor_msgs/Joy", "sensor_msgs/JointState", "std_msgs/String"
VECTOR_TYPE: Final = "geometry_msgs/Vector3"
CHAR_TYPE: Final = "std_msgs/Char"
TEXT_TYPES: Final = (STRING_TYPE, CHAR_TYPE)
ACKERMANN_TYPES: Final = (ACKERMANN_TYPE, ACKERMANN_STAMPED_TYPE)

_MAX_SECS = 0xFFFFFFFF
_HEADER: Final = struct.Struct("<IIII")  # seq, secs, nsecs, length of frame_id
_LENGTH: Final = struct.Struct("<I")
_VECTOR: Final = struct.Struct("<3d")
_ACKERMANN: Final = struct.Struct("<5f")  # steering_angle, its velocity, speed, acceleration, jerk
NUMBERS: Final = {
    "Float32": "f", "Float64": "d", "Int8": "b", "Int16": "h", "Int32": "i", "Int64": "q",
    "UInt8": "B", "UInt16": "H", "UInt32": "I", "UInt64": "Q",
}  # fmt: skip
NUMBER_TYPES: Final = {f"std_msgs/{name}": code for name, code in NUMBERS.items()}
ARRAY_TYPES: Final = {f"std_msgs/{name}MultiArray": code for name, code in NUMBERS.items()}
_WHOLE: Final = {"b": (-128, 127), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1), "q": (-(2**63), 2**63 - 1),
          "B": (0, 255), "H": (0, 2**16 - 1), "I": (0, 2**32 - 1), "Q": (0, 2**64 - 1)}  # fmt: skip
_LARGEST_FLOAT32: Final = 3.4e38
_RANGES: Final = {"f": (-_LARGEST_FLOAT32, _LARGEST_FLOAT32), "d": (-math.inf, math.inf)}
_FEWEST_STEPS: Final = 5  # whole numbers between rest and the fastest speed; with fewer a speed is off by a tenth

T = TypeVar("T", str, bytes)


class TopicType(NamedTuple):
    """A topic by the name that its device uses, and its type."""

    name: str
    type_name: str


class Published(NamedTuple):
    """A published command as a velocity; `stamp_ns` is None without a stamp."""

    twist: Twist
    stamp_ns: int | None = None


class CommandType(ABC):
    """One way to command a robot. `topics`: those that it writes, in the order of the payloads."""

    def __init__(self, topics: Sequence[TopicType]) -> None:
        self.topics = tuple(topics)

    @abstractmethod
    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:
        """Encode a velocity: one payload for each topic. `stamp_ns` is the host's time."""

    def decode(self, topic: str, type_name: str, payload: bytes) -> Published:
        """Decode what a program published on a topic of the robot, by the name that the device uses.

        Raises:
            WrongType: this type does not command the robot.
            BadPayload: the payload is not of this type.
        """
        return decode_twist(topic, type_name, payload)


def decode_twist(topic: str, type_name: str, payload: bytes) -> Published:
    """Decode a Twist or a TwistStamped.

    Raises:
        WrongType: it has another type.
        BadPayload: the payload has another size.
    """
    if type_name == TWIST_TYPE:
        return Published(Twist.decode(payload))
    if type_name == TWIST_STAMPED_TYPE:
        stamp_ns, body = _split_header(type_name, payload)
        return Published(Twist.decode(body), stamp_ns)
    raise WrongType(topic, TWIST_TYPE, type_name)


class TwistCommand(CommandType):
    """A geometry_msgs/Twist or TwistStamped. `frame_id` is of the stamped one."""

    def __init__(self, topic: TopicType, frame_id: str = "") -> None:
        super().__init__((topic,))
        self._frame = frame_id.encode()
        self._is_stamped = topic.type_name == TWIST_STAMPED_TYPE

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:
        """Encode the six numbers, after a header if it is stamped."""
        payload = velocity.encode()
        return (_header(self._frame, stamp_ns) + payload,) if self._is_stamped else (payload,)


class FixedZero(CommandType):
    """A topic of which only the message that stops it is known."""

    def __init__(self, topic: TopicType, zero: bytes) -> None:
        super().__init__((topic,))
        self._zero = zero

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:  # noqa: ARG002 - it only stops
        """Return the message that stops it."""
        return (self._zero,)


class AckermannCommand(CommandType):
    """An ackermann_msgs/AckermannDrive or AckermannDriveStamped: steering angle and speed."""

    def __init__(self, topic: TopicType, drive: AckermannDrive, frame_id: str = "") -> None:
        super().__init__((topic,))
        self._drive, self._frame = drive, frame_id.encode()
        self._is_stamped = topic.type_name == ACKERMANN_STAMPED_TYPE

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:
        """Encode angle and speed. Zero steers straight."""
        steering = self._drive.steering(_planar(velocity))
        payload = _ACKERMANN.pack(steering.angle_rad, 0.0, _float32(steering.speed_m_s), 0.0, 0.0)
        return (_header(self._frame, stamp_ns) + payload,) if self._is_stamped else (payload,)

    def decode(self, topic: str, type_name: str, payload: bytes) -> Published:
        """Decode an AckermannDrive, AckermannDriveStamped, Twist or TwistStamped."""
        stamp_ns, body = None, payload
        if type_name == ACKERMANN_STAMPED_TYPE:
            stamp_ns, body = _split_header(type_name, payload)
        elif type_name != ACKERMANN_TYPE:
            return super().decode(topic, type_name, payload)
        if len(body) != _ACKERMANN.size:
            raise BadPayload(type_name, f"{len(body)} bytes instead of {_ACKERMANN.size}")
        angle_rad, _, speed_m_s, _, _ = _ACKERMANN.unpack(body)
        if not math.isfinite(angle_rad):  # within the steering's limit it would be one of its ends
            return Published(PlanarVelocity(speed_m_s, yaw_rad_s=math.nan).twist, stamp_ns)
        return Published(self._drive.velocity_of(Steering(speed_m_s, angle_rad)).twist, stamp_ns)


class WheelScale(NamedTuple):
    """Number that a wheel is sent: `rest` plus `direction` times its speed (m/s) times `per_m_s`, within the bounds.

    `top` is its fastest speed; 0: unknown.
    """

    per_m_s: float
    direction: float = 1.0
    rest: float = 0.0
    lowest: float = -math.inf
    highest: float = math.inf
    top: float = 0.0

    def value(self, speed_m_s: float) -> float:
        """Return the number for a speed. What is not a number after an overflow is `rest`."""
        value = min(max(self.rest + self.direction * speed_m_s * self.per_m_s, self.lowest), self.highest)
        return self.rest if math.isnan(value) else value


def _check_numbers(setting: str, topic: TopicType, scale: WheelScale) -> None:
    """Check that the type of a topic holds the number at rest and those at the fastest speeds: it would cut them off.

    Raises:
        ConfigError: it does not, or rounds most speeds to rest.
    """
    code = NUMBER_TYPES.get(topic.type_name) or ARRAY_TYPES[topic.type_name]
    lowest, highest = _WHOLE.get(code) or _RANGES[code]
    reach = round(abs(scale.per_m_s) * scale.top, 6) if scale.top else 0.0
    slowest, fastest = scale.rest - reach, scale.rest + reach
    if slowest < lowest or fastest > highest:
        numbers = f"{scale.rest:g}" if not reach else f"{slowest:g} to {fastest:g}"
        advice = "choose a rest and a full that fit, or another type on the board"
        raise ConfigError(
            setting, f"{topic.name} is sent {numbers}, and {topic.type_name} holds {lowest:g} to {highest:g}: {advice}"
        )
    if code not in _WHOLE:
        return
    if scale.rest != round(scale.rest):
        raise ConfigError(setting, f"{topic.type_name} cannot hold rest = {scale.rest:g}: choose a whole number")
    if math.isinf(scale.highest) and 0 < reach < _FEWEST_STEPS:  # by a unit; `full` is chosen by a person
        raise ConfigError(
            setting,
            f"{topic.name} is sent at most {reach:.2g}, and {topic.type_name} holds whole numbers: choose a unit with "
            "larger numbers, or Float32 on the board",
        )


class WheelCommand(CommandType):
    """Numbers for wheels or motors: a topic for each, or one array, or the velocities of a JointState.

    A single number is the speed forwards.
    """

    def __init__(
        self, topics: Sequence[TopicType], drive: Drive, scales: Sequence[WheelScale], *, joints: Sequence[str] = ()
    ) -> None:
        """`scales`: one for each wheel of the drive. `joints`: names of a JointState.

        Raises:
            ConfigError: the topics do not fit the wheels.
        """
        super().__init__(topics)
        self._drive, self._scales, self._joints = drive, tuple(scales), tuple(joints)
        count, types = len(scales), {topic.type_name for topic in topics}
        if len(topics) == 1 and types <= {JOINT_STATE_TYPE}:
            if len(self._joints) != count:
                raise ConfigError("wheels", f"a JointState for {count} wheels needs as many names in `joints`")
        elif not (len(topics) == 1 and types <= ARRAY_TYPES.keys()):
            unknown = sorted(types - NUMBER_TYPES.keys())
            if unknown:
                raise ConfigError("wheels", f"{unknown[0]} is not a number, an array of numbers or a JointState")
            if len(topics) != count:
                raise ConfigError("wheels", f"{len(topics)} topics for {count} wheels; give one for each, in order")
        if JOINT_STATE_TYPE not in types:
            for number, scale in enumerate(scales):
                _check_numbers("wheels", topics[number if len(topics) > 1 else 0], scale)

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:
        """Encode the number of each wheel. Zero is `rest` on every wheel."""
        speeds: Sequence[float] = [0.0] * len(self._scales)
        if not velocity.is_zero:
            planar = _planar(velocity)
            speeds = [planar.x_m_s] if len(self._scales) == 1 else self._drive.wheel_speeds(planar)
        values = [scale.value(speed) for scale, speed in zip(self._scales, speeds, strict=True)]
        first = self.topics[0].type_name
        if first == JOINT_STATE_TYPE:
            return (_joint_state(self._joints, values, stamp_ns),)
        if first in ARRAY_TYPES:
            code = ARRAY_TYPES[first]
            numbers = b"".join(_number(code, value) for value in values)
            return (struct.pack("<III", 0, 0, len(values)) + numbers,)  # no dimensions, no offset
        pairs = zip(self.topics, values, strict=True)
        return tuple(_number(NUMBER_TYPES[topic.type_name], value) for topic, value in pairs)


class ThrottleCommand(CommandType):
    """Two numbers for a car: one for its throttle, one for its steering."""

    def __init__(
        self, topics: Sequence[TopicType], drive: AckermannDrive, throttle: WheelScale, steering: WheelScale
    ) -> None:
        """`throttle` scales m/s, `steering` scales the angle of the front wheels in rad.

        Raises:
            ConfigError: a topic is not a number.
        """
        super().__init__(topics)
        self._drive, self._throttle, self._steering = drive, throttle, steering
        unknown = sorted({topic.type_name for topic in topics} - NUMBER_TYPES.keys())
        if unknown:
            raise ConfigError("throttle", f"{unknown[0]} is not a number")
        for topic, scale in zip(topics, (throttle, steering), strict=True):
            _check_numbers("throttle", topic, scale)

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:  # noqa: ARG002 - no stamp
        """Encode both numbers. Zero is the throttle at rest, straight ahead."""
        steering = self._drive.steering(_planar(velocity))
        values = self._throttle.value(steering.speed_m_s), self._steering.value(steering.angle_rad)
        pairs = zip(self.topics, values, strict=True)
        return tuple(_number(NUMBER_TYPES[topic.type_name], value) for topic, value in pairs)


class VectorCommand(CommandType):
    """A geometry_msgs/Vector3 whose numbers are components of the velocity."""

    def __init__(self, topic: TopicType, fields: Sequence[str]) -> None:
        """`fields`: what x, y and z of the message are: "x", "y", "yaw", or "" for nothing.

        Raises:
            ConfigError: the topic has another type.
        """
        super().__init__((topic,))
        self._fields = (*fields, "", "", "")[:3]
        if topic.type_name != VECTOR_TYPE:
            raise ConfigError("vector", f"{topic.type_name} is not a {VECTOR_TYPE}")

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:  # noqa: ARG002 - no stamp
        """Encode the components. Zero is three zeros."""
        x_m_s, y_m_s, yaw_rad_s = _planar(velocity)
        values = {"x": x_m_s, "y": y_m_s, "yaw": yaw_rad_s, "": 0.0}
        return (_VECTOR.pack(*(values[each] for each in self._fields)),)

    def decode(self, topic: str, type_name: str, payload: bytes) -> Published:
        """Decode a Vector3, Twist or TwistStamped."""
        if type_name != VECTOR_TYPE:
            return super().decode(topic, type_name, payload)
        if len(payload) != _VECTOR.size:
            raise BadPayload(type_name, f"{len(payload)} bytes instead of {_VECTOR.size}")
        values = dict(zip(self._fields, _VECTOR.unpack(payload), strict=True))
        return Published(PlanarVelocity(values.get("x", 0.0), values.get("y", 0.0), values.get("yaw", 0.0)).twist)


class JoyCommand(CommandType):
    """A sensor_msgs/Joy: a velocity as the position of axes."""

    def __init__(
        self,
        topic: TopicType,
        *,
        axes: tuple[int, int | None, int | None],
        full: PlanarVelocity,
        axis_count: int = 8,
        button_count: int = 11,
        button: int | None = None,
    ) -> None:
        """`axes`: the axis of x, y and yaw; None: it has none. `full`: the velocity at the end of each axis.

        `button` is held while the robot moves.
        """
        super().__init__((topic,))
        self._axes, self._full, self._button = axes, full, button
        self._axis_count = max(axis_count, 1 + max(axis for axis in axes if axis is not None))
        self._button_count = button_count if button is None else max(button_count, button + 1)

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:
        """Encode the axes. Zero is all axes at rest, and no button pressed."""
        positions, buttons = [0.0] * self._axis_count, [0] * self._button_count
        for axis, speed, full in zip(self._axes, _planar(velocity), self._full, strict=True):
            if axis is not None and full:
                positions[axis] = min(max(speed / full, -1.0), 1.0)
        if self._button is not None and not velocity.is_zero:
            buttons[self._button] = 1
        axes = struct.pack(f"<I{self._axis_count}f", self._axis_count, *positions)
        return (_header(b"", stamp_ns) + axes + struct.pack(f"<I{self._button_count}i", self._button_count, *buttons),)

    def decode(self, topic: str, type_name: str, payload: bytes) -> Published:
        """Decode a Joy, Twist or TwistStamped."""
        if type_name != JOY_TYPE:
            return super().decode(topic, type_name, payload)
        stamp_ns, body = _split_header(type_name, payload)
        try:
            (count,) = _LENGTH.unpack_from(body)
            positions = struct.unpack_from(f"<{count}f", body, _LENGTH.size)
            (button_count,) = _LENGTH.unpack_from(body, _LENGTH.size + 4 * count)
            buttons = struct.unpack_from(f"<{button_count}i", body, 2 * _LENGTH.size + 4 * count)
        except struct.error as error:
            raise BadPayload(type_name, str(error)) from error
        is_held = self._button is None or (self._button < button_count and bool(buttons[self._button]))
        speeds = [
            positions[axis] * full if is_held and axis is not None and axis < count else 0.0
            for axis, full in zip(self._axes, self._full, strict=True)
        ]
        return Published(PlanarVelocity(*speeds).twist, stamp_ns)


class Words(NamedTuple, Generic[T]):
    """Texts of a robot that is driven by words, or their messages."""

    forward: T
    backward: T
    left: T
    right: T
    stop: T


class WordCommand(CommandType):
    """A String, Char or number: the word of the direction that a velocity has most of. It promises no speed."""

    def __init__(self, topic: TopicType, words: Words[str], full: PlanarVelocity) -> None:
        """`full`: the limits, by which forward and turning motion are compared.

        Raises:
            ConfigError: a word does not fit the type of the topic, or two are one value of it.
        """
        super().__init__((topic,))
        self._full = full
        self._words = words
        self._payloads = Words(*(_word(topic.type_name, word) for word in words))
        if len(set(self._payloads)) < len(words):
            raise ConfigError("words", f"two of {', '.join(map(repr, words))} are one value of {topic.type_name}")

    def encode(self, velocity: AnyVelocity, stamp_ns: int = 0) -> tuple[bytes, ...]:  # noqa: ARG002 - no stamp
        """Encode a word."""
        x_m_s, _, yaw_rad_s = _planar(velocity)
        words = self._payloads
        if not (x_m_s or yaw_rad_s):
            return (words.stop,)
        if abs(x_m_s) * (self._full.yaw_rad_s or 1.0) >= abs(yaw_rad_s) * (self._full.x_m_s or 1.0):
            return (words.forward if x_m_s > 0 else words.backward,)
        return (words.left if yaw_rad_s > 0 else words.right,)

    def decode(self, topic: str, type_name: str, payload: bytes) -> Published:
        """Decode a word as the full velocity of its direction."""
        if type_name != self.topics[0].type_name:
            return super().decode(topic, type_name, payload)
        words, full = self._payloads, self._full
        found = {
            words.forward: PlanarVelocity(full.x_m_s),
            words.backward: PlanarVelocity(-full.x_m_s),
            words.left: PlanarVelocity(yaw_rad_s=full.yaw_rad_s),
            words.right: PlanarVelocity(yaw_rad_s=-full.yaw_rad_s),
            words.stop: ZERO,
        }.get(payload)
        if found is None:
            shown = payload[_LENGTH.size :].decode(errors="replace") if type_name == STRING_TYPE else payload.hex()
            known = ", ".join(map(repr, self._words))
            raise BadPayload(type_name, f"{shown[:32]!r} is not a word of the robot: {known}")
        return Published(found.twist)


def _word(type_name: str, word: str) -> bytes:
    """Return the message of a word.

    Raises:
        ConfigError: the word does not fit the type.
    """
    text = word.encode()
    if type_name == STRING_TYPE:
        return _LENGTH.pack(len(text)) + text
    if type_name == CHAR_TYPE and len(text) == 1:
        return text
    try:
        code, value = NUMBER_TYPES[type_name], float(word)
        lowest, highest = _WHOLE.get(code) or _RANGES[code]
        if math.isfinite(value) and lowest <= value <= highest and (code not in _WHOLE or value == round(value)):
            return _number(code, value)
    except (KeyError, ValueError):  # no number of this type
        pass
    raise ConfigError("words", f"{word!r} is not a value of {type_name}")


# -- layouts ----------------------------------------------------------------------------------------------------------


def zero_of(type_name: str, rest: float = 0.0) -> bytes | None:
    """Return the message of zeros of a type that may command a motion; None if zeros do not mean rest.

    An array of unknown length has no zero: an empty one is not obeyed. `rest`: what a number is at rest.
    """
    if type_name in NUMBER_TYPES:
        code = NUMBER_TYPES[type_name]
        lowest, highest = _WHOLE.get(code) or _RANGES[code]
        return _number(code, rest) if lowest <= rest <= highest else None
    return {
        TWIST_TYPE: Twist().encode(),
        VECTOR_TYPE: bytes(_VECTOR.size),
        TWIST_STAMPED_TYPE: _header(b"", 0) + Twist().encode(),
        ACKERMANN_TYPE: bytes(_ACKERMANN.size),
        ACKERMANN_STAMPED_TYPE: bytes(_HEADER.size + _ACKERMANN.size),
    }.get(type_name)


def _planar(velocity: AnyVelocity) -> PlanarVelocity:
    """Return the velocity of a robot; zero if it is not finite: no direction follows from it."""
    if not velocity.is_finite:
        return ZERO
    if isinstance(velocity, PlanarVelocity):
        return velocity
    return velocity.planar if isinstance(velocity, Twist) else ZERO  # there is no third kind


def _header(frame: bytes, stamp_ns: int) -> bytes:
    secs, nsecs = divmod(stamp_ns, NS_PER_S)
    return _HEADER.pack(0, secs & _MAX_SECS, nsecs, len(frame)) + frame


def _split_header(type_name: str, payload: bytes) -> tuple[int, bytes]:
    """Return the stamp and what follows the header."""
    try:
        _, secs, nsecs, frame_bytes = _HEADER.unpack_from(payload)
    except struct.error as error:
        raise BadPayload(type_name, f"{len(payload)} bytes are too few for a header") from error
    return secs * NS_PER_S + nsecs, payload[_HEADER.size + frame_bytes :]


def _float32(value: float) -> float:
    return min(max(value, -_LARGEST_FLOAT32), _LARGEST_FLOAT32)


def _number(code: str, value: float) -> bytes:
    if code in _WHOLE:
        lowest, highest = _WHOLE[code]
        return struct.pack(f"<{code}", round(min(max(value, lowest), highest)))
    return struct.pack(f"<{code}", _float32(value) if code == "f" else value)


def _joint_state(joints: Sequence[str], values: Sequence[float], stamp_ns: int) -> bytes:
    names = [name.encode() for name in joints]
    parts = [_header(b"", stamp_ns), _LENGTH.pack(len(names))]
    parts += [_LENGTH.pack(len(name)) + name for name in names]
    parts += [_LENGTH.pack(0), struct.pack(f"<I{len(values)}d", len(values), *values), _LENGTH.pack(0)]
    return b"".join(parts)  # no positions, no efforts
