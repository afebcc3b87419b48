"""The panel of topics: rates, values, plots of fields, a form that publishes; and the bounds of lists."""

import asyncio
import csv
import re
import time
from pathlib import Path

import pytest
from axe_playwright_python.async_playwright import Axe
from playwright.async_api import Browser
from playwright.async_api import expect as expect_page

from tests.support.browser import Visit, visit
from tests.support.daemon import Daemon, daemon
from tests.support.rosbridge import client
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

pytestmark = [pytest.mark.asyncio(loop_scope="session"), pytest.mark.long]

WATCH = "localStorage.setItem('hostlink.layout', 'Watch')"
HOSTILE = '<img src=x onerror="window.hit = 1">'
MANY = 250
MANY_LINES = 600
SILENT_S = 2.5  # the page ends a stream that is silent for 2 s
LISTED = 200
LINES = 500


async def open_topic(tab: Visit, name: str) -> None:
    await tab.page.get_by_label("Filter topics").fill(name)
    await tab.page.locator("#topics .topics").get_by_role("button", name=name).first.click()
    await tab.shows("#topics h3", name)


async def test_a_topic_is_listed_read_plotted_saved_and_published(browser: Browser, tmp_path: Path) -> None:
    async with daemon() as host, simulated_robot(host.tcp), visit(browser, host.url, script=WATCH) as tab:
        page = tab.page
        await tab.shows("#robots", "no driver")
        await tab.shows("#topics .topics", "/robot_0/plot_data")
        row = page.locator("#topics .topics li", has_text="/robot_0/plot_data")
        await expect_page(row).to_contain_text("geometry_msgs/Twist")
        await expect_page(row).to_contain_text(" Hz")
        await open_topic(tab, "/robot_0/plot_data")
        await page.get_by_label("Plot linear.x").check()
        await page.get_by_label("Plot angular.z").check()
        chart = page.locator("#topics .chart")
        await expect_page(chart.locator(".legend")).to_contain_text("angular.z")
        await expect_page(chart.locator(".uplot")).to_have_attribute("data-count", re.compile(r"\d\d+"))
        await page.get_by_role("button", name="Topic: pause").click()
        async with page.expect_download() as started:
            await page.get_by_role("button", name="Save the plotted values as CSV").click()
        await (await started.value).save_as(tmp_path / "table.csv")
        with (tmp_path / "table.csv").open(newline="") as file:
            names, *rows = csv.reader(file)
        assert (names, len(rows) > 3) == (["time_s", "linear.x", "angular.z"], True)
        await page.get_by_label("Plot linear.x").uncheck()
        await expect_page(chart.locator(".legend")).not_to_contain_text("linear.x")
        found = await Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        await page.get_by_role("button", name="All topics").click()
        await expect_page(row.get_by_role("button")).to_be_focused()
        await publish_a_velocity(host, tab)
        assert tab.complaints == []


async def publish_a_velocity(host: Daemon, tab: Visit) -> None:
    """Publish by the form, through the gate; the page names the reason of a refusal."""
    page, robot = tab.page, host.hub.robots.find("robot_0")
    await open_topic(tab, "/robot_0/velocity_commands")
    await page.locator("#topics summary").click()
    forward = page.locator("#topics fieldset", has_text="linear").get_by_label("x")
    send = page.locator("#topics form").get_by_role("button", name="Publish")
    size = page.viewport_size
    assert size is not None
    await page.set_viewport_size({"width": 1366, "height": 768})
    await expect_page(send).to_be_in_viewport(ratio=1.0)  # also while its fields need more room
    await page.set_viewport_size(size)
    await forward.fill("")
    await send.click()
    await tab.shows("#topics form", "linear.x: enter a number (float64).")
    await forward.fill("0.05")
    await send.click()
    await tab.shows("#topics form", "Sent at")
    await expect(lambda: robot.gate.counts.commands > 0)
    robot.lock("somebody stands there")
    await send.click()
    await tab.shows("#topics form", "locked")


async def test_lists_are_bounded_and_texts_stay_text(browser: Browser) -> None:
    async with daemon() as host, visit(browser, host.url, script=WATCH) as tab, client(host) as program:
        for number in range(MANY):
            await program.send(op="advertise", topic=f"/many/topic_{number}", type="std_msgs/String")
        await tab.shows("#topics", f"the first {LISTED} are shown")
        assert await tab.page.locator("#topics .topics li").count() == LISTED
        await tab.page.get_by_label("Filter topics").fill("topic_249")
        await expect_page(tab.page.locator("#topics .topics li")).to_have_count(1)
        await open_topic(tab, "/many/topic_249")
        await expect(lambda: len(host.hub.topics.find("/many/topic_249").subscribers) > 0)
        await program.send(op="publish", topic="/many/topic_249", msg={"data": HOSTILE + "y" * 1000})
        await tab.shows("#topics .tree", HOSTILE)
        await tab.shows("#topics .tree", "characters)")
        host.hub.join("a program").advertise("/rosout", "rosgraph_msgs/Log")
        for number in range(MANY_LINES):
            line = {"level": 8, "name": "a program", "msg": f"{HOSTILE} {number}"}
            await program.send(op="publish", topic="/rosout", msg=line)
            await asyncio.sleep(0.002)  # more than a reader is kept at once are counted, not sent
            if number == MANY_LINES - 10:
                time.sleep(SILENT_S)  # noqa: ASYNC251 - the daemon hangs: the page connects again, and misses no line
        await tab.shows("#log", f"{HOSTILE} {MANY_LINES - 1}")
        assert await tab.page.locator("#log li").count() <= LINES
        assert await tab.page.evaluate("window.hit ?? document.querySelectorAll('img').length") == 0
        assert tab.complaints == []
