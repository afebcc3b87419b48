"""Results of the client: the JSON of hostlink's REST API as typed dicts; numbers carry their unit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, Self

from hostlink.core.messages.serialisation import ROS1
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.views import CommandEndpointView, OdometryView, PoseView, RobotView, TopicView, VelocityView

# The names that users import.
Pose = PoseView
Twist = VelocityView
Odometry = OdometryView
RobotState = RobotView
TopicState = TopicView
CommandEndpoint = CommandEndpointView


class StoppedRobot(Standstill):
    """Measurement of one robot after a stop or a lock.

    `endpoints`: what else its devices take that looks like a command; what these topics move is not measured.
    """

    endpoints: tuple[CommandEndpoint, ...] = ()

    @classmethod
    def of(cls, measured: Standstill, endpoints: Sequence[CommandEndpoint]) -> Self:
        """Return a measurement with the topics of the robot's devices."""
        found = cls(*measured)
        found.endpoints = tuple(endpoints)
        return found


class Stopped(dict[str, Standstill]):
    """Measurement of each robot after a stop or a lock of all, by name.

    `endpoints`: topics of boards that command a motion and are not a robot's; what they move is not measured.
    """

    def __init__(self, measured: Mapping[str, Standstill], endpoints: Sequence[CommandEndpoint] = ()) -> None:
        super().__init__(measured)
        self.endpoints = tuple(endpoints)


class RawMessage(NamedTuple):
    """A message as bytes: serialised as ROS 1 does it, which is rosserial's way too, unless `encoding` says else."""

    payload: bytes
    stamp_ns: int  # wall time at which it reached the daemon
    encoding: str = ROS1  # "cdr": as ROS 2 serialises it, because the daemon has no definition of its type


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
    ASLEEP = "asleep"  # this program did not run, or could not send, for longer than a command holds
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
