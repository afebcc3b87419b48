"""Acceleration and deceleration of a velocity gate."""

import dataclasses

import pytest

from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.core.robot.velocity_gate import Limits, VelocityGate
from hostlink.errors import ConfigError
from tests.support.gates import FORWARD, FREE, GENTLE, HEAVY, STOPPED, TURN, gate, moving, outputs


def test_a_ramp_begins_at_zero_and_follows_the_clock() -> None:
    ours = gate(GENTLE)
    ours.drive("ann", FORWARD, priority=50, now_s=7.0)
    assert [ours.step(7.0), ours.step(7.05), ours.step(7.15)] == [
        ZERO,
        pytest.approx(PlanarVelocity(0.05)),
        pytest.approx(PlanarVelocity(0.15)),
    ]


def test_a_ramp_is_straight_so_that_the_slower_axis_leads() -> None:
    ours = gate(GENTLE)
    ours.drive("ann", PlanarVelocity(0.1, yaw_rad_s=2.0), priority=50, now_s=0.0)
    assert ours.step(0.1) == pytest.approx(PlanarVelocity(0.05, yaw_rad_s=1.0))
    assert ours.step(0.2) == PlanarVelocity(0.1, yaw_rad_s=2.0)


def test_a_late_step_does_not_jump() -> None:
    ours = gate(GENTLE)
    ours.drive("ann", FORWARD, priority=50, now_s=0.0)
    assert ours.step(0.45) == pytest.approx(PlanarVelocity(0.1))


def test_clock_that_is_set_back_changes_nothing() -> None:
    ours = gate(GENTLE)
    ours.drive("ann", FORWARD, priority=50, now_s=1.0)
    ours.step(1.1)
    assert ours.step(1.0) == pytest.approx(PlanarVelocity(0.1))


# -- decelerations ----------------------------------------------------------------------------------------------------


def test_a_new_owner_ramps_from_the_present_velocity() -> None:
    ours = moving(HEAVY)
    ours.drive("bob", PlanarVelocity(-0.3), priority=60, now_s=1.0)
    given = [ours.step(1.0 + number * 0.1) for number in range(4)]
    assert given == [
        FORWARD,
        pytest.approx(PlanarVelocity(0.1)),
        pytest.approx(PlanarVelocity(-0.05)),  # half of the step loses 0.1 m/s, the other half gains 0.05
        pytest.approx(PlanarVelocity(-0.15)),
    ]


def test_without_a_deceleration_limit_speed_is_lost_at_once_and_gained_slowly() -> None:
    ours = moving(GENTLE)
    ours.drive("ann", PlanarVelocity(0.1), priority=50, now_s=1.0)
    assert ours.step(1.0) == PlanarVelocity(0.1)
    ours.drive("ann", PlanarVelocity(-0.3), priority=50, now_s=1.1)
    assert ours.step(1.1) == pytest.approx(PlanarVelocity(-0.1))  # all of 0.1 is lost, 0.1 is gained
    ours.drive("ann", ZERO, priority=50, now_s=1.2)
    assert ours.step(1.2) == ZERO


def test_both_axes_slow_down_together_so_that_the_curve_stays() -> None:
    ours = moving(dataclasses.replace(FREE, max_linear_deceleration_m_s2=1.0), TURN)
    ours.stop(now_s=1.0)
    given = outputs(ours, 1.0, 4)
    assert given == [pytest.approx(TURN.scaled(factor)) for factor in (1.0, 0.75, 0.5, 0.25)]
    assert outputs(ours, 1.2) == STOPPED


@pytest.mark.parametrize("way", ["stop", "release", "expiry"])
def test_every_end_of_a_lease_slows_down_and_then_sends_zero_three_times(way: str) -> None:
    ours = moving(HEAVY)
    end_s = 1.5 if way == "expiry" else 1.2
    if way == "stop":
        ours.stop(now_s=end_s)
    elif way == "release":
        ours.withdraw("ann", now_s=end_s)
    assert ours.step(end_s) == FORWARD
    assert (ours.owner_name, ours.is_active) == (None, True)
    assert outputs(ours, end_s + 0.05, 7) == [
        pytest.approx(PlanarVelocity(0.2)),
        pytest.approx(PlanarVelocity(0.1)),
        *STOPPED,
    ]


def test_late_step_has_braked_in_time() -> None:
    """The device's own watchdog has stopped it by then: nothing may set it going again."""
    ours = moving(HEAVY)
    assert ours.step(1.7) == ZERO


def test_stops_one_after_another_do_not_delay_the_ramp() -> None:
    ours = moving(HEAVY)
    for number in range(200):
        ours.stop(now_s=1.0 + number / 1000)
        given = ours.step(1.0 + number / 1000)
    assert given == ZERO


def test_an_idle_zero_does_not_cut_the_ramp() -> None:
    ours = moving(HEAVY)
    ours.stop(now_s=1.0)
    ours.drive("bob", ZERO, priority=100, now_s=1.05)
    assert ours.step(1.05) == pytest.approx(PlanarVelocity(0.2))


def test_command_while_the_robot_slows_down_continues_from_that_speed() -> None:
    ours = moving(HEAVY)
    ours.stop(now_s=1.0)
    ours.step(1.1)
    ours.drive("bob", FORWARD, priority=50, now_s=1.1)
    assert ours.step(1.15) == pytest.approx(PlanarVelocity(0.15))


def test_a_deceleration_of_zero_would_never_stop() -> None:
    with pytest.raises(ConfigError, match="max_linear_deceleration_m_s2 must be above zero: the robot would never"):
        Limits(max_linear_deceleration_m_s2=0.0)


def test_a_stop_without_a_deceleration_limit_does_not_ramp() -> None:
    ours = moving(GENTLE)
    ours.stop(now_s=1.0)
    assert outputs(ours, 1.0) == STOPPED


def test_a_stop_at_once_and_a_new_device_bypass_the_ramp() -> None:
    for end in (VelocityGate.stop_at_once, VelocityGate.restart):
        ours = moving(HEAVY)
        end(ours)
        assert ours.current == ZERO
        assert outputs(ours, 1.0) == STOPPED
