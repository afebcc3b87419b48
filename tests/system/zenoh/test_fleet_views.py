"""A fleet as its users have it: page, client, echo, pub and top show and drive a robot wherever it is."""

import asyncio
import contextlib
import json

import pytest
from playwright.async_api import Browser

from hostlink.client import connect
from hostlink.core.config import Config, LinkConfig
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.browser import visit
from tests.support.driving import hold
from tests.support.fake_device import fake_device, pose, repeating, robot_topics
from tests.support.process import run
from tests.support.waiting import expect
from tests.support.zenoh_fleet import fleet, shown

pytestmark = pytest.mark.quiet

STILL = (0.0, 0.0)


@pytest.mark.asyncio(loop_scope="session")
async def test_every_page_shows_thirty_robots_of_three_daemons_and_drives_one_of_another(browser: Browser) -> None:
    patient = Config(link=LinkConfig(idle_timeout_s=None))  # these robots send one pose
    async with fleet("a", "b", "c", config=patient) as hosts, contextlib.AsyncExitStack() as stack:
        devices = {}
        for number in range(30):
            name = f"robot_{number}"
            topics = robot_topics(name)
            devices[name] = await stack.enter_async_context(fake_device(hosts[number // 10].tcp, topics))
            await devices[name].send(pose(number / 10))
        for host in hosts:
            await expect(lambda: sum(robot.link is not None for robot in host.hub.robots.all()) == 30)  # noqa: B023
        for host in hosts:
            page = await stack.enter_async_context(visit(browser, host.url))
            await page.is_connected()
            await page.until("document.querySelectorAll('#robots .robot label').length === 30")
            assert page.complaints == []
            if host is not hosts[2]:
                await page.page.close()
        await stack.enter_async_context(repeating(devices["robot_7"], pose(1.0)))  # a silent one is not driven
        await page.page.locator("#robots .robot label", has_text="robot_7").first.click()
        await page.shows("#robots .robot:has(input:checked)", " · at a")
        await page.page.evaluate("document.activeElement.blur()")  # keys in a field are letters
        await page.page.keyboard.down("KeyW")
        linear, _ = await devices["robot_7"].velocity_other_than(STILL)
        assert linear > 0
        await page.shows("#drive-state", "You drive")
        await page.page.keyboard.up("KeyW")
        await devices["robot_7"].velocity_of(STILL)
        assert page.complaints == []


@pytest.mark.long
async def test_a_script_drives_and_reads_a_robot_of_another_daemon() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await shown(a, "robot_7")
        async with connect(a.url) as host:
            robot = host.robot("robot_7")
            await device.send(pose(1.5))
            poses = robot.odometry()
            assert (await anext(poses))["pose"]["x_m"] == 1.5
            await device.send(pose(2.5))
            assert (await anext(poses))["pose"]["x_m"] == 2.5
            await hold(robot, 0.2, 0.0)
            assert await device.velocity_other_than(STILL) == (0.2, 0.0)
            gate = b.hub.robots.find_here("robot_7").gate
            await expect(lambda: gate.counts.commands > 5)  # it is repeated
            assert gate.owner is not None
            await robot.stop()
            assert await device.velocity_other_than((0.2, 0.0)) == STILL
            await robot.lock("a test")
            with pytest.raises(CommandRefused, match="locked") as refused:
                await robot.drive(0.2, 0.0)
            assert refused.value.kind is RefusalKind.LOCKED
            await robot.unlock()
            await robot.drive(0.0, 0.0)  # it lets go
            await hold(robot, 0.1, 0.0)
            device.hang_up()
            await expect(lambda: not robot.is_driven)


async def test_commands_reach_a_robot_of_another_daemon() -> None:
    async with (
        fleet("a", "b") as (a, b),
        fake_device(b.tcp, robot_topics("robot_7")) as device,
        repeating(device, pose(0.0)),  # else its link ends before the commands on a busy machine
    ):
        await shown(a, "robot_7")
        await expect(lambda: a.hub.topics.find_or_none("/robot_7/odometry"))
        status, out, _ = await run("top", "--once", "--url", a.url)
        assert status == 0
        (line,) = (line for line in out.splitlines() if line.startswith("robot_7"))
        assert "at b" in line
        status, out, _ = await run("top", "--once", "--json", "--url", a.url)
        (robot,) = json.loads(out)["robots"]
        assert (robot["name"], robot["host"], robot["connected"]) == ("robot_7", "b", True)
        status, out, _ = await run("topics", "--url", a.url)
        assert "/robot_7/odometry" in out
        twist = '{"linear": {"x": 0.2}}'
        async with asyncio.TaskGroup() as tasks:
            publishing = tasks.create_task(run("pub", "/robot_7/cmd_vel", twist, "--count", "5", "--url", a.url))
            assert await device.velocity_other_than(STILL) == (0.2, 0.0)
            status, _, error = await publishing
            status, _, error = await publishing
            assert status == 0, error
        assert await device.velocity_other_than((0.2, 0.0)) == STILL
