"""Wrong numbers of a person are found before they are kept: slips, exchanges, and the rest in the check drive."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest

from hostlink.workbench.calibration import MeasuredRun, Measurement, RunKind, WheelGeometry, calibrated, uncorrected
from hostlink.workbench.calibration_checks import (
    TINY_END,
    complaint_of_nominal,
    complaint_of_run,
    complaint_of_runs,
    confirm,
    doubt_of_squares,
)
from tests.unit.core.robot.drives import SIDE_M, ExactRobot

NOMINAL = WheelGeometry()
BAD = WheelGeometry(0.0448, 0.0453, 0.2142)
ROBOT = ExactRobot(NOMINAL, BAD, noise_m=0.001, seed=3)
OWN = uncorrected(NOMINAL)
RUNS = ROBOT.drives()
CHECKS = [ROBOT.drives(1)[0], ROBOT.square(1), ROBOT.square(-1)]
SQUARES = (RunKind.SQUARE_CCW, RunKind.SQUARE_CW)


def with_measured(run: MeasuredRun, x_m: float, y_m: float, theta_rad: float | None = None) -> MeasuredRun:
    return dataclasses.replace(run, measured=Measurement(x_m, y_m, theta_rad))


def changed(runs: Sequence[MeasuredRun], number: int, x: float = 1.0, y: float = 1.0) -> list[MeasuredRun]:
    """The number-th square read with a factor."""
    squares = [run for run in runs if run.kind in SQUARES]
    wrong = squares[number]
    made = with_measured(wrong, wrong.measured.x_m * x, wrong.measured.y_m * y)
    return [made if run is wrong else run for run in runs]


def all_squares(runs: Sequence[MeasuredRun], x: float = 1.0, y: float = 1.0) -> list[MeasuredRun]:
    made = list(runs)
    for number in range(4):
        made = changed(made, number, x, y)
    return made


def test_an_honest_person_has_no_complaint() -> None:
    assert [complaint_of_run(run, OWN) for run in RUNS] == [""] * len(RUNS)
    assert complaint_of_runs(RUNS, NOMINAL) == ""
    confirmation = confirm(calibrated(RUNS, NOMINAL), CHECKS)
    assert confirmation.complaint == ""
    assert confirmation.after_m < confirmation.before_m / 3


@pytest.mark.parametrize(
    ("kind", "measured", "text"),
    [
        (RunKind.STRAIGHT, (30.1, 0.0, None), "30.10 m, the odometry 3.00"),
        (RunKind.STRAIGHT, (0.301, 0.0, None), "decimal slip"),
        (RunKind.STRAIGHT, (3.0, 2.3, None), "230 cm to the side"),
        (RunKind.SQUARE_CW, (-4.2, -7.0, None), "cm apart after one square"),
        (RunKind.TURNS_CCW, (0.0, 0.0, 3.1), "degrees by the mark"),
        (RunKind.TURNS_CW, (0.0, 0.0, None), "whole turn miscounted"),
    ],
)
def test_one_number_that_no_wheel_explains_is_refused_at_once(
    kind: RunKind, measured: tuple[float, float, float | None], text: str
) -> None:
    run = next(run for run in RUNS if run.kind is kind)
    assert text in complaint_of_run(with_measured(run, *measured), OWN)


def test_a_slip_in_one_of_two_squares_is_found_by_the_other() -> None:
    assert "two drives alike (square_cw)" in complaint_of_runs(changed(RUNS, 0, 0.1, 0.1), NOMINAL)


def test_a_slip_in_one_of_two_lines_is_found_by_the_other() -> None:
    line = RUNS[0]
    runs = [with_measured(line, line.measured.x_m + 0.09, line.measured.y_m), *RUNS[1:]]
    assert "two drives alike (straight)" in complaint_of_runs(runs, NOMINAL)


@pytest.mark.slow
def test_left_and_right_exchanged_in_all_squares_is_named() -> None:
    assert "left and right, or clockwise" in complaint_of_runs(all_squares(RUNS, y=-1.0), NOMINAL)


@pytest.mark.slow
def test_forward_and_sideways_exchanged_in_all_squares_is_named() -> None:
    runs = [with_measured(r, r.measured.y_m, r.measured.x_m) if r.kind in SQUARES else r for r in RUNS]
    assert "forward and sideways exchanged" in complaint_of_runs(runs, NOMINAL)


@pytest.mark.slow
def test_the_squares_of_one_way_entered_as_the_other_s_are_named() -> None:
    by_kind = {kind: [run.measured for run in RUNS if run.kind is kind] for kind in SQUARES}
    runs = []
    for run in RUNS:
        if run.kind in SQUARES:
            other = SQUARES[1 - SQUARES.index(run.kind)]
            runs.append(dataclasses.replace(run, measured=by_kind[other].pop()))
        else:
            runs.append(run)
    assert "or clockwise and counter-clockwise, exchanged" in complaint_of_runs(runs, NOMINAL)


@pytest.mark.slow
def test_squares_that_no_wheels_explain_are_refused() -> None:
    """Both ways off to the left and behind, then to the left and before: neither as entered, nor read otherwise."""
    ends = {RunKind.SQUARE_CW: (-0.6, 0.6), RunKind.SQUARE_CCW: (0.0, 0.6)}
    runs = [with_measured(run, *ends[run.kind]) if run.kind in SQUARES else run for run in RUNS]
    assert "no wheels explain these drives" in complaint_of_runs(runs, NOMINAL)


def test_a_perfect_tape_measure_needs_no_other_reading() -> None:
    assert complaint_of_runs(ExactRobot(NOMINAL, BAD).drives(1), NOMINAL) == ""


def test_turns_that_contradict_the_squares_are_refused() -> None:
    runs = [
        with_measured(run, 0.0, 0.0, (run.measured.theta_rad or 0.0) * 1.1) if "turns" in run.kind else run
        for run in RUNS
    ]
    assert "one of them was measured or entered wrong" in complaint_of_runs(runs, NOMINAL)


@pytest.mark.parametrize("factor", [10.0, 0.1, 2.54, 1 / 2.54, 100.0])
@pytest.mark.parametrize("number", range(3))
def test_a_nominal_number_in_another_unit_is_doubted(number: int, factor: float) -> None:
    values = list(NOMINAL)
    values[number] *= factor
    complaint = complaint_of_nominal(WheelGeometry(*values), NOMINAL)
    assert f"{values[number]:g} m, is" in complaint
    assert "a decimal slip, or a unit? Numbers are metres" in complaint


@pytest.mark.parametrize("share", [0.5, 0.8, 1.0, 1.3, 2.0, 3.5])
def test_nominal_numbers_of_another_robot_are_not_doubted(share: float) -> None:
    assert complaint_of_nominal(WheelGeometry(*(share * value for value in NOMINAL)), NOMINAL) == ""


def test_squares_in_metres_taken_for_centimetres_contradict_lines_and_turns() -> None:
    complaint = complaint_of_runs(all_squares(RUNS, 0.01, 0.01), NOMINAL)
    assert "as if metres were entered as centimetres" in complaint
    assert "enter the unit" in complaint


@pytest.mark.parametrize(("factor", "unit"), [(0.01, "metres"), (10.0, "millimetres"), (1 / 2.54, "inches")])
def test_a_line_in_another_unit_is_refused_with_that_unit(factor: float, unit: str) -> None:
    line = RUNS[0]
    wrong = with_measured(line, line.measured.x_m * factor, line.measured.y_m)
    assert f"was it in {unit}? Enter the unit with the number" in complaint_of_run(wrong, OWN)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_drawn_robots_with_an_honest_person_have_no_complaint(seed: int) -> None:
    random = np.random.default_rng(seed)
    size, uneven, apart = random.uniform(-0.03, 0.03), random.uniform(-0.008, 0.008), random.uniform(-0.06, 0.06)
    true = WheelGeometry(0.045 * (1 + size - uneven), 0.045 * (1 + size + uneven), 0.21 * (1 + apart))
    runs = ExactRobot(NOMINAL, true, noise_m=0.002, seed=seed).drives()
    assert [complaint_of_run(run, OWN) for run in runs] == [""] * len(runs)
    assert complaint_of_runs(runs, NOMINAL) == ""
    tiny = all_squares(runs, 0.01, 0.01)
    assert complaint_of_runs(tiny, NOMINAL) or doubt_of_squares(tiny)


@pytest.mark.parametrize(("x", "y"), [(0.1, 0.1), (-1.0, -1.0)], ids=["decimal slip", "towards the wrong side"])
def test_the_check_drive_refuses_squares_that_were_all_read_wrong(x: float, y: float) -> None:
    found = calibrated(all_squares(RUNS, x, y), NOMINAL)
    assert "does not confirm" in confirm(found, CHECKS).complaint


def test_the_check_drive_refuses_wheels_that_were_exchanged() -> None:
    """Left and right read the wrong way round in everything: wheels that explain it exist, the robot's are others."""
    mirrored = [with_measured(run, run.measured.x_m, -run.measured.y_m, run.measured.theta_rad) for run in RUNS]
    by_kind = {kind: [run.measured for run in mirrored if run.kind is kind] for kind in SQUARES}
    runs = [
        dataclasses.replace(run, measured=by_kind[SQUARES[1 - SQUARES.index(run.kind)]].pop())
        if run.kind in SQUARES
        else run
        for run in mirrored
    ]
    found = calibrated(runs, NOMINAL)
    assert found.geometry.left_radius_m > found.geometry.right_radius_m, "the wheels are exchanged"
    assert complaint_of_runs(runs, NOMINAL) == "", "no other reading is better"
    assert "does not confirm" in confirm(found, CHECKS).complaint


