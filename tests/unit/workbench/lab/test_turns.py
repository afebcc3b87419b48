"""Errors that turns and legs alone can cause, and those that the paper's tables need."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.workbench.lab.experiment import BACK, SQUARE_LEFT, SQUARE_RIGHT
from hostlink.workbench.lab.reports import apart
from hostlink.workbench.lab.turns import (
    TurnErrors,
    best_turns,
    chance_of_table_2,
    errors_cm,
    needed_radius,
    needed_twists,
)

STEADY = np.zeros((1, 3))
small_rad = st.floats(-0.03, 0.03)


@given(twist_rad=small_rad)
def test_equal_turn_errors_move_a_square_as_far_along_x_as_along_y(twist_rad: float) -> None:
    for pattern in (SQUARE_LEFT, SQUARE_RIGHT):
        x_cm, y_cm = np.abs(errors_cm(pattern, TurnErrors(mean_rad=twist_rad), STEADY))[0]
        assert x_cm == pytest.approx(400 * abs(twist_rad), rel=0.1, abs=1e-9)
        assert y_cm == pytest.approx(x_cm, rel=0.1, abs=1e-9)


@given(loss_m=st.floats(-0.3, 0.3))
def test_a_loss_after_each_turn_moves_a_square_along_x_alone(loss_m: float) -> None:
    errors = errors_cm(SQUARE_LEFT, TurnErrors(mean_rad=0.0, loss_m=loss_m), STEADY)[0]
    assert errors == pytest.approx([-100 * loss_m, 0.0], abs=1e-9)


@given(twist_rad=small_rad)
def test_a_turn_error_moves_there_and_back_sideways(twist_rad: float) -> None:
    x_cm, y_cm = np.abs(errors_cm(BACK, TurnErrors(mean_rad=twist_rad), STEADY))[0]
    assert y_cm == pytest.approx(384 * abs(twist_rad), rel=1e-3, abs=1e-9)
    assert x_cm < 0.2


def test_table_4_needs_a_radius_that_is_half_a_per_cent_larger() -> None:
    needed = needed_radius()
    assert needed.low < 0.005 < needed.high
    assert needed.low > 0.0


def test_the_two_columns_of_table_2_need_turns_that_no_one_robot_has() -> None:
    needed = needed_twists()
    assert ("table 2, x", "table 2, y") in apart(needed)
    assert ("table 3, x", "table 3, y") not in apart(needed)
    assert needed[-1].what == "table 5, y"
    assert needed[-1].mean == pytest.approx(0.019, abs=0.001)


def test_no_turn_errors_give_three_runs_like_table_2() -> None:
    chance, _ = chance_of_table_2(draws=2000)
    assert 0.0 < chance < 1e-3


def test_the_best_turn_errors_for_all_tables_are_unlikely_ones() -> None:
    found = best_turns(has_loss=False, draws=1000)
    assert found.p_value < 0.1
    assert found.means_cm[1] > 10.0  # of table 2's 3 cm
