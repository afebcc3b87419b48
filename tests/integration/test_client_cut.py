"""The network between a script and the daemon is cut in every way: the robot stops, the script learns it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

import pytest

from hostlink.client import ConnectionChange, Host, Robot, connect
from hostlink.client.mailbox import Mailbox
from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import HostlinkError
from hostlink.workbench.sim.robot import SimulatedRobot
from tests.support.daemon import Daemon, daemon
from tests.support.proxy import Line, Proxy, proxy
from tests.support.simulated import simulated_robot
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S, expect, expect_never

NOTICED_S = 1.0
STALLED_S = 0.4  # the client counts 0.6 s without a word as a loss, and the last word may be 0.2 s old
STOPPED_M_S = 0.005


@dataclass
class World:
    """Robot that a script drives over a connection that can be cut."""

    host: Daemon
    line: Proxy
    me: Host
    robot: Robot
    body: SimulatedRobot
    changes: Mailbox[ConnectionChange]

    @property
    def known(self) -> AnyRobot:
        """The robot in the daemon."""
        return self.host.hub.robots.find("robot_0")

    async def change(self) -> ConnectionChange:
        async with asyncio.timeout(TIMEOUT_S):
            return await anext(self.changes)

    async def lost(self) -> ConnectionChange:
        """The loss, as the script learns it, within a second of now."""
        watch = Stopwatch()
        change = await self.change()
        assert watch.seconds < NOTICED_S or self.host.was_paused
        assert (change.is_connected, self.me.is_connected) == (False, False)
        return change

    async def moves(self, robot: Robot) -> None:
        """Drive until the robot moves, because a pause of this process breaks a drive off."""
        async with asyncio.timeout(TIMEOUT_S):
            while self.body.speed_m_s < 0.02:
                with contextlib.suppress(HostlinkError):
                    await robot.drive(0.2, 0.0, resume=True)
                await asyncio.sleep(0.1)

    async def stands(self) -> None:
        """Check that the robot is stopped, in the daemon's view and in its world."""
        await expect(lambda: self.known.gate.owner_name is None and self.known.gate.current.is_zero)
        await expect(lambda: abs(self.body.speed_m_s) < STOPPED_M_S)

    async def stays(self, seconds: float = 0.4) -> None:
        """Check that the robot is not driven and does not move."""
        await expect_never(
            lambda: self.known.gate.owner_name is not None or abs(self.body.speed_m_s) > STOPPED_M_S, for_s=seconds
        )


@contextlib.asynccontextmanager
async def driven() -> AsyncIterator[World]:
    async with (
        daemon() as host,
        simulated_robot(host.tcp) as body,
        proxy(("127.0.0.1", int(host.url.rpartition(":")[2]))) as line,
        connect(line.url) as me,
    ):
        robot = me.robot("robot_0")
        world = World(host, line, me, robot, body, me.connection())
        await expect(lambda: world.known.link is not None)
        await world.moves(robot)
        yield world


async def drive_is_dropped(world: World) -> None:
    """The next drive raises; the program drives again when it resumes."""
    assert not world.robot.is_driven
    with pytest.raises(HostlinkError, match="robot_0 was stopped: ") as caught:
        await world.robot.drive(0.2, 0.0)
    assert "stopped: the connection" in str(caught.value) or world.host.was_paused
    await world.moves(world.robot)


@pytest.mark.parametrize("line", [Line.SWALLOWS, pytest.param(Line.STALLS, marks=pytest.mark.long)])
async def test_a_line_that_is_dead_is_noticed_within_a_second_and_the_robot_stands(line: Line) -> None:
    async with driven() as world:
        world.line.set_line(line)
        change = await world.lost()
        assert change.dropped == ("robot_0",) or world.host.was_paused
        assert "nothing was heard from it" in change.reason
        await world.stands()
        world.line.set_line(Line.WORKS)
        assert (await world.change()).is_connected
        assert world.me.is_connected
        await world.stays()
        await drive_is_dropped(world)


