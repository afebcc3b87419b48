"""Feedback of wheels: counts of encoders and speeds of wheels, integrated by the kinematics of the drive. Pure."""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hostlink.core.robot.kinematics import Drive, Pose
from hostlink.core.robot.readings import OdometryReading
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, ConfigError

JOINT_STATE_TYPE = "sensor_msgs/JointState"
_FORMATS = {
    "Int8": "b", "Int16": "h", "Int32": "i", "Int64": "q", "UInt8": "B", "UInt16": "H", "UInt32": "I", "UInt64": "Q",
    "Float32": "f", "Float64": "d",
}  # fmt: skip
_SCALARS = {f"std_msgs/{name}": struct.Struct(f"<{code}") for name, code in _FORMATS.items()}
_ARRAYS = {f"std_msgs/{name}MultiArray": struct.Struct(f"<{code}") for name, code in _FORMATS.items()}
_BITS = {"b": 8, "B": 8, "h": 16, "H": 16, "i": 32, "I": 32, "q": 64, "Q": 64}  # a float does not wrap around
_COUNT = struct.Struct("<I")
_HEADER = struct.Struct("<4xIII")
MOST_ELEMENTS = 64  # of an array or of a JointState: an arm has six, a walking robot twelve
_DIMENSION_BYTES = 8  # size and stride, after the label

_POSITIONS, _SPEEDS = ("ticks", "rad", "m"), ("ticks/s", "rad/s", "rpm", "m/s")
UNITS = (*_POSITIONS, *_SPEEDS)
_NOISE = {"ticks/s": 1.0, "rad/s": 0.1, "rpm": 1.0, "m/s": 0.005}  # slower is the noise of a wheel that is stopped

