"""VelocityGate: every row of its table, and the limits one by one."""

import dataclasses
import math

import pytest

from hostlink.core.robot.admission import LEASE_S, Admission, Command
from hostlink.core.robot.kinematics import AckermannDrive, DifferentialDrive, PlanarDrive
from hostlink.core.robot.velocity import ZERO, PlanarVelocity, Twist
from hostlink.core.robot.velocity_gate import GateCounts, Limits, Unlimited, VelocityGate
from hostlink.errors import CommandRefused, ConfigError, RefusalKind
from tests.support.gates import FORWARD, FREE, HEAVY, STOPPED, TURN, GateOfRobot, driven, gate, moving, outputs

# -- the life of a lease ----------------------------------------------------------------------------------------------

LIMITS = [each.name for each in dataclasses.fields(Limits) if each.init and each.name != "drive"]


def test_a_new_gate_is_silent() -> None:
    ours = gate()
    assert outputs(ours, 0.0, 2) == [None, None]
    assert (ours.is_active, ours.owner_name, ours.current) == (False, None, ZERO)


def test_a_command_is_given_on_every_step_until_the_lease_ends() -> None:
    ours = gate()
    assert ours.drive("ann", FORWARD, priority=50, now_s=0.0) == FORWARD
    assert ours.is_active
    assert outputs(ours, 0.0, 10) == [FORWARD] * 10
    assert (ours.owner_name, ours.current) == ("ann", FORWARD)
    assert outputs(ours, 0.5) == STOPPED
    assert (ours.is_active, ours.owner_name, ours.current) == (False, None, ZERO)
    assert ours.counts == GateCounts(commands=1, expired=1)


def test_velocity_stays_while_the_robot_is_driven_at_its_target() -> None:
    ours = gate(HEAVY)
    ours.drive("ann", FORWARD, now_s=0.0)
    assert not ours.stays(0.05)  # it accelerates
    ours = moving(HEAVY)
    assert ours.stays(1.05)
    assert ours.step(1.05) == FORWARD
    ours.change_limits(dataclasses.replace(HEAVY, max_linear_m_s=0.1))
    assert not ours.stays(1.1)


def test_velocity_does_not_stay_after_the_lease_or_an_interruption() -> None:
    ours = driven()
    assert ours.stays(0.49)
    assert not ours.stays(0.5)
    ours = driven()
    ours.admission.interrupt(0.1)
    assert not ours.stays(0.1)
    assert not gate().stays(0.0)
    restarted = driven()
    restarted.connect(now_s=0.1)
    restarted.drive("bob", FORWARD, now_s=0.1)
    assert not restarted.stays(0.1)  # its first velocity is zero


def test_a_robot_may_move_until_its_last_zero_was_sent() -> None:
    ours = driven()
    sent = [(ours.step(0.5 + 0.03 * number), ours.may_move, ours.is_active) for number in range(3)]
    assert sent == [(ZERO, True, True), (ZERO, True, True), (ZERO, False, False)]


def test_gate_is_stopping_from_a_stop_to_its_last_zero() -> None:
    ours = driven()
    assert not ours.is_stopping
    ours.stop(now_s=0.1)
    stopping = [(ours.is_stopping, ours.step(0.1 + 0.05 * number)) for number in range(4)]
    assert stopping == [(True, ZERO), (True, ZERO), (True, ZERO), (False, None)]


def test_gate_is_driven_until_it_has_stopped_though_zeros_are_due() -> None:
    ours = driven()
    assert (ours.is_driven, ours.may_move) == (True, True)
    ours.withdraw("ann", now_s=0.1)
    assert (ours.is_driven, ours.may_move) == (False, True)
    assert outputs(ours, 0.1) == STOPPED
    assert (ours.is_driven, ours.may_move) == (False, False)


@pytest.mark.parametrize("limits", [FREE, HEAVY])
def test_gate_whose_driver_gives_zero_ends_like_one_whose_driver_left(limits: Limits) -> None:
    let_go, left = moving(limits), moving(limits)
    let_go.drive("ann", ZERO, priority=50, now_s=1.0)
    left.withdraw("ann", now_s=1.0)
    assert let_go.driver is None
    assert (let_go.may_move, let_go.is_driven) == (left.may_move, left.is_driven)
    assert outputs(let_go, 1.0, 200) == outputs(left, 1.0, 200)
    ended = let_go.pop_ended()
    assert ended is not None
    assert (ended.lease.source, ended.was_let_go) == ("ann", True)
    assert let_go.counts.expired == 0


