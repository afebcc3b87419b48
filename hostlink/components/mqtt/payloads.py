"""Payloads of messages: states and answers as JSON, commands parsed. Pure."""

import math
from typing import Any, Final

import msgspec

from hostlink.core.host import PlanarVelocity, RobotState
from hostlink.errors import BadPayload

MAX_PAYLOAD_BYTES: Final = 1024  # of a command
MAX_REASON: Final = 120  # characters
MAX_ERRORS: Final = 16


class Drive(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Payload of a drive. `sent_s` is the sender's clock, in seconds since 1970."""

    sent_s: float
    linear: float = 0.0
    angular: float = 0.0
    linear_y: float = 0.0
    epoch: int | None = None

    @property
    def velocity(self) -> PlanarVelocity:
        """Velocity that it asks for."""
        return PlanarVelocity(self.linear, self.linear_y, self.angular)


_DRIVE = msgspec.json.Decoder(Drive)


def parse_drive(payload: bytes) -> Drive:
    """Return what a payload asks for.

    Raises:
        BadPayload: it is too large, is not such JSON, or has a number that is not finite.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise BadPayload("drive", f"{len(payload)} bytes, at most {MAX_PAYLOAD_BYTES} are taken")
    try:
        drive = _DRIVE.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        hint = "; an MQTT broker may keep a command, so sent_s must say when it was sent" * ("sent_s" in str(error))
        raise BadPayload("drive", f"{error}{hint}") from None
    if not all(map(math.isfinite, (drive.sent_s, drive.linear, drive.angular, drive.linear_y))):
        raise BadPayload("drive", "a number is not finite")
    return drive


def parse_reason(payload: bytes) -> str:
    """Return the reason of a lock. Any payload gives one: a lock must never fail for its text."""
    text = payload[:MAX_PAYLOAD_BYTES].decode(errors="replace")
    text = "".join(letter if letter.isprintable() else " " for letter in text)
    return " ".join(text.split())[:MAX_REASON] or "locked by MQTT"


def encode_state(robot: RobotState) -> bytes:
    """Return a robot's state as JSON. Numbers are rounded, so that noise is not a change."""
    odometry = robot.odometry
    pose = odometry.pose if odometry else None
    twist = odometry.twist if odometry else None
    return msgspec.json.encode(
        {
            "name": robot.name,
            "connected": robot.link is not None,
            "host": robot.host,
            "holder": robot.holder,
            "locked": robot.lock_reason is not None,
            "lock_reason": robot.lock_reason,
            "velocity": velocity_view(robot.velocity),
            "measured": velocity_view(twist) if twist else None,
            "pose": {"x_m": _round(pose.x_m, 3), "y_m": _round(pose.y_m, 3), "theta_rad": _round(pose.theta_rad, 3)}
            if pose
            else None,
            "battery_v": _round(robot.battery_v, 1),
            "battery_percent": _round(robot.battery_percent, 0),
            "signal_dbm": robot.signal_dbm,
            "firmware": robot.firmware,
            "errors": list(robot.device_errors[:MAX_ERRORS]),
            "epoch": robot.epoch,
            "lease_s": robot.lease_s,
            "is_played": robot.is_played,
        }
    )


def encode_answer(command: str, *, ok: bool, **facts: object) -> bytes:
    """Return an answer as JSON. Facts that are None are left out."""
    told = {name: value for name, value in facts.items() if value is not None}
    return msgspec.json.encode({"command": command, "ok": ok, **told})


def velocity_view(velocity: PlanarVelocity) -> dict[str, Any]:
    """Return a velocity under the names of hostlink's other interfaces."""
    return {
        "linear_m_s": _round(velocity.x_m_s, 3),
        "linear_y_m_s": _round(velocity.y_m_s, 3),
        "angular_rad_s": _round(velocity.yaw_rad_s, 3),
    }


def _round(value: float | None, digits: int) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return round(value, digits) + 0.0  # never -0.0
