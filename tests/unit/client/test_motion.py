"""Motions of the client: `drive(for_s=...)`, `move` and `turn`, without sockets and in virtual time."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, cast

import pytest

from hostlink.client import Motion, MotionOutcome, Progress, Robot
from hostlink.client.driver import VelocitySender
from hostlink.client.motion import Begin, CoursePilot, Fix, follow, line, turn
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.errors import BadRequest, CommandRefused, HostlinkError, RefusalKind
from tests.support.background import cancelling
from tests.support.fake_device import topic
from tests.support.memory_client import MemoryHost, memory_host
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT, VELOCITY_ID, Scene, scene
from tests.support.virtual_loop import inside, run_virtual
from tests.support.waiting import expect

PERIOD_S = 0.05
WITHIN_S = 0.7  # a repetition finds the refusal, and the daemon sends zeros


class World:
    """A robot that follows its velocity at once, and the program that drives it."""

    def __init__(self, made: Scene, me: MemoryHost) -> None:
        self.made, self.me, self.robot = made, me, me.robot(ROBOT)
        self.pose = Pose(1.0, 2.0, 0.5)
        self.grip = 1.0  # part of the commanded velocity that the wheels do
        self.is_silent = False

    @property
    def velocity(self) -> Twist:
        payloads = self.made.robot.payloads(VELOCITY_ID)
        return Twist.decode(payloads[-1]) if payloads else Twist(0.0, 0.0)

    @property
    def is_zero(self) -> bool:
        return (self.velocity.linear_x_m_s, self.velocity.angular_z_rad_s) == (0.0, 0.0)

    async def stop(self) -> None:
        """Stop the robot as `Robot.stop` does, without REST and without its last zero."""
        self.me.stop_repeating(ROBOT)
        self.made.hub.robots.find_here(ROBOT).stop()

    async def run(self) -> None:
        while True:
            x_m, y_m, theta_rad = self.pose
            step_m = self.velocity.linear_x_m_s * PERIOD_S * self.grip
            theta_rad += self.velocity.angular_z_rad_s * PERIOD_S * self.grip
            self.pose = Pose(x_m + step_m * math.cos(theta_rad), y_m + step_m * math.sin(theta_rad), theta_rad)
            if not self.is_silent:
                wrapped = math.remainder(theta_rad, math.tau)
                await self.made.robot.send(ODOMETRY_ID, POSE.pack(self.pose.x_m, self.pose.y_m, wrapped))
            await asyncio.sleep(PERIOD_S)


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[World]:
    async with scene() as made, memory_host(made.hub, made.tasks) as me:
        here = World(made, me)
        running = made.tasks.create_task(here.run())
        await asyncio.sleep(0.2)
        try:
            yield here
        finally:
            running.cancel()


def in_world(test: Callable[[World], Awaitable[None]]) -> None:
    async def run() -> None:
        async with world() as here:
            await test(here)
            await asyncio.sleep(WITHIN_S)
            assert here.is_zero
            assert not here.robot.is_driven

    run_virtual(run())


MOTIONS: list[Callable[[Robot], Awaitable[Motion]]] = [
    lambda robot: robot.drive(0.2, 0.0, for_s=20.0),
    lambda robot: robot.move(4.0),
    lambda robot: robot.turn(20.0),
]
NAMES = ["drive", "move", "turn"]
every_motion = pytest.mark.parametrize("motion", MOTIONS, ids=NAMES)


async def interrupted(here: World, motion: Callable[[Robot], Awaitable[Motion]], event: Callable[[], object]) -> Motion:
    """Result of a motion in which something happens after a second."""

    async def run() -> Motion:
        return await motion(here.robot)

    task = here.made.tasks.create_task(run())
    await asyncio.sleep(1.0)
    assert not here.is_zero
    happened = event()
    if isinstance(happened, Awaitable):
        await happened
    return await task


async def as_coroutine(motion: Awaitable[Motion]) -> Motion:
    return await motion


# -- completed --------------------------------------------------------------------------------------------------------


@inside(in_world)
async def test_drive_for_a_time_is_repeated_beyond_the_lease_and_ends_in_zero(here: World) -> None:
    result = await here.robot.drive(0.2, 0.0, for_s=2.0)
    assert (result.outcome, result.kind, result.by) == (MotionOutcome.REACHED, "", None)
    assert result.is_reached
    assert result.elapsed_s == pytest.approx(2.0, abs=0.01)
    assert math.dist(here.pose[:2], (1.0, 2.0)) == pytest.approx(0.4, abs=0.03)
    await asyncio.sleep(PERIOD_S)
    assert here.is_zero


@pytest.mark.parametrize("metres", [1.0, -0.6, 0.0])
@inside(in_world)
async def test_move_reaches_the_place_and_reports_progress(here: World, metres: float) -> None:
    seen: list[Progress] = []
    result = await here.robot.move(metres, on_progress=seen.append)
    assert (result.outcome, result.reason) == (MotionOutcome.REACHED, "")
    assert result.distance_m == pytest.approx(metres, abs=0.03)
    assert result.turned_rad == pytest.approx(0.0, abs=0.05)
    assert math.dist(here.pose[:2], (1.0, 2.0)) == pytest.approx(abs(metres), abs=0.03)
    assert seen[-1].fraction == pytest.approx(1.0, abs=0.05)
    assert [each.elapsed_s for each in seen] == sorted(each.elapsed_s for each in seen)


@pytest.mark.parametrize("radians", [math.pi / 2, -4.0])
@inside(in_world)
async def test_turn_reaches_the_heading_also_beyond_half_a_turn(here: World, radians: float) -> None:
    result = await here.robot.turn(radians)
    assert result.outcome is MotionOutcome.REACHED
    assert result.turned_rad == pytest.approx(radians, abs=0.06)
    assert here.pose.theta_rad - 0.5 == pytest.approx(radians, abs=0.06)


@inside(in_world)
async def test_move_is_never_faster_than_its_speed(here: World) -> None:
    result = await here.robot.move(0.2, speed_m_s=0.04)
    assert result.is_reached
    assert max(here.made.speeds()) == 0.04


# -- ended by something else ------------------------------------------------------------------------------------------


@every_motion
@inside(in_world)
async def test_motion_that_is_locked_is_stopped_with_the_reason(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    gate = here.made.hub.robots.find_here(ROBOT)
    result = await interrupted(here, motion, lambda: gate.lock("smoke", by="the fire alarm"))
    assert (result.outcome, result.kind, result.by) == (MotionOutcome.STOPPED, "locked", "the fire alarm")
    assert "smoke" in result.reason
    assert result.elapsed_s < 1.5
    await asyncio.sleep(PERIOD_S)
    assert here.is_zero
    with pytest.raises(CommandRefused, match="smoke"):  # a motion that cannot begin raises, as `drive` does
        await motion(here.robot)


@every_motion
@inside(in_world)
async def test_motion_that_is_stopped_by_another_is_not_resumed(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    robot = here.made.hub.robots.find_here(ROBOT)
    result = await interrupted(here, motion, lambda: robot.stop(by="the page"))
    assert (result.outcome, result.kind, result.by) == (MotionOutcome.STOPPED, "disarmed", "a stop by the page")
    await asyncio.sleep(0.2)
    assert here.is_zero
    with pytest.raises(CommandRefused, match=r"robot_0 was stopped: .*a stop by the page") as refused:
        await motion(here.robot)  # the program has not let go since
    assert (refused.value.kind, refused.value.by) == (RefusalKind.DISARMED, "a stop by the page")
    assert here.is_zero
    assert (await here.robot.drive(0.1, 0.0, for_s=0.2, resume=True)).is_reached


@every_motion
@inside(in_world)
async def test_motion_ends_when_a_person_takes_over_and_names_who(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    person = here.made.hub.join("teleop of Ada")
    robot = here.made.hub.robots.find_here(ROBOT)

    def take_over() -> None:
        person.drive(robot, PlanarVelocity(-0.1), priority=60)

    result = await interrupted(here, motion, take_over)
    assert (result.outcome, result.kind, result.by) == (MotionOutcome.STOPPED, "held", "teleop of Ada")
    await asyncio.sleep(PERIOD_S)
    assert here.velocity.linear_x_m_s == -0.1  # the end of the motion has not stopped the person
    person.leave()


@every_motion
@inside(in_world)
async def test_motion_ends_by_a_stop_of_the_same_program(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    result = await interrupted(here, motion, here.me.stop_driven)
    assert (result.outcome, result.kind, result.by) == (MotionOutcome.STOPPED, "program", "this program")


@every_motion
@inside(in_world)
async def test_motion_gives_way_to_a_newer_drive_of_the_same_program(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    result = await interrupted(here, motion, lambda: here.robot.drive(-0.1, 0.0))
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "program")
    await asyncio.sleep(PERIOD_S)
    assert here.velocity.linear_x_m_s == -0.1
    await here.me.stop_driven()


@pytest.mark.parametrize("motion", MOTIONS[1:], ids=NAMES[1:])
@pytest.mark.parametrize("of_all", [True, False], ids=["all", "robot"])
@inside(in_world)
async def test_motion_that_waits_for_its_first_pose_ends_by_a_stop_of_the_same_program(
    here: World, motion: Callable[[Robot], Awaitable[Motion]], of_all: bool
) -> None:
    here.is_silent = True
    await asyncio.sleep(3.0)  # the poses of before are old
    task = here.made.tasks.create_task(as_coroutine(motion(here.robot)))
    await asyncio.sleep(0.5)
    await (here.me.stop_driven() if of_all else here.stop())
    here.is_silent = False
    result = await task
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "program")
    await asyncio.sleep(PERIOD_S)
    assert here.is_zero


@every_motion
@inside(in_world)
async def test_motion_ends_by_a_stop_during_the_round_trip_of_its_command(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    here.me.connection_.delay_s = 0.4
    task = here.made.tasks.create_task(as_coroutine(motion(here.robot)))
    await asyncio.sleep(0.3)
    await here.stop()
    result = await task
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "program")
    assert result.elapsed_s < 1.0


@every_motion
@inside(in_world)
async def test_end_of_a_replaced_motion_leaves_the_notice_of_the_newer_drive(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    task = here.made.tasks.create_task(as_coroutine(motion(here.robot)))
    await asyncio.sleep(1.0)
    await here.robot.drive(-0.1, 0.0)
    here.made.hub.robots.find_here(ROBOT).lock("a person is near")
    assert (await task).kind == "program"
    await asyncio.sleep(0.5)
    with pytest.raises(HostlinkError, match=r"robot_0 was stopped: .*resume=True"):
        await here.robot.drive(-0.1, 0.0)


@every_motion
@inside(in_world)
async def test_motion_that_is_cancelled_ends_in_zero_at_once(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1.0):
            await motion(here.robot)
    await asyncio.sleep(0.01)
    assert here.is_zero


@every_motion
@inside(in_world)
async def test_motion_whose_connection_breaks_ends_with_the_lease(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    result = await interrupted(here, motion, here.me.lose)
    assert (result.outcome, result.kind, result.by) == (MotionOutcome.STOPPED, "connection", None)
    assert result.reason == "the network is cut"


@pytest.mark.parametrize("motion", MOTIONS[1:], ids=NAMES[1:])
@inside(in_world)
async def test_motion_without_odometry_for_half_a_second_ends(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    def silence() -> None:
        here.is_silent = True

    result = await interrupted(here, motion, silence)
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "no_odometry")
    assert 1.4 < result.elapsed_s < 1.8


@pytest.mark.parametrize("motion", MOTIONS[1:], ids=NAMES[1:])
@inside(in_world)
async def test_motion_against_an_obstacle_is_blocked(here: World, motion: Callable[[Robot], Awaitable[Motion]]) -> None:
    def block() -> None:
        here.grip = 0.0

    result = await interrupted(here, motion, block)
    assert result.outcome is MotionOutcome.BLOCKED
    assert "did not advance" in result.reason
    assert result.elapsed_s < 3.5


@inside(in_world)
async def test_motion_whose_odometry_jumps_is_stopped(here: World) -> None:
    def turn() -> None:
        here.pose = Pose(1.0, 2.0, 2.5)

    result = await interrupted(here, MOTIONS[1], turn)
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "off_course")
    assert result.reason == "the odometry jumped"


@pytest.mark.parametrize("jump", [Pose(0.5, 0.0, 0.0), Pose(0.0, 0.0, 1.2)])
def test_pilot_ends_by_a_jump_of_the_place_or_the_heading(jump: Pose) -> None:
    pilot = CoursePilot(line(1.0, 0.2, None), Fix(Pose()), 0.0)
    assert pilot.update(Fix(Pose()), 0.0).x_m_s == 0.2
    assert pilot.update(Fix(jump), 0.1) == PlanarVelocity()
    assert (pilot.outcome, pilot.reason) == (MotionOutcome.STOPPED, "the odometry jumped")


@pytest.mark.parametrize(
    "event", ["taken over", "locked", "odometry lost", "stopped by the program", "connection lost"]
)
@pytest.mark.parametrize("motion", [lambda robot: robot.move(0.2), lambda robot: robot.turn(0.6)], ids=NAMES[1:])
@inside(in_world)
async def test_motion_that_has_arrived_is_reached_also_if_it_ends_before_the_robot_settled(
    here: World, motion: Callable[[Robot], Awaitable[Motion]], event: str
) -> None:
    robot = here.made.hub.robots.find_here(ROBOT)
    task = here.made.tasks.create_task(as_coroutine(motion(here.robot)))
    await asyncio.sleep(0.5)
    await expect(lambda: here.is_zero)
    other = here.made.hub.join("a program of lower priority")
    match event:
        case "taken over":
            for _ in range(10):  # a zero holds no robot
                with contextlib.suppress(CommandRefused):  # until the lease of the newest velocity ends
                    other.drive(robot, PlanarVelocity(-0.1), priority=10)
                await asyncio.sleep(0.1)
        case "locked":
            robot.lock("smoke")
        case "odometry lost":
            here.is_silent = True
        case "stopped by the program":
            await here.stop()
        case _:
            here.me.lose()
    result = await task
    other.leave()
    assert (result.outcome, result.kind, result.by, result.reason) == (MotionOutcome.REACHED, "", None, "")
    assert result.distance_m is not None
    assert result.turned_rad is not None
    assert result.distance_m / 0.2 + result.turned_rad / 0.6 == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("continues", [True, False])
@inside(in_world)
async def test_motion_whose_board_restarts_without_an_interruption_ends(here: World, continues: bool) -> None:
    """The pose continues or begins again; the distance of the meantime is unknown in both cases."""
    estimator = here.made.hub.robots.find_here(ROBOT).odometry
    estimator._continues = continues
    here.pose = Pose(0.1, 0.0, 0.0)
    await asyncio.sleep(2.5)

    def restart() -> None:
        here.pose = Pose()

    result = await interrupted(here, MOTIONS[1], restart)
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "odometry_reset")
    assert "board restarted" in result.reason
    assert result.distance_m == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("before", [Pose(), Pose(1.0, 2.0, 0.5)], ids=["near the origin", "far away"])
@pytest.mark.parametrize("motion", MOTIONS[1:], ids=NAMES[1:])
@inside(in_world)
async def test_motion_whose_odometry_is_reset_ends(
    here: World, motion: Callable[[Robot], Awaitable[Motion]], before: Pose
) -> None:
    """Within a second of the origin the step back is smaller than a jump."""
    estimator = here.made.hub.robots.find_here(ROBOT).odometry
    here.pose = before
    await asyncio.sleep(0.2)

    def reset() -> None:
        estimator.expect_reset(asyncio.get_running_loop().time())
        here.pose = Pose()

    result = await interrupted(here, motion, reset)
    assert (result.outcome, result.kind) == (MotionOutcome.STOPPED, "odometry_reset")
    assert result.reason == "the robot's odometry was reset"


@pytest.mark.parametrize("late_s", [0.0, 0.4])
def test_pilot_passes_through_the_origin_with_late_poses(late_s: float) -> None:
    for course, at in ((line(-1.0, 0.2, None), Pose(0.31, 0.0, 0.0)), (turn(-1.5, 0.8, None), Pose(0.0, 0.0, 0.9))):
        pilot = CoursePilot(course, Fix(at), 0.0)
        for step in range(1, 40):
            x_m, theta_rad = (
                (max(at.x_m - 0.02 * step, -0.5), 0.0) if course.distance_m else (0.0, at.theta_rad - 0.08 * step)
            )
            arrives_s = step * 0.1 + (late_s if step % 2 else 0.0)
            pilot.update(Fix(Pose(x_m, 0.0, theta_rad)), arrives_s)
        assert pilot.outcome is not MotionOutcome.STOPPED


@inside(in_world)
async def test_motion_has_a_bound_in_time(here: World) -> None:
    result = await here.robot.move(4.0, timeout_s=1.5)
    assert result.outcome is MotionOutcome.TIMED_OUT
    assert result.reason == "it was not completed within 1.5 s"
    assert result.elapsed_s == pytest.approx(1.5, abs=0.1)
    assert result.distance_m == pytest.approx(0.3, abs=0.05)


def test_motion_has_a_bound_in_distance() -> None:
    """A robot that is pushed to the side, past the end or backwards leaves its course, and is stopped."""
    course = line(1.0, 0.2, None)
    for end in (Pose(0.5, 0.35), Pose(1.35, 0.0), Pose(-0.35, 0.0)):
        pilot = CoursePilot(course, Fix(Pose()), 0.0)
        steps = 20
        for step in range(1, steps + 1):
            if pilot.outcome is None:
                part = step / steps
                velocity = pilot.update(Fix(Pose(end.x_m * part, end.y_m * part)), step * 0.1)
        assert (pilot.outcome, pilot.kind) == (MotionOutcome.STOPPED, "off_course")
        assert velocity == PlanarVelocity()


@inside(in_world)
async def test_error_of_the_progress_function_ends_the_motion_and_is_raised(here: World) -> None:
    def fail(progress: Progress) -> None:
        if progress.distance_m > 0.1:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await here.robot.move(2.0, on_progress=fail)
    await asyncio.sleep(0.01)
    assert here.is_zero


class _RefusedSender:
    """Sender whose commands are refused."""

    def newest(self, _: str) -> int:
        return 0

    number_of = newest

    def next_number(self) -> int:
        return 0

    def notice_sleep(self) -> None:
        """Do nothing."""

    async def drive(self, *_: object, **__: object) -> None:
        raise HostlinkError("locked")


def test_motion_that_is_cancelled_while_its_refusal_ends_it_is_cancelled() -> None:
    """A program that suppresses the refusal would drive on otherwise."""
    is_closing = asyncio.Event()

    async def odometry() -> AsyncIterator[Any]:
        try:
            while True:
                yield {"age_s": 0.0, "pose": {"x_m": 0.0, "y_m": 0.0, "theta_rad": 0.0}}
                await asyncio.sleep(0.01)
        finally:
            is_closing.set()
            await asyncio.sleep(0.1)

    async def test() -> None:
        sender = cast(VelocitySender, _RefusedSender())
        async with asyncio.TaskGroup() as tasks:
            moving = tasks.create_task(follow(sender, "robot_0", 0, line(1.0, 0.3, None), odometry(), None, Begin()))
            await is_closing.wait()
            moving.cancel()
        assert moving.cancelled()

    run_virtual(test())


@inside(in_world)
async def test_motion_without_any_odometry_does_not_begin(here: World) -> None:
    here.is_silent = True
    await asyncio.sleep(1.0)  # the known pose is old
    with pytest.raises(HostlinkError, match="no odometry arrived for 3 s"):
        await here.robot.move(1.0)
    assert here.is_zero


@pytest.mark.parametrize(
    ("motion", "problem"),
    [
        (lambda robot: robot.move(math.nan), "metres is nan"),
        (lambda robot: robot.move(1.0, speed_m_s=-0.2), "speed_m_s is -0.2; pass at least 0.02"),
        (lambda robot: robot.turn(1.0, speed_rad_s=0.01), "speed_rad_s is 0.01; pass at least 0.05"),
        (lambda robot: robot.turn(1.0, timeout_s=0.0), "timeout_s is 0; pass a positive"),
        (lambda robot: robot.drive(0.1, 0.0, for_s=math.inf), "for_s is inf; pass a positive"),
    ],
)
@inside(in_world)
async def test_motion_with_an_invalid_number_is_refused(
    here: World, motion: Callable[[Robot], Awaitable[Motion]], problem: str
) -> None:
    with pytest.raises(HostlinkError, match=problem) as caught:
        await motion(here.robot)
    assert caught.value.kind == "BadRequest"


@inside(in_world)
async def test_end_of_all_motions_keeps_the_notice_of_a_velocity_that_was_broken_off(here: World) -> None:
    driver = here.me._driver
    await here.robot.drive(0.1, 0.0)
    here.me.lose()
    driver.give_up()
    assert not here.robot.is_driven
    with pytest.raises(HostlinkError, match="the network is cut"):
        await here.robot.drive(0.1, 0.0)
    await here.robot.drive(0.1, 0.0, resume=True)  # a drive after the end is a new one
    assert here.robot.is_driven
    await here.me.stop_driven()


@pytest.mark.parametrize("motion", MOTIONS[1:], ids=NAMES[1:])
@inside(in_world)
async def test_end_of_all_motions_ends_one_that_has_not_commanded_and_no_later_one(
    here: World, motion: Callable[[Robot], Awaitable[Motion]]
) -> None:
    here.is_silent = True
    await asyncio.sleep(3.0)  # the poses of before are old
    waiting = here.made.tasks.create_task(as_coroutine(motion(here.robot)))
    await asyncio.sleep(0.5)
    here.me._driver.give_up()
    here.is_silent = False
    assert (await waiting).kind == "program"
    assert here.is_zero
    assert (await here.robot.move(0.2)).is_reached


@pytest.mark.parametrize("way", ["move", "turn"])
def test_motion_of_a_robot_without_a_pose_is_refused_at_once(way: str) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect([topic(EndpointKind.SUBSCRIBER, 100, "/car/cmd_vel", "geometry_msgs/Twist")])
        async with cancelling() as tasks, memory_host(made.hub, tasks) as host:
            began_s, before = made.now_s, len(device.payloads(100))
            with pytest.raises(BadRequest, match="car has no odometry, so that no distance"):
                await getattr(host.robot("car"), way)(1.0)
            assert (made.now_s, len(device.payloads(100))) == (began_s, before)

    in_hub(test)
