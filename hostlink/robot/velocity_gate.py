"""VelocityGate: the one way to move a robot. A command is a lease; whatever ends it, the robot stops."""

import dataclasses
import math
from dataclasses import dataclass

from hostlink.errors import BadRequest, ConfigError, RobotHeld
from hostlink.robot.kinematics import DifferentialDrive
from hostlink.robot.velocity import ZERO, Velocity

LEASE_S = 0.5  # the time-out of diff_drive_controller and of the robot's own watchdog
ZEROS = 3  # a single stop can be lost on a radio
LONGEST_STEP_S = 0.1  # a step that comes late must not jump


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a robot may be asked for; None: no limit. ConfigError for one that could not hold."""

    max_linear_m_s: float | None = 1.0
    max_angular_rad_s: float | None = 4.0
    max_wheel_m_s: float | None = None  # with wheel_separation_m
    wheel_separation_m: float | None = None
    max_linear_acceleration_m_s2: float | None = None
    max_angular_acceleration_rad_s2: float | None = None

    def __post_init__(self) -> None:
        """A limit below zero would turn velocities around, one that is not finite would let everything pass."""
        for name, limit in dataclasses.asdict(self).items():
            if limit is not None and not (math.isfinite(limit) and limit >= 0):
                raise ConfigError("limits of a robot", f"{name} must be a finite number, zero or more, not {limit}")

    def apply(self, velocity: Velocity) -> Velocity:
        """The same curve, slow enough for every limit."""
        factor = min(
            _factor(velocity.linear_m_s, self.max_linear_m_s),
            _factor(velocity.angular_rad_s, self.max_angular_rad_s),
            _factor(self._fastest_wheel_m_s(velocity), self.max_wheel_m_s),
        )
        return velocity if factor >= 1 else velocity.scaled(factor)

    def step(self, current: Velocity, target: Velocity, step_s: float) -> Velocity:
        """From `current` as far towards `target` as the accelerations allow in `step_s`."""
        change = Velocity(*(there - here for here, there in zip(current, target, strict=True)))
        fraction = min(
            _factor(change.linear_m_s, _times(self.max_linear_acceleration_m_s2, step_s)),
            _factor(change.angular_rad_s, _times(self.max_angular_acceleration_rad_s2, step_s)),
        )
        return current.toward(target, fraction)

    def _fastest_wheel_m_s(self, velocity: Velocity) -> float:
        if self.wheel_separation_m is None:
            return velocity.linear_m_s
        drive = DifferentialDrive(wheel_separation_m=self.wheel_separation_m)
        return max(map(abs, drive.wheel_speeds(velocity.linear_x_m_s, velocity.angular_z_rad_s)))


@dataclass(slots=True)
class GateCounts:
    """What went through a gate, and what did not."""

    commands: int = 0  # that were taken; each of the others is refused or an ignored zero
    refused: int = 0
    limited: int = 0
    ignored_zeros: int = 0
    expired: int = 0
    stops: int = 0


class VelocityGate:
    """Who drives a robot, how fast, and until when.

    | state    | event                                          | next     | `step` gives then                      |
    |----------|------------------------------------------------|----------|----------------------------------------|
    | idle     | -                                              | idle     | None: silence                          |
    | stopping | -                                              | stopping | zero, ZEROS times; after the last: idle |
    | held     | -                                              | held     | the velocity, on every call            |
    | idle     | zero                                           | stopping | zero, once: nobody wants to drive      |
    | stopping | zero                                           | stopping | zero                                   |
    | idle, stopping | command                                  | held     | the velocity; after `restart` zero first |
    | held     | command of the holder                          | held     | the velocity, for a lease from now     |
    | held     | zero of the holder                             | held     | down to zero, for the lease as it was  |
    | held     | zero of the holder again, while still slowing  | held     | down to zero, for a lease from now     |
    | held     | zero of another                                | held     | no change: an idle zero is no wish     |
    | held     | command of another, of as high a priority      | held     | the other's, at the same accelerations |
    | held     | command of another, of a lower priority        | held     | no change: RobotHeld for the other     |
    | held     | lease over, release by the holder              | stopping | zero, at once                          |
    | held     | release by another                             | held     | no change                              |
    | any      | stop, restart                                  | stopping | zero, at once                          |
    """

    def __init__(self, robot: str, limits: Limits, *, lease_s: float = LEASE_S) -> None:
        self.lease_s = lease_s
        self.current = ZERO
        self.holder: str | None = None
        self.counts = GateCounts()
        self._robot = robot
        self._limits = limits
        self._target = ZERO
        self._priority = 0
        self._deadline_s = 0.0
        self._zeros = 0  # that are still to be given before anything else
        self._is_new_device = False
        self._stepped_at_s = 0.0

    @property
    def is_active(self) -> bool:
        """Whether `step` has something to say."""
        return self.holder is not None or self._zeros > 0

    def command(self, owner: str, velocity: Velocity, *, priority: int, now_s: float) -> Velocity:
        """Drive for the length of a lease; returns the velocity within the limits. BadRequest, RobotHeld."""
        if not velocity.is_finite:
            self.counts.refused += 1
            raise BadRequest(f"{self._robot}: a velocity must be made of finite numbers")
        self._expire(now_s)
        if velocity.is_zero and self.holder != owner:
            return self._take_idle_zero()
        if self.holder is None:
            self._stepped_at_s = now_s
        elif self.holder != owner and priority < self._priority:
            self.counts.refused += 1
            raise RobotHeld(self._robot, self.holder)
        is_slowing = self._target.is_zero and not self.current.is_zero
        if is_slowing or not velocity.is_zero:
            self._deadline_s = now_s + self.lease_s
        self.holder, self._priority, self._target = owner, priority, self._limits.apply(velocity)
        self._zeros = int(self._is_new_device)
        self.counts.commands += 1
        self.counts.limited += self._target != velocity
        return self._target

    def _take_idle_zero(self) -> Velocity:
        """A zero of somebody who does not drive: told to a robot that stands, ignored while another drives."""
        if self.holder is None:
            self._zeros = max(self._zeros, 1)
            self.counts.commands += 1
        else:
            self.counts.ignored_zeros += 1
        return ZERO

    def release(self, owner: str, *, now_s: float) -> None:
        """The owner is gone: if it drives, the robot stops."""
        self._expire(now_s)
        if self.holder == owner:
            self._stop()

    def stop(self, *, now_s: float) -> None:
        """Anybody may stop a robot, at any time."""
        self._expire(now_s)
        self.counts.stops += 1
        self._stop()

    def restart(self) -> None:
        """The device is new: nothing of before holds, and its first velocity is zero whatever comes."""
        self._stop()
        self._is_new_device = True

    def step(self, now_s: float) -> Velocity | None:
        """The velocity to send now; None: nothing. Call it often while `is_active`, and after every command."""
        self._expire(now_s)
        step_s = min(max(now_s - self._stepped_at_s, 0.0), LONGEST_STEP_S)
        self._stepped_at_s = now_s
        if self._zeros > 0:
            self._zeros -= 1
            self._is_new_device = False
            return ZERO
        if self.holder is None:
            return None
        self.current = self._limits.step(self.current, self._target, step_s)
        return self.current

    def _expire(self, now_s: float) -> None:
        if self.holder is not None and now_s >= self._deadline_s:
            self.counts.expired += 1
            self._stop()

    def _stop(self) -> None:
        self.holder = None
        self.current = self._target = ZERO
        self._zeros = ZEROS


def _factor(value: float, limit: float | None) -> float:
    """By how much a value must shrink to keep a limit; 1 at the most."""
    return 1.0 if limit is None or value <= limit else limit / value


def _times(rate: float | None, seconds: float) -> float | None:
    return None if rate is None else rate * seconds
