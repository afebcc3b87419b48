"""RemoteRobot: a robot of another daemon, as that one describes it. Its gate and its lease are there."""

import dataclasses
import math
import secrets
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from hostlink.errors import CommandRefused, DeviceGone
from hostlink.hub.message import Message
from hostlink.hub.refusals import Refusals
from hostlink.robot.admission import EPOCH_BITS, Admission, Command
from hostlink.robot.directory import RobotTopicNames
from hostlink.robot.odometry_estimator import OdometrySnapshot
from hostlink.robot.velocity import ZERO, PlanarVelocity


class Elsewhere(Protocol):
    """How the daemons that have other robots are reached. What is no coroutine does not wait."""

    def drive(
        self, robot: "RemoteRobot", velocity: PlanarVelocity, *, owner: Hashable, priority: int, epoch: int | None
    ) -> None:
        """Send a command of an owner; what it was refused for is raised by the next one, or by `answer`."""
        ...

    async def answer(self, robot: "RemoteRobot", owner: Hashable) -> PlanarVelocity:
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
    """What the other daemon reported of its gate, and the admission of commands that are sent there from here."""

    admission: Admission
    owner_name: str | None = None
    priority: int | None = None
    current: PlanarVelocity = ZERO
    epoch: int | None = None  # of the admission there

    @property
    def lock_reason(self) -> str | None:
        """Why the robot is locked; None: it is not."""
        return self.admission.lock_reason

    def report(self, *, epoch: int | None, lock_reason: str | None, now_s: float) -> None:
        """Note what the other daemon says of its admission: what was interrupted there is interrupted here."""
        admission = self.admission
        if lock_reason is not None and admission.lock_reason != lock_reason:
            admission.lock(lock_reason, now_s)
        elif lock_reason is None and admission.lock_reason is not None:
            admission.unlock(now_s)
        elif self.epoch is not None and epoch is not None and epoch > self.epoch:
            admission.interrupt(now_s)
        if epoch is not None:  # a state may be older than an answer
            self.epoch = epoch if self.epoch is None else max(epoch, self.epoch)


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


@dataclass(slots=True, eq=False, kw_only=True, weakref_slot=True)
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
    gate: RemoteGate = field(init=False)
    odometry: RemoteOdometry = field(default_factory=RemoteOdometry)
    refusals: Refusals = field(default_factory=Refusals)
    followers: dict[Hashable, Callable[[Message | None], None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.gate = RemoteGate(Admission(self.name, epoch=secrets.randbits(EPOCH_BITS)))

    @property
    def resumed_link(self) -> int:
        """The link since which no reconnection was an interruption."""
        return 0 if self.link is None else self.link.number

    def command(self, command: Command[PlanarVelocity], now_s: float) -> PlanarVelocity:
        """Send a command to the daemon that has the robot, if it is admitted here; returns it as it was sent.

        Raises:
            CommandRefused: it is not admitted; or as the answer to the command of its source before this one.
            DeviceGone: it is not known which robot is meant, or its daemon does not answer.
            FrameTooLarge, WrongType: so was the command of its source before this one answered.
        """
        self.check_unique()
        decision = self.gate.admission.decide(command, now_s)
        if decision.kind is not None:
            raise CommandRefused(self.name, decision.kind, decision.reason, holder=decision.holder)
        epoch = None if command.epoch is None else self.gate.epoch
        self.elsewhere.drive(self, command.velocity, owner=command.source, priority=command.priority, epoch=epoch)
        return command.velocity

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
