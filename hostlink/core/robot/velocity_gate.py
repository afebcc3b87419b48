"""VelocityGate: the limits and ramps of one velocity topic, between an admitted command and its device. Pure."""

import dataclasses
import math
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, Protocol, TypeVar

from hostlink.core.robot.admission import Admission, Command, Lease
from hostlink.core.robot.kinematics import PLANAR, Drive
from hostlink.core.robot.velocity import AnyVelocity, PlanarVelocity
from hostlink.core.runtime.compiled import mypyc_attr
from hostlink.errors import CommandRefused, ConfigError

ZEROS = 3  # a single stop can be lost on a radio
LONGEST_STEP_S = 0.1  # a late step must not jump
_ALL_OF_IT = 1 - 1e-9  # independent of rounding, a way to zero loses speed to its end, and a step reaches it
_LIMITS = ("max_linear_m_s", "max_angular_rad_s", "max_wheel_m_s")
LOCKED_ZERO_INTERVAL_S = 0.5  # a locked robot receives its zero again and again: it may have no watchdog of its own

V = TypeVar("V", bound=AnyVelocity)


class Bounds(Protocol[V]):
    """Interface of the limits of a gate: `Limits` of a robot, or `Unlimited`."""

    def apply(self, velocity: V) -> V: ...

    def slowest(self, velocity: V) -> str | None: ...

    def step(self, current: V, target: V, step_s: float) -> V: ...


