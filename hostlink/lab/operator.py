"""The operator: drives a robot from mark to mark as the paper's authors did, with a keyboard and his eyes. Pure.

Each movement is completed before the next one: turn on the spot until the robot points to the next mark, stand, drive
straight, stand. Nobody steers on the way. He knows by practice how far the robot rolls on after he lets go of the key,
and how far the caster turns it afterwards.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from hostlink.lab.patterns import Pattern
from hostlink.lab.random_numbers import RandomNumbers
from hostlink.lab.robots import LabRobot
from hostlink.robot.kinematics import Pose, wrap_angle

POLL_S = 0.1
_LEAST_POLL_S = 0.01
_SETTLED_S = 1.5  # after it stands: the paper's filter follows
_MOST_STOP_S = 15.0  # for a stop; then the operator goes on
_MOST_LEG_S = 120.0
_STREAM = 9  # of the operator's random numbers
_STANDING_M = 1e-5  # moved in a poll
_REHEARSED_S = 8.0  # long enough for any set-point to be reached


@dataclass(frozen=True, slots=True, kw_only=True)
class Habits:
    """How he drives."""

    linear_m_s: float = 0.245  # 200 ticks/s: the minimum-jerk stop of 3.6 s
    angular_rad_s: float = 0.6  # where the paper's teleoperation begins
    mark_noise_m: float = 0.01  # standard deviation of where he stops
    aim_noise_rad: float = 0.02  # and of where he points
    push_m: float = 0.0  # sideways, by his foot, after the first leg


class PoseSample(NamedTuple):
    """Where the robot was and where it believed to be."""

    truth: Pose
    odometry: Pose


@dataclass(frozen=True, slots=True)
class Run:
    """A pattern that was driven."""

    pattern: Pattern
    samples: list[PoseSample] = field(repr=False)

    @property
    def error_cm(self) -> tuple[float, float]:
        """Odometry less truth at the end, x and y."""
        truth, odometry = self.samples[-1]
        return (odometry.x_m - truth.x_m) * 100, (odometry.y_m - truth.y_m) * 100

    @property
    def length_error_cm(self) -> float:
        """The same for the distance from the start, as the paper measured its lines."""
        truth, odometry = self.samples[-1]
        return (math.hypot(odometry.x_m, odometry.y_m) - math.hypot(truth.x_m, truth.y_m)) * 100


class Practice(NamedTuple):
    """What the operator knows of a robot: how far it goes on after a zero, and how the caster turns it then."""

    forward_m: float
    turned_rad: float
    kick_rad: float  # farther than it stood, once it drives straight after a turn


def rehearse(new_robot: Callable[[], LabRobot], habits: Habits) -> Practice:
    """Find by practice how far the robot rolls on and overturns."""
    straight = _Operated(new_robot(), habits)
    straight.go(habits.linear_m_s, 0.0, _REHEARSED_S)
    begun_m = straight.robot.world.rolled_m
    straight.stop()
    turning = _Operated(new_robot(), habits)
    turning.go(0.0, habits.angular_rad_s, _REHEARSED_S)
    begun_rad = turning.robot.world.theta_rad
    turning.stop()
    stood_rad = turning.robot.world.theta_rad
    turning.go(habits.linear_m_s, 0.0, _REHEARSED_S)
    kick_rad = turning.robot.world.theta_rad - stood_rad
    return Practice(straight.robot.world.rolled_m - begun_m, stood_rad - begun_rad, kick_rad)


def drive(robot: LabRobot, pattern: Pattern, *, run: int, practice: Practice, habits: Habits) -> Run:
    """Drive one pattern. `run`: its number, from which lengths and the operator's inaccuracy follow."""
    noise = RandomNumbers(run, _STREAM)
    driver = _Operated(robot, habits)
    for number, mark in enumerate(pattern.marks_of(run)):
        if number > 0:
            driver.turn_to(mark, practice.turned_rad + practice.kick_rad, noise.normal() * habits.aim_noise_rad)
        driver.drive_to(mark, practice.forward_m, noise.normal() * habits.mark_noise_m)
        if number == 0 and habits.push_m:
            robot.world.shove(0.0, habits.push_m, 0.0)
            driver.stop()
    return Run(pattern, driver.samples)


class _Operated:
    """A robot at the operator's keyboard."""

    def __init__(self, robot: LabRobot, habits: Habits) -> None:
        self.robot = robot
        self.samples = [_sample(robot)]
        self._habits = habits

    @property
    def _truth(self) -> Pose:
        return self.samples[-1].truth

    def turn_to(self, mark: tuple[float, float], early_rad: float, noise_rad: float) -> None:
        """Turn on the spot until the robot points to the mark; half a turn goes to the left."""
        truth = self._truth
        wanted_rad = wrap_angle(math.atan2(mark[1] - truth.y_m, mark[0] - truth.x_m) - truth.theta_rad)
        if wanted_rad < -0.75 * math.pi:
            wanted_rad += math.tau
        sign = math.copysign(1.0, wanted_rad)
        goal_rad = abs(wanted_rad) + noise_rad - early_rad
        begun_rad = truth.theta_rad
        self._press(0.0, sign * self._habits.angular_rad_s)
        self._until(lambda: goal_rad - sign * (self._truth.theta_rad - begun_rad), self._habits.angular_rad_s)
        self.stop()

    def drive_to(self, mark: tuple[float, float], early_m: float, noise_m: float) -> None:
        """Drive straight until the robot is beside the mark."""
        begun = self._truth
        way_m = math.hypot(mark[0] - begun.x_m, mark[1] - begun.y_m)
        along = ((mark[0] - begun.x_m) / way_m, (mark[1] - begun.y_m) / way_m)
        goal_m = way_m + noise_m - early_m

        def left_m() -> float:
            truth = self._truth
            return goal_m - (truth.x_m - begun.x_m) * along[0] - (truth.y_m - begun.y_m) * along[1]

        self._press(self._habits.linear_m_s, 0.0)
        self._until(left_m, self._habits.linear_m_s)
        self.stop()

    def go(self, linear_m_s: float, angular_rad_s: float, seconds: float) -> None:
        """Drive for a time."""
        self._press(linear_m_s, angular_rad_s)
        self.robot.advance(seconds)

    def stop(self) -> None:
        """Let go of the key, and wait until the robot stands and its odometry has followed."""
        self._press(0.0, 0.0)
        waited_s = 0.0
        while waited_s < _MOST_STOP_S:
            before = self._truth
            self._advance(POLL_S)
            waited_s += POLL_S
            after = self._truth
            if math.dist(before, after) < _STANDING_M:
                break
        self._advance(_SETTLED_S)

    def _press(self, linear_m_s: float, angular_rad_s: float) -> None:
        self.robot.command(linear_m_s, angular_rad_s)

    def _until(self, left: Callable[[], float], speed: float) -> None:
        """Wait until nothing is left."""
        waited_s = 0.0
        while (rest := left()) > 0.0 and waited_s < _MOST_LEG_S:
            wait_s = max(_LEAST_POLL_S, min(POLL_S, rest / speed))
            self._advance(wait_s)
            waited_s += wait_s

    def _advance(self, seconds: float) -> None:
        self.robot.advance(seconds)
        self.samples.append(_sample(self.robot))


def _sample(robot: LabRobot) -> PoseSample:
    world = robot.world
    return PoseSample(Pose(world.x_m, world.y_m, world.theta_rad), robot.odometry)
