"""VelocityGate: the one way to move a robot. A command is a lease; whatever ends it, the robot stops."""

import dataclasses
import math
from collections.abc import Hashable
from dataclasses import dataclass

from hostlink.errors import BadRequest, ConfigError, RobotHeld
from hostlink.robot.claims import Claim, Claims
from hostlink.robot.kinematics import DifferentialDrive
from hostlink.robot.velocity import ZERO, Velocity

LEASE_S = 0.5  # the time-out of diff_drive_controller and of the robot's own watchdog
ZEROS = 3  # a single stop can be lost on a radio
LONGEST_STEP_S = 0.1  # a step that comes late must not jump
_ALL_OF_IT = 1 - 1e-9  # whatever the rounding, a way to zero loses speed to its very end, and a step reaches it
_LIMITS = ("max_linear_m_s", "max_angular_rad_s", "max_wheel_m_s")
LOCKED_ZERO_INTERVAL_S = 0.5  # a locked robot receives its zero again and again: it may have no watchdog of its own


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a robot may be commanded; None: no limit.

    Raises:
        ConfigError: one of them cannot be kept.
    """

    max_linear_m_s: float | None = 1.0
    max_angular_rad_s: float | None = 4.0
    max_wheel_m_s: float | None = None  # with wheel_separation_m
    wheel_separation_m: float | None = None
    max_linear_acceleration_m_s2: float | None = None
    max_angular_acceleration_rad_s2: float | None = None
    max_linear_deceleration_m_s2: float | None = None
    max_angular_deceleration_rad_s2: float | None = None

    def __post_init__(self) -> None:
        """A limit below zero would turn velocities around, one that is not finite would let everything pass."""
        for name, limit in dataclasses.asdict(self).items():
            if limit is not None and not (math.isfinite(limit) and limit >= 0):
                raise ConfigError("limits of a robot", f"{name} must be a finite number, zero or more, not {limit}")
            if limit == 0 and "deceleration" in name:
                raise ConfigError("limits of a robot", f"{name} must be above zero: the robot would never stop")

    def apply(self, velocity: Velocity) -> Velocity:
        """The same curve, slow enough for every limit."""
        factor = min(self._factors(velocity))
        return velocity if factor >= 1 else velocity.scaled(factor)

    def slowest(self, velocity: Velocity) -> str | None:
        """The limit that slows this velocity down most; None: it keeps every limit."""
        factors = self._factors(velocity)
        smallest = min(factors)
        return _LIMITS[factors.index(smallest)] if smallest < 1 else None

    def _factors(self, velocity: Velocity) -> tuple[float, float, float]:
        """By how much each of _LIMITS slows it down."""
        return (
            _factor(velocity.linear_m_s, self.max_linear_m_s),
            _factor(velocity.angular_rad_s, self.max_angular_rad_s),
            1.0 if self.max_wheel_m_s is None else _factor(self._fastest_wheel_m_s(velocity), self.max_wheel_m_s),
        )

    def step(self, current: Velocity, target: Velocity, step_s: float) -> Velocity:
        """From `current` straight towards `target`, as far as accelerations and decelerations allow in `step_s`."""
        if current == target:
            return target
        linear = _reach(
            current[:3],
            target[:3],
            _times(self.max_linear_acceleration_m_s2, step_s),
            _times(self.max_linear_deceleration_m_s2, step_s),
        )
        angular = _reach(
            current[3:],
            target[3:],
            _times(self.max_angular_acceleration_rad_s2, step_s),
            _times(self.max_angular_deceleration_rad_s2, step_s),
        )
        return current.toward(target, min(linear, angular))

    def _fastest_wheel_m_s(self, velocity: Velocity) -> float:
        if self.wheel_separation_m is None:
            return velocity.linear_m_s
        drive = DifferentialDrive(wheel_separation_m=self.wheel_separation_m)
        return max(map(abs, drive.wheel_speeds(velocity.linear_x_m_s, velocity.angular_z_rad_s)))


@dataclass(slots=True)
class GateCounts:
    """What went through a gate, and what did not."""

    commands: int = 0  # that were accepted; each of the others is refused or an ignored zero
    refused: int = 0
    limited: int = 0
    ignored_zeros: int = 0
    expired: int = 0
    stops: int = 0
    locks: int = 0
    forgotten_claims: int = 0  # over MAX_CLAIMS; the least important go first


class VelocityGate:
    """Who drives a robot, how fast, and until when.

    | state    | event                                          | next     | `step` gives then                      |
    |----------|------------------------------------------------|----------|----------------------------------------|
    | idle     | -                                              | idle     | None: silence                          |
    | slowing  | -                                              | slowing  | down to zero; after that: stopping     |
    | stopping | -                                              | stopping | zero, ZEROS times; after the last: idle |
    | driven   | -                                              | driven   | the velocity, on every call            |
    | idle     | zero                                           | stopping | zero, once: nobody wants to drive      |
    | slowing, stopping | zero                                  | as it is | as without it                          |
    | idle, slowing, stopping | command                         | driven   | the velocity; after `restart` zero first |
    | any but locked | command below another's claim, not of the owner  | as it is | no change: RobotHeld    |
    | driven   | command of the owner                           | driven   | the velocity, for a lease from now     |
    | driven   | zero of the owner                              | driven   | down to zero, for the lease as it was  |
    | driven   | zero of another                                | driven   | no change: it does not want to drive   |
    | driven   | command of another, of as high a priority      | driven   | the other's, at the same accelerations |
    | driven   | lease over, stop, release by the owner         | slowing  | down to zero at the deceleration limit, |
    |          |                                                |          | at once without one                    |
    | driven   | release by another                             | driven   | no change                              |
    | idle     | stop                                           | stopping | zero                                   |
    | any      | stop_at_once, restart                          | stopping | zero, at once                          |
    | any      | lock                                           | locked   | zero at once, ZEROS times, then again  |
    |          |                                                |          | every LOCKED_ZERO_INTERVAL_S           |
    | locked   | any but unlock                                 | locked   | the same: RobotHeld for each command   |
    | locked   | unlock                                         | stopping | the zeros that are left                |

    Each command claims the robot for its owner, at its priority and for a lease. Nothing ends a claim but that time,
    the owner's leaving, and a new device: after a stop or a lock the robot is not free for somebody less important,
    while the owner continues with his next command. A robot with several velocity topics has a gate for each, and one
    set of claims for all of them.
    """

    def __init__(self, robot: str, limits: Limits, *, lease_s: float = LEASE_S, claims: Claims | None = None) -> None:
        """`claims`: those of the robot's other gates, for one that has several."""
        self.lease_s = lease_s
        self.claims = Claims() if claims is None else claims
        self.current = ZERO
        self.lock_reason: str | None = None
        self.is_new_device = False  # it has not been given its first zero
        self.counts = GateCounts()
        self._robot, self.limits = robot, limits
        self._lease: Claim | None = None
        self._target = ZERO
        self._zeros = 0
        self._zero_at_s = self._stepped_at_s = float("-inf")

    @property
    def owner(self) -> Hashable | None:
        """Who drives."""
        return None if self._lease is None else self._lease.owner

    @property
    def owner_name(self) -> str | None:
        """The name of who drives; others may have it, too."""
        return None if self._lease is None else str(self._lease.owner)

    @property
    def priority(self) -> int | None:
        """What another must have to drive."""
        return None if self._lease is None else self._lease.priority

    @property
    def may_move(self) -> bool:
        """Whether the robot is driven, slows down, or may not have received its stop yet."""
        return self._lease is not None or self._zeros > 0 or not self.current.is_zero

    @property
    def is_stopping(self) -> bool:
        """Whether the device has a zero of several; `step` gives the others, without a command."""
        return self._lease is None and self._zeros > 0 and not self.is_new_device

    @property
    def stops(self) -> int:
        """How often somebody has stopped or locked it."""
        return self.counts.stops + self.counts.locks

    @property
    def is_driven(self) -> bool:
        """Whether somebody drives, or it slows down; a stop that is on its way to a robot at rest is neither."""
        return self._lease is not None or not self.current.is_zero

    @property
    def is_active(self) -> bool:
        """Whether `step` has something to send, now or later."""
        return self.may_move or self.lock_reason is not None

    def is_claimed(self, now_s: float) -> bool:
        """Whether somebody's claim keeps others from driving, though he may not drive himself."""
        return self.claims.has_any(self, now_s)

    def command(self, owner: Hashable, velocity: Velocity, *, priority: int, now_s: float) -> Velocity:
        """Drive for the length of a lease; returns the velocity within the limits.

        Raises:
            RobotHeld: it is locked, or another claims it with a higher priority.
            BadRequest: the velocity is not finite.
        """
        if self.lock_reason is not None:
            self.counts.refused += 1
            raise RobotHeld(self._robot, None, lock_reason=self.lock_reason)
        if not velocity.is_finite:
            self.counts.refused += 1
            raise BadRequest(f"{self._robot}: a velocity must be made of finite numbers")
        self._expire(now_s)
        lease = self._lease
        if velocity.is_zero and self.owner != owner:
            return self._accept_idle_zero()
        if not velocity.is_zero and self.owner != owner:
            self._respect_claims(owner, priority, now_s)
        if lease is None and self.current.is_zero:
            self._stepped_at_s = now_s
        deadline_s = lease.deadline_s if lease is not None and velocity.is_zero else now_s + self.lease_s
        self._lease = self._claim(Claim(owner, priority, deadline_s))
        self._target = self.limits.apply(velocity)
        self._zeros = int(self.is_new_device)
        self.counts.commands += 1
        self.counts.limited += self._target != velocity
        return self._target

    def _accept_idle_zero(self) -> Velocity:
        """A zero of somebody who does not drive: sent to a robot at rest, ignored while another drives."""
        if self._lease is None:
            self._zeros = max(self._zeros, 1)
            self.counts.commands += 1
        else:
            self.counts.ignored_zeros += 1
        return ZERO

    def _respect_claims(self, owner: Hashable, priority: int, now_s: float) -> None:
        """Raise RobotHeld while somebody more important wants to drive."""
        strongest = self.claims.strongest_beside(owner, now_s)
        if strongest is not None and priority < strongest.priority:
            self.counts.refused += 1
            raise RobotHeld(self._robot, str(strongest.owner))

    def _claim(self, lease: Claim) -> Claim:
        self.counts.forgotten_claims += self.claims.put(self, lease)
        return lease

    def release(self, owner: Hashable, *, now_s: float) -> None:
        """The owner is gone: if it drives, the robot stops; whoever is next may drive it."""
        self._expire(now_s)
        self.claims.remove(self, owner)
        if self.owner == owner:
            self._stop(now_s)

    def stop(self, *, now_s: float) -> None:
        """Anybody may stop a robot, at any time; it brakes as hard as its limits allow.

        Nobody else gets it by that: the next command of whoever drove moves it again, and until his lease would have
        run out nobody less important is accepted.
        """
        self._expire(now_s)
        self.counts.stops += 1
        self._stop(now_s)

    def stop_at_once(self) -> None:
        """Zero at once, whatever the limits."""
        self._lease = None
        self.current = self._target = ZERO
        self._zeros = ZEROS

    def restart(self) -> None:
        """The device is new: nothing earlier is valid but a lock, and its first velocity is zero whatever comes."""
        self.stop_at_once()
        self.claims.clear(self)
        self.is_new_device = True

    def lock(self, reason: str) -> None:
        """The emergency stop: zero at once, and refuse every command until `unlock`."""
        self.counts.locks += 1
        self.lock_reason = reason
        self.stop_at_once()

    def unlock(self) -> None:
        """Commands are accepted again; nothing moves before one comes."""
        self.lock_reason = None

    def change_limits(self, limits: Limits) -> None:
        """From now on; a robot that is driven too fast slows down as far as they allow."""
        self.limits = limits
        self._target = limits.apply(self._target)

    def step(self, now_s: float) -> Velocity | None:
        """The velocity to send now; None: nothing. Call it often while `is_active`, and after every command."""
        self._expire(now_s)
        step_s = max(now_s - self._stepped_at_s, 0.0)
        self._stepped_at_s = now_s
        if self._lease is None:  # braking keeps its time even when a step comes late
            self.current = self.limits.step(self.current, ZERO, step_s)
            return self._stand(now_s) if self.current.is_zero else self.current
        if self._zeros > 0:
            return self._stand(now_s)
        self.current = self.limits.step(self.current, self._target, min(step_s, LONGEST_STEP_S))
        return self.current

    def _stand(self, now_s: float) -> Velocity | None:
        """The zeros that are owed to a robot that stands."""
        if self._zeros > 0:
            self._zeros -= 1
            self.is_new_device = False
        elif self.lock_reason is None or now_s < self._zero_at_s + LOCKED_ZERO_INTERVAL_S:
            return None
        self._zero_at_s = now_s
        return ZERO

    def _expire(self, now_s: float) -> None:
        if self._lease is not None and now_s >= self._lease.deadline_s:
            self.counts.expired += 1
            self._stop(self._lease.deadline_s)

    def _stop(self, at_s: float) -> None:
        if self._lease is not None:
            self._stepped_at_s = max(self._stepped_at_s, at_s)
        self._lease = None
        self.current = self.limits.step(self.current, ZERO, 0.0)  # zero, unless a deceleration is to be kept
        self._target = ZERO
        self._zeros = ZEROS


def _factor(value: float, limit: float | None) -> float:
    """By how much a value must shrink to keep a limit; 1 at the most."""
    return 1.0 if limit is None or value <= limit else limit / value


def _times(rate: float | None, seconds: float) -> float:
    return math.inf if rate is None else rate * seconds


def _reach(here: tuple[float, ...], there: tuple[float, ...], faster: float, slower: float) -> float:
    """What fraction of the way from one velocity to another a step may make, 1 at the most.

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
