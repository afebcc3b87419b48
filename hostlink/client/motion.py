"""Motions that end by themselves: drive for a time, move a distance, turn an angle.

| event                                                       | outcome       | who sends the zero                     |
|-------------------------------------------------------------|---------------|----------------------------------------|
| the time is over, the place or the heading is reached       | reached       | the motion                             |
| no progress for STUCK_S of robot/course.py                  | blocked       | the motion                             |
| `timeout_s` is over                                         | timed_out     | the motion                             |
| no odometry for SILENCE_S, a jump, away from the course     | stopped       | the motion                             |
| the board restarts, the odometry is reset                   | stopped       | the motion                             |
| stop, lock, another driver, the device connects again       | stopped       | the daemon, before the client knows it |
| `stop`, `drive` of this program, the end of it or of a cell | stopped       | who ended it                           |
| the connection is lost, this program does not run           | stopped       | the daemon, when the lease ends        |
| cancellation, Ctrl-C, an error of `on_progress`             | is raised     | the motion                             |

A course that has arrived holds a zero until the robot has settled. Another event in that time does not change its
result: reached.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import NamedTuple, Self

from hostlink.client.course import STUCK_S, CourseFollower, Leg, Speed
from hostlink.client.driver import REPEAT_INTERVAL_S, VelocitySender
from hostlink.client.mailbox import Mailbox
from hostlink.client.views import Driven, Motion, MotionKind, MotionOutcome, Odometry, Progress, RobotState
from hostlink.core.robot.kinematics import Pose, frame_of, is_near_origin, placed, wrap_angle
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.errors import BadRequest, CommandRefused, HostlinkError

SILENCE_S = 0.5  # without odometry the robot would drive blind
FIRST_POSE_S = 3.0
JUMP_M, JUMP_RAD = 0.3, 1.0  # between two poses, besides what the speed explains: the odometry was set
LEAST_RESET_M, LEAST_RESET_RAD = 0.05, 0.15  # smaller steps to the origin are motion: the course errs by no more
TIMER_S = 0.001  # a timer's resolution: what is left of a time is over
STRAY_M = 0.3  # past the end, or away from the start of a turn
LEAST_M_S, LEAST_RAD_S = 0.02, 0.05  # at lower speeds progress cannot be told from a stop
GRACE_S, TIMES_LONGER = 10.0, 4.0  # of the default timeout: a robot's limits may slow it down

OnProgress = Callable[[Progress], object]


class Begin(NamedTuple):
    """Permissions of the first command of a motion: take the robot over, and drive without letting go before."""

    take_over: bool = False
    resume: bool = False


class Fix(NamedTuple):
    """A pose, and the number of restarts of the robot's board until then."""

    pose: Pose
    restarts: int = 0


class Course(NamedTuple):
    """A line, which may lead back, or a turn on the spot; with its speed and its bound in time."""

    distance_m: float
    turn_rad: float
    speed: Speed
    timeout_s: float


def line(distance_m: float, speed_m_s: float, timeout_s: float | None) -> Course:
    """A line.

    Raises:
        BadRequest: a number is not finite, or the speed or the timeout is too small.
    """
    timeout_s = _checked("metres", distance_m, "speed_m_s", speed_m_s, LEAST_M_S, timeout_s)
    return Course(distance_m, 0.0, Speed(linear_m_s=speed_m_s), timeout_s)


def turn(turn_rad: float, speed_rad_s: float, timeout_s: float | None) -> Course:
    """A turn.

    Raises:
        BadRequest: a number is not finite, or the speed or the timeout is too small.
    """
    timeout_s = _checked("radians", turn_rad, "speed_rad_s", speed_rad_s, LEAST_RAD_S, timeout_s)
    return Course(0.0, turn_rad, Speed(angular_rad_s=speed_rad_s), timeout_s)


def _checked(name: str, size: float, speed_name: str, speed: float, least: float, timeout_s: float | None) -> float:
    """Return the bound in time."""
    if not math.isfinite(size):
        raise BadRequest(f"{name} is {size}; pass a finite number")
    if not least <= speed < math.inf:
        raise BadRequest(f"{speed_name} is {speed:g}; pass at least {least:g}, and the sign with {name}")
    if timeout_s is None:
        return GRACE_S + TIMES_LONGER * abs(size) / speed
    return positive("timeout_s", timeout_s)


