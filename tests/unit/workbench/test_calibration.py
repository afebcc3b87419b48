"""Calibration: the wheels are found again, by both methods, with intervals that contain them."""

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.errors import HostlinkError
from hostlink.workbench.calibration import (
    MeasuredRun,
    Measurement,
    ReturnErrors,
    RunKind,
    WheelGeometry,
    calibrated,
    end_of,
    student_95,
    umbmark_angles,
    uncorrected,
)
from tests.unit.core.robot.drives import SIDE_M, ExactRobot

NOMINAL = WheelGeometry()
BAD = WheelGeometry(0.0448, 0.0453, 0.2142)

geometries = st.builds(WheelGeometry, st.floats(0.0445, 0.0455), st.floats(0.0445, 0.0455), st.floats(0.204, 0.216))


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(geometries)
def test_without_noise_both_methods_find_the_wheels(true: WheelGeometry) -> None:
    found = calibrated(ExactRobot(NOMINAL, true).drives(1), NOMINAL)
    assert found.geometry == pytest.approx(true, rel=1e-5)
    assert found.umbmark_geometry == pytest.approx(true, rel=2e-4)
    assert found.separation_by_turns_m == pytest.approx(true.separation_m, rel=1e-4)


def test_without_noise_the_square_s_error_falls_a_hundredfold() -> None:
    found = calibrated(ExactRobot(NOMINAL, BAD).drives(), NOMINAL)
    assert found.before.largest_m > 0.4
    assert found.after.largest_m < found.before.largest_m / 1000
    assert found.residual_m < 0.001


def test_a_robot_that_believes_in_other_wheels_is_calibrated_from_there() -> None:
    nominal = WheelGeometry(0.030, 0.031, 0.150)
    true = WheelGeometry(0.0303, 0.0309, 0.154)
    found = calibrated(ExactRobot(nominal, true).drives(1), nominal)
    assert found.geometry == pytest.approx(true, rel=1e-5)


@pytest.mark.slow
def test_noise_is_averaged_and_the_intervals_contain_the_truth_nearly_always() -> None:
    inside = 0
    for seed in range(12):
        found = calibrated(ExactRobot(NOMINAL, BAD, noise_m=0.002, seed=seed).drives(), NOMINAL)
        off = [abs(one - other) for one, other in zip(found.geometry, BAD, strict=True)]
        inside += sum(error <= width for error, width in zip(off, found.deviations, strict=True))
        assert found.after.largest_m < found.before.largest_m / 3
    assert 0.8 * 36 <= inside <= 36


@pytest.mark.slow
def test_headings_that_were_measured_count_too() -> None:
    robot = ExactRobot(NOMINAL, BAD)
    runs = []
    for run in robot.drives(1):
        turned_rad = end_of(run, calibrated(ExactRobot(NOMINAL, BAD).drives(1), NOMINAL).correction).theta_rad
        runs.append(dataclasses.replace(run, measured=run.measured._replace(theta_rad=turned_rad)))
    assert calibrated(runs, NOMINAL).geometry == pytest.approx(BAD, rel=1e-4)


def test_calibration_without_turns_has_no_separation_by_turns() -> None:
    runs = [run for run in ExactRobot(NOMINAL, BAD).drives(1) if "turns" not in run.kind]
    assert calibrated(runs, NOMINAL).separation_by_turns_m is None


@pytest.mark.parametrize("missing", [RunKind.STRAIGHT, RunKind.SQUARE_CW, RunKind.SQUARE_CCW])
def test_drives_that_do_not_determine_the_wheels_are_refused(missing: RunKind) -> None:
    runs = [run for run in ExactRobot(NOMINAL, BAD).drives(1) if run.kind is not missing]
    with pytest.raises(HostlinkError, match=f"needs also: {missing}"):
        calibrated(runs, NOMINAL)


def test_the_ends_without_a_correction_are_those_of_the_robot_s_odometry() -> None:
    run = ExactRobot(NOMINAL, BAD).square(1)
    end = end_of(run, uncorrected(NOMINAL))
    assert end.x_m == pytest.approx(0.0, abs=0.05)
    assert end.theta_rad == pytest.approx(2 * math.pi, abs=0.1)


def test_a_drive_without_a_motion_ends_where_it_began() -> None:
    run = MeasuredRun(RunKind.STRAIGHT, 1.0, (), Measurement(0.0, 0.0))
    assert end_of(run, uncorrected(NOMINAL)) == (0.0, 0.0, 0.0)


def test_the_angles_are_borenstein_and_feng_s() -> None:
    """A corner that turns too far and sides that bend, each alone: signs and sizes of their small-angle formulas."""
    alpha, beta = 0.01, 0.02
    corner = ReturnErrors(
        cw_m=(-2 * SIDE_M * alpha, -2 * SIDE_M * alpha), ccw_m=(-2 * SIDE_M * alpha, 2 * SIDE_M * alpha)
    )
    side = ReturnErrors(cw_m=(-2 * SIDE_M * beta, -2 * SIDE_M * beta), ccw_m=(2 * SIDE_M * beta, -2 * SIDE_M * beta))
    assert umbmark_angles(corner, SIDE_M) == pytest.approx((alpha, 0.0))
    assert umbmark_angles(side, SIDE_M) == pytest.approx((0.0, beta))


@pytest.mark.parametrize(("freedom", "t"), [(3, 3.182), (5, 2.571), (9, 2.262), (30, 2.042)])
def test_student_s_t_is_the_tables(freedom: int, t: float) -> None:
    assert student_95(freedom) == pytest.approx(t, rel=0.01)
