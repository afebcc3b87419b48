"""VelocityGate: who drives, how fast, until when. Every row of its table, and the limits one by one."""

import dataclasses
import math

import pytest

from hostlink.errors import BadRequest, ConfigError, RobotHeld
from hostlink.robot.velocity import ZERO, Velocity
from hostlink.robot.velocity_gate import GateCounts, Limits, VelocityGate

FREE = Limits(max_linear_m_s=None, max_angular_rad_s=None)
FORWARD = Velocity(0.3)
TURN = Velocity(0.2, angular_z_rad_s=1.0)


def gate(limits: Limits = FREE) -> VelocityGate:
    return VelocityGate("robot_0", limits)


def held(limits: Limits = FREE, *, priority: int = 50) -> VelocityGate:
    """`ann` drives forward since 0 s, and the robot knows."""
    ours = gate(limits)
    ours.command("ann", FORWARD, priority=priority, now_s=0.0)
    ours.step(0.0)
    return ours


def outputs(ours: VelocityGate, now_s: float, count: int = 5) -> list[Velocity | None]:
    return [ours.step(now_s + number * 0.05) for number in range(count)]


STOPPED = [ZERO, ZERO, ZERO, None, None]


# -- the life of a lease ----------------------------------------------------------------------------------------------


def test_a_new_gate_is_silent() -> None:
    ours = gate()
    assert outputs(ours, 0.0, 2) == [None, None]
    assert (ours.is_active, ours.holder, ours.current) == (False, None, ZERO)


def test_a_command_is_given_on_every_step_until_the_lease_ends() -> None:
    ours = gate()
    assert ours.command("ann", FORWARD, priority=50, now_s=0.0) == FORWARD
    assert ours.is_active
    assert outputs(ours, 0.0, 10) == [FORWARD] * 10
    assert (ours.holder, ours.current) == ("ann", FORWARD)
    assert outputs(ours, 0.5) == STOPPED
    assert (ours.is_active, ours.holder, ours.current) == (False, None, ZERO)
    assert ours.counts == GateCounts(commands=1, expired=1)


def test_a_command_renews_the_lease() -> None:
    ours = held()
    ours.command("ann", TURN, priority=50, now_s=0.4)
    assert ours.step(0.89) == TURN
    assert ours.step(0.9) == ZERO


def test_a_late_command_is_a_new_lease() -> None:
    ours = held()
    ours.command("ann", TURN, priority=50, now_s=0.5)
    assert ours.counts.expired == 1
    assert ours.step(0.5) == TURN


def test_the_lease_may_have_another_length() -> None:
    ours = VelocityGate("robot_0", FREE, lease_s=2.0)
    ours.command("ann", FORWARD, priority=50, now_s=0.0)
    assert [ours.step(1.9), ours.step(2.0)] == [FORWARD, ZERO]


def test_the_holder_may_leave() -> None:
    ours = held()
    ours.release("ann", now_s=0.1)
    assert outputs(ours, 0.1) == STOPPED
    assert ours.counts.expired == 0


def test_a_lease_that_nobody_saw_end_has_expired_all_the_same() -> None:
    ours = held()
    ours.release("ann", now_s=0.5)
    assert outputs(ours, 0.5) == STOPPED
    assert ours.counts.expired == 1


def test_nobody_else_ends_it_by_leaving() -> None:
    ours = held()
    ours.release("bob", now_s=0.1)
    assert ours.step(0.1) == FORWARD


def test_leaving_after_the_end_changes_nothing() -> None:
    ours = held()
    outputs(ours, 0.5, 3)
    ours.release("ann", now_s=1.0)
    assert ours.step(1.0) is None


def test_anybody_may_stop_it() -> None:
    ours = held(priority=100)
    ours.stop(now_s=0.1)
    assert (ours.holder, ours.current) == (None, ZERO)
    assert outputs(ours, 0.1) == STOPPED
    assert ours.counts.stops == 1


def test_a_stop_is_told_to_a_robot_that_stands() -> None:
    ours = gate()
    ours.stop(now_s=0.0)
    assert ours.is_active
    assert outputs(ours, 0.0) == STOPPED