def require_pose(state: RobotState) -> None:
    """Check that a robot can be driven by its odometry.

    Raises:
        BadRequest: nothing tells where it is.
    """
    feedback = state.get("feedback", "pose")  # an older daemon knows robots with a pose only
    if feedback != "pose":
        known = "has no odometry" if feedback == "none" else f"tells its {feedback} only, and no pose"
        raise BadRequest(
            f"{state['name']} {known}, so that no distance and no angle can be measured; "
            "`hostlink teleop` and drive() drive it without"
        )


def positive(name: str, value: float) -> float:
    """Check a duration.

    Raises:
        BadRequest: it is not positive, or not finite.
    """
    if not 0.0 < value < math.inf:
        raise BadRequest(f"{name} is {value:g}; pass a positive number of seconds")
    return value


class CoursePilot:
    """Decides the velocity at each pose of a course, and when the course ends. Pure.

    A line backwards is a line forwards of the robot's mirror image, which drives the other way.
    """

    def __init__(self, course: Course, first: Fix, now_s: float) -> None:
        self.outcome: MotionOutcome | None = None
        self.kind, self.reason = "", ""
        self._course, self._began_s = course, now_s
        self._way = -1.0 if course.distance_m < 0 else 1.0
        self._follower = CourseFollower([Leg(abs(course.distance_m), course.turn_rad)], course.speed)
        self._origin = frame_of(Pose(), first.pose)
        self._newest = first
        self._last, self._last_s = Pose(), now_s
        self._turned_rad = 0.0

    @property
    def has_arrived(self) -> bool:
        """Whether the place or the heading was reached: another source does not change the result."""
        return self._follower.is_settling or self.outcome is MotionOutcome.REACHED

    def update(self, fix: Fix, now_s: float) -> PlanarVelocity:
        """Return the velocity at this pose; zero when the course has ended."""
        before, self._newest = self._newest, fix
        if fix.restarts != before.restarts:
            self._stop("the robot's board restarted, which `hostlink doctor` explains", MotionKind.ODOMETRY_RESET)
            return PlanarVelocity()
        here = placed(self._origin, fix.pose)
        step_m, step_rad = math.dist(here[:2], self._last[:2]), wrap_angle(here.theta_rad - self._last.theta_rad)
        passed_s, speed = now_s - self._last_s, self._course.speed
        if is_near_origin(fix.pose) and self._is_reset(step_m, abs(step_rad), passed_s):
            self._stop("the robot's odometry was reset", MotionKind.ODOMETRY_RESET)
            return PlanarVelocity()
        if step_m > JUMP_M + speed.linear_m_s * passed_s or abs(step_rad) > JUMP_RAD + speed.angular_rad_s * passed_s:
            self._stop("the odometry jumped")
            return PlanarVelocity()
        self._last, self._last_s = here, now_s
        self._turned_rad += step_rad
        past_m = here.x_m * self._way - abs(self._course.distance_m)
        if past_m > STRAY_M or abs(here.y_m) > STRAY_M or here.x_m * self._way < -STRAY_M:
            self.outcome, self.kind = MotionOutcome.STOPPED, MotionKind.OFF_COURSE  # also if it had arrived before
            self.reason = f"the robot is more than {STRAY_M:g} m away from its course"
            return PlanarVelocity()
        seen = here if self._way > 0 else Pose(-here.x_m, -here.y_m, here.theta_rad)
        linear_m_s, angular_rad_s = self._follower.update(seen, now_s)
        if self._follower.is_stuck:
            self.outcome = MotionOutcome.BLOCKED
            self.reason = f"the odometry did not advance for {STUCK_S:g} s; look for an obstacle or a failing encoder"
        elif self._follower.is_done:
            self.outcome = MotionOutcome.REACHED
        limit_rad_s = speed.angular_rad_s  # a line is followed by turning, too
        return PlanarVelocity(self._way * linear_m_s, 0.0, max(-limit_rad_s, min(limit_rad_s, angular_rad_s)))

    def _is_reset(self, step_m: float, step_rad: float, passed_s: float) -> bool:
        """Whether a step to the origin is a reset: poses are never more than SILENCE_S late."""
        speed, longest_s = self._course.speed, passed_s + SILENCE_S
        return (
            step_m > LEAST_RESET_M + speed.linear_m_s * longest_s
            or step_rad > LEAST_RESET_RAD + speed.angular_rad_s * longest_s
        )

    def check(self, now_s: float, *, is_silent: bool) -> None:
        """Decide whether the course ends because it lasts too long, or because no pose has arrived."""
        if is_silent and now_s > self._last_s + SILENCE_S:
            reason = f"no odometry arrived for {SILENCE_S:g} s; `hostlink doctor` finds out why"
            self._stop(reason, MotionKind.NO_ODOMETRY)
        elif now_s > self._began_s + self._course.timeout_s and not self.has_arrived:
            self.outcome = MotionOutcome.TIMED_OUT
            self.reason = f"it was not completed within {self._course.timeout_s:.1f} s"

    def progress(self, now_s: float) -> Progress:
        """Progress at the newest pose."""
        course, distance_m = self._course, self._last.x_m
        gone, whole = (self._turned_rad, course.turn_rad) if course.turn_rad else (distance_m, course.distance_m)
        return Progress(distance_m, self._turned_rad, now_s - self._began_s, gone / whole if whole else 1.0)

    def _stop(self, reason: str, kind: MotionKind = MotionKind.OFF_COURSE) -> None:
        if self.has_arrived:
            self.outcome = MotionOutcome.REACHED
        else:
            self.outcome, self.kind, self.reason = MotionOutcome.STOPPED, kind, reason


