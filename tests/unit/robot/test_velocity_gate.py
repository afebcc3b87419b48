"""VelocityGate: who drives, how fast, until when. Every row of its table, and the limits one by one."""

import dataclasses
import math
from collections.abc import Callable

import pytest

from hostlink.errors import BadRequest, ConfigError, RobotHeld
from hostlink.robot.claims import MAX_CLAIMS, Claims
from hostlink.robot.velocity import ZERO, Velocity
from hostlink.robot.velocity_gate import GateCounts, Limits, VelocityGate
from tests.support.gates import FORWARD, FREE, HEAVY, STOPPED, TURN, driven, gate, moving, outputs

# -- the life of a lease ----------------------------------------------------------------------------------------------


def test_a_new_gate_is_silent() -> None:
    ours = gate()
    assert outputs(ours, 0.0, 2) == [None, None]
    assert (ours.is_active, ours.owner_name, ours.current) == (False, None, ZERO)


def test_a_command_is_given_on_every_step_until_the_lease_ends() -> None:
    ours = gate()
    assert ours.command("ann", FORWARD, priority=50, now_s=0.0) == FORWARD
    assert ours.is_active
    assert outputs(ours, 0.0, 10) == [FORWARD] * 10
    assert (ours.owner_name, ours.current) == ("ann", FORWARD)
    assert outputs(ours, 0.5) == STOPPED
    assert (ours.is_active, ours.owner_name, ours.current) == (False, None, ZERO)
    assert ours.counts == GateCounts(commands=1, expired=1)


def test_a_robot_may_move_until_its_last_zero_was_sent() -> None:
    ours = driven()
    sent = [(ours.step(0.5 + 0.03 * number), ours.may_move, ours.is_active) for number in range(3)]
    assert sent == [(ZERO, True, True), (ZERO, True, True), (ZERO, False, False)]


def test_it_is_stopping_from_a_stop_to_its_last_zero() -> None:
    ours = driven()
    assert not ours.is_stopping
    ours.stop(now_s=0.1)
    stopping = [(ours.is_stopping, ours.step(0.1 + 0.05 * number)) for number in range(4)]
    assert stopping == [(True, ZERO), (True, ZERO), (True, ZERO), (False, None)]


def test_it_is_driven_until_it_stands_though_zeros_are_on_their_way() -> None:
    ours = driven()
    assert (ours.is_driven, ours.may_move) == (True, True)
    ours.release("ann", now_s=0.1)
    assert (ours.is_driven, ours.may_move) == (False, True)
    assert outputs(ours, 0.1) == STOPPED
    assert (ours.is_driven, ours.may_move) == (False, False)


def test_it_is_driven_by_a_driver_who_stands_and_while_it_slows_down_for_nobody() -> None:
    ours = gate()
    ours.command("ann", ZERO, priority=50, now_s=0.0)
    ours.command("ann", FORWARD, priority=50, now_s=0.0)
    assert (ours.current.is_zero, ours.is_driven) == (True, True)
    slowing = moving(HEAVY)
    slowing.release("ann", now_s=1.0)
    assert (slowing.owner_name, slowing.current.is_zero, slowing.is_driven) == (None, False, True)


def test_a_command_renews_the_lease() -> None:
    ours = driven()
    ours.command("ann", TURN, priority=50, now_s=0.4)
    assert ours.step(0.89) == TURN
    assert ours.step(0.9) == ZERO


def test_a_late_command_is_a_new_lease() -> None:
    ours = driven()
    ours.command("ann", TURN, priority=50, now_s=0.5)
    assert ours.counts.expired == 1
    assert ours.step(0.5) == TURN


def test_the_lease_may_have_another_length() -> None:
    ours = VelocityGate("robot_0", FREE, lease_s=2.0)
    ours.command("ann", FORWARD, priority=50, now_s=0.0)
    assert [ours.step(1.9), ours.step(2.0)] == [FORWARD, ZERO]


def test_the_owner_may_leave() -> None:
    ours = driven()
    ours.release("ann", now_s=0.1)
    assert outputs(ours, 0.1) == STOPPED
    assert ours.counts.expired == 0


