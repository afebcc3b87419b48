"""OdometryCorrection, and the estimator with one: a robot that believes in other wheels is shown where it truly is."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.kinematics import DifferentialDrive, Pose, wrap_angle
from hostlink.core.robot.odometry import OdometryCorrection, OdometryEstimator, OdometrySnapshot, wheel_way
from hostlink.core.robot.velocity import PlanarVelocity

PERIOD_S = 0.1
CORRECTION = OdometryCorrection(1.01, 0.98, 0.21, 0.22)
BELIEVED, TRUE = DifferentialDrive(wheel_separation_m=0.21), DifferentialDrive(wheel_separation_m=0.22)

factors = st.floats(0.9, 1.1)
ways_m = st.floats(-0.1, 0.1)


def rolled(speeds: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """(as believed, in truth) of the wheels at this velocity, in a period."""
    believed = [speed * PERIOD_S for speed in BELIEVED.wheel_speeds(PlanarVelocity(speeds[0], yaw_rad_s=speeds[1]))]
    return (believed[0], believed[1]), (believed[0] * CORRECTION.left_factor, believed[1] * CORRECTION.right_factor)


@given(factors, factors, st.floats(0.1, 0.3), st.floats(0.1, 0.3), st.lists(st.tuples(ways_m, ways_m), max_size=20))
def test_the_true_way_is_found_for_any_wheels(
    left: float, right: float, nominal_m: float, true_m: float, ways: list[tuple[float, float]]
) -> None:
    correction = OdometryCorrection(left, right, nominal_m, true_m)
    believed, true = DifferentialDrive(wheel_separation_m=nominal_m), DifferentialDrive(wheel_separation_m=true_m)
    odometry = truth = shown = Pose(1.0, -2.0, 3.0)
    for left_m, right_m in ways:
        before, odometry = odometry, believed.integrate(odometry, (left_m, right_m))
        truth = true.integrate(truth, (left_m * left, right_m * right))
        shown = correction.advance(shown, before, odometry)
        assert shown[:2] == pytest.approx(truth[:2], abs=1e-9)
        assert wrap_angle(shown.theta_rad - truth.theta_rad) == pytest.approx(0.0, abs=1e-9)


@given(ways_m, ways_m)
def test_wheels_that_are_believed_rightly_change_nothing(left_m: float, right_m: float) -> None:
    before = Pose(0.5, 0.5, -3.1)
    after = BELIEVED.integrate(before, (left_m, right_m))
    shown = OdometryCorrection().advance(before, before, after)
    assert shown[:2] == pytest.approx(after[:2], abs=1e-12)
    assert wrap_angle(shown.theta_rad - after.theta_rad) == pytest.approx(0.0, abs=1e-12)


def test_motion_that_does_not_fit_an_arc_is_kept() -> None:
    way = wheel_way(Pose(), Pose(0.1, 0.02, 0.0), 0.2)
    assert way == pytest.approx((0.1, 0.1, 0.02))
    assert OdometryCorrection(1.1, 1.1).advance(Pose(), Pose(), Pose(0.1, 0.02, 0.0)) == pytest.approx(
        (0.11, 0.02, 0.0)
    )


def snapshot_of(estimator: OdometryEstimator) -> OdometrySnapshot:
    snapshot = estimator.snapshot(0.0)
    assert snapshot is not None
    return snapshot


def is_at(estimator: OdometryEstimator, pose: Pose) -> bool:
    here = snapshot_of(estimator).pose
    return math.dist(here[:2], pose[:2]) < 1e-9 and abs(wrap_angle(here.theta_rad - pose.theta_rad)) < 1e-9


events = st.tuples(
    st.sampled_from(["drive", "leap over", "restart", "reset", "lost"]), st.floats(-0.5, 0.5), st.floats(-2, 2)
)


@given(st.lists(events, max_size=40))
def test_the_estimator_shows_the_truth_over_restarts_resets_and_cuts(history: list[tuple[str, float, float]]) -> None:
    estimator, reported, truth, now_s = OdometryEstimator(correction=CORRECTION), Pose(), Pose(), 0.0
    estimator.update(reported, now_s=now_s, wall_ns=0)
    for event, linear_m_s, angular_rad_s in history:
        if event == "restart" and (math.hypot(*reported[:2]) > 0.1 or abs(reported.theta_rad) > 0.3):
            reported = Pose()
        elif event == "reset":
            estimator.expect_reset(now_s)
            reported = truth = Pose()
        elif event == "lost":
            now_s += 8.0
        elif event == "drive":
            believed, true = rolled((linear_m_s, angular_rad_s))
            reported, truth = BELIEVED.integrate(reported, believed), TRUE.integrate(truth, true)
        elif event == "leap over":  # damage: it is not believed
            estimator.update(Pose(300.0, 4.0, 0.0), now_s=now_s + PERIOD_S / 2, wall_ns=0)
        now_s += PERIOD_S
        estimator.update(reported, now_s=now_s, wall_ns=0)
        assert is_at(estimator, truth)


def test_motion_reported_by_the_device_is_corrected() -> None:
    estimator = OdometryEstimator(correction=CORRECTION)
    estimator.update(Pose(), now_s=0.0, wall_ns=0, twist=PlanarVelocity(0.2, 0.1, 0.5))
    (_, true) = rolled((0.2, 0.5))
    forward_m_s = (true[0] + true[1]) / 2 / PERIOD_S
    yaw_rad_s = (true[1] - true[0]) / TRUE.wheel_separation_m / PERIOD_S
    assert snapshot_of(estimator).twist == pytest.approx(PlanarVelocity(forward_m_s, 0.1, yaw_rad_s))


def test_the_motion_that_follows_from_the_poses_is_the_true_one() -> None:
    estimator, reported = OdometryEstimator(correction=CORRECTION), Pose()
    for number in range(10):
        estimator.update(reported, now_s=number * PERIOD_S, wall_ns=number)
        reported = BELIEVED.integrate(reported, rolled((0.2, 0.5))[0])
    true = CORRECTION.velocity(PlanarVelocity(0.2, yaw_rad_s=0.5))
    assert snapshot_of(estimator).twist == pytest.approx(true, rel=1e-6, abs=1e-9)


def test_a_device_that_restarts_begins_again_where_that_is_configured() -> None:
    estimator = OdometryEstimator(correction=CORRECTION, continues=False)
    for number in range(10):
        estimator.update(Pose(0.05 * number, 0.0, 0.0), now_s=number * PERIOD_S, wall_ns=number)
    estimator.update(Pose(), now_s=1.0, wall_ns=10)
    assert snapshot_of(estimator).pose == Pose()
