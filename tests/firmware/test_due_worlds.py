"""The Due's program in worlds that nobody has tuned it for: odometry true, never too fast, standing after a zero."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.sim.drive_train import MotorWorld
from tests.firmware.worlds import LEFT, RIGHT, Trace, World, motors, world

STANDING_TICKS_S = 5.0  # 6 mm/s
CREEP_TICKS_S = 15.0  # 18 mm/s: what the least PWM gives to a wheel without friction before the encoder has two edges
ROW_S = 0.01
STOP_S = 0.6
OVER_S = 0.3
LATE_TICKS = 12.0  # odometry is a turn of the loop late: 9.3 ticks at full speed; and a wheel has parts of a tick
REVERSAL_TICKS = 1.0  # what rolls on unseen, under 5 ticks/s, while the sign changes
WORLDS = settings(max_examples=settings.default.max_examples * 2)  # 20 ms each

speeds = st.floats(0.02, 0.34).flatmap(lambda size: st.sampled_from([size, -size]))
turns = st.one_of(st.just(0.0), st.floats(-1.5, 1.5))
drives = st.tuples(speeds, turns, st.floats(0.1, 3.0), st.sampled_from([0.0, 0.0, 0.04, 0.07, 0.1, 0.2, 0.6, 1.0]))
stories = st.lists(drives, min_size=1, max_size=8)  # speed, turn, for so long; then a zero for so long


def longest_s(is_so: np.ndarray) -> float:
    """How long something was so without a break."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_so.astype(int), [0]])))
    return float(np.max(edges[1::2] - edges[::2], initial=0)) * ROW_S