def test_a_lease_expires_without_anybody_checking_it() -> None:
    ours = driven()
    ours.release("ann", now_s=0.5)
    assert outputs(ours, 0.5) == STOPPED
    assert ours.counts.expired == 1


def test_nobody_else_ends_it_by_leaving() -> None:
    ours = driven()
    ours.release("bob", now_s=0.1)
    assert ours.step(0.1) == FORWARD


def test_leaving_after_the_end_changes_nothing() -> None:
    ours = driven()
    outputs(ours, 0.5, 3)
    ours.release("ann", now_s=1.0)
    assert ours.step(1.0) is None


def test_anybody_may_stop_it() -> None:
    ours = driven(priority=100)
    ours.stop(now_s=0.1)
    assert (ours.owner_name, ours.current) == (None, ZERO)
    assert outputs(ours, 0.1) == STOPPED
    assert ours.counts.stops == 1


def test_a_command_of_before_a_stop_or_a_lock_can_be_told() -> None:
    ours = driven()
    before = ours.stops
    ours.stop(now_s=0.1)
    ours.lock("smoke")
    ours.unlock()
    assert (before, ours.stops) == (0, 2)


def test_a_stop_is_sent_to_a_robot_that_stands() -> None:
    ours = gate()
    ours.stop(now_s=0.0)
    assert ours.is_active
    assert outputs(ours, 0.0) == STOPPED


@pytest.mark.parametrize(("owner", "priority"), [("ann", 50), ("ann", 0), ("bob", 50), ("bob", 100)])
def test_after_a_stop_the_owner_and_whoever_is_as_important_may_drive_again(owner: str, priority: int) -> None:
    ours = driven()
    ours.stop(now_s=0.1)
    assert ours.step(0.1) == ZERO
    ours.command(owner, TURN, priority=priority, now_s=0.2)
    assert (ours.owner_name, ours.step(0.2)) == (owner, TURN)


# -- claims -----------------------------------------------------------------------------------------------------------

INTERRUPTIONS: dict[str, Callable[[VelocityGate], None]] = {
    "stop": lambda ours: ours.stop(now_s=0.1),
    "stop_at_once": VelocityGate.stop_at_once,
    "lock and unlock": lambda ours: (ours.lock("smoke"), ours.unlock())[-1],
}


@pytest.mark.parametrize("interruption", INTERRUPTIONS)
def test_no_interruption_makes_somebody_less_important_the_owner(interruption: str) -> None:
    ours = driven(priority=100)
    INTERRUPTIONS[interruption](ours)
    with pytest.raises(RobotHeld, match="ann drives it with a higher priority"):
        ours.command("bob", TURN, priority=99, now_s=0.49)
    assert outputs(ours, 0.49) == STOPPED
    ours.command("bob", TURN, priority=0, now_s=0.7)
    assert ours.owner_name == "bob"


def test_a_stop_and_a_publish_thirty_times_a_second_get_no_time_against_an_owner() -> None:
    ours, given = gate(), list[Velocity | None]()
    for tick in range(300):  # 30 Hz, for ten seconds
        now_s = tick / 30
        if tick % 3 == 0:
            ours.command("ann", FORWARD, priority=100, now_s=now_s)
            given.append(ours.step(now_s))
        ours.stop(now_s=now_s)
        with pytest.raises(RobotHeld):
            ours.command("eve", TURN, priority=0, now_s=now_s)
        given.append(ours.step(now_s))
    assert (given.count(TURN), given.count(FORWARD)) == (0, 100)


def test_a_claim_ends_with_its_owners_leaving_also_while_nobody_drives() -> None:
    ours = driven(priority=100)
    ours.stop(now_s=0.1)
    ours.release("ann", now_s=0.2)
    ours.command("bob", TURN, priority=0, now_s=0.2)
    assert ours.owner_name == "bob"


def test_who_was_replaced_keeps_its_claim_when_the_other_leaves() -> None:
    ours = driven(priority=100)
    ours.command("bob", TURN, priority=100, now_s=0.1)
    ours.release("bob", now_s=0.2)
    with pytest.raises(RobotHeld, match="ann drives it with a higher priority"):
        ours.command("eve", TURN, priority=60, now_s=0.3)


