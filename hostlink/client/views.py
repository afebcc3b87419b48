"""Results of the client: the JSON of hostlink's REST API as typed dicts; numbers carry their unit."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, NotRequired, TypedDict


class Pose(TypedDict):
    """Place of a robot by its own odometry, in the frame in which the odometry began (REP 103)."""

    x_m: float
    y_m: float
    theta_rad: float  # counter-clockwise, in (-pi, pi]


class Twist(TypedDict):
    """Velocity of a robot: forward, counter-clockwise, and to the left."""

    linear_m_s: float
    angular_rad_s: float
    linear_y_m_s: NotRequired[float]  # an older daemon sends none


class Odometry(TypedDict):
    """A pose that the robot sent, and what follows from it."""

    pose: Pose
    twist: Twist
    stamp_ns: int  # wall time at which it reached the daemon
    age_s: float  # since then, when this was sent
    rate_hz: float  # at which poses come
    count: int  # of poses since the daemon knows the robot
    restarts: NotRequired[int]  # of its device that were noticed


class RobotState(TypedDict):
    """A robot as the daemon sees it now."""

    name: str
    connected: bool
    link: int | None  # the number of its device's connection
    velocity_topic: str
    odometry_topic: str
    holder: str | None  # who drives it
    holder_address: NotRequired[str | None]  # from where
    velocity: Twist  # as commanded, within the limits
    odometry: Odometry | None  # None: no pose came yet
    priority: NotRequired[int | None]  # of who drives it
    played: NotRequired[bool]  # its device is a recording, which obeys no command
    locked: NotRequired[bool]
    lock_reason: NotRequired[str | None]
    host: NotRequired[str | None]  # the daemon that has it; None: the one that sent this
    also_at: NotRequired[list[str]]  # other daemons that have a robot of this name; then it is driven only here
    wheel_separation_m: NotRequired[float | None]  # as it is configured
    kinematics: NotRequired[str]  # as it is configured: "differential", or empty
    unreachable: NotRequired[str | None]  # why its device could not take the last velocity
    epoch: NotRequired[int]  # counts interruptions: stops, locks, reconnections
    lease_s: NotRequired[float]  # how long a command lasts
    frames: NotRequired[int | None]  # that its device has sent on this link; None: not connected, or not here
    battery_v: NotRequired[float | None]  # None: its device sends no voltage
    battery_percent: NotRequired[float | None]  # None: its device sends no charge
    signal_dbm: NotRequired[int | None]  # of its device's WiFi; None: the device does not report it
    device_errors: NotRequired[list[str]]  # codes of what `hostlink doctor` finds wrong, the likeliest cause first
    firmware: NotRequired[str | None]  # name and version, as its device logs them


class TopicState(TypedDict):
    """A topic of the graph."""

    name: str
    type: str  # as geometry_msgs/Twist; empty while it is unknown
    publishers: int
    subscribers: int
    messages: int  # that have passed


class RawMessage(NamedTuple):
    """A message as it is on the wire: serialised as ROS 1 does it, which is rosserial's way too."""

    payload: bytes
    stamp_ns: int  # wall time at which it reached the daemon


class Driven(NamedTuple):
    """Velocity that the robot receives after a `drive`, within its limits."""

    linear_m_s: float  # that the robot receives, once its accelerations are over
    angular_rad_s: float
    is_limited: bool  # it is slower than what was commanded
    limited_by: str | None  # the robot's setting that slows it down most; None: none, or its daemon is another
    linear_y_m_s: float = 0.0


class Refusal(NamedTuple):
    """Reason of a refused command: a kind for programs (`locked`, `held`, `disarmed`, ...), a reason for people."""

    kind: str
    reason: str


class MotionOutcome(StrEnum):
    """End of a motion of `drive(for_s=...)`, `move` or `turn`."""

    REACHED = "reached"
    BLOCKED = "blocked"  # the odometry did not advance as commanded
    STOPPED = "stopped"  # `Motion.kind`, `by` and `reason` tell why
    TIMED_OUT = "timed_out"


class Progress(NamedTuple):
    """Progress of a `move` or `turn`, by odometry."""

    distance_m: float  # forward, along the heading at the start
    turned_rad: float  # counter-clockwise
    elapsed_s: float
    fraction: float  # of the way; it may pass 1 by a little


@dataclass(frozen=True, slots=True)
class Motion:
    """End of a motion. The robot was sent a zero, or the daemon had stopped it before."""

    outcome: MotionOutcome
    elapsed_s: float
    distance_m: float | None = None  # forward, by odometry; None: the motion was `drive(for_s=...)`
    turned_rad: float | None = None  # counter-clockwise
    kind: str = ""  # of a stop: `held`, `locked`, `disarmed` ..., as in CommandRefused; or one of MotionKind
    by: str | None = None  # who drives or locked the robot, or what stopped it: "a stop by ..."; None: unknown
    reason: str = ""  # for people

    @property
    def is_reached(self) -> bool:
        """Whether the motion was completed."""
        return self.outcome is MotionOutcome.REACHED


class MotionKind(StrEnum):
    """Causes of a stop that the client finds itself."""

    PROGRAM = "program"  # this program stopped the robot, or drove it otherwise
    CONNECTION = "connection"  # lost
    ASLEEP = "asleep"  # this program did not run for longer than a command holds
    NO_ODOMETRY = "no_odometry"
    ODOMETRY_RESET = "odometry_reset"  # the robot's board restarted, or a program made its place the origin
    OFF_COURSE = "off_course"  # the odometry jumped, or the robot left the line


@dataclass(frozen=True, slots=True)
class Event:
    """State of the daemon: `robots`, `links` or `clients`; or a `log` line of a device."""

    name: str
    data: dict[str, Any]  # the JSON of GET /api/robots, /api/links, /api/clients; a rosgraph_msgs/Log


@dataclass(frozen=True, slots=True)
class ConnectionChange:
    """The connection to the daemon was lost, or is there again."""

    is_connected: bool
    reason: str  # why it was lost
    dropped: tuple[str, ...] = ()  # the robots that were driven: they stop, and nothing drives them again by itself