class _Held:
    """The velocity of one motion for the length of a block, as long as no other call ends it."""

    def __init__(self, driver: VelocitySender, robot: str, priority: int, begin: "Begin") -> None:
        self._driver, self._robot, self._priority, self._begin = driver, robot, priority, begin
        self._newest = driver.newest(robot)  # number of the motion's own newest call; before: of the one before it
        self._has_driven = False

    @property
    def is_lost(self) -> bool:
        """Whether another call of this program, a refusal, or a sleep of this program has ended it."""
        self._driver.notice_sleep()
        if self._driver.newest(self._robot) != self._newest:
            return True
        return self._has_driven and self._driver.number_of(self._robot) != self._newest

    async def drive(self, velocity: PlanarVelocity) -> Driven:
        """Command a velocity. A call of this program meanwhile is noticed by `is_lost`."""
        self._newest = self._driver.next_number()
        begin = Begin() if self._has_driven else self._begin
        driven = await self._driver.drive(
            self._robot,
            velocity,
            self._priority,
            number=self._newest,
            take_over=begin.take_over,
            resume=begin.resume,
        )
        self._has_driven = True
        return driven

    def pop_end(self, elapsed_s: float) -> Motion:
        """Result of a motion that something else has ended."""
        end = self._driver.pop_end(self._robot, self._newest)
        by = "this program" if end.kind == MotionKind.PROGRAM else end.by
        return Motion(MotionOutcome.STOPPED, elapsed_s, kind=end.kind, by=by, reason=end.reason)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        """Command a zero, unless another command of this program has replaced the motion."""
        if self._has_driven and not self.is_lost:
            self._driver.stop_repeating(self._robot)
            await self._driver.send_zero(self._robot, self._priority)


def _refused(error: HostlinkError, elapsed_s: float) -> Motion:
    by = error.by if isinstance(error, CommandRefused) else None
    return Motion(MotionOutcome.STOPPED, elapsed_s, kind=str(error.kind), by=by, reason=str(error))


async def drive_for(
    driver: VelocitySender, robot: str, velocity: PlanarVelocity, priority: int, *, for_s: float, begin: Begin
) -> Motion:
    """Hold one velocity for a time.

    Raises:
        HostlinkError: as `Robot.drive`; nothing was driven.
    """
    now_s = asyncio.get_running_loop().time
    positive("for_s", for_s)
    async with _Held(driver, robot, priority, begin) as held:
        await held.drive(velocity)
        began_s = now_s()
        while (left_s := began_s + for_s - now_s()) > TIMER_S:
            await asyncio.sleep(min(left_s, REPEAT_INTERVAL_S))
            if held.is_lost:
                break
        if held.is_lost:
            return held.pop_end(now_s() - began_s)
    return Motion(MotionOutcome.REACHED, now_s() - began_s)