def test_gate_has_its_driver_at_zero_and_none_while_it_slows_down() -> None:
    ours = gate()
    ours.drive("ann", ZERO, priority=50, now_s=0.0)
    ours.drive("ann", FORWARD, priority=50, now_s=0.0)
    assert (ours.current.is_zero, ours.is_driven) == (True, True)
    slowing = moving(HEAVY)
    slowing.withdraw("ann", now_s=1.0)
    assert (slowing.owner_name, slowing.current.is_zero, slowing.is_driven) == (None, False, True)


def test_a_command_renews_the_lease() -> None:
    ours = driven()
    ours.drive("ann", TURN, priority=50, now_s=0.4)
    assert ours.step(0.89) == TURN
    assert ours.step(0.9) == ZERO


def test_a_late_command_is_a_new_lease() -> None:
    ours = driven()
    ours.drive("ann", TURN, priority=50, now_s=0.5)
    assert ours.counts.expired == 1
    assert ours.step(0.5) == TURN


def test_the_lease_may_have_another_length() -> None:
    ours = GateOfRobot(FREE, lease_s=2.0)
    ours.drive("ann", FORWARD, priority=50, now_s=0.0)
    assert [ours.step(1.9), ours.step(2.0)] == [FORWARD, ZERO]


def test_the_owner_may_leave() -> None:
    ours = driven()
    ours.withdraw("ann", now_s=0.1)
    assert outputs(ours, 0.1) == STOPPED
    assert ours.counts.expired == 0


def test_a_lease_expires_without_anybody_checking_it() -> None:
    ours = driven()
    ours.withdraw("ann", now_s=0.5)
    assert outputs(ours, 0.5) == STOPPED
    assert ours.counts.expired == 1


def test_leaving_after_the_end_changes_nothing() -> None:
    ours = driven()
    outputs(ours, 0.5, 3)
    ours.withdraw("ann", now_s=1.0)
    assert ours.step(1.0) is None


def test_a_stop_is_sent_to_a_robot_that_stands() -> None:
    ours = gate()
    ours.stop(now_s=0.0)
    assert ours.is_active
    assert outputs(ours, 0.0) == STOPPED


# -- a new device -----------------------------------------------------------------------------------------------------


def test_a_restart_forgets_everything() -> None:
    ours = driven(priority=100)
    ours.restart()
    assert (ours.owner_name, ours.current) == (None, ZERO)
    assert outputs(ours, 0.1) == STOPPED


def test_first_velocity_of_a_new_device_is_zero_also_with_a_command_at_once() -> None:
    ours = gate()
    ours.connect(now_s=0.0)
    ours.drive("ann", FORWARD, priority=50, now_s=0.0)
    ours.drive("ann", TURN, priority=50, now_s=0.0)
    assert outputs(ours, 0.0, 3) == [ZERO, TURN, TURN]


# -- zeros ------------------------------------------------------------------------------------------------------------


def test_a_zero_of_the_owner_stops_and_ends_the_lease() -> None:
    ours = driven()
    assert ours.drive("ann", ZERO, priority=50, now_s=0.2) == ZERO
    assert ours.owner_name is None
    assert outputs(ours, 0.2) == STOPPED
    ours.drive("ann", ZERO, priority=50, now_s=0.4)
    assert outputs(ours, 0.4, 2) == [ZERO, None]


def test_an_idle_zero_is_sent_once() -> None:
    ours = gate()
    ours.drive("ann", ZERO, priority=50, now_s=0.0)
    assert outputs(ours, 0.0, 3) == [ZERO, None, None]


def test_an_idle_zero_does_not_shorten_a_stop() -> None:
    ours = gate()
    ours.stop(now_s=0.0)
    ours.drive("ann", ZERO, priority=50, now_s=0.0)
    assert outputs(ours, 0.0) == STOPPED


