"""The page of the documents on which the firmware drives, from a file, in a real browser."""

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from playwright.async_api import Browser

from tests.support.browser import Visit, visit
from tools import try_page

pytestmark = pytest.mark.asyncio(loop_scope="session")

LONGEST_S = 20.0
PLACE = re.compile(r"x (-?[\d.]+) m, y (-?[\d.]+) m, (-?\d+)°")


@contextlib.asynccontextmanager
async def opened(browser: Browser, folder: Path) -> AsyncIterator[Visit]:
    file = folder / "try.html"
    try_page.write(file)
    async with visit(browser, file.as_uri()) as tab:
        await tab.shows("#log", "robot is ready")
        yield tab


async def place(tab: Visit, name: str = "truth") -> tuple[float, float, float]:
    found = PLACE.fullmatch(await tab.page.locator(f"#{name}").inner_text())
    assert found is not None
    return float(found[1]), float(found[2]), float(found[3])


async def comes_to(tab: Visit, is_there: Callable[[float, float, float], bool]) -> None:
    async with asyncio.timeout(LONGEST_S):
        while not is_there(*await place(tab)):  # noqa: ASYNC110 - the page sends no event
            await asyncio.sleep(0.05)


async def stands(tab: Visit) -> None:
    await tab.shows("#speeds", "left 0 ticks/s, right 0 ticks/s")


async def test_robot_drives_by_keys_and_stands_when_they_are_let_go(browser: Browser, tmp_path: Path) -> None:
    async with opened(browser, tmp_path) as tab:
        await tab.page.keyboard.down("ArrowUp")
        await comes_to(tab, lambda x, y, _: x > 0.2 and abs(y) < 0.05)
        await tab.page.keyboard.up("ArrowUp")
        await stands(tab)
        assert (await place(tab))[0] == pytest.approx((await place(tab, "believed"))[0], abs=0.02)
        await tab.page.keyboard.down("KeyA")
        await comes_to(tab, lambda _x, _y, degrees: degrees > 30)
        await tab.page.evaluate("window.dispatchEvent(new Event('blur'))")
        await stands(tab)
        assert (tab.complaints, tab.other_hosts) == ([], [])


@pytest.mark.long
async def test_robot_drives_by_a_drag_to_the_left_and_stands_when_it_ends(browser: Browser, tmp_path: Path) -> None:
    async with opened(browser, tmp_path) as tab:
        mouse, box = tab.page.mouse, await tab.page.locator("#floor").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        await mouse.move(x, y)
        await mouse.down()
        await mouse.move(x - 60, y - 60)
        await comes_to(tab, lambda x, y, degrees: x > 0.05 and y > 0.02 and degrees > 20)
        await mouse.up()
        await stands(tab)
        assert tab.complaints == []


async def test_held_wheel_stops_the_robot_with_a_line_in_its_log(browser: Browser, tmp_path: Path) -> None:
    async with opened(browser, tmp_path) as tab:
        await tab.page.get_by_role("button", name="Hold the left wheel").click()
        await tab.page.keyboard.down("KeyW")
        await tab.shows("#log", "left wheel stalled: no edge at PWM", timeout_s=LONGEST_S)
        await stands(tab)


@pytest.mark.long
async def test_other_world_begins_again_and_odometry_errs_in_it(browser: Browser, tmp_path: Path) -> None:
    async with opened(browser, tmp_path) as tab:
        await tab.page.get_by_label("World").select_option(label="the left wheel is 2 % larger")
        await tab.shows("#truth", "x 0.00 m")
        await tab.shows("#log", "robot is ready")
        await tab.page.locator("#floor").focus()
        await tab.page.keyboard.down("KeyW")
        await comes_to(tab, lambda x, _y, degrees: x > 0.3 and degrees < -1)
        await tab.page.keyboard.up("KeyW")
        await stands(tab)
        assert abs((await place(tab, "believed"))[2]) <= 1


async def test_page_without_the_module_says_how_it_is_built(browser: Browser) -> None:
    async with visit(browser, try_page.SOURCE.as_uri()) as tab:
        await tab.shows("#log", "make docs builds build/docs/try.html")
        assert tab.complaints == []