async def follow(
    driver: VelocitySender,
    robot: str,
    priority: int,
    course: Course,
    odometry: AsyncIterator[Odometry],
    on_progress: OnProgress | None,
    begin: Begin,
) -> Motion:
    """Follow a course by odometry.

    Raises:
        HostlinkError: no odometry arrives, or the first command is refused; nothing was driven.
    """
    poses: Mailbox[Odometry] = Mailbox(f"poses of {robot}")
    try:
        async with asyncio.TaskGroup() as tasks:
            reading = tasks.create_task(_read(odometry, poses), name=f"odometry of {robot}")
            try:
                async with _Held(driver, robot, priority, begin) as held:
                    return await _follow(held, course, poses, on_progress)
            finally:
                reading.cancel()
    except BaseExceptionGroup as group:  # an error of the caller's function is the caller's own
        raise_if_cancelled()  # TaskGroup drops a cancellation if there is an error, too
        raise group.exceptions[0] from None


async def _read(odometry: AsyncIterator[Odometry], poses: Mailbox[Odometry]) -> None:
    try:
        async for each in odometry:
            poses.put(each)
    except HostlinkError as error:
        poses.put(error)


async def _follow(held: _Held, course: Course, poses: Mailbox[Odometry], on_progress: OnProgress | None) -> Motion:
    now_s = asyncio.get_running_loop().time
    fix = await _first(poses)
    if held.is_lost:
        return held.pop_end(0.0)
    began_s = now_s()
    pilot = CoursePilot(course, fix, began_s)
    commanded: PlanarVelocity | None = None
    try:
        while True:
            velocity = pilot.update(fix, now_s())
            if pilot.outcome is None and velocity != commanded:
                await held.drive(velocity)
                commanded = velocity
            if on_progress is not None:
                on_progress(pilot.progress(now_s()))
            newer: Fix | None = None
            while newer is None and pilot.outcome is None:
                newer = await _newest(poses)
                if held.is_lost:  # nothing is awaited between this and the next command
                    ended = held.pop_end(now_s() - began_s)
                    return _ended(pilot, ended, now_s())
                pilot.check(now_s(), is_silent=newer is None)
            if pilot.outcome is not None:
                ended = Motion(pilot.outcome, now_s() - began_s, kind=pilot.kind, reason=pilot.reason)
                return _ended(pilot, ended, now_s())
            assert newer is not None  # noqa: S101 - the loop above ends with one of both
            fix = newer
    except HostlinkError as error:
        if commanded is None:
            raise
        return _ended(pilot, _refused(error, now_s() - began_s), now_s())


def _ended(pilot: CoursePilot, motion: Motion, now_s: float) -> Motion:
    """Return the result with the way that was gone. Another source does not change that a motion has arrived."""
    progress = pilot.progress(now_s)
    if pilot.has_arrived and pilot.outcome is None:
        motion = Motion(MotionOutcome.REACHED, motion.elapsed_s)
    return replace(motion, distance_m=progress.distance_m, turned_rad=progress.turned_rad)


async def _first(poses: Mailbox[Odometry]) -> Fix:
    """Wait for a pose of now.

    Raises:
        HostlinkError: none arrives, or the daemon refuses the stream.
    """
    try:
        async with asyncio.timeout(FIRST_POSE_S):
            while (fix := await _newest(poses)) is None:
                pass
    except TimeoutError:
        raise HostlinkError(f"no odometry arrived for {FIRST_POSE_S:g} s; `hostlink doctor` finds out why") from None
    return fix


async def _newest(poses: Mailbox[Odometry]) -> Fix | None:
    """Return the newest pose; None when none arrives within REPEAT_INTERVAL_S."""
    try:
        async with asyncio.timeout(REPEAT_INTERVAL_S):
            found = await anext(poses)
    except TimeoutError:
        return None
    found = [found, *poses.pop_all()][-1]
    pose = found["pose"]
    if pose is None or found["age_s"] > SILENCE_S:
        return None
    return Fix(Pose(pose["x_m"], pose["y_m"], pose["theta_rad"]), found.get("restarts", 0))
