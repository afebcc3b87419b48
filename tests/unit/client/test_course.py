"""CourseFollower: courses end at their ends, with few commands, also with wrong odometry."""

import itertools
import math

import pytest

from hostlink.client.course import SETTLE_S, STUCK_S, CourseFollower, Leg, Speed, square, straight, turns
from hostlink.core.robot.kinematics import DifferentialDrive, Pose
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.workbench.calibration import RunKind, WheelGeometry, end_of, uncorrected
from tests.unit.core.robot.drives import ExactRobot

NOMINAL = WheelGeometry()


@pytest.mark.parametrize(
    ("kind", "legs", "end"),
    [
        (RunKind.STRAIGHT, straight(3.0), (3.0, 0.0, 0.0)),
        (RunKind.TURNS_CCW, turns(3, 1), (0.0, 0.0, 6 * math.pi)),
        (RunKind.TURNS_CW, turns(3, -1), (0.0, 0.0, -6 * math.pi)),
        (RunKind.SQUARE_CCW, square(2.0, 1), (0.0, 0.0, 2 * math.pi)),
        (RunKind.SQUARE_CW, square(2.0, -1), (0.0, 0.0, -2 * math.pi)),
    ],
)
def test_a_course_ends_where_it_should_by_the_odometry(
    kind: RunKind, legs: tuple[Leg, ...], end: tuple[float, float, float]
) -> None:
    run = ExactRobot(NOMINAL, NOMINAL).drive(kind, legs, 1.0)
    at = end_of(run, uncorrected(NOMINAL))
    assert at[:2] == pytest.approx(end[:2], abs=0.04)
    assert at.theta_rad == pytest.approx(end[2], abs=0.06)


def test_a_robot_that_draws_to_one_side_is_led_back_to_the_line() -> None:
    drive, pose, follower, now_s = DifferentialDrive(), Pose(), CourseFollower(straight(3.0)), 0.0
    farthest_m = 0.0
    while not follower.is_done:
        linear, angular = follower.update(pose, now_s)
        left_m, right_m = (speed * 0.1 for speed in drive.wheel_speeds(PlanarVelocity(linear, 0.0, angular)))
        pose = drive.integrate(pose, (left_m, right_m * 1.02))
        farthest_m, now_s = max(farthest_m, abs(pose.y_m)), now_s + 0.1
        assert now_s < 60.0
    assert farthest_m < 0.05
    assert pose.x_m == pytest.approx(3.0, abs=0.03)


def test_the_command_changes_rarely() -> None:
    """A robot that ramps to each new command would stand still under one for each pose."""
    follower, pose, drive, now_s = CourseFollower(square(1.0, 1)), Pose(), DifferentialDrive(), 0.0
    commands = []
    while not follower.is_done:
        commands.append(follower.update(pose, now_s))
        pose = drive.integrate(
            pose,
            [speed * 0.1 for speed in drive.wheel_speeds(PlanarVelocity(commands[-1][0], 0.0, commands[-1][1]))],
        )
        now_s += 0.1
        assert now_s < 60.0
    changes = sum(one != other for one, other in itertools.pairwise(commands))
    assert changes <= 8 * 6


@pytest.mark.parametrize("heading_rad", [-0.1, -0.0333, 0.0, 0.0333, 0.1])
def test_a_tick_more_or_less_changes_no_command(heading_rad: float) -> None:
    """A robot at rest at the boundary of two commands would never start."""
    follower = CourseFollower(straight(3.0))
    follower.update(Pose(), 0.0)
    commands = {follower.update(Pose(0.0, 0.0, heading_rad + 0.003 * (turn % 2)), 0.1 * turn) for turn in range(1, 11)}
    assert len(commands) == 1


def test_the_speeds_are_those_that_were_given() -> None:
    assert CourseFollower(straight(3.0), Speed(0.4, 1.0)).update(Pose(), 0.0) == (0.4, 0.0)
    assert CourseFollower(turns(1, -1), Speed(0.4, 1.0)).update(Pose(), 0.0) == (0.0, -1.0)