def wheels(made: World) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Of each wheel: its true speed, its set-point, what was asked of it, what its motor is given."""
    trace, commanded = made.trace, np.concatenate(made.commanded)
    return [
        (trace.left, trace.left_set, commanded[:, LEFT], trace.left_drive),
        (trace.right, trace.right_set, commanded[:, RIGHT], trace.right_drive),
    ]


def check_odometry(trace: Trace, reversals: int) -> None:
    """It says what each wheel did: on the way but for what it is late, at the end but for the reversals."""
    for true, reported in zip(trace.rolled(is_truth=True), trace.rolled(is_truth=False), strict=True):
        off = np.abs((true - true[0]) - (reported - reported[0]))
        assert float(np.max(off)) <= LATE_TICKS + REVERSAL_TICKS * reversals
        assert float(off[-1]) <= 1.0 + REVERSAL_TICKS * reversals


def error_m(trace: Trace) -> float:
    """How far the odometry ends from the truth."""
    return float(np.hypot(trace.x_m[-1] - trace.odom_x_m[-1], trace.y_m[-1] - trace.odom_y_m[-1]))


def way_m(trace: Trace) -> float:
    """How far the middle of the robot has rolled, forwards and backwards."""
    return float(np.sum(np.hypot(np.diff(trace.x_m), np.diff(trace.y_m))))


def of_late(values: np.ndarray) -> np.ndarray:
    """The most in the last 0.3 s: who is told to go slower has to brake first."""
    rows = round(OVER_S / ROW_S)
    padded = np.concatenate([np.full(rows - 1, values[0]), values])
    return np.max(np.lib.stride_tricks.sliding_window_view(padded, rows), axis=1)


def too_fast_s(made: World) -> float:
    """How long a wheel was faster than 1.1 times what was asked for and a tick in 0.2 s, while it was driven."""
    found = []
    for speed, set_point, commanded, _ in wheels(made):
        most = of_late(np.maximum(np.abs(commanded), np.abs(set_point)))
        allowed = np.maximum(1.1 * most + STANDING_TICKS_S, CREEP_TICKS_S)
        found.append(longest_s((np.abs(speed) > allowed) & (commanded != 0)))
    return max(found)


def against_ticks_s(made: World) -> float:
    """The fastest that a wheel rolled while its motor was driven the other way."""
    return max(float(np.max(-speed * np.sign(drive), initial=0.0)) for speed, _, _, drive in wheels(made))


def brake_s(motor: MotorWorld, speed_ticks_s: float) -> float:
    """How long the shorted motor takes by itself."""
    friction = motor.friction_ticks_s
    ratio = (speed_ticks_s + friction) / (STANDING_TICKS_S + friction)
    return motor.brake_constant_s * float(np.log(max(ratio, 1.0)))


def check_stop(made: World, pair: tuple[MotorWorld, MotorWorld]) -> None:
    """A zero stands as soon as the brake allows, which is 0.6 s for any motor with a constant of 0.14 s or less."""
    before = sum(map(len, made.rows)) - 1
    made.drive(0.0, 0.0, 1.2)
    for motor, (speed, *_) in zip(pair, wheels(made), strict=True):
        after = np.abs(speed[before:])
        stood_s = float(np.max(np.flatnonzero(after > STANDING_TICKS_S), initial=-1) + 1) * ROW_S
        assert stood_s <= brake_s(motor, float(after[0])) + 2 * ROW_S
        assert stood_s <= STOP_S + ROW_S or motor.brake_constant_s > 0.14


@WORLDS
@given(pair=motors(), story=stories)
def test_whatever_motors_it_has_the_robot_moves_as_its_odometry_shows(
    pair: tuple[MotorWorld, MotorWorld], story: list[tuple[float, float, float, float]]
) -> None:
    with world(*pair) as made:
        for linear, angular, seconds, pause_s in story:
            made.drive(linear, angular, round(seconds, 2))
            made.drive(0.0, 0.0, pause_s)
        check_stop(made, pair)
        check_odometry(made.trace, len(story))
        assert too_fast_s(made) <= OVER_S
        assert against_ticks_s(made) <= 15.0, "a motor was driven against its wheel"
        assert made.errors == []


hands = st.tuples(st.sampled_from([LEFT, RIGHT]), st.floats(-300.0, 300.0), st.floats(0.1, 2.0))


@WORLDS
@given(pair=motors(), story=st.lists(st.tuples(drives, st.none() | hands), min_size=1, max_size=6))
def test_a_wheel_that_somebody_turned_is_driven_as_before_when_it_is_let_go(
    pair: tuple[MotorWorld, MotorWorld],
    story: list[tuple[tuple[float, float, float, float], tuple[int, float, float] | None]],
) -> None:
    """What one channel cannot see, the way a hand turns, it must not pay for afterwards."""
    with world(*pair) as made:
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
            check_stop(made, pair)
            check_odometry(made.trace, 1)
            assert too_fast_s(made) <= OVER_S
            assert against_ticks_s(made) <= 15.0


@WORLDS
@given(pair=motors(), linear=st.floats(0.08, 0.28), sense=st.sampled_from([1, -1]))
def test_whatever_motors_it_has_a_steady_speed_is_the_requested_one(
    pair: tuple[MotorWorld, MotorWorld], linear: float, sense: int
) -> None:
    """To 1 %; to 5 % where the motor cannot turn so slowly, and is driven and braked in turn."""
    with world(*pair) as made:
        made.drive(sense * linear, 0.0, 14.0)
        for speed, _, commanded, drive in wheels(made):
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
    """Sides of more than a metre with stops, turns on the spot, and some way back; in a perfect world."""
    with world() as made:
        for pause_s, angular, turn_s, later_s, back_s in sides:
            made.drive(linear, 0.0, 6.0)
            made.drive(0.0, 0.0, pause_s)
            made.drive(-linear, 0.0, back_s)
            made.drive(0.0, sense * angular, round(turn_s, 2))
            made.drive(0.0, 0.0, later_s)
        made.drive(0.0, 0.0, 1.0)
        assert error_m(made.trace) <= 0.002 * way_m(made.trace)
