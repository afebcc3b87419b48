"""The Due's firmware in drawn worlds: its motors are found from plot_data, and the gains make it faster."""

import math

import numpy as np
import pytest

from hostlink.cli.step import PAPER_GAINS, make_stage
from hostlink.workbench.lab.robots import FILTER, FULL_PWM, LOOP_S
from hostlink.workbench.motor_model import simc_gains
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import Feedback
from hostlink.workbench.step_response import step_figures
from tools.compare_gains import PAPER, SEPARATION_M, SIDES, Gains, compare, drawn_world, drive, identify, rows

FILTER_S = -LOOP_S / math.log(1 - FILTER)  # time constant of the firmware's filter: 0.32 s
LATE_S = 0.1  # the most that the turns of its loop add
COASTS = 0.2  # share of the time with a PWM below the one for the wheel's speed: it coasts then, more slowly
SPEEDS_M_S = (0.1, 0.2, 0.3)

FEW_SEEDS = [1, 2, 3]  # of drawn worlds; the tests marked long have more


def true_gain(world: WorldParameters, side: str) -> float:
    """Ticks/s for each count of PWM, above the dead zone."""
    driven_pwm = FULL_PWM if world[f"{side}.has_jump"] else FULL_PWM - world[f"{side}.dead_zone_pwm"]
    full_speed_ticks_s = world[f"{side}.full_speed_rad_s"] * world[f"{side}.ticks_per_turn"] / math.tau
    return full_speed_ticks_s / driven_pwm * world["battery_v"] / world["rated_v"]


@pytest.mark.parametrize("seed", FEW_SEEDS + [pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 13)])
def test_motors_of_drawn_worlds_are_found(seed: int) -> None:
    world = drawn_world(seed)
    for side, model in identify(world).items():
        assert model.gain == pytest.approx(true_gain(world, side), rel=0.06), side
        late_s = model.time_constant_s + model.dead_time_s - world[f"{side}.rise_constant_s"] - FILTER_S
        assert 0 < late_s < LATE_S + COASTS * world[f"{side}.coast_constant_s"], side
        assert model.explained > 0.995, side


@pytest.mark.parametrize("seed", FEW_SEEDS + [pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 7)])
def test_tuned_gains_follow_the_set_point_better_than_table_1_and_do_not_swing(seed: int) -> None:
    world = drawn_world(seed)
    tuned = {side: simc_gains(model) for side, model in identify(world).items()}
    for speed_m_s in SPEEDS_M_S:
        step = [make_stage(speed_m_s, 6.0, None, SEPARATION_M)]
        before, after = drive(world, PAPER_GAINS, step), drive(world, tuned, step)
        for side in SIDES:
            old, new = step_figures(before.records[side]), step_figures(after.records[side])
            assert new.tracking_error < 0.95 * old.tracking_error
            assert abs(new.steady_error_percent) < 1
            assert new.settling_s is not None
            assert old.settling_s is not None
            assert new.settling_s <= old.settling_s


def tuned_worlds(count: int) -> list[tuple[WorldParameters, Gains]]:
    """Return the first robots of docs/gains-measured.md#how-far-the-true-speed-overshoots, each with its own gains."""
    worlds = [drawn_world(seed) for seed in range(1, count + 1)]
    return [(world, {side: simc_gains(model) for side, model in identify(world).items()}) for world in worlds]


@pytest.fixture(scope="module")
def hundred_worlds() -> list[tuple[WorldParameters, Gains]]:
    return tuned_worlds(100)


def overshoots_percent(worlds: list[tuple[WorldParameters, Gains]], speed_m_s: float) -> list[float]:
    step = [make_stage(speed_m_s, 6.0, None, SEPARATION_M)]
    return [percent for world, gains in worlds for percent in drive(world, gains, step).overshoots_percent.values()]


MEDIAN_AND_WORST_PERCENT = {0.1: (3.0, 9.5), 0.2: (0.2, 1.7), 0.3: (0.1, 0.5)}  # by speed, of a hundred robots


@pytest.mark.long
@pytest.mark.timeout(600)  # a minute and a half on a quiet machine
@pytest.mark.parametrize("speed_m_s", SPEEDS_M_S)
def test_true_speed_of_a_hundred_tuned_robots_overshoots_as_the_document_says(
    hundred_worlds: list[tuple[WorldParameters, Gains]], speed_m_s: float
) -> None:
    median_percent, worst_percent = MEDIAN_AND_WORST_PERCENT[speed_m_s]
    found = overshoots_percent(hundred_worlds, speed_m_s)
    assert np.median(found) <= median_percent
    assert max(found) <= worst_percent


@pytest.mark.long
@pytest.mark.timeout(600)  # a minute and a half on a quiet machine
@pytest.mark.parametrize("speed_m_s", SPEEDS_M_S)
def test_true_speed_of_a_hundred_robots_with_table_1_overshoots_by_at_most_one_percent(
    hundred_worlds: list[tuple[WorldParameters, Gains]], speed_m_s: float
) -> None:
    assert max(overshoots_percent([(world, PAPER_GAINS) for world, _ in hundred_worlds], speed_m_s)) <= 1.0


def test_true_speed_of_three_of_the_hundred_robots_overshoots_by_at_most_the_worst() -> None:
    worlds = tuned_worlds(3)
    for speed_m_s, (_, worst_percent) in MEDIAN_AND_WORST_PERCENT.items():
        assert max(overshoots_percent(worlds, speed_m_s)) <= worst_percent
    assert max(overshoots_percent([(world, PAPER_GAINS) for world, _ in worlds], 0.1)) <= 1.0


def test_backwards_the_same_motor_is_found() -> None:
    forwards, backwards = identify(PAPER, 0.2), identify(PAPER, -0.2)
    for side in SIDES:
        assert backwards[side].gain == pytest.approx(forwards[side].gain, rel=0.02)


def test_the_paper_s_feedback_stays_five_percent_low() -> None:
    step = [make_stage(0.2, 6.0, None, SEPARATION_M)]
    paper = step_figures(drive(PAPER, PAPER_GAINS, step, feedback=Feedback.PAPER).records["left"])
    ours = step_figures(drive(PAPER, PAPER_GAINS, step).records["left"])
    assert paper.steady_error_percent == pytest.approx(-5.4, abs=0.5)
    assert abs(ours.steady_error_percent) < 1.0


def test_the_table_has_a_row_for_each_way_and_speed() -> None:
    lines = list(rows(compare([PAPER], [0.2])))
    assert len(lines) == 5
    assert all(line.count("|") == 9 for line in lines)
    assert "never" not in lines[-1]
