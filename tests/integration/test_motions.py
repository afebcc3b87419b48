"""Motions of a script on a simulated robot next to a neighbour that misbehaves."""

import asyncio
import contextlib
import threading

import pytest

from hostlink.client import BlockingHost, MotionOutcome, Progress, connect, connect_blocking
from hostlink.errors import HostlinkError
from hostlink.workbench.sim.firmware_world import RobotKind
from tests.support.daemon import Daemon, daemon
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect


@pytest.mark.long
async def test_move_and_turn_arrive_beside_a_neighbour_that_misbehaves() -> None:
    """The neighbour floods the daemon, locks and drives its own robot, and names robots that are not there."""

    async def misbehave(url: str) -> None:
        async with connect(url) as neighbour:
            mine, missing = neighbour.robot("robot_1"), neighbour.robot("robot_9")
            while True:
                for robot in (mine, missing):
                    await robot.command(-0.5, 2.0)
                with contextlib.suppress(HostlinkError):
                    await mine.drive(float("nan"), 0.0)
                await mine.lock("a defect", wait_s=0)
                with contextlib.suppress(HostlinkError):
                    await mine.move(1.0)
                await mine.unlock()
                await neighbour.publish("/noise", {"data": "x" * 10_000}, type_name="std_msgs/String")
                await asyncio.sleep(0.01)

    async with (
        daemon() as host,
        simulated_robot(host.tcp, kind=RobotKind.NIMBLE) as robot,
        simulated_robot(host.tcp, "robot_1", kind=RobotKind.NIMBLE),
    ):
        await expect(lambda: len(host.hub.robots.all()) == 2)
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 0)
        async with connect(host.url) as me, asyncio.TaskGroup() as tasks:
            neighbour = tasks.create_task(misbehave(host.url))
            moved = await me.robot("robot_0").move(0.4, speed_m_s=0.3)
            turned = await me.robot("robot_0").turn(-1.0)
            neighbour.cancel()
        assert (moved.outcome, moved.reason) == (MotionOutcome.REACHED, "")
        assert moved.distance_m == pytest.approx(0.4, abs=0.05)
        assert turned.turned_rad == pytest.approx(-1.0, abs=0.15)
        await expect(lambda: abs(robot.speed_m_s) < 0.01)


async def test_progress_of_a_blocking_move_is_reported_in_the_callers_thread_and_may_stop_the_robot() -> None:
    def script(me: BlockingHost, host: Daemon) -> None:
        robot = me.robot("robot_0")
        threads = set[threading.Thread]()

        def show(progress: Progress) -> None:
            threads.add(threading.current_thread())
            if progress.distance_m > 0.1:
                robot.stop(wait_s=0)

        result = robot.move(2.0, on_progress=show)
        assert (result.outcome, result.by) == (MotionOutcome.STOPPED, "this program") or host.was_paused
        assert threads == {threading.current_thread()}

        def fail(_: Progress) -> None:
            raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            robot.move(2.0, on_progress=fail)

    async with daemon() as host, simulated_robot(host.tcp, kind=RobotKind.NIMBLE) as robot:
        await expect(lambda: bool(host.hub.robots.all()) and host.hub.robots.find("robot_0").odometry.count > 0)

        def connected() -> None:
            with connect_blocking(host.url) as me:
                script(me, host)

        await asyncio.to_thread(connected)
        await expect(lambda: abs(robot.speed_m_s) < 0.01)
        await expect(lambda: host.hub.robots.find("robot_0").gate.owner_name is None)
