"""Commands of teleop for a held key over the network. What a key does after an interruption: tests/unit/cli."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from hostlink.cli.driving import Driving, Key
from hostlink.cli.teleop import KeyDriver, watched_robot
from hostlink.client import HostlinkError, connect
from hostlink.robot.admission import LEASE_S
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.proxy import Line, Proxy, proxy
from tests.support.waiting import expect

ZERO = (0.0, 0.0)


class Keys:
    """A person at the keys."""

    def __init__(self, driving: Driving, driver: KeyDriver) -> None:
        self.driving, self.driver = driving, driver

    async def press(self, name: str, seconds: float) -> None:
        """The key repeats, and what is due is sent."""
        now_s = asyncio.get_running_loop().time
        until_s = now_s() + seconds
        while now_s() < until_s:
            self.driving.receive(Key(name), now_s())
            await self.driver.send_due()
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def at_the_keys(host: Daemon, url: str = "") -> AsyncIterator[Keys]:
    driving = Driving(layout="original", linear_m_s=0.2, angular_rad_s=0.8)
    async with connect(url or host.url, reconnect=False) as me:
        robot = me.robot("robot_0", priority=60)
        async with watched_robot(me, await robot.state()) as watched:
            yield Keys(driving, KeyDriver(robot, driving, watched))


async def test_pressed_key_drives_and_its_release_sends_zero() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, at_the_keys(host) as keys:
        await keys.press("w", 0.3)
        assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
        keys.driving.stop()
        await keys.driver.finish()
        assert await device.velocity_other_than((0.2, 0.0)) == ZERO
        assert keys.driver.refusal == ""


async def drive_until_the_line_dies(host: Daemon, line: Proxy) -> None:
    async with at_the_keys(host, line.url) as keys:
        await keys.press("w", 0.2)
        line.set_line(Line.STALLS)
        await keys.press("w", 2.0)


async def test_commands_that_a_network_delivers_late_move_nothing() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()),
        proxy(("127.0.0.1", int(host.url.rpartition(":")[2]))) as line,
    ):
        with pytest.raises(HostlinkError, match="nothing was heard"):
            await drive_until_the_line_dies(host, line)
        gate = host.hub.robots.find("robot_0").gate
        await expect(lambda: gate.owner_name is None)
        commands = gate.counts.commands
        await asyncio.sleep(1.2 * LEASE_S)
        line.set_line(Line.WORKS)
        await asyncio.sleep(0.5)
        assert (gate.counts.commands, gate.current.is_zero) == (commands, True)