def test_an_owner_who_lowers_its_priority_goes_on_and_admits_nobody_below_the_others() -> None:
    ours = driven(priority=100)
    ours.command("bob", TURN, priority=100, now_s=0.1)
    assert ours.command("bob", TURN, priority=0, now_s=0.2) == TURN
    with pytest.raises(RobotHeld, match="ann drives it with a higher priority"):
        ours.command("eve", TURN, priority=60, now_s=0.3)
    ours.command("eve", TURN, priority=60, now_s=0.5)
    assert ours.owner_name == "eve"


def test_a_new_device_is_free_for_everybody() -> None:
    ours = driven(priority=100)
    ours.restart()
    ours.command("bob", TURN, priority=0, now_s=0.1)
    assert ours.owner_name == "bob"


def test_a_refused_command_claims_nothing() -> None:
    ours = driven(priority=100)
    with pytest.raises(RobotHeld):
        ours.command("bob", TURN, priority=99, now_s=0.4)
    ours.command("eve", TURN, priority=0, now_s=0.5)
    assert ours.owner_name == "eve"


def test_gates_that_share_their_claims_share_who_may_drive() -> None:
    claims = Claims()
    base, arm = (VelocityGate("robot_0", FREE, claims=claims) for _ in range(2))
    base.command("ann", FORWARD, priority=60, now_s=0.0)
    with pytest.raises(RobotHeld, match="ann"):
        arm.command("bob", FORWARD, priority=50, now_s=0.1)
    arm.command("cat", FORWARD, priority=60, now_s=0.1)
    assert (base.owner, arm.owner) == ("ann", "cat")
    arm.restart()
    with pytest.raises(RobotHeld, match="ann"):
        arm.command("bob", FORWARD, priority=50, now_s=0.2)
    base.restart()
    arm.command("bob", FORWARD, priority=50, now_s=0.2)
    assert (base.is_claimed(0.3), arm.is_claimed(0.3), arm.is_claimed(0.7)) == (False, True, False)


def test_an_owners_claims_at_two_gates_end_each_with_its_own() -> None:
    claims = Claims()
    base, arm = (VelocityGate("robot_0", FREE, claims=claims) for _ in range(2))
    base.command("ann", FORWARD, priority=60, now_s=0.0)
    arm.command("ann", FORWARD, priority=40, now_s=0.1)
    arm.release("ann", now_s=0.2)
    with pytest.raises(RobotHeld, match="ann"):
        arm.command("bob", FORWARD, priority=50, now_s=0.4)
    arm.command("bob", FORWARD, priority=50, now_s=0.5)


def test_the_claims_are_bounded_and_the_most_important_stay() -> None:
    ours = driven(priority=100)
    for number in range(MAX_CLAIMS + 5):
        ours.command(f"crowd {number}", TURN, priority=100, now_s=0.1)
    assert ours.counts.forgotten_claims == 6
    with pytest.raises(RobotHeld):
        ours.command("eve", TURN, priority=99, now_s=0.2)


# -- a new device -----------------------------------------------------------------------------------------------------


def test_a_restart_forgets_everything() -> None:
    ours = driven(priority=100)
    ours.restart()
    assert (ours.owner_name, ours.current) == (None, ZERO)
    assert outputs(ours, 0.1) == STOPPED


def test_the_first_velocity_of_a_new_device_is_zero_even_when_somebody_drives_at_once() -> None:
    ours = gate()
    ours.restart()
    ours.command("ann", FORWARD, priority=50, now_s=0.0)
    ours.command("ann", TURN, priority=50, now_s=0.0)
    assert outputs(ours, 0.0, 3) == [ZERO, TURN, TURN]


# -- who drives -------------------------------------------------------------------------------------------------------


def test_a_lower_priority_is_refused_and_changes_nothing() -> None:
    ours = driven(priority=50)
    with pytest.raises(RobotHeld, match="robot_0: ann drives it with a higher priority"):
        ours.command("bob", TURN, priority=49, now_s=0.4)
    assert ours.step(0.4) == FORWARD
    assert ours.step(0.5) == ZERO
    assert ours.counts == GateCounts(commands=1, refused=1, expired=1)