def test_a_course_without_legs_is_done() -> None:
    follower = CourseFollower(())
    assert (follower.is_done, follower.legs_left) == (True, 0)
    assert follower.update(Pose(), 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("way", [0.0, -1.0], ids=["stands", "goes back"])
@pytest.mark.parametrize("legs", [straight(3.0), turns(1, 1), turns(1, -1)], ids=["line", "left turn", "right turn"])
def test_a_robot_whose_odometry_does_not_advance_is_driven_no_more(legs: tuple[Leg, ...], way: float) -> None:
    """The wheels may turn although the odometry does not: a dead encoder, or a motor with exchanged wires."""
    follower, now_s, at = CourseFollower(legs), 0.0, 0.0
    while follower.update(Pose(at, 0.0, at), now_s) != (0.0, 0.0):
        assert now_s <= STUCK_S
        at += way * math.copysign(0.02, legs[0].forward_m or legs[0].turn_rad)
        now_s += 0.1
    assert follower.is_stuck
    assert not follower.is_done
    assert follower.update(Pose(1.0, 0.0, 0.0), now_s + 0.1) == (0.0, 0.0)


def test_each_leg_has_the_time_for_its_own_start() -> None:
    follower, now_s = CourseFollower((Leg(forward_m=0.1), Leg(forward_m=0.1))), 0.0
    for x_m in (0.0, 0.1, 0.1, 0.2):
        now_s += 0.9 * STUCK_S
        follower.update(Pose(x_m), now_s)
    assert not follower.is_stuck


def test_two_poses_of_one_time_are_followed_as_one() -> None:
    once, twice = CourseFollower(straight(1.0)), CourseFollower(straight(1.0))
    for now_s, x_m in ((0.0, 0.0), (0.1, 0.01), (0.2, 0.03)):
        twice.update(Pose(x_m, 0.0, 0.0), now_s)
        assert once.update(Pose(x_m, 0.0, 0.0), now_s) == twice.update(Pose(x_m, 0.0, 0.0), now_s)


def test_course_settles_after_its_end_and_is_done_then() -> None:
    follower = CourseFollower(straight(0.1))
    follower.update(Pose(), 0.0)
    assert not follower.is_settling
    assert follower.update(Pose(0.1, 0.0, 0.0), 1.0) == (0.0, 0.0)
    assert (follower.is_settling, follower.is_done) == (True, False)
    follower.update(Pose(0.1, 0.0, 0.0), 1.0 + SETTLE_S)
    assert (follower.is_settling, follower.is_done) == (False, True)


def end_of_leg(leg: Leg, lag_s: float, phase_s: float, speed: Speed, interval_s: float = 0.1) -> float:
    """Drive one leg with a robot that obeys each command `lag_s` later. Return its place at the end, m or rad."""
    follower, at, step_s = CourseFollower((leg,), speed), 0.0, 0.005
    commands, turn = [(0.0, 0.0)], 0
    while not follower.is_done:
        now_s = turn * step_s
        if turn % round(interval_s / step_s) == round(phase_s / step_s):
            pose = Pose(0.0, 0.0, math.remainder(at, math.tau)) if leg.turn_rad else Pose(at, 0.0, 0.0)
            commands.append((now_s + lag_s, sum(follower.update(pose, now_s))))
        at += [velocity for from_s, velocity in commands if from_s <= now_s][-1] * step_s
        turn += 1
        assert now_s < 60.0
    return at


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.12, 0.3])
@pytest.mark.parametrize(
    ("way", "speed", "most", "mean"),
    [
        (Leg(turn_rad=1.0), Speed(), 0.02, 0.006),
        (Leg(turn_rad=-1.0), Speed(), 0.02, 0.006),
        (Leg(forward_m=1.0), Speed(), 0.011, 0.005),
        (Leg(forward_m=1.0), Speed(linear_m_s=0.04), 0.011, 0.005),
    ],
    ids=["left turn", "right turn", "line", "slow line"],
)
def test_robot_stops_as_often_before_the_end_as_behind_it(
    lag_s: float, way: Leg, speed: Speed, most: float, mean: float
) -> None:
    errors = []
    for size, phase_s in itertools.product((0.3, 0.31, 0.327, 0.5, 0.513, 1.0, 1.57), (0.0, 0.03, 0.07)):
        leg = Leg(way.forward_m * size, way.turn_rad * size)
        errors.append(end_of_leg(leg, lag_s, phase_s, speed) - leg.forward_m - leg.turn_rad)
    assert max(map(abs, errors)) < most
    assert abs(sum(errors) / len(errors)) < mean


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [0.0, 0.02, 0.05, 0.12])
@pytest.mark.parametrize("interval_s", [0.1, 0.05, 0.035, 0.02])
@pytest.mark.parametrize(
    ("way", "slow", "close"),
    [(Leg(turn_rad=1.0), 0.3, 0.003), (Leg(forward_m=1.0), 0.08, 0.001)],  # rad/s and rad, m/s and m
    ids=["turn", "line"],
)
def test_robot_ends_a_leg_within_half_a_pose_whether_it_obeys_at_once_or_late(
    lag_s: float, interval_s: float, way: Leg, slow: float, close: float
) -> None:
    """A robot that obeys at once fell short by 3 to 6 mm, and by 13 mrad, at each rate of its poses."""
    for size, phase_s in itertools.product((0.1, 0.3, 0.327, 1.0, 1.57), (0.0, 0.01, 0.015)):
        leg = Leg(way.forward_m * size, way.turn_rad * size)
        left = end_of_leg(leg, lag_s, phase_s, Speed(), interval_s) - leg.forward_m - leg.turn_rad
        assert abs(left) < 1.1 * (close + slow * interval_s / 2)  # the clock of the test has steps of 5 ms


def test_robot_that_is_stuck_on_the_rest_of_a_leg_has_arrived() -> None:
    follower, commands = CourseFollower(straight(0.3)), []
    for turn in range(200):
        x_m = 0.28 if follower.is_settling else min(0.02 * turn, 0.3)  # it slips back when it has arrived
        commands.append(follower.update(Pose(x_m), 0.1 * turn))
    assert (follower.is_done, follower.is_stuck) == (True, False)
    assert commands[-1] == (0.0, 0.0)
    assert sum(one == (0.0, 0.0) != other for one, other in itertools.pairwise(commands)) == 1  # it drove the rest once