def test_the_check_drive_refuses_lines_that_were_all_read_wrong() -> None:
    runs = [with_measured(r, r.measured.x_m * 1.1, r.measured.y_m) if r.kind is RunKind.STRAIGHT else r for r in RUNS]
    assert "the line is" in confirm(calibrated(runs, NOMINAL), CHECKS).complaint


def test_a_robot_whose_numbers_are_right_has_nothing_to_gain() -> None:
    robot = ExactRobot(NOMINAL, NOMINAL, noise_m=0.001)
    found = calibrated(robot.drives(), NOMINAL)
    checks = [robot.drives(1)[0], robot.square(1), robot.square(-1)]
    assert "nothing to gain" in confirm(found, checks).complaint


def test_wheels_that_are_both_too_large_are_a_gain_for_lines_alone() -> None:
    robot = ExactRobot(NOMINAL, WheelGeometry(0.0459, 0.0459, 0.2142), noise_m=0.0003)
    found = calibrated(robot.drives(), NOMINAL)
    assert confirm(found, [robot.drives(1)[0], robot.square(1), robot.square(-1)]).complaint == ""


def test_squares_without_turns_on_the_spot_say_nothing_of_units() -> None:
    runs = [run for run in RUNS if run.kind not in (RunKind.TURNS_CCW, RunKind.TURNS_CW)]
    assert complaint_of_runs(runs, NOMINAL) == ""


@pytest.mark.parametrize("seed", range(30))
def test_squares_of_drawn_robots_are_doubted_when_metres_are_taken_for_centimetres(seed: int) -> None:
    random = np.random.default_rng(seed)
    size, uneven, apart = random.uniform(-0.03, 0.03), random.uniform(-0.008, 0.008), random.uniform(-0.06, 0.06)
    true = WheelGeometry(0.045 * (1 + size - uneven), 0.045 * (1 + size + uneven), 0.21 * (1 + apart))
    runs = ExactRobot(NOMINAL, true, noise_m=0.002, seed=seed).drives()
    assert doubt_of_squares(all_squares(runs, 0.01, 0.01)) != ""
    off_m = max(math.hypot(*run.measured[:2]) for run in runs if run.kind in SQUARES)
    assert (doubt_of_squares(runs) == "") == (off_m > TINY_END * SIDE_M)


def test_squares_that_end_exactly_at_their_start_are_not_doubted() -> None:
    assert doubt_of_squares(all_squares(RUNS, 0.0, 0.0)) == ""
