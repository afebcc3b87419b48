"""The page in a real browser: Debian's Chromium without windows, driven from the test."""

import asyncio
import contextlib
import math
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from playwright.async_api import Browser, ConsoleMessage, Page, Request, async_playwright, expect

from tests.support.waiting import TIMEOUT_S

POLL_S = 0.05
PAUSE_S = 0.3  # between two polls: the page may have taken it for a suspended computer
GIVEN_UP = "WebSocket is closed before the connection is established."  # by the page, which then tries again
EFFECT_S = 3.0  # for the effect of a key on a busy machine

expect.set_options(timeout=1000 * TIMEOUT_S)

CHROMIUM = "/usr/bin/chromium-headless-shell"  # without the windows of a whole browser: a visit costs half of the CPU
FLAGS = [
    "--no-sandbox",  # the tests may run as root
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
MEASURE = Path(__file__).with_name("page_measure.js").read_text(encoding="utf-8")
DRIVING_KEYS = ("KeyW", "KeyA", "ArrowUp")  # those that tests hold
DESK = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}


Act = Callable[[], Awaitable[object]]


@dataclass
class Visit:
    """One visit of the page, and the errors that the browser reported."""

    page: Page
    host: str
    complaints: list[str] = field(default_factory=list)
    other_hosts: list[str] = field(default_factory=list)

    def add_complaint(self, message: ConsoleMessage) -> None:
        is_complaint = message.type in ("error", "warning")  # a violation of the Content-Security-Policy is one of them
        if is_complaint and not message.text.endswith(GIVEN_UP):
            self.complaints.append(message.text)

    def add_request(self, request: Request) -> None:
        if urlsplit(request.url).netloc != self.host:
            self.other_hosts.append(request.url)

    async def shows(self, selector: str, text: str, *, timeout_s: float = TIMEOUT_S) -> None:
        await expect(self.page.locator(selector)).to_contain_text(text, timeout=1000 * timeout_s)

    async def until(self, expression: str, arg: Any = None) -> None:
        """Wait until an expression of the page is true. `wait_for_function` may not: the page forbids `eval`."""
        async with asyncio.timeout(TIMEOUT_S):
            while not await self.page.evaluate(expression, arg):  # noqa: ASYNC110 - the browser is another process
                await asyncio.sleep(POLL_S)

    async def is_connected(self, *, timeout_s: float = TIMEOUT_S) -> None:
        await self.shows("#connection", "connected", timeout_s=timeout_s)

    async def hold(self, key: str, is_so: Callable[[], object]) -> None:
        """Hold a key until a condition is true (`press_until`)."""
        keys = self.page.keyboard
        await self.press_until(lambda: keys.down(key), lambda: keys.up(key), is_so)

    async def drag_stick(self, right_px: float, up_px: float, is_so: Callable[[], object]) -> None:
        """Drag the joystick with the mouse until a condition is true (`press_until`)."""
        mouse, (x, y) = self.page.mouse, await self.stick()

        async def press() -> None:
            await mouse.move(x, y)
            await mouse.down()
            await mouse.move(x + right_px, y - up_px, steps=3)

        await self.press_until(press, mouse.up, is_so)

    async def hold_button(self, button: str, is_so: Callable[[], object]) -> None:
        """Hold a button of a test's gamepad until a condition is true (`press_until`)."""
        await self.press_until(
            lambda: self.page.evaluate(f"{button}.pressed = true"),
            lambda: self.page.evaluate(f"{button}.pressed = false"),
            is_so,
        )

    async def press_until(self, press: Act, release: Act, is_so: Callable[[], object]) -> None:
        """Press something until a condition is true.

        The page ends a motion when it has stood still for long, and so does the daemon. After a pause of the machine
        without the effect, it is therefore released and pressed again.
        """
        now_s = asyncio.get_running_loop().time
        await press()
        deadline_s, again_at_s = now_s() + TIMEOUT_S, math.inf
        while not is_so():
            polled_s = now_s()
            assert polled_s < deadline_s, f"it had no effect within {TIMEOUT_S:g} s"
            if polled_s >= again_at_s:
                await release()
                await press()
                again_at_s = math.inf
            await asyncio.sleep(POLL_S)
            if now_s() - polled_s > PAUSE_S:
                again_at_s = min(again_at_s, now_s() + EFFECT_S)

    async def layout(self, name: str) -> None:
        """Choose a layout: Drive, Tune, Fleet, Watch."""
        await self.page.locator("#layouts").get_by_role("button", name=name).click()

    async def faults(self) -> list[str]:
        """Return what leaves the window, overlaps, is hard to read or must be scrolled to."""
        found: list[str] = await self.page.evaluate(MEASURE)
        return found

    async def stick(self) -> tuple[float, float]:
        """The middle of the joystick."""
        await self.page.locator("#joystick").scroll_into_view_if_needed()
        box = await self.page.locator("#joystick").bounding_box()
        assert box is not None
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    async def map_has(self, name: str, pattern: str) -> None:
        """The map has attributes of what it drew: `points`, `length`."""
        await expect(self.page.locator("#map-canvas")).to_have_attribute(f"data-{name}", re.compile(pattern))


@contextlib.asynccontextmanager
async def chromium() -> AsyncIterator[Browser]:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            yield browser
        finally:
            await browser.close()


@contextlib.asynccontextmanager
async def visit(browser: Browser, url: str, *, script: str = "", **context: Any) -> AsyncIterator[Visit]:
    """Open the page as a new visitor; `script` runs before the page."""
    async with await browser.new_context(**{"viewport": DESK, **context}) as fresh:
        page = await fresh.new_page()
        new = Visit(page, urlsplit(url).netloc)
        page.on("console", new.add_complaint)
        page.on("pageerror", lambda error: new.complaints.append(str(error)))
        page.on("request", new.add_request)
        if script:
            await page.add_init_script(script)
        await page.goto(url)
        yield new


@contextlib.asynccontextmanager
async def revisit(tab: Visit, url: str) -> AsyncIterator[Visit]:
    """Open the page in a tab that is used again, at half of the CPU of `visit`. Nothing is kept or held after it."""
    tab.host = urlsplit(url).netloc
    tab.complaints.clear()
    tab.other_hosts.clear()
    await tab.page.goto(url)
    try:
        yield tab
    finally:
        await tab.page.mouse.up()
        for key in DRIVING_KEYS:
            await tab.page.keyboard.up(key)
        await tab.page.evaluate("() => [localStorage, sessionStorage].forEach((each) => each.clear())")
        await tab.page.goto("about:blank")