def test_a_command_after_a_stop_drives_again() -> None:
    ours = held()
    ours.stop(now_s=0.1)
    assert ours.step(0.1) == ZERO
    ours.command("bob", TURN, priority=0, now_s=0.2)
    assert ours.step(0.2) == TURN


# -- a new device -----------------------------------------------------------------------------------------------------


def test_a_restart_forgets_everything() -> None:
    ours = held(priority=100)
    ours.restart()
    assert (ours.holder, ours.current) == (None, ZERO)
    assert outputs(ours, 0.1) == STOPPED


def test_the_first_velocity_of_a_new_device_is_zero_even_when_somebody_drives_at_once() -> None:
    ours = gate()
    ours.restart()
    ours.command("ann", FORWARD, priority=50, now_s=0.0)
    ours.command("ann", TURN, priority=50, now_s=0.0)
    assert outputs(ours, 0.0, 3) == [ZERO, TURN, TURN]


# -- who drives -------------------------------------------------------------------------------------------------------


def test_a_lower_priority_is_refused_and_changes_nothing() -> None:
    ours = held(priority=50)
    with pytest.raises(RobotHeld, match="robot_0: ann drives it with a higher priority"):
        ours.command("bob", TURN, priority=49, now_s=0.4)
    assert ours.step(0.4) == FORWARD
    assert ours.step(0.5) == ZERO
    assert ours.counts == GateCounts(commands=1, refused=1, expired=1)


@pytest.mark.parametrize("priority", [50, 51])
def test_as_high_a_priority_takes_over(priority: int) -> None:
    ours = held(priority=50)
    ours.command("bob", TURN, priority=priority, now_s=0.4)
    assert (ours.holder, ours.step(0.4), ours.step(0.8)) == ("bob", TURN, TURN)
    ours.release("ann", now_s=0.85)
    assert ours.step(0.85) == TURN


def test_the_priority_goes_with_the_lease() -> None:
    ours = held(priority=100)
    outputs(ours, 0.5, 1)
    ours.command("bob", TURN, priority=0, now_s=0.6)
    assert ours.holder == "bob"


# -- zeros ------------------------------------------------------------------------------------------------------------


def test_a_zero_of_another_is_ignored_whatever_its_priority() -> None:
    ours = held(priority=50)
    for priority in (0, 50, 100):
        assert ours.command("bob", ZERO, priority=priority, now_s=0.4) == ZERO
    assert (ours.holder, ours.step(0.4), ours.step(0.5)) == ("ann", FORWARD, ZERO)
    assert ours.counts.ignored_zeros == 3


def test_a_zero_of_the_holder_stops_but_does_not_hold() -> None:
    ours = held()
    assert ours.command("ann", ZERO, priority=50, now_s=0.2) == ZERO
    assert ours.step(0.2) == ZERO
    ours.command("ann", ZERO, priority=50, now_s=0.4)
    assert (ours.holder, ours.step(0.4)) == ("ann", ZERO)
    assert outputs(ours, 0.5) == STOPPED


def test_idle_zeros_of_a_high_priority_do_not_lock_others_out() -> None:
    ours = gate()
    for number in range(20):
        ours.command("planner", ZERO, priority=100, now_s=number * 0.1)
        assert (ours.step(number * 0.1), ours.holder) == (ZERO, None)
    ours.command("ann", FORWARD, priority=0, now_s=2.0)
    assert (ours.holder, ours.step(2.0)) == ("ann", FORWARD)


def test_an_idle_zero_is_told_once() -> None:
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
    ours = held()
    with pytest.raises(BadRequest, match="robot_0: a velocity must be made of finite numbers"):
        ours.command("ann", FORWARD._replace(**{Velocity._fields[axis]: wrong}), priority=50, now_s=0.4)
    assert (ours.step(0.4), ours.step(0.5)) == (FORWARD, ZERO)
    assert ours.counts.refused == 1


