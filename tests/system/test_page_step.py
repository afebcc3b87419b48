"""The step on the page: it drives while its button is held, and shows what the wheels made of it."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from playwright.async_api import Browser

from hostlink.config import Config, RobotConfig
from hostlink.sim.robot import SimulatedRobot
from tests.support.browser import Visit, chromium, visit
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.quiet]

PAPER = Config(robots={"robot_0": RobotConfig(wheel_separation_m=0.210, max_wheel_m_s=0.3436)})
SLOW = "localStorage.setItem('hostlink.max.linear', '0.06')"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def browser() -> AsyncIterator[Browser]:
    async with chromium() as browser:
        yield browser


@contextlib.asynccontextmanager
async def bench(browser: Browser) -> AsyncIterator[tuple[Daemon, SimulatedRobot, Visit]]:
    async with (
        daemon(PAPER) as host,
        simulated_robot(host.tcp) as robot,
        visit(browser, host.url, script=SLOW) as tab,
    ):
        await tab.is_connected()
        await tab.page.locator("#step:enabled").wait_for()
        await asyncio.sleep(0.3)  # a message of plot_data: it must stand
        yield host, robot, tab
        assert tab.complaints == []


def speed_m_s(host: Daemon) -> float:
    return float(host.hub.robots.find("robot_0").gate.current.linear_x_m_s)


async def press(tab: Visit) -> None:
    await tab.page.locator("#step").hover()
    await tab.page.mouse.down()


async def test_a_step_is_driven_while_the_button_is_held_and_its_figures_are_shown(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        await press(tab)
        await expect(lambda: speed_m_s(host) == pytest.approx(0.06))
        await tab.shows("#step-state", "Hold until the speed is steady")
        await asyncio.sleep(3.0)
        await tab.page.mouse.up()
        await expect(lambda: speed_m_s(host) == 0)
        await expect(lambda: robot.speed_m_s == 0)
        for row in ("#step-left", "#step-right"):
            await tab.shows(row, "%")
            rise, overshoot, _ = [await cell.inner_text() for cell in await tab.page.locator(f"{row} td").all()]
            assert 0.3 < float(rise.removesuffix(" s")) < 2.5
            assert float(overshoot.removesuffix(" %")) < 10


async def test_a_short_step_has_no_figures(browser: Browser) -> None:
    async with bench(browser) as (host, _, tab):
        await press(tab)
        await expect(lambda: speed_m_s(host) > 0)
        await tab.page.mouse.up()
        await tab.shows("#step-state", "Too short")
        await tab.shows("#step-left", "–")


async def test_enter_holds_it_too_and_the_stop_ends_it(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        await tab.page.locator("#step").focus()
        await tab.page.keyboard.down("Enter")
        await expect(lambda: speed_m_s(host) > 0)
        await tab.page.keyboard.press("Escape")
        await expect(lambda: host.hub.robots.find("robot_0").gate.lock_reason is not None)
        await expect(lambda: robot.speed_m_s == 0)
        await tab.page.keyboard.up("Enter")


async def test_a_button_that_is_disabled_while_it_is_held_still_lets_go(browser: Browser) -> None:
    async with bench(browser) as (host, _, tab):
        await press(tab)
        await expect(lambda: speed_m_s(host) > 0)
        await tab.page.evaluate("document.querySelector('#step').disabled = true")
        await tab.page.mouse.up()
        await expect(lambda: speed_m_s(host) == 0)


async def test_leaving_the_window_lets_go(browser: Browser) -> None:
    async with bench(browser) as (host, _, tab):
        await press(tab)
        await expect(lambda: speed_m_s(host) > 0)
        await tab.page.evaluate("dispatchEvent(new Event('blur'))")
        await expect(lambda: speed_m_s(host) == 0)
        await tab.page.mouse.up()


FREEZE = "(ms) => { const end = performance.now() + ms; while (performance.now() < end); }"


async def test_a_page_that_froze_while_the_button_is_held_drives_no_second_step(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        await press(tab)
        await expect(lambda: robot.speed_m_s > 0.01)
        await tab.page.evaluate(FREEZE, 1500)
        await tab.shows("#step-state", "did not run for")
        await expect(lambda: speed_m_s(host) == 0 and robot.speed_m_s == 0)
        for _ in range(20):
            await asyncio.sleep(0.05)
            assert speed_m_s(host) == 0
        await tab.shows("#step-left", "–")
        await tab.page.mouse.up()


async def test_a_robot_whose_plot_data_falls_silent_is_stopped(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        await press(tab)
        await expect(lambda: robot.speed_m_s > 0.01)
        robot.is_plot_silent = True
        await tab.shows("#step-state", "fallen silent")
        await expect(lambda: speed_m_s(host) == 0)
        await tab.page.mouse.up()


async def test_a_robot_that_rolls_begins_no_step(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        robot.controllers[0].aim(100.0)
        await expect(lambda: robot.controllers[0].speed_ticks_s > 10)
        await asyncio.sleep(0.3)
        await press(tab)
        await tab.shows("#step-state", "begins with a robot that stands")
        assert speed_m_s(host) == 0
        await tab.page.mouse.up()


async def test_a_robot_without_plot_data_has_no_step(browser: Browser) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, visit(browser, host.url) as tab:
        await device.send(pose(1.0))
        await tab.shows("#pose", "1.00 m")
        assert await tab.page.locator("#step").is_disabled()