async def test_commands_that_a_full_tunnel_delivers_late_are_refused() -> None:
    async with driven() as world:
        world.line.set_line(Line.STALLS)
        await world.lost()
        commands = world.known.gate.counts.commands
        await world.stands()
        await world.stays(1.2 * LEASE_S)  # longer than the last command holds
        world.line.set_line(Line.WORKS)
        assert (await world.change()).is_connected
        await world.stays()
        assert world.known.gate.counts.commands == commands


@pytest.mark.parametrize("is_repeated", [True, False])
async def test_a_stop_that_overtakes_commands_on_their_way_stops_for_good(is_repeated: bool) -> None:
    async with driven() as world:
        if not is_repeated:
            await world.robot.stop()
        began_s = loop_time_s()
        world.line.set_line(Line.STALLS_SOCKETS)
        for _ in range(3):  # shorter than what counts as a loss
            if not is_repeated:
                await world.robot.command(0.2, 0.0)
            await asyncio.sleep(0.1)
        await world.robot.stop()
        gate = world.known.gate
        assert gate.owner_name is None
        world.line.set_line(Line.WORKS)
        stalled_s = loop_time_s() - began_s
        await expect(lambda: gate.owner_name is None and gate.current.is_zero)
        await expect_never(lambda: not gate.current.is_zero, for_s=0.3)
        assert world.me.is_connected or stalled_s > STALLED_S or world.host.was_paused


async def test_during_the_cut_every_call_raises_at_once() -> None:
    async with driven() as world:
        world.line.set_line(Line.SWALLOWS)
        with pytest.raises(HostlinkError, match=r"is lost: nothing was heard from it for 0\.6 s; it is made again by"):
            await world.me.call("/rosapi/get_time", {})  # under way when the line dies
        for attempt in (
            world.robot.drive(0.2, 0.0),
            world.me.publish("/chat", {"data": "x"}, type_name="std_msgs/String"),
            world.me.call("/rosapi/get_time", {}),
        ):
            watch = Stopwatch()
            with pytest.raises(HostlinkError) as caught:
                await attempt
            assert "the connection" in str(caught.value) or world.host.was_paused
            assert watch.seconds < 0.1 or world.host.was_paused


async def test_a_drive_that_is_under_way_when_the_line_dies_fails_and_is_not_repeated() -> None:
    async with driven() as world:
        world.line.set_line(Line.SWALLOWS)
        watch = Stopwatch()
        with pytest.raises(HostlinkError) as caught:
            await world.robot.drive(0.3, 0.0)
        assert "the connection" in str(caught.value) or world.host.was_paused
        assert watch.seconds < NOTICED_S or world.host.was_paused
        assert not world.robot.is_driven
        await world.stands()
        world.line.set_line(Line.WORKS)
        await expect(lambda: world.me.is_connected)
        await world.robot.drive(0.1, 0.0, resume=True)  # the loss was raised already


async def test_reconnection_after_a_reset_restores_subscriptions_and_advertisements() -> None:
    async with (
        driven() as world,
        world.me.subscribe("/robot_0/odometry") as poses,
        world.me.advertise("/chat", "std_msgs/String"),
    ):
        odometry, events = world.robot.odometry(), world.me.watch()
        await anext(odometry)
        await anext(events)
        world.line.break_off()
        assert (await world.lost()).dropped == ("robot_0",) or world.host.was_paused
        await world.stands()
        assert (await world.change()).is_connected
        poses.pop_all()
        await anext(poses)
        await anext(odometry)
        await anext(events)
        await expect(lambda: world.host.hub.topics.find("/chat").publishers)
        await drive_is_dropped(world)


async def test_each_of_several_cuts_is_reported() -> None:
    async with driven() as world:
        for _ in range(3):
            world.line.break_off()
            await world.lost()
            assert (await world.change()).is_connected


async def test_the_block_can_be_left_while_the_line_is_dead() -> None:
    async with driven() as world:
        await world.robot.stop(wait_s=0.0)
        async with connect(world.line.url) as other:
            await world.moves(other.robot("robot_0"))
            world.line.set_line(Line.SWALLOWS)
            watch = Stopwatch()
        assert watch.seconds < 4.0 or world.host.was_paused
        await world.stands()
