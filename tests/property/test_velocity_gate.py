"""VelocityGate: what holds after any history of commands, stops, departures and restarts."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.kinematics import MecanumDrive, PlanarDrive
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.core.robot.velocity_gate import (
    LOCKED_ZERO_INTERVAL_S,
    LONGEST_STEP_S,
    ZEROS,
    Limits,
)
from hostlink.errors import CommandRefused
from tests.support.gates import GateOfRobot

SLACK = 1 + 1e-9  # of a scaled double

bounds = st.none() | st.floats(0.05, 5)
drives_of_limits = st.builds(PlanarDrive, wheel_separation_m=st.just(0.0) | st.floats(0.05, 1)) | st.builds(
    MecanumDrive, wheel_separation_m=st.floats(0.05, 1), wheelbase_m=st.floats(0.05, 1)
)
limits_of_speed = st.builds(
    Limits,
    max_linear_m_s=bounds,
    max_angular_rad_s=bounds,
    max_wheel_m_s=bounds,
    drive=drives_of_limits,
)
limits_of_all = st.builds(
    dataclasses.replace,
    limits_of_speed,
    max_linear_acceleration_m_s2=bounds,
    max_angular_acceleration_rad_s2=bounds,
    max_linear_deceleration_m_s2=bounds,
    max_angular_deceleration_rad_s2=bounds,
)
components = st.just(0.0) | st.floats(-3, 3)
nothing = st.just(0.0)
velocities = st.builds(PlanarVelocity, *[components] * 3) | st.builds(PlanarVelocity, components, nothing, components)
movements = velocities.filter(lambda velocity: not velocity.is_zero)
not_finite = st.tuples(velocities, st.integers(0, 2), st.sampled_from([math.nan, math.inf, -math.inf])).map(
    lambda drawn: drawn[0]._replace(**{PlanarVelocity._fields[drawn[1]]: drawn[2]})
)
owners = st.sampled_from(["ann", "bob", "eve"])
priorities = st.sampled_from([0, 50, 100])


def share(value: float, limit: float | None) -> float:
    """Return the share of a limit that a value uses."""
    return 0.0 if limit is None else value / limit


def use(velocity: PlanarVelocity, limits: Limits) -> float:
    """Return the share of the strictest speed limit that a velocity uses: 1 is all of it."""
    drive = limits.drive
    assert isinstance(drive, PlanarDrive | MecanumDrive)
    if isinstance(drive, MecanumDrive):
        wheel_m_s = max(map(abs, drive.wheel_speeds(velocity)))
    else:
        wheel_m_s = velocity.speed_m_s + velocity.turn_rad_s * drive.wheel_separation_m / 2
    return max(
        share(velocity.speed_m_s, limits.max_linear_m_s),
        share(velocity.turn_rad_s, limits.max_angular_rad_s),
        share(wheel_m_s, limits.max_wheel_m_s),
    )


@given(limits_of_speed, velocities)
def test_limited_velocity_keeps_its_curve_and_reaches_the_limit(limits: Limits, requested: PlanarVelocity) -> None:
    given_ = limits.apply(requested)
    factor = min(1.0, 1 / max(use(requested, limits), 1e-300))
    assert given_ == pytest.approx(requested.scaled(factor), rel=1e-9)
    assert use(given_, limits) <= SLACK
    assert limits.apply(given_) == pytest.approx(given_, rel=1e-9)


@given(limits_of_all, st.builds(PlanarVelocity, *[st.floats(allow_nan=False, allow_infinity=False)] * 3))
def test_any_finite_command_gives_finite_velocities(limits: Limits, requested: PlanarVelocity) -> None:
    gate = GateOfRobot(limits)
    for now_s, wanted in ((0.0, requested), (0.1, requested.scaled(-1)), (0.2, requested)):
        assert gate.drive("ann", wanted, priority=0, now_s=now_s).is_finite
        given_ = gate.step(now_s + 0.05)
        assert given_.is_finite


def seconds_of(here: tuple[float, ...], there: tuple[float, ...], gain: float | None, loss: float | None) -> float:
    """Return the least time of a straight way between two velocities. Without a limit (None) a part costs no time."""
    way = [end - begin for begin, end in zip(here, there, strict=True)]
    length = math.hypot(*way)
    if length < 1e-12:  # less than any rounding
        return 0.0
    nearest = -sum(begin * step for begin, step in zip(here, way, strict=True)) / length**2  # to zero; 1: the end
    losing = min(max(nearest, 0.0), 1.0) * length
    return share(losing, loss) + share(length - losing, gain)


def braked(velocity: PlanarVelocity, limits: Limits, seconds: float) -> PlanarVelocity:
    """Return the velocity after so much braking. The axis that needs longest leads."""
    needed_s = max(
        share(velocity.speed_m_s, limits.max_linear_deceleration_m_s2),
        share(velocity.turn_rad_s, limits.max_angular_deceleration_rad_s2),
    )
    return velocity.scaled(1 - seconds / needed_s) if seconds < needed_s else ZERO


class GateHistory(RuleBasedStateMachine):
    """A gate as the hub uses it: a step after each command and in between, now and then late."""

    @initialize(limits=limits_of_all)
    def build(self, limits: Limits) -> None:
        self.limits = limits
        self.gate = GateOfRobot(limits)
        self.now_s = 100.0
        self.stepped_at_s = self.now_s
        self.given: PlanarVelocity = ZERO  # what the device has
        self.owner: str | None = None
        self.wanted = ZERO
        self.deadline_s = -math.inf
        self.zeros = 0  # that the gate still owes
        self.zero_at_s = -math.inf
        self.is_new_device = self.is_locked = False

    # -- what happens -------------------------------------------------------------------------------------------------

    @rule(dt_s=st.sampled_from([0.0, 0.001, 0.05, 0.05, 0.1, 0.3, 0.7]))
    def time_passes(self, dt_s: float) -> None:
        self.now_s += dt_s
        self.step()

    @rule(owner=owners, velocity=movements, priority=priorities)
    def somebody_drives(self, owner: str, velocity: PlanarVelocity, priority: int) -> None:
        self.notice_the_end()
        try:
            limited = self.gate.drive(owner, velocity, priority=priority, now_s=self.now_s)
        except CommandRefused:  # who may drive is decided by Admission, which has a test of its own
            self.notice_the_refusal(owner)
            return
        assert limited == self.limits.apply(velocity)
        if self.owner is None and self.given.is_zero:
            self.stepped_at_s = self.now_s
        self.owner, self.wanted = owner, limited
        self.deadline_s = self.now_s + LEASE_S
        self.zeros = int(self.is_new_device)
        self.step()

    @precondition(lambda self: not self.is_locked)
    @rule(owner=owners, priority=priorities)
    def somebody_sends_zero(self, owner: str, priority: int) -> None:
        self.notice_the_end()
        if self.owner not in (owner, None):
            with pytest.raises(CommandRefused):
                self.gate.drive(owner, ZERO, priority=priority, now_s=self.now_s)
        else:
            assert self.gate.drive(owner, ZERO, priority=priority, now_s=self.now_s) == ZERO
        if self.owner == owner:  # it lets go
            self.end(self.now_s)
        elif self.owner is None:
            self.zeros = max(self.zeros, 1)
        self.step()

    @rule(owner=owners, velocity=not_finite, priority=priorities)
    def somebody_sends_no_number(self, owner: str, velocity: PlanarVelocity, priority: int) -> None:
        with pytest.raises(CommandRefused):
            self.gate.drive(owner, velocity, priority=priority, now_s=self.now_s)
        self.notice_the_refusal(owner)

    @rule(owner=owners)
    def somebody_leaves(self, owner: str) -> None:
        self.notice_the_end()
        self.gate.withdraw(owner, now_s=self.now_s)
        if self.owner == owner:
            self.end(self.now_s)
        assert self.gate.owner_name != owner

    @rule()
    def somebody_stops_it(self) -> None:
        self.notice_the_end()
        self.gate.interrupt(now_s=self.now_s)
        self.end(self.now_s)
        assert self.gate.owner_name is None

    @rule()
    def the_device_restarts(self) -> None:
        self.gate.connect(now_s=self.now_s)
        self.stop_at_once()
        self.is_new_device = True

    @rule()
    def the_daemon_ends(self) -> None:
        self.gate.stop_at_once()
        self.stop_at_once()

    @rule()
    def somebody_locks_it(self) -> None:
        self.gate.lock("smoke", now_s=self.now_s)
        self.stop_at_once()
        self.is_locked = True

    @rule()
    def somebody_unlocks_it(self) -> None:
        self.gate.admission.unlock(self.now_s)
        self.is_locked = False

    @rule()
    def silence_falls(self) -> None:
        self.now_s += 1000.0  # longer than any ramp
        self.notice_the_end()
        owed = self.zeros
        given_ = [self.step() for _ in range(ZEROS + 2)]
        assert given_[:owed] == [ZERO] * owed
        if self.is_locked:
            assert set(given_) <= {ZERO, None}
        else:
            assert given_[owed:] == [None] * (ZEROS + 2 - owed)
        assert not self.gate.may_move

    @precondition(lambda self: self.owner is not None)
    @rule()
    def the_clock_reaches_the_very_end_of_the_lease(self) -> None:
        self.now_s = math.nextafter(max(self.now_s, self.deadline_s), 0)
        self.step()

    # -- what must hold -----------------------------------------------------------------------------------------------

    def step(self) -> PlanarVelocity | None:
        self.notice_the_end()
        before, dt_s = self.given, self.now_s - self.stepped_at_s
        given_ = self.gate.current if self.gate.stays(self.now_s) else self.gate.step(self.now_s)
        self.stepped_at_s = self.now_s
        assert self.gate.owner_name == self.owner
        assert not self.is_locked or given_ in (ZERO, None)
        if self.owner is None:
            self.check_end(before, given_, dt_s)
        elif self.zeros > 0:
            assert given_ == ZERO
            self.zeros -= 1
            self.is_new_device = False
        else:
            assert given_ is not None
            self.check_drive(before, given_, min(dt_s, LONGEST_STEP_S))
        self.given = self.gate.current
        assert self.gate.may_move == (self.owner is not None or self.zeros > 0 or not self.given.is_zero)
        assert self.gate.is_active == (self.gate.may_move or self.is_locked)
        return given_

    def check_end(self, before: PlanarVelocity, given_: PlanarVelocity | None, dt_s: float) -> None:
        """Check an undriven gate: it brakes to zero as fast as allowed, sends the owed zeros, then nothing."""
        left = braked(before, self.limits, dt_s)
        assert self.gate.current == pytest.approx(left, abs=1e-6)
        if not self.gate.current.is_zero:
            assert given_ == self.gate.current
        elif self.zeros > 0 or (self.is_locked and self.now_s >= self.zero_at_s + LOCKED_ZERO_INTERVAL_S):
            assert given_ == ZERO
            self.zero_at_s = self.now_s
            self.zeros = max(self.zeros - 1, 0)
            self.is_new_device = False
        else:
            assert given_ is None

    def check_drive(self, before: PlanarVelocity, given_: PlanarVelocity, dt_s: float) -> None:
        limits = self.limits
        assert use(given_, limits) <= SLACK
        gains = (limits.max_linear_acceleration_m_s2, limits.max_angular_acceleration_rad_s2)
        losses = (limits.max_linear_deceleration_m_s2, limits.max_angular_deceleration_rad_s2)
        assert seconds_of(before[:2], given_[:2], gains[0], losses[0]) <= dt_s + 1e-6
        assert seconds_of(before[2:], given_[2:], gains[1], losses[1]) <= dt_s + 1e-6
        assert self.now_s < self.deadline_s
        if (*gains, *losses) == (None,) * 4:
            assert given_ == self.wanted

    def notice_the_refusal(self, owner: str) -> None:
        """Two commands at once after a silence end the drive of their source."""
        if self.owner == owner and self.gate.admission.driver(self.gate, self.now_s) is None:
            self.notice_the_end()
            self.end(self.now_s)
        self.step()

    def notice_the_end(self) -> None:
        if self.owner is not None and self.now_s >= self.deadline_s:
            self.end(self.deadline_s)

    def end(self, at_s: float) -> None:
        if self.owner is not None:
            self.stepped_at_s = max(self.stepped_at_s, at_s)
        self.owner = None
        self.zeros = ZEROS

    def stop_at_once(self) -> None:
        self.owner = None
        self.given, self.zeros = ZERO, ZEROS


TestGateHistory = GateHistory.TestCase
