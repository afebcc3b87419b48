"""hostlink.client against the daemon as a process that is killed; and a script that does not run for a while."""

import asyncio
import time

import pytest

from hostlink.client import connect
from hostlink.errors import HostlinkError
from tests.support.driving import hold
from tests.support.process import free_port, serve, simulated
from tests.support.simulated import simulated_robot
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S, expect

pytestmark = pytest.mark.quiet


async def test_a_daemon_that_is_killed_and_started_again_while_a_script_drives() -> None:
    device_port, api_port = free_port(), free_port()
    ports = ("--listen", f"127.0.0.1:{device_port}", "--api", f"127.0.0.1:{api_port}")
    async with simulated_robot(("127.0.0.1", device_port)) as body, serve(*ports) as first:
        await first.read_log("robot.appeared")
        async with connect(first.url) as me:
            changes, robot = me.connection(), me.robot("robot_0")
            await hold(robot, 0.2, 0.0)
            await expect(lambda: body.speed_m_s > 0.02)
            odometry = robot.odometry()
            await anext(odometry)
            first.child.kill()
            watch = Stopwatch()
            async with asyncio.timeout(TIMEOUT_S):
                assert (await anext(changes)).dropped == ("robot_0",)
            assert watch.seconds < 1.0
            await expect(lambda: abs(body.speed_m_s) < 0.005)  # by its own watchdog: no program could stop it
            with pytest.raises(HostlinkError, match="the connection"):
                await robot.drive(0.2, 0.0)
            async with serve(*ports) as second:
                await second.read_log("robot.appeared")
                async with asyncio.timeout(TIMEOUT_S):
                    assert (await anext(changes)).is_connected
                    await anext(odometry)
                assert (await robot.state())["holder"] is None
                assert abs(body.speed_m_s) < 0.005
                await hold(robot, 0.1, 0.0)  # the loss was told by the drive before
                await expect(lambda: body.speed_m_s > 0.02)


async def test_script_that_did_not_run_for_a_while_stays_connected_and_repeats_no_velocity() -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        async with connect(daemon.url) as me:
            changes, robot = me.connection(), me.robot("robot_0")
            await hold(robot, 0.2, 0.0)
            time.sleep(0.9)  # noqa: ASYNC251 - what the test is about
            await expect(lambda: not robot.is_driven)
            with pytest.raises(HostlinkError, match=r"this program did not run, or could not send, for \d\.\d s"):
                await robot.drive(0.2, 0.0)
            await me.settle()
            assert changes.pop_all() == []