# -- limits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "requested", "given"),
    [
        (Limits(), PlanarVelocity(0.9, yaw_rad_s=3.9), PlanarVelocity(0.9, yaw_rad_s=3.9)),
        (Limits(), PlanarVelocity(2.0, yaw_rad_s=1.0), PlanarVelocity(1.0, yaw_rad_s=0.5)),
        (Limits(), PlanarVelocity(-2.0, yaw_rad_s=1.0), PlanarVelocity(-1.0, yaw_rad_s=0.5)),
        (Limits(), PlanarVelocity(0.4, yaw_rad_s=-8.0), PlanarVelocity(0.2, yaw_rad_s=-4.0)),
        (Limits(), PlanarVelocity(3.0, 4.0, 1.0), PlanarVelocity(0.6, 0.8, 0.2)),
        (Limits(max_linear_m_s=0.0), FORWARD, ZERO),
        (FREE, PlanarVelocity(1e6, 1e6, 1e6), PlanarVelocity(1e6, 1e6, 1e6)),
        (Limits(max_wheel_m_s=0.3), PlanarVelocity(0.6, yaw_rad_s=2.0), PlanarVelocity(0.3, yaw_rad_s=1.0)),
    ],
)
def test_all_components_shrink_by_one_factor(limits: Limits, requested: PlanarVelocity, given: PlanarVelocity) -> None:
    assert limits.apply(requested) == pytest.approx(given)


@pytest.mark.parametrize("forward", [1, -1])
@pytest.mark.parametrize("left", [1, -1])
def test_the_faster_wheel_counts_in_every_direction(forward: int, left: int) -> None:
    limits = Limits(max_wheel_m_s=0.3, drive=PlanarDrive(wheel_separation_m=0.2))
    given = limits.apply(PlanarVelocity(forward * 0.4, yaw_rad_s=left * 2.0))  # one wheel would make 0.6 m/s
    assert given == pytest.approx(PlanarVelocity(forward * 0.2, yaw_rad_s=left * 1.0))


def test_the_caller_hears_what_the_limits_left() -> None:
    ours = gate(Limits())
    assert ours.drive("ann", PlanarVelocity(3.0), priority=50, now_s=0.0) == PlanarVelocity(1.0)
    assert ours.step(0.0) == PlanarVelocity(1.0)
    ours.drive("ann", FORWARD, priority=50, now_s=0.1)
    assert ours.counts == GateCounts(commands=2, limited=1)


def test_the_largest_numbers_stand_still_under_a_limit() -> None:
    assert Limits().apply(PlanarVelocity(1.7e308, 1.7e308, 1.7e308)).is_zero


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("wrong", [-0.1, math.nan, math.inf, -math.inf])
def test_an_impossible_limit_is_refused(name: str, wrong: float) -> None:
    with pytest.raises(ConfigError, match=f"limits of a robot: {name} must be a finite number, zero or more, not"):
        Limits(**{name: wrong})


def test_speed_limit_applies_to_the_length_of_x_and_y() -> None:
    assert Limits(max_linear_m_s=0.5).apply(PlanarVelocity(0.0, -2.0, 1.0)) == PlanarVelocity(0.0, -0.5, 0.25)
    assert Limits(max_linear_m_s=0.5).apply(PlanarVelocity(0.6, 0.8)) == pytest.approx(PlanarVelocity(0.3, 0.4))


def test_wheel_limit_applies_to_the_length_of_x_and_y_and_to_the_turn() -> None:
    limits = Limits(max_wheel_m_s=0.3, drive=PlanarDrive(wheel_separation_m=0.2))
    assert limits.apply(PlanarVelocity(0.0, 0.9)) == pytest.approx(PlanarVelocity(0.0, 0.3))
    assert limits.apply(PlanarVelocity(0.3, 0.4, 1.0)) == pytest.approx(PlanarVelocity(0.15, 0.2, 0.5))
    assert limits.slowest(PlanarVelocity(0.0, 0.9)) == "max_wheel_m_s"


def test_wheel_limit_of_a_drive_is_that_of_its_wheels() -> None:
    limits = Limits(max_wheel_m_s=0.3, drive=DifferentialDrive(wheel_separation_m=0.2))
    assert limits.apply(PlanarVelocity(0.3, 0.0, -3.0)) == pytest.approx(PlanarVelocity(0.15, 0.0, -1.5))


def test_curve_that_a_car_cannot_steer_becomes_its_tightest_before_the_limits() -> None:
    car = AckermannDrive(wheelbase_m=0.5, max_steering_rad=math.atan(0.5))  # a circle of 1 m
    limits = Limits(max_linear_m_s=0.5, drive=car)
    assert limits.apply(PlanarVelocity(0.4, 0.0, 2.0)) == pytest.approx(PlanarVelocity(0.4, 0.0, 0.4))
    assert limits.slowest(PlanarVelocity(0.4, 0.0, 2.0)) == "max_steering_rad"
    assert limits.apply(PlanarVelocity(-1.0, 0.0, 2.0)) == pytest.approx(PlanarVelocity(-0.5, 0.0, 0.5))
    assert limits.slowest(PlanarVelocity(-1.0, 0.0, 2.0)) == "max_linear_m_s"
    assert limits.slowest(PlanarVelocity(0.4, 0.0, 0.2)) is None


