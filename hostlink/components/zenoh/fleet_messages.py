"""Messages between the daemons of a fleet, as JSON, and the keys that carry them.

A key begins with the verb and holds the sender's name, so that Zenoh's access rules can say who may do what.
"""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypeVar

import msgspec

from hostlink.components.zenoh.session import ZenohSession
from hostlink.core.host import CommandEndpoint
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.state import Priority, RobotName, RobotState, Text, TopicName, TypeName
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.core.runtime.logs import printable

MAX_ROBOTS = 256  # of one daemon
MAX_TOPICS = 4096  # of one daemon
MAX_BOARD_TOPICS = 64  # in one answer
MAX_STATE_BYTES = 256 * 1024
MAX_REQUEST_BYTES = 4096
_DIGITS = 6  # micrometres
_TEXT_CHARS = 200

MALFORMED = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)  # of a decoder; also over a bound

GROUP = "fleet"  # of its participants in the hub


class Sender(NamedTuple):
    """Sender of a message: the daemon's name, and the id of its session, which is new after each start."""

    name: str
    zid: str


_ADDRESSED = ("drive", "publish", "answer")  # verbs of messages to one daemon


class Keys:
    """The keys of one fleet: FLEET/VERB/NAME/ID/..., and FLEET/VERB/ID OF THE RECEIVER/NAME/ID/... for _ADDRESSED."""

    def __init__(self, fleet: str) -> None:
        self.fleet = fleet

    def key(self, verb: str, sender: Sender, *rest: str, to: str = "") -> str:
        """Return a key. `to`: the id of the daemon that an addressed message is for."""
        return "/".join((self.fleet, verb, *((to,) if to else ()), *sender, *rest))

    def sender(self, key: str) -> Sender | None:
        """Return the sender in a key; None for a key outside of this fleet."""
        parts = self._parts(key)
        return Sender(parts[0], parts[1]) if len(parts) > 1 else None

    def topic(self, key: str) -> str:
        """The topic at the end of a key of `out` or `publish`."""
        return "/" + "/".join(self._parts(key)[2:])

    def _parts(self, key: str) -> list[str]:
        """Return the parts of a key from the name of the sender on."""
        if not key.startswith(f"{self.fleet}/"):
            return []
        verb, *parts = key.removeprefix(f"{self.fleet}/").split("/")
        return parts[1:] if verb in _ADDRESSED else parts


