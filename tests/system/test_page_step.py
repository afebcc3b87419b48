"""The step on the page: it drives while its button is held, and shows what the wheels made of it."""

import asyncio
import contextlib
import csv
import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from playwright.async_api import Browser
from playwright.async_api import expect as expect_page

from hostlink.core.config import Config, RobotConfig
from tests.support.browser import Visit, visit
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.simulated import DisturbedRobot, simulated_robot
from tests.support.waiting import expect, expect_never

pytestmark = [pytest.mark.asyncio(loop_scope="session"), pytest.mark.long]

PAPER = Config(robots={"robot_0": RobotConfig(wheel_separation_m=0.210, max_wheel_m_s=0.3436)})
HOSTILE = "<img src=x onerror='window.hit = 1'>"
SLOW = "localStorage.setItem('hostlink.max.linear', '0.06')"


@contextlib.asynccontextmanager
async def bench(browser: Browser) -> AsyncIterator[tuple[Daemon, DisturbedRobot, Visit]]:
    async with (
        daemon(PAPER) as host,
        simulated_robot(host.tcp) as robot,
        visit(browser, host.url, script=SLOW) as tab,
    ):
        await tab.is_connected()
        await tab.layout("Tune")
        await tab.page.locator("#step:enabled").wait_for()
        plot = tab.page.locator("#plot-left .uplot")
        await expect_page(plot).to_have_attribute(
            "data-count", re.compile("^[1-9]")
        )  # the page knows that it is stopped
        yield host, robot, tab
        assert tab.complaints == []


def speed_m_s(host: Daemon) -> float:
    return float(host.hub.robots.find("robot_0").gate.current.x_m_s)


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
            rise, overshoot, *_ = [await cell.inner_text() for cell in await tab.page.locator(f"{row} td").all()]
            assert 0.3 < float(rise.removesuffix(" s")) < 2.5
            assert float(overshoot.removesuffix(" %")) < 10


async def test_a_short_step_has_no_figures(browser: Browser) -> None:
    async with bench(browser) as (host, _, tab):
        await press(tab)
        await expect(lambda: speed_m_s(host) > 0)
        await tab.page.mouse.up()
        await tab.shows("#step-state", "Too short")
        await tab.shows("#step-left", "–")


async def test_enter_holds_the_step_button_and_the_stop_ends_the_step(browser: Browser) -> None:
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
        await expect_never(lambda: speed_m_s(host) != 0, for_s=1.0)
        await tab.shows("#step-left", "–")
        await tab.page.mouse.up()


async def test_a_robot_whose_plot_data_falls_silent_is_stopped(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        await press(tab)
        await expect(lambda: robot.speed_m_s > 0.01)
        robot.is_plot_silent = True
        await tab.shows("#step-state", "plot_data is missing")
        await expect(lambda: speed_m_s(host) == 0)
        await tab.page.mouse.up()


async def test_a_robot_that_rolls_begins_no_step(browser: Browser) -> None:
    async with bench(browser) as (host, robot, tab):
        robot.world.wheels[0].grip(100.0)
        await expect(lambda: robot.world.now("left_measured_ticks_s") > 10)
        await asyncio.sleep(0.3)
        await press(tab)
        await tab.shows("#step-state", "Stop the robot before a step")
        assert speed_m_s(host) == 0
        await tab.page.mouse.up()


async def test_a_robot_without_plot_data_has_no_step(browser: Browser) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, visit(browser, host.url) as tab:
        await device.send(pose(1.0))
        await tab.shows("#pose", "1.00 m")
        assert await tab.page.locator("#step").is_disabled()


async def test_the_run_before_stays_as_a_ghost_and_a_run_is_saved_as_a_table(browser: Browser, tmp_path: Path) -> None:
    async with bench(browser) as (host, robot, tab):
        page = tab.page
        ghost = page.locator("#steps .legend b").first
        for _ in range(2):
            await press(tab)
            await expect(lambda: robot.world.now("left_measured_ticks_s") > 10.0)
            await asyncio.sleep(0.2)  # two messages of plot_data have it
            await page.mouse.up()
            await expect(lambda: speed_m_s(host) == 0 and robot.speed_m_s == 0)
            await asyncio.sleep(0.3)  # a message of plot_data: it must stand
        await expect_page(ghost).not_to_have_text("–")
        async with page.expect_download() as started:
            await page.locator("#step-csv").click()
        await (await started.value).save_as(tmp_path / "step.csv")
        with (tmp_path / "step.csv").open(newline="") as file:
            names, *rows = csv.reader(file)
        assert names == ["time_s", "left_set_point", "left_measured", "right_set_point", "right_measured"]
        assert max(float(row[2]) for row in rows) > 1


async def test_gains_are_kept_under_a_name(browser: Browser) -> None:
    async with bench(browser) as (_, robot, tab):
        page = tab.page
        await page.get_by_label("Left Kp").fill("17.5")
        await page.get_by_label("Save these as").fill(HOSTILE)
        await page.get_by_role("button", name="Save", exact=True).click()
        await page.get_by_label("Left Kp").fill("3")
        await page.reload()
        await page.locator("#step:enabled").wait_for()
        await page.get_by_label("Saved gains").select_option(HOSTILE)
        assert await page.get_by_label("Left Kp").input_value() == "17.5"
        assert robot.controls[0].kp != 17.5  # choosing sends nothing
        await page.get_by_role("button", name="Remove the chosen gains").click()
        await expect_page(page.get_by_label("Saved gains").locator("option")).to_have_count(1)
        assert await page.locator("img").count() == 0
