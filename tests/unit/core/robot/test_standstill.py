"""Standstill of a robot after a stop, and motion of a driven robot."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.standstill import (
    LONGEST_ANSWER_S,
    NO_ODOMETRY,
    PATIENCE_S,
    STEADY_S,
    DriveWatch,
    Speeds,
    Standstill,
    StandstillState,
    StopWatch,
    sentence,
)

STILL, MOVING = Speeds(0.0, 0.001), Speeds(0.15, 0.3)
AT_REST_BY_COUNTS, MOVING_BY_COUNTS = Speeds(is_moving=False), Speeds(is_moving=True)
AT_REST, MOVES, UNKNOWN = StandstillState.STOPPED, StandstillState.MOVING, StandstillState.UNKNOWN


def after(*poses: tuple[float, Speeds]) -> Standstill:
    """Measurement after a stop at 10 s, with odometry received at these times."""
    watch = StopWatch(10.0)
    for received_s, speeds in poses:
        watch.observe(speeds, received_s)
    return watch.result(lambda: "driven by client 3", lambda: "its device is not connected")


def test_a_robot_stands_since_the_first_of_the_poses_that_stand_still() -> None:
    measured = after((10.1, MOVING), (10.2, MOVING), (10.3, STILL), (10.4, STILL))
    assert (measured.state, measured.reason) == (AT_REST, "")
    assert measured.after_s == pytest.approx(0.3)


def test_a_robot_that_moves_has_its_newest_speed_and_the_reason() -> None:
    measured = after((10.1, STILL), (10.2, STILL), (10.3, MOVING))
    assert measured == Standstill(MOVES, 0.15, 0.3, None, "driven by client 3")


def test_counts_that_tell_no_speed_tell_whether_the_robot_stands() -> None:
    measured = after((10.1, MOVING_BY_COUNTS), (10.2, AT_REST_BY_COUNTS), (10.3, AT_REST_BY_COUNTS))
    assert (measured.state, measured.speed_m_s, measured.after_s) == (AT_REST, None, pytest.approx(0.2))
    measured = after((10.1, AT_REST_BY_COUNTS), (10.2, AT_REST_BY_COUNTS), (10.3, MOVING_BY_COUNTS))
    assert measured == Standstill(MOVES, reason="driven by client 3")
    assert "its odometry does not change" in warning_after(PATIENCE_S, AT_REST_BY_COUNTS)
    assert warning_after(PATIENCE_S, MOVING_BY_COUNTS) == ""


@pytest.mark.parametrize("poses", [(), ((9.9, STILL), (10.0, STILL)), ((9.9, MOVING),)])
def test_odometry_from_before_the_stop_tells_nothing(poses: tuple[tuple[float, Speeds], ...]) -> None:
    assert after(*poses) == Standstill(UNKNOWN, reason="its device is not connected")


def test_odometry_that_left_the_device_before_it_could_have_the_stop_tells_nothing() -> None:
    watch = StopWatch(10.0, 0.3)
    for received_s, speeds in ((10.1, STILL), (10.2, STILL), (10.3, STILL), (10.35, MOVING)):
        watch.observe(speeds, received_s)
        assert not watch.is_standing
    watch.observe(STILL, 10.4)
    watch.observe(STILL, 10.5)
    assert watch.result(str, str).after_s == pytest.approx(0.4)


def test_answer_that_a_booting_device_took_seconds_for_delays_no_measurement_for_longer() -> None:
    watch = StopWatch(10.0, 4.0)
    watch.observe(STILL, 10.0 + LONGEST_ANSWER_S + 0.1)
    watch.observe(STILL, 10.0 + LONGEST_ANSWER_S + 0.2)
    assert watch.is_standing


def test_one_pose_that_stands_still_is_not_enough_a_robot_that_reverses_has_one() -> None:
    assert after((10.1, MOVING), (10.2, STILL)).state is UNKNOWN
    assert after((10.1, MOVING), (10.2, STILL), (10.2, STILL)).state is UNKNOWN  # the same one, read again
    assert after((10.1, MOVING), (10.2, STILL), (10.3, Speeds(-0.1, 0.0))).state is MOVES


@given(st.lists(st.tuples(st.floats(9.0, 12.0), st.sampled_from([STILL, MOVING, Speeds(0.0, 0.5)])), max_size=12))
def test_no_robot_is_said_to_stand_whose_newest_pose_since_the_stop_moves(poses: list[tuple[float, Speeds]]) -> None:
    poses.sort(key=lambda pose: pose[0])
    measured = after(*poses)
    since = {received_s: speeds for received_s, speeds in reversed(poses) if received_s > 10.0}
    if measured.state is not AT_REST:
        return
    newest_s = max(since)
    assert since[newest_s].are_still
    assert min(received_s for received_s in since) <= newest_s - STEADY_S


@pytest.mark.parametrize(
    ("measured", "text"),
    [
        (Standstill(AT_REST, 0.001, 0.0, 0.42), "robot_0 is stopped (0.00 m/s after 0.4 s)"),
        (Standstill(MOVES, -0.15, 0.3, reason="driven by demo"), "robot_0 still moves at 0.15 m/s: driven by demo"),
        (Standstill(MOVES, 0.001, -0.3, reason="driven by demo"), "robot_0 still turns at 0.30 rad/s: driven by demo"),
        (Standstill(UNKNOWN, reason="it sends no odometry"),
         "robot_0: it is not known whether it is stopped: it sends no odometry"),
        (Standstill(UNKNOWN, reason=NO_ODOMETRY),
         "zero sent; robot_0 has no odometry, so nobody can say that it is stopped"),
        (Standstill(AT_REST, after_s=0.42), "robot_0 is stopped (after 0.4 s)"),
        (Standstill(MOVES, reason="driven by demo"), "robot_0 still moves: driven by demo"),
    ],
)  # fmt: skip
def test_the_sentence_has_the_numbers_that_were_measured(measured: Standstill, text: str) -> None:
    assert sentence("robot_0", measured) == text


def warning_after(seconds: float, *measured: Speeds | None, commanded: Speeds = MOVING, age_s: float = 0.1) -> str:
    watch = DriveWatch()
    for number in range(round(seconds / 0.2) + 1):
        watch.observe(commanded, measured[min(number, len(measured) - 1)], number * 0.2, age_s=age_s)
    return watch.warning


def test_a_driven_robot_whose_odometry_stands_still_is_warned_of_after_a_second() -> None:
    assert warning_after(PATIENCE_S - 0.2, STILL) == ""
    assert "its odometry does not change" in warning_after(PATIENCE_S, STILL)


def test_odometry_that_is_old_or_missing_is_another_warning() -> None:
    assert "sends no odometry" in warning_after(2.0, MOVING, age_s=3.0)
    assert "sends no odometry" in warning_after(2.0, None)


def test_a_robot_that_moves_or_is_not_driven_is_not_warned_of() -> None:
    assert warning_after(5.0, MOVING) == ""
    assert warning_after(5.0, STILL, commanded=Speeds(0.0, 0.0)) == ""
    assert warning_after(5.0, *[STILL] * 10, MOVING) == ""
