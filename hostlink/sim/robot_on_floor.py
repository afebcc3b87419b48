"""RobotOnFloor: the paper's robot without its device, in virtual time, and a person who measures it. Pure.

Control, motors, wheels and floor are the simulator's; no bytes, no clock. It is what `hostlink calibrate --simulate`
drives.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from hostlink.robot.course import CourseFollower, Leg
from hostlink.robot.kinematics import Pose, placed
from hostlink.robot.odometry_correction import OdometryCorrection
from hostlink.sim.controller import LEFT_GAINS, RIGHT_GAINS, WheelController
from hostlink.sim.geometry import Geometry
from hostlink.sim.world_parameters import WorldParameters
from hostlink.sim.worlds import open_world

COMMAND_S = 0.1  # between two poses of the odometry, and two commands
LOOP_US = 33_333  # of the firmware's loop
PASS_US = 1000
LONGEST_S = 1800.0  # of a course: a robot that needs longer does not move
_EDGES = 1 << 32  # the counters wrap


class DrivenRobot(Protocol):
    """What follows a course: a RobotOnFloor, or the firmware in its world."""

    @property
    def odometry(self) -> Pose:
        """Where it believes to be."""

    @property
    def pose(self) -> Pose:
        """Where it truly is; whole turns stay in theta."""

    def drive(self, linear_m_s: float, angular_rad_s: float, seconds: float) -> None:
        """Command a velocity for so long."""


class RobotOnFloor:
    """It drives by `drive`; `odometry` is what it believes, `pose` the truth.

    Its time is that of the firmware's loop in a world (firmware/host/robot_in_world.h): a pass each millisecond, a turn
    of the control in the first pass after each thirtieth of a second.
    """

    def __init__(self, world: WorldParameters) -> None:
        self.odometry = Pose()
        self._world = open_world(world)
        self._geometry = Geometry()
        self._controllers = (WheelController(LEFT_GAINS), WheelController(RIGHT_GAINS))
        self._edges = (0, 0)
        self._now_us = self._turned_at_us = self._due_since_us = 0

    @property
    def pose(self) -> Pose:
        """Where it truly is; whole turns stay in theta."""
        return Pose(self._world.x_m, self._world.y_m, self._world.theta_rad)

    def drive(self, linear_m_s: float, angular_rad_s: float, seconds: float) -> None:
        """Command a velocity for so long."""
        for number in range(round(seconds * 1000)):
            self._now_us += PASS_US
            self._world.step(PASS_US * 1e-6)
            if number == 0:
                self._command(linear_m_s, angular_rad_s)
            self._turn_if_due()

    def _command(self, linear_m_s: float, angular_rad_s: float) -> None:
        wanted_ticks_s = self._geometry.wheel_speeds(linear_m_s, angular_rad_s)
        left, right = self._controllers
        left.aim(wanted_ticks_s[0])
        right.aim(wanted_ticks_s[1])
        self._world.drive(left.pwm_now, right.pwm_now)

    def _turn_if_due(self) -> None:
        late_us = self._now_us - self._due_since_us - LOOP_US
        if late_us < 0:
            return
        self._due_since_us = self._due_since_us + LOOP_US if late_us < LOOP_US / 2 else self._now_us
        passed_us, self._turned_at_us = self._now_us - self._turned_at_us, self._now_us
        self._turn(float(np.float32(passed_us) * np.float32(1e-6)))

    def _turn(self, dt_s: float) -> None:
        """One turn of its control."""
        left, right = self._controllers
        before, self._edges = self._edges, (self._world.left.edges, self._world.right.edges)
        counted = [(new - old) % _EDGES for old, new in zip(before, self._edges, strict=True)]
        ticks = [control.step(count, dt_s) for control, count in zip(self._controllers, counted, strict=True)]
        self._world.drive(left.pwm, right.pwm)
        self.odometry = self._geometry.integrate(self.odometry, ticks[0], ticks[1])


class Person:
    """Somebody with a tape measure; what is read off it is a little wrong, the same for the same seed."""

    def __init__(self, seed: int, *, reads_m: float = 0.002, reads_rad: float = math.radians(0.5)) -> None:
        """`reads_m`, `reads_rad`: standard deviations; the second is that of the mark's direction, too."""
        self._random = np.random.default_rng(seed)
        self._reads_m, self._reads_rad = reads_m, reads_rad

    def measure(self, end: Pose) -> Pose:
        """Where something is, from a mark."""
        marked = placed(Pose(theta_rad=self._reads_rad * float(self._random.normal())), end)
        x_m, y_m = (marked[axis] + self._reads_m * float(self._random.normal()) for axis in (0, 1))
        return Pose(x_m, y_m, end.theta_rad + self._reads_rad * float(self._random.normal()))


def follow(
    robot: DrivenRobot,
    legs: Sequence[Leg],
    correction: OdometryCorrection | None = None,
    show: Callable[[int], None] = lambda _: None,
) -> tuple[tuple[Pose, ...], Pose]:
    """Drive a course by its odometry, corrected if need be; returns its poses, and how far it truly came.

    `show` is given the number of legs that are left.

    Raises:
        TimeoutError: it does not get there.
    """
    follower, start, path, shown = CourseFollower(legs), robot.pose, [robot.odometry], Pose()
    correction = OdometryCorrection() if correction is None else correction
    now_s = 0.0
    while not follower.is_done:
        if now_s > LONGEST_S or follower.is_stuck:
            raise TimeoutError(
                f"the simulated robot does not get there: {follower.legs_left} legs are left after {now_s:.0f} s"
            )
        robot.drive(*follower.update(shown, now_s), COMMAND_S)
        shown = correction.advance(shown, path[-1], robot.odometry)
        path.append(robot.odometry)
        now_s += COMMAND_S
        show(follower.legs_left)
    return tuple(path), _from(start, robot.pose)


def _from(start: Pose, end: Pose) -> Pose:
    """A pose as it is from another; whole turns stay in it."""
    cos, sin = math.cos(start.theta_rad), math.sin(start.theta_rad)
    dx_m, dy_m = end.x_m - start.x_m, end.y_m - start.y_m
    return Pose(dx_m * cos + dy_m * sin, dy_m * cos - dx_m * sin, end.theta_rad - start.theta_rad)