@pytest.mark.parametrize(
    ("limits", "asked", "given"),
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
def test_all_components_shrink_by_one_factor(limits: Limits, asked: Velocity, given: Velocity) -> None:
    assert limits.apply(asked) == pytest.approx(given)


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
def test_a_limit_that_could_not_hold_is_refused(name: str, wrong: float) -> None:
    with pytest.raises(ConfigError, match=f"limits of a robot: {name} must be a finite number, zero or more, not"):
        Limits(**{name: wrong})


# -- accelerations ----------------------------------------------------------------------------------------------------

GENTLE = Limits(max_linear_acceleration_m_s2=1.0, max_angular_acceleration_rad_s2=10.0)


def test_a_ramp_begins_at_zero_and_follows_the_clock() -> None:
    ours = gate(GENTLE)
    ours.command("ann", FORWARD, priority=50, now_s=7.0)
    assert [ours.step(7.0), ours.step(7.05), ours.step(7.15)] == [
        ZERO,
        pytest.approx(Velocity(0.05)),
        pytest.approx(Velocity(0.15)),
    ]


def test_a_ramp_is_straight_so_that_the_slower_axis_leads() -> None:
    ours = gate(GENTLE)
    ours.command("ann", Velocity(0.1, angular_z_rad_s=2.0), priority=50, now_s=0.0)
    assert ours.step(0.1) == pytest.approx(Velocity(0.05, angular_z_rad_s=1.0))
    assert ours.step(0.2) == Velocity(0.1, angular_z_rad_s=2.0)


def test_a_late_step_does_not_jump() -> None:
    ours = gate(GENTLE)
    ours.command("ann", FORWARD, priority=50, now_s=0.0)
    assert ours.step(0.45) == pytest.approx(Velocity(0.1))


def test_a_clock_that_goes_back_changes_nothing() -> None:
    ours = gate(GENTLE)
    ours.command("ann", FORWARD, priority=50, now_s=1.0)
    ours.step(1.1)
    assert ours.step(1.0) == pytest.approx(Velocity(0.1))


# -- decelerations ----------------------------------------------------------------------------------------------------

HEAVY = dataclasses.replace(GENTLE, max_linear_deceleration_m_s2=2.0, max_angular_deceleration_rad_s2=20.0)


def moving(limits: Limits, velocity: Velocity = FORWARD) -> VelocityGate:
    """`ann` has driven at this velocity for a while, until 1.0 s."""
    ours = gate(limits)
    for tenths in range(11):
        ours.command("ann", velocity, priority=50, now_s=tenths / 10)
        ours.step(tenths / 10)
    assert ours.current == velocity
    return ours


def test_a_take_over_ramps_from_where_the_robot_is() -> None:
    ours = moving(HEAVY)
    ours.command("bob", Velocity(-0.3), priority=50, now_s=1.0)
    given = [ours.step(1.0 + number * 0.1) for number in range(4)]
    assert given == [
        FORWARD,
        pytest.approx(Velocity(0.1)),
        pytest.approx(Velocity(-0.05)),  # half of the step loses 0.1 m/s, the other half gains 0.05
        pytest.approx(Velocity(-0.15)),
    ]


def test_without_a_deceleration_limit_speed_is_lost_at_once_and_gained_slowly() -> None:
    ours = moving(GENTLE)
    ours.command("ann", Velocity(0.1), priority=50, now_s=1.0)
    assert ours.step(1.0) == Velocity(0.1)
    ours.command("ann", Velocity(-0.3), priority=50, now_s=1.1)
    assert ours.step(1.1) == pytest.approx(Velocity(-0.1))  # all of 0.1 is lost, 0.1 is gained
    ours.command("ann", ZERO, priority=50, now_s=1.2)
    assert ours.step(1.2) == ZERO


def test_both_axes_slow_down_together_so_that_the_curve_stays() -> None:
    ours = moving(dataclasses.replace(FREE, max_linear_deceleration_m_s2=1.0), TURN)
    ours.stop(now_s=1.0)
    given = outputs(ours, 1.0, 4)
    assert given == [pytest.approx(TURN.scaled(factor)) for factor in (1.0, 0.75, 0.5, 0.25)]
    assert outputs(ours, 1.2) == STOPPED


@pytest.mark.parametrize("way", ["stop", "release", "expiry"])
def test_every_end_of_a_lease_slows_down_and_then_tells_zero_three_times(way: str) -> None:
    ours = moving(HEAVY)
    end_s = 1.5 if way == "expiry" else 1.2
    if way == "stop":
        ours.stop(now_s=end_s)
    elif way == "release":
        ours.release("ann", now_s=end_s)
    assert ours.step(end_s) == FORWARD
    assert (ours.holder, ours.is_active) == (None, True)
    assert outputs(ours, end_s + 0.05, 7) == [
        pytest.approx(Velocity(0.2)),
        pytest.approx(Velocity(0.1)),
        *STOPPED,
    ]


def test_a_step_that_comes_late_has_braked_in_time() -> None:
    """The device's own watchdog has stopped it by then: nothing may set it going again."""
    ours = moving(HEAVY)
    assert ours.step(1.7) == ZERO


def test_stops_one_after_another_do_not_hold_the_ramp_up() -> None:
    ours = moving(HEAVY)
    for number in range(200):
        ours.stop(now_s=1.0 + number / 1000)
        given = ours.step(1.0 + number / 1000)
    assert given == ZERO


def test_an_idle_zero_does_not_cut_the_ramp() -> None:
    ours = moving(HEAVY)
    ours.stop(now_s=1.0)
    ours.command("bob", ZERO, priority=100, now_s=1.05)
    assert ours.step(1.05) == pytest.approx(Velocity(0.2))


def test_who_drives_while_it_slows_down_takes_it_from_there() -> None:
    ours = moving(HEAVY)
    ours.stop(now_s=1.0)
    ours.step(1.1)
    ours.command("bob", FORWARD, priority=0, now_s=1.1)
    assert ours.step(1.15) == pytest.approx(Velocity(0.15))


def test_a_deceleration_of_zero_would_never_stop() -> None:
    with pytest.raises(ConfigError, match="max_linear_deceleration_m_s2 must be above zero: the robot would never"):
        Limits(max_linear_deceleration_m_s2=0.0)


def test_a_stop_without_a_deceleration_limit_does_not_ramp() -> None:
    ours = moving(GENTLE)
    ours.stop(now_s=1.0)
    assert outputs(ours, 1.0) == STOPPED


def test_a_halt_and_a_new_device_bypass_the_ramp() -> None:
    for end in (VelocityGate.halt, VelocityGate.restart):
        ours = moving(HEAVY)
        end(ours)
        assert ours.current == ZERO
        assert outputs(ours, 1.0) == STOPPED


# -- the lock ---------------------------------------------------------------------------------------------------------


def test_a_lock_is_zero_at_once_past_every_ramp_and_then_zero_again_and_again() -> None:
    ours = moving(HEAVY)
    ours.lock("smoke")
    assert (ours.holder, ours.priority, ours.current, ours.lock_reason) == (None, None, ZERO, "smoke")
    given = outputs(ours, 1.0, 25)  # for 1.25 s
    assert given == [ZERO] * 3 + [None] * 9 + [ZERO] + [None] * 9 + [ZERO] + [None] * 2
    assert ours.counts.locks == 1


@pytest.mark.parametrize("velocity", [FORWARD, ZERO, Velocity(math.nan)])
def test_a_locked_robot_refuses_every_command(velocity: Velocity) -> None:
    ours = held()
    ours.lock("smoke")
    for owner in ("ann", "bob"):
        with pytest.raises(RobotHeld, match="robot_0: locked: smoke; POST /api/robots/robot_0/unlock"):
            ours.command(owner, velocity, priority=100, now_s=0.1)
    assert ours.step(0.1) == ZERO
    assert ours.counts.refused == 2


def test_only_unlock_opens_a_lock() -> None:
    ours = held()
    ours.lock("smoke")
    ours.stop(now_s=0.1)
    ours.release("ann", now_s=0.1)
    ours.halt()
    ours.restart()
    assert ours.step(100.0) == ZERO
    assert ours.lock_reason == "smoke"
    ours.unlock()
    outputs(ours, 100.1, 3)
    assert ours.step(100.3) is None
    assert ours.command("bob", TURN, priority=0, now_s=100.3) == TURN
    assert ours.step(100.3) == TURN


def test_a_locked_robot_that_has_heard_its_zeros_stands() -> None:
    ours = held()
    ours.lock("smoke")
    outputs(ours, 0.1, 3)
    assert (ours.may_move, ours.is_active) == (False, True)


def test_the_priority_of_the_holder_is_known() -> None:
    assert held(priority=60).priority == 60