class PoseState(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Newest pose and motion. It is sent ten times a second, so its fields have no names.

    An older daemon does not send the last one.
    """

    x_m: float
    y_m: float
    theta_rad: float
    linear_m_s: float
    angular_rad_s: float
    stamp_ns: int
    age_s: float
    rate_hz: float
    count: int
    restarts: int = 0
    ignored: int = 0
    linear_y_m_s: float = 0.0

    @classmethod
    def of(cls, known: OdometrySnapshot) -> "PoseState | None":
        """Return the message; None without a velocity: older daemons would take its absence for a standstill."""
        if known.pose is None or known.twist is None:
            return None
        return cls(
            x_m=round(known.pose.x_m, _DIGITS),
            y_m=round(known.pose.y_m, _DIGITS),
            theta_rad=round(known.pose.theta_rad, _DIGITS),
            linear_m_s=round(known.twist.x_m_s, _DIGITS),
            angular_rad_s=round(known.twist.yaw_rad_s, _DIGITS),
            linear_y_m_s=round(known.twist.y_m_s, _DIGITS),
            stamp_ns=known.stamp_ns,
            age_s=round(known.age_s, _DIGITS),
            rate_hz=round(known.rate_hz, 2),
            count=known.count,
            restarts=known.restarts,
            ignored=known.ignored,
        )

    @property
    def odometry(self) -> OdometrySnapshot:
        return OdometrySnapshot(
            pose=Pose(self.x_m, self.y_m, self.theta_rad),
            twist=PlanarVelocity(self.linear_m_s, self.linear_y_m_s, self.angular_rad_s),
            stamp_ns=self.stamp_ns,
            age_s=self.age_s,
            rate_hz=self.rate_hz,
            count=self.count,
            restarts=self.restarts,
            ignored=self.ignored,
        )


class RobotMessage(RobotState, frozen=True, kw_only=True, omit_defaults=True):
    """A RobotState as daemons send it: every field of it, velocity and odometry as older daemons know them."""

    velocity: tuple[float, float] = (0.0, 0.0)  # type: ignore[assignment]  # forward, and the turn
    linear_y_m_s: float = 0.0
    pose: PoseState | None = None
    epoch: int | None = None  # type: ignore[assignment]  # one from before epochs sends none

    @classmethod
    def of(cls, state: RobotState) -> "RobotMessage":
        facts = {name: getattr(state, name) for name in _FIELDS}
        velocity, odometry = state.velocity, state.odometry
        facts["velocity"], facts["linear_y_m_s"] = (velocity.x_m_s, velocity.yaw_rad_s), velocity.y_m_s
        facts["pose"] = None if odometry is None else PoseState.of(odometry)
        return cls(**facts)

    @property
    def state(self) -> RobotState:
        facts = {name: getattr(self, name) for name in _FIELDS}
        facts["velocity"] = PlanarVelocity(self.velocity[0], self.linear_y_m_s, self.velocity[1])
        facts["odometry"] = None if self.pose is None else self.pose.odometry
        facts["epoch"] = self.epoch or 0
        return RobotState(**facts)

    @property
    def is_below_its_name(self) -> bool:
        """Whether its topics are its own, and no other robot's."""
        topics = (self.velocity_topic, self.odometry_topic, self.reset_topic)
        return all(topic is None or topic.startswith(f"/{self.name}/") for topic in topics)


_FIELDS = tuple(name for name in RobotState.__struct_fields__ if name != "odometry")


class State(msgspec.Struct, frozen=True, kw_only=True):
    """Every robot of a daemon. `sent_s`: by its own clock; `topics`: a number that changes with its topics."""

    sent_s: float
    topics: int
    robots: Annotated[tuple[RobotMessage, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
    is_last: bool = False  # the daemon ends, and has stopped its robots; an older daemon does not send it
    boards_locked: Text | None = None  # reason of the lock of its boards; an older daemon locks none


class RobotMotion(msgspec.Struct, frozen=True, array_like=True):
    """Motion of a robot, which changes all the time."""

    name: RobotName
    velocity: tuple[float, float]
    pose: PoseState | None
    linear_y_m_s: float = 0.0  # an older daemon does not send it


class Live(msgspec.Struct, frozen=True, kw_only=True):
    """Motions of a daemon's robots, sent while another daemon subscribes."""

    robots: Annotated[tuple[RobotMotion, ...], msgspec.Meta(max_length=MAX_ROBOTS)]


class FleetTopic(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A topic below a robot's name. `is_published`: others may subscribe; `is_subscribed`: others may publish."""

    robot: RobotName
    name: TopicName
    type: TypeName
    is_published: bool = False
    is_subscribed: bool = False
    is_velocity: bool = False


class TopicList(msgspec.Struct, frozen=True, kw_only=True):
    """Every topic of a daemon's robots."""

    number: int
    topics: Annotated[tuple[FleetTopic, ...], msgspec.Meta(max_length=MAX_TOPICS)]


class FleetCommand(msgspec.Struct, frozen=True, kw_only=True, tag="drive"):
    """A velocity, linear and angular, for the length of a lease. `owner`: who drives, among those of the sender."""

    number: int
    sent_s: float
    robot: RobotName
    owner: int
    owner_name: Text
    velocity: tuple[float, float, float, float, float, float]
    priority: Priority
    epoch: int | None = None  # of the robot, as the sender last saw it
    take_over: bool = False  # from another driver of the same priority

    @property
    def wanted(self) -> PlanarVelocity:
        return Twist(*self.velocity).planar


class Release(msgspec.Struct, frozen=True, kw_only=True, tag="release"):
    """A driver has left: what it drives stops."""

    number: int
    owner: int


class Unlock(msgspec.Struct, frozen=True, kw_only=True, tag="unlock"):
    """Let a robot be driven again; None: every board, and every robot whose name no other daemon has."""

    number: int
    robot: RobotName | None


Receivers = Annotated[tuple[Annotated[str, msgspec.Meta(max_length=64)], ...], msgspec.Meta(max_length=64)]


class Stop(msgspec.Struct, frozen=True, kw_only=True, tag="stop"):
    """Stop all robots of a name at all daemons; None: every robot. `to`: only at the daemons of these ids."""

    number: int
    robot: RobotName | None = None
    to: Receivers = ()


class Lock(msgspec.Struct, frozen=True, kw_only=True, tag="lock"):
    """Stop all robots of a name, and refuse commands until they are unlocked. `to`: as for a stop.

    None: every robot and every board. An older daemon does not answer that.
    """

    number: int
    robot: RobotName | None
    reason: Text
    to: Receivers = ()


class BoardTopic(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Topic that commands a motion and is not a robot's, after a stop or a lock; as `CommandEndpoint`."""

    link: int
    peer: Text
    topic: Text
    type: Text
    robot: Text | None = None
    is_guarded: bool = False
    is_locked: bool = False
    reason: Text = ""

    @classmethod
    def of(cls, endpoint: CommandEndpoint) -> "BoardTopic":
        """Return the message of a topic here."""
        return cls(
            link=endpoint.link,
            peer=printable(endpoint.peer, _TEXT_CHARS),
            topic=printable(endpoint.topic, _TEXT_CHARS),
            type=printable(endpoint.type_name, _TEXT_CHARS),
            robot=None if endpoint.robot is None else printable(endpoint.robot, _TEXT_CHARS),
            is_guarded=endpoint.is_guarded,
            is_locked=endpoint.is_locked,
            reason=printable(endpoint.reason, _TEXT_CHARS),
        )

    def at(self, host: str) -> CommandEndpoint:
        """Return the topic of another daemon."""
        robot = None if self.robot is None else printable(self.robot)
        topic, peer, type_name = map(printable, (self.topic, self.peer, self.type))
        reason = printable(self.reason)
        return CommandEndpoint(
            self.link, peer, robot, topic, type_name, self.is_guarded, self.is_locked, reason, printable(host)
        )


class FleetAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Answer to the request of a number: the velocity after the limits, the robots concerned, or a refusal.

    `epoch`: how often the robot was interrupted. `boards`: after a stop or a lock, topics that are not a robot's, those
    first that were not covered.
    """

    number: int
    error: Text = ""  # a refusal's kind, or the name of a class of hostlink.errors
    reason: Annotated[str, msgspec.Meta(max_length=1024)] = ""
    owner: Text | None = None  # who drives it
    velocity: tuple[float, ...] | None = None
    epoch: int | None = None
    robots: Annotated[tuple[RobotMessage, ...], msgspec.Meta(max_length=MAX_ROBOTS)] = ()
    boards: Annotated[tuple[BoardTopic, ...], msgspec.Meta(max_length=MAX_BOARD_TOPICS)] = ()


Request = FleetCommand | Release | Unlock
StopRequest = Stop | Lock

_Kind = TypeVar("_Kind")
STATE, LIVE = msgspec.json.Decoder(State), msgspec.json.Decoder(Live)
TOPIC_LIST, ANSWER = msgspec.json.Decoder(TopicList), msgspec.json.Decoder(FleetAnswer)
REQUEST: msgspec.json.Decoder[Request] = msgspec.json.Decoder(Request)  # to one daemon
STOP_REQUEST: msgspec.json.Decoder[StopRequest] = msgspec.json.Decoder(StopRequest)  # to all daemons
encode = msgspec.json.Encoder().encode


@dataclass(frozen=True, slots=True)
class FleetTransport:
    """Messages of this daemon to the others of its fleet, and theirs to it.

    `me`: name and id of this daemon; `counts`: refused and dropped messages, by cause; `slept_s`: for how long this
    computer has slept so far, which the loop's time leaves out.
    """

    session: ZenohSession
    keys: Keys
    me: Sender
    counts: Counter[str]
    may_drive: tuple[str, ...] = ("*",)  # patterns of the names of daemons whose programs may drive robots here
    slept_s: Callable[[], float] = lambda: 0.0

    def key(self, verb: str, *rest: str, to: str = "") -> str:
        """Return a key of this daemon's messages."""
        return self.keys.key(verb, self.me, *rest, to=to)

    def clock_s(self, loop_s: float) -> float:
        """Return a time of the loop by the clock of `sent_s`, which counts the sleep of this computer.

        By a clock without it, each later command would be as old as the sleep was long.
        """
        return loop_s + self.slept_s()

    def put(self, verb: str, message: msgspec.Struct, *, to: str = "") -> None:
        """Send a message before all others; `to`: the id of a daemon, else it is for all."""
        self.session.put(self.key(verb, to=to), encode(message), is_urgent=True)

    def decode(self, payload: bytes, decoder: "msgspec.json.Decoder[_Kind]") -> _Kind | None:
        """Decode what another daemon has sent. None: it is malformed, which is counted."""
        try:
            return decoder.decode(payload)
        except MALFORMED:
            self.counts["malformed"] += 1
            return None


def is_shareable(robot: str) -> bool:
    """Whether other daemons can know a robot by its name."""
    return re.fullmatch(r"\w{1,64}", robot, re.ASCII) is not None


def fleet_name(robot: str, topic: str) -> str:
    """A topic of a robot as other daemons know it: below the robot's name."""
    return topic if topic.startswith(f"/{robot}/") else f"/{robot}{topic}"


def message_of(state: RobotState) -> RobotMessage:
    """A robot as other daemons receive it: its topics below its name, without what concerns this daemon alone."""
    robot = state.name
    shared = msgspec.structs.replace(
        state,
        also_at=(),
        frames=None,
        velocity_topic=fleet_name(robot, state.velocity_topic),
        odometry_topic=None if state.odometry_topic is None else fleet_name(robot, state.odometry_topic),
        reset_topic=None if state.reset_topic is None else fleet_name(robot, state.reset_topic),
        holder=None if state.holder is None else printable(state.holder, _TEXT_CHARS),
        holder_address=None,
        unreachable=None if state.unreachable is None else printable(state.unreachable, _TEXT_CHARS),
    )
    return RobotMessage.of(shared)