@pytest.mark.parametrize("priority", [50, 51])
def test_an_equal_priority_replaces_the_owner(priority: int) -> None:
    ours = driven(priority=50)
    ours.command("bob", TURN, priority=priority, now_s=0.4)
    assert (ours.owner_name, ours.step(0.4), ours.step(0.8)) == ("bob", TURN, TURN)
    ours.release("ann", now_s=0.85)
    assert ours.step(0.85) == TURN


def test_the_priority_goes_with_the_lease() -> None:
    ours = driven(priority=100)
    outputs(ours, 0.5, 1)
    ours.command("bob", TURN, priority=0, now_s=0.6)
    assert ours.owner_name == "bob"


# -- zeros ------------------------------------------------------------------------------------------------------------


def test_a_zero_of_another_is_ignored_whatever_its_priority() -> None:
    ours = driven(priority=50)
    for priority in (0, 50, 100):
        assert ours.command("bob", ZERO, priority=priority, now_s=0.4) == ZERO
    assert (ours.owner_name, ours.step(0.4), ours.step(0.5)) == ("ann", FORWARD, ZERO)
    assert ours.counts.ignored_zeros == 3


def test_a_zero_of_the_owner_stops_but_does_not_extend_the_lease() -> None:
    ours = driven()
    assert ours.command("ann", ZERO, priority=50, now_s=0.2) == ZERO
    assert ours.step(0.2) == ZERO
    ours.command("ann", ZERO, priority=50, now_s=0.4)
    assert (ours.owner_name, ours.step(0.4)) == ("ann", ZERO)
    assert outputs(ours, 0.5) == STOPPED


def test_idle_zeros_of_a_high_priority_do_not_lock_others_out() -> None:
    ours = gate()
    for number in range(20):
        ours.command("planner", ZERO, priority=100, now_s=number * 0.1)
        assert (ours.step(number * 0.1), ours.owner_name) == (ZERO, None)
    ours.command("ann", FORWARD, priority=0, now_s=2.0)
    assert (ours.owner_name, ours.step(2.0)) == ("ann", FORWARD)


def test_an_idle_zero_is_sent_once() -> None:
    ours = gate()
    ours.command("ann", ZERO, priority=50, now_s=0.0)
    assert outputs(ours, 0.0, 3) == [ZERO, None, None]


def test_an_idle_zero_does_not_shorten_a_stop() -> None:
    ours = gate()
    ours.stop(now_s=0.0)
    ours.command("ann", ZERO, priority=50, now_s=0.0)
    assert outputs(ours, 0.0) == STOPPED


# -- limits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_and_not_kept(axis: int, wrong: float) -> None:
    ours = driven()
    with pytest.raises(BadRequest, match="robot_0: a velocity must be made of finite numbers"):
        ours.command("ann", FORWARD._replace(**{Velocity._fields[axis]: wrong}), priority=50, now_s=0.4)
    assert (ours.step(0.4), ours.step(0.5)) == (FORWARD, ZERO)
    assert ours.counts.refused == 1


@pytest.mark.parametrize(
    ("limits", "requested", "given"),
    [
        (Limits(), Velocity(0.9, angular_z_rad_s=3.9), Velocity(0.9, angular_z_rad_s=3.9)),
        (Limits(), Velocity(2.0, angular_z_rad_s=1.0), Velocity(1.0, angular_z_rad_s=0.5)),
        (Limits(), Velocity(-2.0, angular_z_rad_s=1.0), Velocity(-1.0, angular_z_rad_s=0.5)),
        (Limits(), Velocity(0.4, angular_z_rad_s=-8.0), Velocity(0.2, angular_z_rad_s=-4.0)),
        (Limits(), Velocity(0.0, 3.0, 4.0, 1.0, 1.0, 1.0), Velocity(0.0, 0.6, 0.8, 0.2, 0.2, 0.2)),
        (Limits(max_linear_m_s=0.0), FORWARD, ZERO),
        (FREE, Velocity(1e6, 1e6, 1e6, 1e6, 1e6, 1e6), Velocity(1e6, 1e6, 1e6, 1e6, 1e6, 1e6)),
        (Limits(max_wheel_m_s=0.3), Velocity(0.6, angular_z_rad_s=2.0), Velocity(0.3, angular_z_rad_s=1.0)),
    ],
)
def test_all_components_shrink_by_one_factor(limits: Limits, requested: Velocity, given: Velocity) -> None:
    assert limits.apply(requested) == pytest.approx(given)


