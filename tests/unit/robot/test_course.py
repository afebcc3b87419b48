"""CourseFollower: courses end where they should, with few commands, whatever the robot believes."""

import itertools
import math

import pytest

from hostlink.robot.calibration import Kind, WheelGeometry, end_of, uncorrected
from hostlink.robot.course import CourseFollower, Leg, Speed, square, straight, turns
from hostlink.robot.kinematics import DifferentialDrive, Pose
from tests.unit.robot.drives import ExactRobot

NOMINAL = WheelGeometry()


@pytest.mark.parametrize(
    ("kind", "legs", "end"),
    [
        (Kind.STRAIGHT, straight(3.0), (3.0, 0.0, 0.0)),
        (Kind.TURNS_CCW, turns(3, 1), (0.0, 0.0, 6 * math.pi)),
        (Kind.TURNS_CW, turns(3, -1), (0.0, 0.0, -6 * math.pi)),
        (Kind.SQUARE_CCW, square(2.0, 1), (0.0, 0.0, 2 * math.pi)),
        (Kind.SQUARE_CW, square(2.0, -1), (0.0, 0.0, -2 * math.pi)),
    ],
)
def test_a_course_ends_where_it_should_by_the_odometry(
    kind: Kind, legs: tuple[Leg, ...], end: tuple[float, float, float]
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
        left_m, right_m = (speed * 0.1 for speed in drive.wheel_speeds(linear, angular))
        pose = drive.integrate(pose, left_m, right_m * 1.02)
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
        pose = drive.integrate(pose, *(speed * 0.1 for speed in drive.wheel_speeds(*commands[-1])))
        now_s += 0.1
        assert now_s < 60.0
    changes = sum(one != other for one, other in itertools.pairwise(commands))
    assert changes <= 8 * 6


def test_the_speeds_are_those_that_were_given() -> None:
    assert CourseFollower(straight(3.0), Speed(0.4, 1.0)).update(Pose(), 0.0) == (0.4, 0.0)
    assert CourseFollower(turns(1, -1), Speed(0.4, 1.0)).update(Pose(), 0.0) == (0.0, -1.0)


def test_a_course_without_legs_is_done() -> None:
    follower = CourseFollower(())
    assert (follower.is_done, follower.legs_left) == (True, 0)
    assert follower.update(Pose(), 0.0) == (0.0, 0.0)
