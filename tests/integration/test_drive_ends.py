"""Reasons why a drive ended, in the log and in the drive history. An ordinary end is not reported as a lost command."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from hostlink.cli.driving import Action, Driving, Key
from hostlink.cli.teleop import KeyDriver, watched_robot
from hostlink.client import connect
from hostlink.hub.robot_events import LEASE_ENDED, LET_GO, OWNER_LEFT, WAS_STOPPED, EventKind, RobotEvent
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.waiting import expect

Drive = Callable[[Daemon], Awaitable[None]]
SPEED_M_S = 0.2


async def put(host: Daemon, linear: float) -> None:
    body = b'{"linear": %f, "angular": 0.0}' % linear
    await host.drive("robot_0", body)


async def rest_ends_with_a_zero(host: Daemon) -> None:
    await put(host, SPEED_M_S)
    await put(host, 0.0)


async def rest_falls_silent(host: Daemon) -> None:
    await put(host, SPEED_M_S)


async def a_script_ends(host: Daemon) -> None:
    async with connect(host.url) as me:
        await me.robot("robot_0").drive(SPEED_M_S, 0.0)


async def a_script_drives_zero_and_lives_on(host: Daemon) -> None:
    async with connect(host.url) as me:
        await me.robot("robot_0").drive(SPEED_M_S, 0.0)
        await me.robot("robot_0").drive(0.0, 0.0)
        await asyncio.sleep(0.8)


async def a_script_stops(host: Daemon) -> None:
    async with connect(host.url) as me:
        await me.robot("robot_0").drive(SPEED_M_S, 0.0)
        await me.robot("robot_0").stop()


async def a_key_is_released(host: Daemon) -> None:
    driving = Driving(layout="original", linear_m_s=SPEED_M_S, angular_rad_s=0.5)
    async with connect(host.url, reconnect=False) as me:
        robot = me.robot("robot_0", priority=60)
        async with watched_robot(me, await robot.state()) as watched:
            driver = KeyDriver(robot, driving, watched)
            for tick in range(30):
                if tick in (0, 5):
                    action = Action.PRESSED if tick == 0 else Action.RELEASED
                    driving.receive(Key("w", action), asyncio.get_running_loop().time())
                await driver.send_due()
                await asyncio.sleep(0.03)


@pytest.mark.parametrize(
    ("drive", "reason"),
    [
        (rest_ends_with_a_zero, LET_GO),
        (rest_falls_silent, LEASE_ENDED),
        (a_script_ends, OWNER_LEFT),
        (a_script_drives_zero_and_lives_on, LET_GO),
        (a_script_stops, WAS_STOPPED),
        (a_key_is_released, LET_GO),
    ],
)
async def test_a_drive_ends_for_the_reason_that_there_was(drive: Drive, reason: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.has("robot_0"))
        ends: list[str] = []

        def note(event: RobotEvent) -> None:
            if event.kind is EventKind.STOPPED:
                ends.append(str(event.facts["reason"]))

        host.hub.events.observe("test", note)
        await drive(host)
        await expect(lambda: ends)
        await asyncio.sleep(0.1)
        assert ends == [reason]
