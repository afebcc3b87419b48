"""Velocity: the six components of a geometry_msgs/Twist, in m/s and rad/s."""

import math
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from hostlink.errors import BadPayload

TWIST_TYPE = "geometry_msgs/Twist"
TWIST_STAMPED_TYPE = "geometry_msgs/TwistStamped"
_TWIST = struct.Struct("<6d")


class Velocity(NamedTuple):
    """x forward, y left, z up; angular counter-clockwise (REP 103). A differential drive uses first and last."""

    linear_x_m_s: float = 0.0
    linear_y_m_s: float = 0.0
    linear_z_m_s: float = 0.0
    angular_x_rad_s: float = 0.0
    angular_y_rad_s: float = 0.0
    angular_z_rad_s: float = 0.0

    @classmethod
    def from_twist(cls, twist: Mapping[str, Any]) -> "Velocity":
        """From a decoded Twist."""
        linear, angular = twist["linear"], twist["angular"]
        return cls(linear["x"], linear["y"], linear["z"], angular["x"], angular["y"], angular["z"])

    @classmethod
    def decode(cls, payload: bytes) -> "Velocity":
        """From a serialised Twist.

        Raises:
            BadPayload: it is none.
        """
        if len(payload) != _TWIST.size:
            raise BadPayload(TWIST_TYPE, f"{len(payload)} bytes instead of {_TWIST.size}")
        return cls(*_TWIST.unpack(payload))

    def encode(self) -> bytes:
        """As a serialised Twist."""
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
    def linear_m_s(self) -> float:
        """How fast the robot's origin moves."""
        return math.hypot(*self[:3])

    @property
    def angular_rad_s(self) -> float:
        """How fast the robot turns."""
        return math.hypot(*self[3:])

    def scaled(self, factor: float) -> "Velocity":
        """The same curve, slower or faster."""
        return Velocity(*(component * factor for component in self))

    def toward(self, target: "Velocity", fraction: float) -> "Velocity":
        """The point of the straight line to `target`; a fraction of 1 is the target itself."""
        if fraction >= 1:
            return target
        rest = 1 - fraction  # not here + (there - here) * fraction: the difference of two finite numbers may be none
        return Velocity(*(here * rest + there * fraction for here, there in zip(self, target, strict=True)))


ZERO = Velocity()
