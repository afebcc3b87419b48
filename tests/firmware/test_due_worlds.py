"""The Due's program in worlds for which it was not tuned: true odometry, no overspeed, stopped after a zero."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hostlink.workbench.sim.firmware_module import WorldParameters
from tests.firmware.drive_checks import ROW_S, check_odometry, check_speed, check_standstill, wheels
from tests.firmware.worlds import FULL_PWM, LEFT, METRES_PER_TICK, RIGHT, Trace, World, world, worlds

WORLDS = settings(max_examples=settings.default.max_examples * 2)  # 20 ms each; make fuzz draws 10,000

speeds = st.floats(0.02, 0.34).flatmap(lambda size: st.sampled_from([size, -size]))
turns = st.one_of(st.just(0.0), st.floats(-1.5, 1.5))
drives = st.tuples(speeds, turns, st.floats(0.1, 3.0), st.sampled_from([0.0, 0.0, 0.04, 0.07, 0.1, 0.2, 0.6, 1.0]))
stories = st.lists(drives, min_size=1, max_size=8)  # speed, turn, seconds; then a zero for seconds


def error_m(trace: Trace) -> float:
    """Distance between the end of the odometry and the true end."""
    return float(np.hypot(trace.x_m[-1] - trace.odom_x_m[-1], trace.y_m[-1] - trace.odom_y_m[-1]))


def way_m(trace: Trace) -> float:
    """Distance that the middle of the robot has rolled, forwards and backwards."""
    return float(np.sum(np.hypot(np.diff(trace.x_m), np.diff(trace.y_m))))


def top_ticks_s(drawn: WorldParameters) -> float:
    """Speed of the slower wheel with full PWM, on this floor and with this battery."""
    pwm = FULL_PWM * (drawn["battery_v"] - drawn["battery_sag_v"]) / drawn["rated_v"] - drawn["floor_pwm"]
    found = []
    for side in ("left", "right"):
        dead_pwm = 0.0 if drawn[f"{side}.has_jump"] else drawn[f"{side}.dead_zone_pwm"]
        full_speed_ticks_s = drawn[f"{side}.full_speed_rad_s"] * drawn[f"{side}.ticks_per_turn"] / math.tau
        found.append((pwm - dead_pwm) / (FULL_PWM - dead_pwm) * full_speed_ticks_s)
    return min(found)


def check_stop(made: World, drawn: WorldParameters) -> None:
    """A zero stops the robot."""
    before = sum(map(len, made.rows)) - 1
    made.drive(0.0, 0.0, 1.2)
    check_standstill(made.trace.since(before), drawn)


@WORLDS
@given(drawn=worlds(), story=stories)
def test_robot_with_drawn_motors_moves_as_its_odometry_shows(
    drawn: WorldParameters, story: list[tuple[float, float, float, float]]
) -> None:
    with world(drawn) as made:
        for linear, angular, seconds, pause_s in story:
            made.drive(linear, angular, round(seconds, 2))
            made.drive(0.0, 0.0, pause_s)
        check_stop(made, drawn)
        check_odometry(made.trace, len(story))
        check_speed(made.trace, np.concatenate(made.commanded))
        assert made.errors == []


hands = st.tuples(st.sampled_from([LEFT, RIGHT]), st.floats(-300.0, 300.0), st.floats(0.1, 2.0))


@WORLDS
@given(drawn=worlds(), story=st.lists(st.tuples(drives, st.none() | hands), min_size=1, max_size=6))
def test_wheel_turned_by_hand_is_driven_as_before_after_release(
    drawn: WorldParameters,
    story: list[tuple[tuple[float, float, float, float], tuple[int, float, float] | None]],
) -> None:
    """One channel cannot see the direction of the hand that turns the wheel. The robot drives correctly afterwards."""
    with world(drawn) as made:
        for (linear, angular, seconds, pause_s), hand in story:
            if hand is not None:
                side, ticks_s, held_s = hand
                made.grip(side, ticks_s)
                made.drive(linear, angular, round(held_s, 2))
                made.release(side)
                made.drive(0.0, 0.0, 1.0)
            made.rows.clear()
            made.commanded.clear()
            made.drive(linear, angular, round(seconds, 2))
            made.drive(0.0, 0.0, pause_s)
            check_stop(made, drawn)
            check_odometry(made.trace, 1)
            check_speed(made.trace, np.concatenate(made.commanded))


@pytest.mark.long
@WORLDS
@given(drawn=worlds(), linear=st.floats(0.08, 0.28), sense=st.sampled_from([1, -1]))
def test_steady_speed_with_drawn_motors_is_the_requested_one(drawn: WorldParameters, linear: float, sense: int) -> None:
    """Bound: 1 %, or 5 % where the motor cannot turn so slowly, and is alternately driven and braked."""
    assume(linear < 0.9 * METRES_PER_TICK * top_ticks_s(drawn))
    with world(drawn) as made:
        made.drive(sense * linear, 0.0, 14.0)
        for speed, _, commanded, drive in wheels(made.trace, np.concatenate(made.commanded)):
            late = slice(-round(5.0 / ROW_S), None)
            tolerance = 0.05 if np.any(drive[late] == 0) else 0.01
            assert float(np.mean(speed[late])) == pytest.approx(float(commanded[-1]), rel=tolerance)


pauses = st.sampled_from([0.0, 0.1, 0.3, 1.0])
corners = st.tuples(pauses, st.floats(0.4, 1.2), st.floats(2.0, 4.0), pauses, st.sampled_from([0.0, 0.0, 1.0]))


@WORLDS
@given(linear=st.floats(0.15, 0.32), sides=st.lists(corners, min_size=4, max_size=4), sense=st.sampled_from([1, -1]))
def test_odometry_of_a_stop_and_go_square_is_true_to_0_2_percent_of_the_way(
    linear: float, sides: list[tuple[float, float, float, float, float]], sense: int
) -> None:
    """Sides of more than a metre with stops, turns on the spot, and some reversing; in a perfect world."""
    with world() as made:
        for pause_s, angular, turn_s, later_s, back_s in sides:
            made.drive(linear, 0.0, 6.0)
            made.drive(0.0, 0.0, pause_s)
            made.drive(-linear, 0.0, back_s)
            made.drive(0.0, sense * angular, round(turn_s, 2))
            made.drive(0.0, 0.0, later_s)
        made.drive(0.0, 0.0, 1.0)
        assert error_m(made.trace) <= 0.002 * way_m(made.trace)