class Unlimited(Generic[V]):
    """No limit and no ramp, for a velocity topic that belongs to no robot: its numbers stay as they were published."""

    def apply(self, velocity: V) -> V:
        """The velocity itself."""
        return velocity

    def slowest(self, _: V) -> None:
        """No limit slows it down."""
        return

    def step(self, _current: V, target: V, _step_s: float) -> V:
        """The target, at once."""
        return target


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a robot's commands; None: no limit. Speed is the length of (x, y).

    Raises:
        ConfigError: one of them cannot be kept.
    """

    max_linear_m_s: float | None = 1.0
    max_angular_rad_s: float | None = 4.0
    max_wheel_m_s: float | None = None  # of the drive's wheels
    max_linear_acceleration_m_s2: float | None = None
    max_angular_acceleration_rad_s2: float | None = None
    max_linear_deceleration_m_s2: float | None = None
    max_angular_deceleration_rad_s2: float | None = None
    drive: Drive = PLANAR
    has_ramps: bool = field(init=False, default=False)  # an acceleration or a deceleration is limited

    def __post_init__(self) -> None:
        """A limit below zero would turn velocities around, one that is not finite would let everything pass."""
        for name in (each.name for each in dataclasses.fields(self) if each.init and each.name != "drive"):
            limit = getattr(self, name)
            if limit is not None and "celeration" in name:
                object.__setattr__(self, "has_ramps", True)
            if limit is not None and not (math.isfinite(limit) and limit >= 0):
                raise ConfigError("limits of a robot", f"{name} must be a finite number, zero or more, not {limit}")
            if limit == 0 and "deceleration" in name:
                raise ConfigError("limits of a robot", f"{name} must be above zero: the robot would never stop")

    def apply(self, velocity: PlanarVelocity) -> PlanarVelocity:
        """The velocity on the same curve, slow enough for every limit; the tightest curve instead of a tighter one."""
        velocity = self.drive.possible(velocity)
        factor = min(self._factors(velocity))
        return velocity if factor >= 1 else velocity.scaled(factor)

    def slowest(self, velocity: PlanarVelocity) -> str | None:
        """The limit that slows this velocity down most, or that of its curve; None: it keeps every limit."""
        possible = self.drive.possible(velocity)
        factors = self._factors(possible)
        smallest = min(factors)
        if smallest < 1:
            return _LIMITS[factors.index(smallest)]
        return None if possible == velocity else "max_steering_rad"

    def _factors(self, velocity: PlanarVelocity) -> tuple[float, float, float]:
        """Factor by which each of _LIMITS slows the velocity down."""
        x_m_s, y_m_s, yaw_rad_s = velocity
        linear_m_s, angular_rad_s = math.hypot(x_m_s, y_m_s), abs(yaw_rad_s)
        linear, angular, wheel = self.max_linear_m_s, self.max_angular_rad_s, self.max_wheel_m_s
        wheel_m_s = 0.0 if wheel is None else self.drive.fastest_wheel_m_s(velocity)
        return (
            1.0 if linear is None or linear_m_s <= linear else linear / linear_m_s,
            1.0 if angular is None or angular_rad_s <= angular else angular / angular_rad_s,
            1.0 if wheel is None or wheel_m_s <= wheel else wheel / wheel_m_s,
        )

    def step(self, current: PlanarVelocity, target: PlanarVelocity, step_s: float) -> PlanarVelocity:
        """From `current` straight towards `target`, as far as accelerations and decelerations allow in `step_s`."""
        if current == target or not self.has_ramps:
            return target
        linear = _reach(
            current[:2],
            target[:2],
            _times(self.max_linear_acceleration_m_s2, step_s),
            _times(self.max_linear_deceleration_m_s2, step_s),
        )
        angular = _reach(
            current[2:],
            target[2:],
            _times(self.max_angular_acceleration_rad_s2, step_s),
            _times(self.max_angular_deceleration_rad_s2, step_s),
        )
        return current.toward(target, min(linear, angular))


@dataclass(slots=True)
class GateCounts:
    """Counters of a gate. Its `Admission` counts refused commands."""

    commands: int = 0  # that were admitted
    limited: int = 0
    expired: int = 0
    stops: int = 0


class EndedLease(NamedTuple):
    """Lease that ended by time, or because its source let go: its last command is a zero."""

    lease: Lease
    was_let_go: bool


@mypyc_attr(allow_interpreted_subclasses=True)
class VelocityGate(Generic[V]):
    """Output to the device of one velocity topic: admitted velocities within the limits, and zeros.

    Who may command is decided by the robot's `Admission`; the gate is told when its lease ends.

    | state    | event                                          | next     | `step` gives then                      |
    |----------|------------------------------------------------|----------|----------------------------------------|
    | idle     | -                                              | idle     | None: silence                          |
    | slowing  | -                                              | slowing  | down to zero; after that: stopping     |
    | stopping | -                                              | stopping | zero, ZEROS times; after the last: idle |
    | driven   | -                                              | driven   | the velocity, on every call            |
    | idle     | zero                                           | stopping | zero, once                             |
    | slowing, stopping | zero                                  | as it is | as without it                          |
    | idle, slowing, stopping | velocity                        | driven   | the velocity; after `restart` zero first |
    | driven   | velocity                                       | driven   | the velocity, at the accelerations     |
    | driven   | zero, end of the lease, `stop`                 | slowing  | down to zero at the deceleration limit, |
    |          |                                                |          | at once without one                    |
    | idle     | `stop`                                         | stopping | zero                                   |
    | any      | `stop_at_once`, `restart`                      | stopping | zero, at once                          |
    | locked   | -                                              | locked   | zero at once, ZEROS times, then again  |
    |          |                                                |          | every LOCKED_ZERO_INTERVAL_S           |
    """

    def __init__(self, admission: Admission, limits: Bounds[V], zero: V, motion: str = "") -> None:
        """`admission` is shared by all velocity topics of a robot, `motion` by those that command the same thing."""
        self.admission, self.motion = admission, motion
        self.limits = limits
        self.zero = self.current = zero
        self.is_new_device = False  # it has not been given its first zero
        self.counts = GateCounts()
        self.driver: Lease | None = None  # the source that drives, and the end of its lease
        self.target = self.zero  # the newest command within the limits
        self._ended: EndedLease | None = None
        self._zeros = 0
        self._zero_at_s = self._stepped_at_s = float("-inf")

    @property
    def owner(self) -> Hashable | None:
        """The source that drives."""
        return None if self.driver is None else self.driver.source

    @property
    def owner_name(self) -> str | None:
        """The name of the source that drives; others may have it, too."""
        return None if self.driver is None else str(self.driver.source)

    @property
    def priority(self) -> int | None:
        """The priority of the source that drives."""
        return None if self.driver is None else self.driver.priority

    @property
    def lock_reason(self) -> str | None:
        """Reason of the lock; None: not locked."""
        return self.admission.lock_reason

    @property
    def may_move(self) -> bool:
        """Whether the robot is driven, slows down, or may not have received its stop yet."""
        return self.driver is not None or self._zeros > 0 or not self.current.is_zero

    @property
    def is_stopping(self) -> bool:
        """Whether the device has a zero of several; `step` gives the others, without a command."""
        return self.driver is None and self._zeros > 0 and not self.is_new_device

    @property
    def is_driven(self) -> bool:
        """Whether a source drives, or the robot slows down; a stop on its way to a robot at rest is neither."""
        return self.driver is not None or not self.current.is_zero

    @property
    def is_active(self) -> bool:
        """Whether `step` has something to send, now or later."""
        return self.may_move or self.lock_reason is not None

    def command(self, command: Command[V], *, now_s: float) -> V:
        """Drive at the velocity of the command, if it is admitted; returns it within the limits.

        Raises:
            CommandRefused: the admission has refused it.
        """
        self._expire(now_s)
        velocity = command.velocity
        decision = self.admission.decide(command, now_s, topic=self, motion=self.motion)
        if decision.kind is not None:
            raise CommandRefused(
                self.admission.robot, decision.kind, decision.reason, holder=decision.holder, by=decision.by
            )
        self.counts.commands += 1
        if velocity.is_zero:
            if self.driver is not None:
                self._ended = EndedLease(self.driver, was_let_go=True)
                self._stop(now_s)
            elif self._ended is not None and self._ended.lease.source == command.source:
                self._ended = EndedLease(self._ended.lease, was_let_go=True)
            self._zeros = max(self._zeros, 1)
            return self.zero
        if self.driver is None and self.current.is_zero:
            self._stepped_at_s = now_s
        self.driver = self.admission.driver(self, now_s)
        self.target = self.limits.apply(velocity)
        self._zeros = int(self.is_new_device)
        self.counts.limited += self.target != velocity
        return self.target

    def pop_ended(self) -> EndedLease | None:
        """Remove and return a lease that ended by time or by a zero, in a command or a step.

        Call it after each of them. A lease that `stop` ends is not returned.
        """
        ended, self._ended = self._ended, None
        return ended

    def stop(self, *, now_s: float) -> None:
        """End the lease, and brake as hard as the limits allow."""
        self._expire(now_s)
        self._stop(now_s)
        self._ended = None

    def stop_at_once(self) -> None:
        """End the lease, and give zero at once, without the limit of deceleration."""
        self.admission.end(self)
        self.driver = self._ended = None
        self.current = self.target = self.zero
        self._zeros = ZEROS

    def restart(self) -> None:
        """Start again for a new device: its first velocity is zero."""
        self.stop_at_once()
        self.is_new_device = True

    def change_limits(self, limits: Bounds[V]) -> None:
        """From now on; a robot that is driven too fast slows down as far as they allow."""
        self.limits = limits
        self.target = limits.apply(self.target)

    def step(self, now_s: float) -> V | None:
        """The velocity to send now; None: nothing. Call it often while `is_active`, and after every command."""
        self._expire(now_s)
        step_s = max(now_s - self._stepped_at_s, 0.0)
        self._stepped_at_s = now_s
        if self.driver is None:  # braking keeps its time even when a step is late
            self.current = self.limits.step(self.current, self.zero, step_s)
            return self._stand(now_s) if self.current.is_zero else self.current
        if self._zeros > 0:
            return self._stand(now_s)
        self.current = self.limits.step(self.current, self.target, min(step_s, LONGEST_STEP_S))
        return self.current

    def stays(self, now_s: float) -> bool:
        """Whether the robot is driven at its target already. A `step` is then done; it would give `current` again."""
        if self._zeros > 0 or self.current != self.target or self.admission.driver(self, now_s) is None:
            return False
        self._stepped_at_s = now_s
        return True

    def _stand(self, now_s: float) -> V | None:
        """Zeros that are still to be sent to a robot without a driver."""
        if self._zeros > 0:
            self._zeros -= 1
            self.is_new_device = False
        elif self.admission.lock_reason is None or now_s < self._zero_at_s + LOCKED_ZERO_INTERVAL_S:
            return None
        self._zero_at_s = now_s
        return self.zero

    def _expire(self, now_s: float) -> None:
        if self.driver is not None and self.admission.driver(self, now_s) is None:
            self.counts.expired += now_s >= self.driver.deadline_s
            self._ended = EndedLease(self.driver, was_let_go=False)
            self._stop(min(now_s, self.driver.deadline_s))

    def _stop(self, at_s: float) -> None:
        if self.driver is not None:
            self._stepped_at_s = max(self._stepped_at_s, at_s)
        self.admission.end(self)
        self.driver = None
        self.current = self.limits.step(self.current, self.zero, 0.0)  # zero, unless a deceleration is to be kept
        self.target = self.zero
        self._zeros = ZEROS


def _times(rate: float | None, seconds: float) -> float:
    return math.inf if rate is None else rate * seconds


def _reach(here: tuple[float, ...], there: tuple[float, ...], faster: float, slower: float) -> float:
    """Fraction of the distance from one velocity to another that a step may make, at most 1.

    `faster` and `slower` are how much speed the step may gain or lose. The way is a straight line: it loses speed as
    far as the point that is nearest to zero, and gains it from there.
    """
    if here == there:
        return 1.0
    largest = max(map(abs, (*here, *there)))  # in units of it no product of large or small numbers is lost
    way = [end / largest - begin / largest for begin, end in zip(here, there, strict=True)]
    length = math.hypot(*way)
    losing = -sum(begin / largest * (step / length) for begin, step in zip(here, way, strict=True))
    losing = length if losing > length * _ALL_OF_IT else max(losing, 0.0)
    may_lose, may_gain = slower / largest, faster / largest
    if losing > 0 and losing >= may_lose:
        made = may_lose
    else:
        made = losing + may_gain * (1 - losing / may_lose if losing > 0 else 1)
    return 1.0 if made > length * _ALL_OF_IT else made / length
