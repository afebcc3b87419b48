"""RemoteRobot: a robot of another daemon, as that one describes it. Its gate and its lease are there."""

import dataclasses
import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from hostlink.errors import DeviceGone, RobotHeld
from hostlink.hub.message import Message
from hostlink.hub.refusals import Refusals
from hostlink.robot.directory import RobotTopicNames
from hostlink.robot.locked_streams import LockedStreams
from hostlink.robot.odometry_estimator import OdometrySnapshot
from hostlink.robot.velocity import ZERO, Velocity
from hostlink.robot.velocity_gate import LEASE_S


class Elsewhere(Protocol):
    """How the daemons that have other robots are reached. What is no coroutine does not wait."""

    def drive(
        self, robot: "RemoteRobot", velocity: Velocity, *, owner: Hashable, priority: int, stops: int | None
    ) -> None:
        """Send a command of an owner; what it was refused for is raised by the next one, or by `answer`."""
        ...

    async def answer(self, robot: "RemoteRobot", owner: Hashable) -> Velocity:
        """The answer to the newest command of an owner: the velocity after the limits."""
        ...

    def release(self, owner: Hashable) -> None:
        """A source of commands is gone."""
        ...

    def stop(self, name: str | None) -> None:
        """Stop whatever has this name, wherever it is; None: every robot."""
        ...

    def lock(self, name: str, reason: str) -> None:
        """Lock whatever has this name, wherever it is."""
        ...

    def unlock(self, robot: "RemoteRobot") -> None:
        """Let it be driven again."""
        ...

    async def settled(self) -> None:
        """Wait until every daemon has answered the stops, locks and unlocks so far."""
        ...


class RemoteLink(NamedTuple):
    """The device's connection over there. `number` is one of this daemon's numbers, `own_number` the other's."""

    number: int
    own_number: int


@dataclass(slots=True)
class RemoteGate:
    """What the other daemon reported of its gate."""

    owner_name: str | None = None
    priority: int | None = None
    lock_reason: str | None = None
    current: Velocity = ZERO
    lease_s: float = LEASE_S
    stops: int | None = None  # as its daemon's newest answer to a command here has counted them


class RemoteOdometry:
    """The newest pose that the other daemon sent. It sends poses as they come while they are read here."""

    def __init__(self) -> None:
        self.read_at_s = -math.inf
        self.count = 0
        self._newest: OdometrySnapshot | None = None
        self._at_s = 0.0

    def update(self, newest: OdometrySnapshot, now_s: float) -> bool:
        """Returns whether it is another pose than before."""
        is_new = self._newest is None or (newest.count, newest.restarts) != (self._newest.count, self._newest.restarts)
        self._newest, self._at_s, self.count = newest, now_s, newest.count
        return is_new

    def snapshot(self, now_s: float) -> OdometrySnapshot | None:
        """The newest pose with its age; None before the first."""
        self.read_at_s = now_s
        if self._newest is None:
            return None
        return dataclasses.replace(self._newest, age_s=self._newest.age_s + now_s - self._at_s)


@dataclass(slots=True, eq=False, kw_only=True)
class RemoteRobot:
    """It has the shape of a Robot, for whoever shows robots."""

    name: str
    host: str  # the name of the daemon that has it
    place: Hashable  # which daemon that is: names may repeat
    shown: RobotTopicNames
    elsewhere: Elsewhere
    link: RemoteLink | None = None
    is_played: bool = False  # its device is a recording
    also_at: tuple[str, ...] = ()  # other daemons that have a robot of this name; then it is not driven from here
    streams: LockedStreams = field(default_factory=LockedStreams)
    gate: RemoteGate = field(default_factory=RemoteGate)
    odometry: RemoteOdometry = field(default_factory=RemoteOdometry)
    refusals: Refusals = field(default_factory=Refusals)
    followers: dict[Hashable, Callable[[Message | None], None]] = field(default_factory=dict)

    def command(self, velocity: Velocity, *, owner: Hashable, priority: int, stops: int | None = None) -> Velocity:
        """Send a command to the daemon that has the robot; returns it as it was sent.

        `stops`: the robot's, as its sender knew them; a stop since refuses the command there.

        Raises:
            DeviceGone: it is not connected, or it is not known which robot is meant.
            RobotHeld: it is locked, or as the answer to the owner's command before this one.
            BadRequest, FrameTooLarge, WrongType: so was the owner's command before this one answered.
        """
        self.check_unique()
        if self.link is None:
            raise DeviceGone(self.name, f"its device is not connected to {self.host}")
        if self.gate.lock_reason is not None:
            raise RobotHeld(self.name, None, lock_reason=self.gate.lock_reason)
        self.elsewhere.drive(self, velocity, owner=owner, priority=priority, stops=stops)
        return velocity

    def check_unique(self) -> None:
        """Refuse what could mean either of two robots.

        Raises:
            DeviceGone: robots of several daemons have this name.
        """
        if self.also_at:
            places = ", ".join((self.host, *self.also_at))
            raise DeviceGone(self.name, f"several robots have this name, at {places}; rename all but one of them")

    def follow(self) -> None:
        """Call the followers: there is a new pose."""
        for receive in tuple(self.followers.values()):
            receive(None)
