"""RobotState: everything that is shown of a robot, as one record. Pure.

`Robot.state` makes it, for a robot of this daemon and for one of another daemon. What REST, the events, the metrics,
the client, `hostlink robots`, `top` and the page show is a view of it. The daemons of a fleet send it to each other;
the bounds of its fields hold for what another daemon sends.
"""

import math
import struct
from typing import Annotated, Any, NamedTuple

import msgspec

from hostlink.core.robot.feedback import FeedbackKind
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.velocity import TWIST_TYPE, ZERO, Kinematics, PlanarVelocity

BATTERY_TYPE = "sensor_msgs/BatteryState"
MAX_PRIORITY = 100  # a person at keys or a joystick has 60
_LONGEST_TOPIC = 256
_MAX_NAMES = 64  # of errors, and of hosts

RobotName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_]+$", max_length=64)]
TopicName = Annotated[str, msgspec.Meta(pattern=r"^(/[A-Za-z0-9_]+)+$", max_length=_LONGEST_TOPIC)]
TypeName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z]\w*/[A-Za-z]\w*$", max_length=128)]
Text = Annotated[str, msgspec.Meta(max_length=256)]
Texts = Annotated[tuple[Text, ...], msgspec.Meta(max_length=_MAX_NAMES)]
Priority = Annotated[int, msgspec.Meta(ge=0, le=MAX_PRIORITY)]

#: What is not known of a robot whose device is not connected.
DEVICE_AWAY: dict[str, Any] = {
    "battery_v": None, "battery_percent": None, "signal_dbm": None, "device_errors": (), "firmware": None,
}  # fmt: skip


class RobotState(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One robot at one moment. A field is None where its value is not known, or where the robot lacks it."""

    name: RobotName
    host: Text | None = None  # the daemon that has its link; None: this one
    also_at: Texts = ()  # other daemons that have a robot of this name
    link: int | None = None  # the number of its device's connection; None: the device is not connected
    frames: int | None = None  # that its device has sent on this link; None for a robot of another daemon
    velocity_topic: TopicName
    command_type: TypeName = TWIST_TYPE  # of its velocity topic
    feedback: FeedbackKind = FeedbackKind.POSE  # what is known of its motion
    odometry_topic: TopicName | None = None
    odometry_type: TypeName | None = None
    reset_topic: TopicName | None = None
    is_played: bool = False  # its device is a recording, which cannot be driven
    holder: Text | None = None  # who drives it
    holder_address: Text | None = None  # from which who drives it is connected; None for a robot of another daemon
    priority: Priority | None = None  # of who drives it
    lock_reason: Text | None = None  # None: it is not locked
    epoch: int = 0  # counts interruptions: stops, locks, reconnections
    unreachable: Text | None = None  # why its device could not receive the last velocity; None: the device could
    wheel_separation_m: float | None = None  # as it is configured
    kinematics: Kinematics = Kinematics.PLANAR
    lease_s: Annotated[float, msgspec.Meta(gt=0, le=60)] = 0.5
    velocity: PlanarVelocity = ZERO  # as its device is sent it
    odometry: OdometrySnapshot | None = None
    battery_v: float | None = None
    battery_percent: float | None = None
    signal_dbm: int | None = None  # of its device's WiFi
    device_errors: Texts = ()  # the codes of what `hostlink doctor` finds wrong, the likeliest cause first
    firmware: Text | None = None  # name and version, as its device logs them


class BatteryReading(NamedTuple):
    """Battery values that a device measures; None for those that it does not measure."""

    voltage_v: float | None
    percent: float | None


_FRAME_ID = struct.Struct("<12xI")  # the header: seq, secs, nsecs, the length of frame_id
_CHARGE = struct.Struct("<f20xf")  # voltage; temperature to design_capacity between; percentage


def read_battery(payload: bytes) -> BatteryReading:
    """From a sensor_msgs/BatteryState. A damaged one measures nothing."""
    try:
        (frame_bytes,) = _FRAME_ID.unpack_from(payload)
        voltage_v, fraction = _CHARGE.unpack_from(payload, _FRAME_ID.size + frame_bytes)
    except struct.error:
        return BatteryReading(None, None)
    is_charge = 0.0 <= fraction <= 1.0  # a NaN is neither
    return BatteryReading(
        round(voltage_v, 3) if math.isfinite(voltage_v) else None, round(100.0 * fraction, 1) if is_charge else None
    )
