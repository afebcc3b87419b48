"""Reasons why a drive ended, in the log and in the drive history. An ordinary end is not reported as a lost command."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

import pytest

from hostlink.cli.driving import Action, Driving, Key
from hostlink.cli.teleop import KeyDriver, watched_robot
from hostlink.client import Host, connect
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


async def rest_stops(host: Daemon) -> None:
    await put(host, SPEED_M_S)
    await host.rest("POST", "/api/robots/robot_0/stop")


async def a_script_ends(host: Daemon) -> None:
    async with connect(host.url) as me:
        await me.robot("robot_0").drive(SPEED_M_S, 0.0)


async def a_script_fails(host: Daemon) -> None:
    with contextlib.suppress(ZeroDivisionError):
        async with connect(host.url) as me:
            await me.robot("robot_0").drive(SPEED_M_S, 0.0)
            raise ZeroDivisionError


async def a_script_of_single_commands_ends(host: Daemon) -> None:
    async with connect(host.url) as me:
        for _ in range(3):
            await me.robot("robot_0").command(SPEED_M_S, 0.0)
            await asyncio.sleep(0.1)


async def a_script_drives_zero_and_lives_on(host: Daemon) -> None:
    async with connect(host.url) as me:
        await me.robot("robot_0").drive(SPEED_M_S, 0.0)
        await me.robot("robot_0").drive(0.0, 0.0)
        await asyncio.sleep(0.8)


async def a_script_stops(host: Daemon) -> None:
    async with connect(host.url) as me:
        await me.robot("robot_0").drive(SPEED_M_S, 0.0)
        await me.robot("robot_0").stop()


async def keys(me: Host, *, is_quit: bool) -> None:
    robot = me.robot("robot_0", priority=60)
    driving = Driving(layout="original", linear_m_s=SPEED_M_S, angular_rad_s=0.5)
    async with watched_robot(me, await robot.state()) as watched:
        driver = KeyDriver(robot, driving, watched)
        loop = asyncio.get_running_loop()
        for tick in range(30):
            if tick in (0, 5):
                driving.receive(Key("w", Action.PRESSED if tick == 0 else Action.RELEASED), loop.time())
                if is_quit and tick == 5:
                    driving.stop()
                    await driver.finish()
                    return
            await driver.send_due()
            await asyncio.sleep(0.03)


async def a_key_is_released(host: Daemon) -> None:
    async with connect(host.url, reconnect=False) as me:
        await keys(me, is_quit=False)


async def teleop_ends(host: Daemon) -> None:
    async with connect(host.url, reconnect=False) as me:
        await keys(me, is_quit=True)


async def messages_end_with_a_zero(host: Daemon) -> None:
    """Publish a last zero, as rqt_robot_steering and teleop_twist_keyboard do."""
    async with connect(host.url) as me:
        for linear in (SPEED_M_S, SPEED_M_S, 0.0):
            await me.publish("/robot_0/velocity_commands", {"linear": {"x": linear}}, type_name="geometry_msgs/Twist")
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.6)


@pytest.mark.parametrize(
    ("drive", "reason"),
    [
        (rest_ends_with_a_zero, LET_GO),
        (rest_falls_silent, LEASE_ENDED),
        (rest_stops, WAS_STOPPED),
        (a_script_ends, OWNER_LEFT),
        (a_script_fails, OWNER_LEFT),
        (a_script_of_single_commands_ends, OWNER_LEFT),
        (a_script_drives_zero_and_lives_on, LET_GO),
        (a_script_stops, WAS_STOPPED),
        (a_key_is_released, LET_GO),
        (teleop_ends, OWNER_LEFT),
        (messages_end_with_a_zero, LET_GO),
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