MOVED_S = 0.5  # a robot whose counts did not change for so long is not moving: 2 ticks/s are 1 cm/s and less
LONGEST_S = 2.0  # over a longer silence a speed says nothing, and the board may have restarted
SHORTEST_S = 0.1  # messages that a network delivered together were sent up to so far apart
LEAP_M_S = 10.0  # faster than the wheels of any small robot: the counts were set, or bytes are damaged
SHAKE_M = 0.02  # what a wheel may roll more than at its last speed, in one step
USUAL_M_S2, USUAL_M_S = 1.0, 0.3  # acceleration of a wheel, and how much its speed changes
NEAR_ZERO_M = 0.1  # what a wheel rolls between the start of its board and the first message


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSettings:
    """Settings of a robot's wheel feedback, as `[robots.X.encoders]` has them.

    Each topic is a wheel; one topic with an array, or a JointState, has all of them. `wheels` names them in their
    order; without it they are in the order of the drive's wheels.
    """

    topics: tuple[str, ...] = ()
    topic: str | None = None
    joints: tuple[str, ...] = ()  # of a JointState
    wheels: tuple[str, ...] = ()
    directions: tuple[int, ...] = ()  # 1, or -1 for a wheel that counts down when it rolls forward
    unit: str = "ticks"
    counts: str = "absolute"  # or "differences" since the message before
    ticks_per_turn: float | None = None
    wheel_radius_m: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Topics to read."""
        return self.topics if self.topic is None else (self.topic,)

    @property
    def metres_per_unit(self) -> float | None:
        """Way of the rim for one unit; None if a dimension of it is unknown."""
        if self.unit in ("m", "m/s"):
            return 1.0
        if self.wheel_radius_m is None:
            return None
        if self.unit in ("rad", "rad/s"):
            return self.wheel_radius_m
        if self.unit == "rpm":
            return math.tau * self.wheel_radius_m / 60
        return None if self.ticks_per_turn is None else math.tau * self.wheel_radius_m / self.ticks_per_turn

    @property
    def lacking(self) -> str:
        """Settings without which the way of a wheel is unknown; empty if none is missing."""
        if self.metres_per_unit is not None:
            return ""
        needs_ticks = self.unit in ("ticks", "ticks/s") and self.ticks_per_turn is None
        names = ("ticks_per_turn" if needs_ticks else "", "" if self.wheel_radius_m is not None else "wheel_radius_m")
        return " and ".join(filter(None, names))


class WheelReader:
    """Reader of the values of one topic: one number, an array, or the joints of a JointState."""

    def __init__(self, type_name: str, settings: WheelSettings) -> None:
        """Raises ConfigError: the type has no numbers of wheels, or the joints are not named."""
        self.type_name = type_name
        self._joints = settings.joints
        self._is_speed = settings.unit in _SPEEDS
        self._format = _SCALARS.get(type_name) or _ARRAYS.get(type_name)
        self._is_array = type_name in _ARRAYS
        if type_name == JOINT_STATE_TYPE:
            if not settings.joints:
                raise ConfigError("encoders", f"joints must name the wheels in the {JOINT_STATE_TYPE}")
            if settings.unit not in ("rad", "rad/s", "m", "m/s"):
                raise ConfigError(
                    "encoders", f'a {JOINT_STATE_TYPE} has positions (unit = "rad") or velocities (unit = "rad/s")'
                )
        elif self._format is None:
            raise ConfigError("encoders", f"{type_name} has no counts or speeds of wheels")
        self.bits = None if self._format is None else _BITS.get(self._format.format[-1:])

    def read(self, payload: bytes) -> tuple[tuple[float, ...], int | None]:
        """Return the values and the stamp. An int stays an int: a float has too few digits for 64 bits.

        Raises:
            BadPayload: the payload is not of the type.
        """
        try:
            if self._format is None:
                return self._joint_values(payload)
            if self._is_array:
                return _array(self._format, payload), None
            return self._format.unpack(payload), None
        except (struct.error, ValueError, IndexError) as error:
            raise BadPayload(self.type_name, f"{len(payload)} bytes: {error}") from error

    def _joint_values(self, payload: bytes) -> tuple[tuple[float, ...], int | None]:
        secs, nsecs, frame_bytes = _HEADER.unpack_from(payload)
        at = _HEADER.size + frame_bytes
        count, at = _counted(payload, at)
        names = []
        for _ in range(count):
            (size,) = _COUNT.unpack_from(payload, at)
            at += _COUNT.size
            names.append(payload[at : at + size].decode(errors="replace"))
            at += size
        columns = []
        for _ in range(3):  # position, velocity, effort
            size, at = _counted(payload, at)
            columns.append(struct.unpack_from(f"<{size}d", payload, at))
            at += 8 * size
        if at != len(payload):
            raise ValueError(f"the message ends after {at}")
        values = dict(zip(names, columns[1 if self._is_speed else 0], strict=False))
        missing = [name for name in self._joints if name not in values]
        if missing:
            raise ValueError(f"{missing[0]!r} has no {'velocity' if self._is_speed else 'position'}")
        return tuple(values[name] for name in self._joints), secs * NS_PER_S + nsecs


def _counted(payload: bytes, at: int) -> tuple[int, int]:
    (count,) = _COUNT.unpack_from(payload, at)
    if count > MOST_ELEMENTS:
        raise ValueError(f"{count} elements; at most {MOST_ELEMENTS} are read")
    return count, at + _COUNT.size


def _array(format_: struct.Struct, payload: bytes) -> tuple[float, ...]:
    """Return the values of a MultiArray. Its layout is ignored."""
    dimensions, at = _counted(payload, 0)
    for _ in range(dimensions):
        (size,) = _COUNT.unpack_from(payload, at)
        at += _COUNT.size + size + _DIMENSION_BYTES
    at += _COUNT.size  # data_offset
    count, at = _counted(payload, at)
    if len(payload) != at + count * format_.size:
        raise ValueError(f"{count} elements need {at + count * format_.size}")
    return tuple(value for (value,) in format_.iter_unpack(payload[at:]))


class _Sample(NamedTuple):
    at_s: float
    values: tuple[float, ...]  # of each channel, with its direction


class WheelFeedback:
    """Integrates what wheels report to a pose of the robot.

    Topics of one wheel each are read in sets: a reading follows when each of them has reported since the last one.
    Counts wrap around at the width of their type. Counts of a board that has restarted begin at zero again: the pose
    stays. Counts that leap farther than a wheel can roll are ignored, and believed when the next ones confirm them.

    | counts compared with those before                               | what is made of them                    |
    |-----------------------------------------------------------------|-----------------------------------------|
    | all of them near zero, and not where they were going            | a restart: counted from here            |
    | farther than LEAP_M_S allows                                     | nothing; the next ones decide           |
    | everything else                                                 | the wheels rolled that far              |
    """

    def __init__(self, topics: Mapping[str, str], settings: WheelSettings, drive: Drive) -> None:
        """`topics`: name and type of each topic of `settings`, in the order of the settings.

        Raises:
            ConfigError: the settings do not fit the topics or the drive.
        """
        self._settings = settings
        self._readers = {name: WheelReader(type_name, settings) for name, type_name in topics.items()}
        self._is_whole = settings.topic is not None  # one message has all wheels
        self._is_speed = settings.unit in _SPEEDS
        self._is_absolute = not self._is_speed and settings.counts == "absolute"
        self._drive = drive
        named = max(len(settings.joints), len(settings.wheels), len(settings.directions))
        count = len(settings.topics) or named or len(drive.wheels)
        self._channels = count  # 0: as many as the first message has
        for key, values in (("wheels", settings.wheels), ("directions", settings.directions)):
            if values and len(values) != count:
                raise ConfigError("encoders", f"{key} has {len(values)} entries for {count} wheels")
        self._metres = settings.metres_per_unit
        self._channel_of_wheel, self.lacks = _assigned(settings, count, drive.wheels)
        self.has_pose = not self.lacks
        self._pose = Pose()
        self.restarts = 0  # of the board, and leaps that were confirmed
        self._heard: dict[str, tuple[float, ...]] = {}  # since the last set
        self._summed: dict[str, list[float]] = {}  # differences since the last set
        self._last: _Sample | None = None
        self._doubtful: _Sample | None = None
        self._rates: tuple[float, ...] = ()  # speed of each channel over the last step, in its unit
        self._moved_at_s = -math.inf

    def restart(self) -> None:
        """Note that the device has connected again: its counts may begin at zero. The pose stays."""
        self._heard.clear()
        self._summed.clear()
        self._last = self._doubtful = None
        self._rates = ()

    def reset_pose(self) -> None:
        """Make the robot's place the origin."""
        self._pose = Pose()

    def read(self, topic: str, payload: bytes, *, now_s: float) -> OdometryReading | None:
        """Return a reading when every wheel has reported since the last one; None until then.

        Raises:
            BadPayload: the payload is damaged, or has too few wheels.
        """
        reader = self._readers[topic]
        values, stamp_ns = reader.read(payload)
        if self._is_whole:
            self._channels = self._channels or len(values)
            if len(values) < self._channels:
                raise BadPayload(reader.type_name, f"{len(values)} values for {self._channels} wheels")
            values = values[: self._channels]
        if not all(map(math.isfinite, values)):
            raise BadPayload(reader.type_name, "a value that is not finite")
        if not self._is_absolute and not self._is_speed:
            summed = self._summed.setdefault(topic, [0.0] * len(values))
            self._summed[topic] = [before + value for before, value in zip(summed, values, strict=True)]
            values = tuple(self._summed[topic])
        self._heard[topic] = values
        if len(self._heard) < len(self._readers):
            return None
        new = _Sample(now_s, self._in_order())
        self._heard.clear()
        self._summed.clear()
        return self._step(new, stamp_ns)

    def _in_order(self) -> tuple[float, ...]:
        values = [value for name in self._readers for value in self._heard[name]]
        directions = self._settings.directions
        return tuple(values if not directions else [a * b for a, b in zip(values, directions, strict=True)])

    def _step(self, new: _Sample, stamp_ns: int | None) -> OdometryReading | None:
        if self._is_speed:
            return self._step_speeds(new, stamp_ns)
        moved = self._differences(new) if self._is_absolute else self._plausible(new, new.values)
        if moved is None:
            return None
        if any(moved):
            self._moved_at_s = new.at_s
        if not self.has_pose:
            return OdometryReading(stamp_ns=stamp_ns, is_moving=new.at_s - self._moved_at_s < MOVED_S)
        self._pose = self._drive.integrate(self._pose, self._of_wheels(moved))
        return OdometryReading(self._pose, stamp_ns=stamp_ns)

    def _step_speeds(self, new: _Sample, stamp_ns: int | None) -> OdometryReading:
        before, self._last = self._last, new
        if not self.has_pose:
            is_moving = any(abs(value) > _NOISE[self._settings.unit] for value in new.values)
            return OdometryReading(stamp_ns=stamp_ns, is_moving=is_moving)
        twist = self._drive.velocity(self._of_wheels(new.values))
        if before is not None and 0 < new.at_s - before.at_s <= LONGEST_S:
            half_s = (new.at_s - before.at_s) / 2
            rolled = tuple((a + b) * half_s for a, b in zip(before.values, new.values, strict=True))
            self._pose = self._drive.integrate(self._pose, self._of_wheels(rolled))
        return OdometryReading(self._pose, twist, stamp_ns)

    def _of_wheels(self, values: Sequence[float]) -> list[float]:
        metres = self._metres or 0.0
        return [values[channel] * metres for channel in self._channel_of_wheel]

    def _plausible(self, new: _Sample, moved: tuple[float, ...]) -> tuple[float, ...] | None:
        """Differences per message; None if a wheel cannot have rolled so far."""
        before, self._last = self._last, new
        span_s = math.inf if before is None else new.at_s - before.at_s
        return moved if before is None or not self._is_leap(moved, span_s) else None

    def _differences(self, new: _Sample) -> tuple[float, ...] | None:
        """Way of each channel since the last set; None for the first set, a restart and a leap."""
        before, doubtful, self._doubtful = self._last, self._doubtful, None
        if before is None:
            self._last = new
            return None
        span_s = new.at_s - before.at_s
        moved = self._between(before, new)
        if self._is_restart(before, new, moved, span_s):
            self.restarts += 1
        elif not self._is_leap(moved, span_s):
            self._last, self._rates = new, tuple(each / max(span_s, SHORTEST_S) for each in moved)
            return moved
        elif doubtful is not None and not self._is_leap(self._between(doubtful, new), new.at_s - doubtful.at_s):
            self.restarts += 1
            moved, self._last, self._rates = self._between(doubtful, new), new, ()
            return moved
        else:
            self._doubtful = new
            return None
        self._last, self._rates = new, ()
        return (0.0,) * len(moved)

    def _between(self, before: _Sample, after: _Sample) -> tuple[float, ...]:
        bits = next(iter(self._readers.values())).bits
        moved = tuple(b - a for a, b in zip(before.values, after.values, strict=True))
        if bits is None:
            return moved
        half = 1 << (bits - 1)
        return tuple((each + half) % (half << 1) - half for each in moved)

    def _is_leap(self, moved: tuple[float, ...], span_s: float) -> bool:
        if self._metres is None:
            return False  # it counts as motion
        most = LEAP_M_S * max(span_s, SHORTEST_S) / self._metres
        return any(abs(each) > most for each in moved)

    def _is_restart(self, before: _Sample, new: _Sample, moved: tuple[float, ...], span_s: float) -> bool:
        """Whether all counts are near zero, to where at least one of them was not going."""
        metres = self._metres
        if metres is None or any(abs(value) * metres > NEAR_ZERO_M for value in new.values):
            return False
        if span_s > LONGEST_S:
            return any(abs(value) * metres > NEAR_ZERO_M for value in before.values)
        if sum(map(abs, new.values)) >= sum(map(abs, before.values)):
            return False
        rates = self._rates or (0.0,) * len(moved)
        unexpected_m = [abs(each - rate * span_s) * metres for each, rate in zip(moved, rates, strict=True)]
        return max(unexpected_m) > 2 * SHAKE_M + min(USUAL_M_S2 * span_s, USUAL_M_S) * span_s


