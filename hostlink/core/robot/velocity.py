"""The velocity of a robot: x, y and yaw. The six numbers of a Twist exist for velocity topics without a robot."""

import math
import struct
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from hostlink.errors import BadPayload

TWIST_TYPE = "geometry_msgs/Twist"
TWIST_STAMPED_TYPE = "geometry_msgs/TwistStamped"
_TWIST = struct.Struct("<6d")


class Kinematics(StrEnum):
    """Drive of a device: which velocities it obeys. All but SPATIAL are settings of a robot."""

    SPATIAL = "spatial"  # all six components: a velocity topic that belongs to no robot
    PLANAR = ""  # x, y and yaw: a robot about which nothing else is configured; also "planar" in the settings
    DIFFERENTIAL = "differential"  # x and yaw: two wheels on one axis
    SKID_STEER = "skid_steer"  # x and yaw: wheels on both sides that slide sideways in a turn
    MECANUM = "mecanum"  # x, y and yaw: four wheels with rollers at 45 degrees
    OMNI3 = "omni3"  # x, y and yaw: three wheels with rollers at 90 degrees
    OMNI4 = "omni4"  # the same with four
    ACKERMANN = "ackermann"  # x, and a yaw of at most a curvature times x: steered wheels


class AnyVelocity(Protocol):
    """Interface of a velocity for admission and gate."""

    @property
    def is_zero(self) -> bool: ...

    @property
    def is_finite(self) -> bool: ...

    @property
    def speed_m_s(self) -> float: ...

    @property
    def turn_rad_s(self) -> float: ...

    def encode(self) -> bytes: ...


class PlanarVelocity(NamedTuple):
    """The velocity of a robot in its own frame: x forward, y to the left, yaw counter-clockwise (REP 103)."""

    x_m_s: float = 0.0
    y_m_s: float = 0.0
    yaw_rad_s: float = 0.0

    def encode(self) -> bytes:
        """Encode a serialised Twist."""
        return _TWIST.pack(self.x_m_s, self.y_m_s, 0.0, 0.0, 0.0, self.yaw_rad_s)

    @property
    def twist(self) -> "Twist":
        """The six numbers of a Twist."""
        return Twist(self.x_m_s, self.y_m_s, angular_z_rad_s=self.yaw_rad_s)

    @property
    def is_zero(self) -> bool:
        """Whether nothing moves."""
        return not (self.x_m_s or self.y_m_s or self.yaw_rad_s)

    @property
    def is_finite(self) -> bool:
        """Whether every component is a number."""
        return math.isfinite(self.x_m_s) and math.isfinite(self.y_m_s) and math.isfinite(self.yaw_rad_s)

    @property
    def speed_m_s(self) -> float:
        """Speed of the robot's origin: the length of (x, y)."""
        return math.hypot(self.x_m_s, self.y_m_s)

    @property
    def turn_rad_s(self) -> float:
        """Turning speed of the robot, in either direction."""
        return abs(self.yaw_rad_s)

    def scaled(self, factor: float) -> "PlanarVelocity":
        """The velocity on the same curve, slower or faster."""
        return PlanarVelocity(*(component * factor for component in self))

    def toward(self, target: "PlanarVelocity", fraction: float) -> "PlanarVelocity":
        """The point of the straight line to `target`; a fraction of 1 is the target itself."""
        if fraction >= 1:
            return target
        rest = 1 - fraction  # not here + (there - here) * fraction: the difference of two finite numbers may be none
        return PlanarVelocity(*(here * rest + there * fraction for here, there in zip(self, target, strict=True)))


class Twist(NamedTuple):
    """The six numbers of a geometry_msgs/Twist, as they were published."""

    linear_x_m_s: float = 0.0
    linear_y_m_s: float = 0.0
    linear_z_m_s: float = 0.0
    angular_x_rad_s: float = 0.0
    angular_y_rad_s: float = 0.0
    angular_z_rad_s: float = 0.0

    @classmethod
    def from_fields(cls, twist: Mapping[str, Any]) -> "Twist":
        """From a decoded Twist."""
        linear, angular = twist["linear"], twist["angular"]
        return cls(linear["x"], linear["y"], linear["z"], angular["x"], angular["y"], angular["z"])

    @classmethod
    def decode(cls, payload: bytes) -> "Twist":
        """From a serialised Twist.

        Raises:
            BadPayload: the payload has another length.
        """
        if len(payload) != _TWIST.size:
            raise BadPayload(TWIST_TYPE, f"{len(payload)} bytes instead of {_TWIST.size}")
        return cls(*_TWIST.unpack(payload))

    def encode(self) -> bytes:
        """Encode a serialised Twist."""
        return _TWIST.pack(*self)

    @property
    def is_zero(self) -> bool:
        """Whether nothing moves."""
        return not any(self)

    @property
    def is_finite(self) -> bool:
        """Whether every component is a number."""
        return all(map(math.isfinite, self))

    @property
    def speed_m_s(self) -> float:
        """The length of the linear velocity."""
        return math.hypot(*self[:3])

    @property
    def turn_rad_s(self) -> float:
        """The length of the angular velocity."""
        return math.hypot(*self[3:])

    @property
    def planar(self) -> PlanarVelocity:
        """The three components that a robot on a floor has."""
        return PlanarVelocity(self.linear_x_m_s, self.linear_y_m_s, self.angular_z_rad_s)

    @property
    def is_planar(self) -> bool:
        """Whether `planar` is all of it."""
        return not any(self[2:5])


ZERO = PlanarVelocity()