def test_six_numbers_of_a_topic_without_a_robot_stay_as_they_are() -> None:
    fast = Twist(9.0, 9.0, 9.0, 9.0, 9.0, 9.0)
    admission = Admission("/arm/velocity", drive=None)
    admission.connect(0.0)
    ours: VelocityGate[Twist] = VelocityGate(admission, Unlimited(), Twist())
    assert ours.command(Command(fast, "ann", 50, 0.0), now_s=0.0) == fast
    assert ours.limits.slowest(fast) is None
    assert [ours.step(0.0), ours.step(0.4)] == [fast, fast]
    assert outputs(ours, 0.5) == [Twist(), Twist(), Twist(), None, None]


# -- the lock ---------------------------------------------------------------------------------------------------------


def test_a_lock_is_zero_at_once_past_every_ramp_and_then_zero_again_and_again() -> None:
    ours = moving(HEAVY)
    ours.lock("smoke", now_s=1.0)
    assert (ours.owner_name, ours.priority, ours.current, ours.lock_reason) == (None, None, ZERO, "smoke")
    given = outputs(ours, 1.0, 25)  # for 1.25 s
    assert given == [ZERO] * 3 + [None] * 9 + [ZERO] + [None] * 9 + [ZERO] + [None] * 2


def test_a_locked_robot_that_has_received_its_zeros_stands() -> None:
    ours = driven()
    ours.lock("smoke", now_s=1.0)
    outputs(ours, 0.1, 3)
    assert (ours.may_move, ours.is_active) == (False, True)


def test_the_priority_of_the_owner_is_known() -> None:
    assert driven(priority=60).priority == 60


@pytest.mark.parametrize(
    ("linear_m_s", "angular_rad_s", "name"),
    [
        (0.4, 1.0, None),
        (-0.6, 0.0, "max_linear_m_s"),
        (0.1, -3.0, "max_angular_rad_s"),
        (0.6, 5.0, "max_angular_rad_s"),
        (0.45, 1.9, "max_wheel_m_s"),
    ],
)
def test_the_limit_that_slows_a_velocity_down_most_is_named(
    linear_m_s: float, angular_rad_s: float, name: str | None
) -> None:
    limits = Limits(
        max_linear_m_s=0.5, max_angular_rad_s=2.0, max_wheel_m_s=0.55, drive=PlanarDrive(wheel_separation_m=0.2)
    )
    velocity = PlanarVelocity(x_m_s=linear_m_s, yaw_rad_s=angular_rad_s)
    assert limits.slowest(velocity) == name
    assert (limits.apply(velocity) == velocity) is (name is None)


def test_end_of_the_lease_is_known_and_a_gate_without_driver_has_none() -> None:
    ours = gate()
    assert ours.driver is None
    ours.drive("ann", FORWARD, now_s=1.0)
    assert ours.driver is not None
    assert ours.driver.deadline_s == 1.5


def test_target_is_the_newest_command_within_the_limits() -> None:
    ours = driven(Limits(max_linear_m_s=0.2))
    assert ours.target == PlanarVelocity(0.2)
    ours.drive("ann", ZERO, now_s=0.1)
    assert ours.target.is_zero


def test_command_that_is_not_admitted_is_refused_with_its_kind_and_changes_nothing() -> None:
    ours = driven(priority=60)
    with pytest.raises(CommandRefused) as refused:
        ours.drive("bob", TURN, priority=50, now_s=0.1)
    assert (refused.value.kind, refused.value.holder) == (RefusalKind.HELD, "ann")
    assert ours.step(0.1) == FORWARD


@pytest.mark.parametrize("owner", ["ann", "bob"])
@pytest.mark.parametrize("velocity", [ZERO, FORWARD])
def test_command_after_a_lease_leaves_the_ended_lease_to_the_caller_once(owner: str, velocity: PlanarVelocity) -> None:
    ours = driven()
    ours.drive(owner, velocity, now_s=LEASE_S)
    ended = ours.pop_ended()
    assert ended is not None
    assert (ended.lease.source, ended.was_let_go) == ("ann", owner == "ann" and velocity == ZERO)
    assert ours.pop_ended() is None


def test_deceleration_of_zero_is_refused_because_the_robot_would_never_stop() -> None:
    with pytest.raises(
        ConfigError, match="max_linear_deceleration_m_s2 must be above zero: the robot would never stop"
    ):
        Limits(max_linear_deceleration_m_s2=0.0)