def _assigned(settings: WheelSettings, count: int, wheels: Sequence[str]) -> tuple[list[int], str]:
    """Return the channel of each wheel of the drive, and what is missing for a pose (empty: nothing).

    A channel named "left" or "right", or one of two channels of a drive with more wheels, is all wheels of its side.

    Raises:
        ConfigError: a name is not a wheel's.
    """
    if settings.lacking:
        return [], f"{settings.lacking} of its encoders"
    if not wheels:
        return [], "the dimensions of its drive (kinematics)"
    names = settings.wheels or (tuple(wheels) if count == len(wheels) else ())
    if not names and count == 2:  # noqa: PLR2004 - the sides of a robot
        names = ("left", "right")
    if not names:
        return [], f"wheels = [...] of its encoders, which names {count} of {', '.join(wheels)}"
    for name in names:
        if not any(_is_at(wheel, name) for wheel in wheels):
            *known, last = dict.fromkeys((*wheels, "left", "right"))
            raise ConfigError("encoders", f"{name!r} is not a wheel of this drive: {', '.join(known)} or {last}")
    found = [next((i for i, name in enumerate(names) if _is_at(wheel, name)), None) for wheel in wheels]
    missing = [wheel for wheel, channel in zip(wheels, found, strict=True) if channel is None]
    return [channel for channel in found if channel is not None], ", ".join(missing) and (
        f"the encoders of {', '.join(missing)}"
    )


def _is_at(wheel: str, name: str) -> bool:
    return wheel == name or (name in ("left", "right") and wheel.endswith(f"_{name}"))