@pytest.mark.parametrize("forward", [1, -1])
@pytest.mark.parametrize("left", [1, -1])
def test_the_faster_wheel_counts_in_every_direction(forward: int, left: int) -> None:
    limits = Limits(max_wheel_m_s=0.3, wheel_separation_m=0.2)
    given = limits.apply(Velocity(forward * 0.4, angular_z_rad_s=left * 2.0))  # one wheel would make 0.6 m/s
    assert given == pytest.approx(Velocity(forward * 0.2, angular_z_rad_s=left * 1.0))


def test_the_caller_hears_what_the_limits_left() -> None:
    ours = gate(Limits())
    assert ours.command("ann", Velocity(3.0), priority=50, now_s=0.0) == Velocity(1.0)
    assert ours.step(0.0) == Velocity(1.0)
    ours.command("ann", FORWARD, priority=50, now_s=0.1)
    assert ours.counts == GateCounts(commands=2, limited=1)


def test_the_largest_numbers_stand_still_under_a_limit() -> None:
    assert Limits().apply(Velocity(1.7e308, 1.7e308, 0.0, 0.0, 0.0, 1.7e308)).is_zero


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Limits)])
@pytest.mark.parametrize("wrong", [-0.1, math.nan, math.inf, -math.inf])
def test_an_impossible_limit_is_refused(name: str, wrong: float) -> None:
    with pytest.raises(ConfigError, match=f"limits of a robot: {name} must be a finite number, zero or more, not"):
        Limits(**{name: wrong})


# -- the lock ---------------------------------------------------------------------------------------------------------


def test_a_lock_is_zero_at_once_past_every_ramp_and_then_zero_again_and_again() -> None:
    ours = moving(HEAVY)
    ours.lock("smoke")
    assert (ours.owner_name, ours.priority, ours.current, ours.lock_reason) == (None, None, ZERO, "smoke")
    given = outputs(ours, 1.0, 25)  # for 1.25 s
    assert given == [ZERO] * 3 + [None] * 9 + [ZERO] + [None] * 9 + [ZERO] + [None] * 2
    assert ours.counts.locks == 1


@pytest.mark.parametrize("velocity", [FORWARD, ZERO, Velocity(math.nan)])
def test_a_locked_robot_refuses_every_command(velocity: Velocity) -> None:
    ours = driven()
    ours.lock("smoke")
    for owner in ("ann", "bob"):
        with pytest.raises(RobotHeld, match="robot_0: locked: smoke; to drive it again: hostlink unlock robot_0"):
            ours.command(owner, velocity, priority=100, now_s=0.1)
    assert ours.step(0.1) == ZERO
    assert ours.counts.refused == 2


def test_only_unlock_opens_a_lock() -> None:
    ours = driven()
    ours.lock("smoke")
    ours.stop(now_s=0.1)
    ours.release("ann", now_s=0.1)
    ours.stop_at_once()
    ours.restart()
    assert ours.step(100.0) == ZERO
    assert ours.lock_reason == "smoke"
    ours.unlock()
    outputs(ours, 100.1, 3)
    assert ours.step(100.3) is None
    assert ours.command("bob", TURN, priority=0, now_s=100.3) == TURN
    assert ours.step(100.3) == TURN


def test_a_locked_robot_that_has_received_its_zeros_stands() -> None:
    ours = driven()
    ours.lock("smoke")
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
    limits = Limits(max_linear_m_s=0.5, max_angular_rad_s=2.0, max_wheel_m_s=0.55, wheel_separation_m=0.2)
    velocity = Velocity(linear_x_m_s=linear_m_s, angular_z_rad_s=angular_rad_s)
    assert limits.slowest(velocity) == name
    assert (limits.apply(velocity) == velocity) is (name is None)
