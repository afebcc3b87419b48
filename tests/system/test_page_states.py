"""The page where something is missing: a robot, a token, a right. And its appearance, also for screen readers."""

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.async_playwright import Axe
from playwright.async_api import Browser

from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from tests.support.browser import DESK, PHONE, visit
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

pytestmark = [pytest.mark.asyncio(loop_scope="session"), pytest.mark.long]

DRIVE, READ = "a-token-of-a-driver", "a-token-of-a-watcher"
PICTURES = Path("build/screenshots")
PAPER = Config(robots={"robot_0": RobotConfig(wheel_separation_m=0.210, max_wheel_m_s=0.3436)})
TURN_RAD = float(
    os.environ.get("HOSTLINK_PICTURE_RAD", "0.1")
)  # how far it drives before the picture: make screenshots
SIZES: dict[str, dict[str, Any]] = {
    "phone": {"viewport": PHONE, "device_scale_factor": 2, "has_touch": True, "is_mobile": True},
    "desk": {"viewport": DESK},
}


async def test_page_without_a_robot_shows_how_to_get_one_and_that_one_is_gone(browser: Browser) -> None:
    async with daemon() as host, visit(browser, host.url) as tab:
        await tab.shows("#robots", "No robot yet")
        await tab.shows("#drive-state", "No robot yet")
        async with fake_device(host.tcp, robot_topics()) as device:
            await device.send(pose(1.0, -2.0))
            await tab.shows("#pose", "−2.00 m")
            await tab.shows("#plots-note", "no plot_data")
            await tab.shows("#tuning-state", "has no tuning topics")
        await tab.shows("#robots", "not connected")
        await tab.shows("#notice", "robot_0 is not connected")
        assert tab.complaints == []


async def test_played_robot_is_named_a_recording_instead_of_its_driver(browser: Browser) -> None:
    mark = topic(EndpointKind.PUBLISHER, 130, "/robot_0/played", "hostlink_msgs/PlayedRecording")
    async with (
        daemon() as host,
        visit(browser, host.url) as tab,
        fake_device(host.tcp, [*robot_topics(), mark]) as device,
    ):
        await device.send(pose(1.0, -2.0))
        await tab.shows("#drive-state", "A recording: it cannot be driven")
        await tab.shows("#robots", "a recording")


async def test_device_that_is_not_a_robot_is_explained(browser: Browser) -> None:
    async with daemon() as host, visit(browser, host.url) as tab:
        _, writer = await asyncio.open_connection(*host.tcp)
        writer.write(b"hello, this is no rosserial\r\n" * 20)
        await tab.shows("#link .diagnosis", "127.0.0.1")
        writer.close()


async def test_a_token_is_requested_and_kept_out_of_the_address(browser: Browser) -> None:
    tokens = (TokenConfig(name="phone", role="drive", token=DRIVE), TokenConfig(name="wall", role="read", token=READ))
    async with daemon(Config().with_tables(api=ApiConfig(tokens=tokens))) as host, simulated_robot(host.tcp):
        async with visit(browser, host.url) as tab:
            await tab.shows("#access", "A token is needed")
            await tab.page.get_by_role("textbox", name="Token").fill(DRIVE)
            await tab.page.get_by_role("button", name="Log in").click()
            await tab.is_connected()
            await tab.page.locator("#access").wait_for(state="hidden")
        async with visit(browser, f"{host.url}/?token={READ}") as tab:
            await tab.is_connected()
            assert tab.page.url == f"{host.url}/"
            await tab.shows("#robots", "robot_0")
            await tab.shows("#notice", "has the role read")
            await tab.page.locator("#notice").wait_for(state="hidden", timeout=10_000)  # once
            await tab.page.keyboard.down("KeyW")
            await tab.shows("#drive-state", "has the role read")
            await tab.shows("#command-linear", "0.00")
            for useless in ("#max-linear", "#max-angular", "#unlock", "#odometry-reset"):
                assert await tab.page.locator(useless).is_disabled()
            await tab.page.keyboard.up("KeyW")
            await tab.page.keyboard.press("Escape")
            await tab.shows("#robots", "locked")  # a token that may read may stop
            await tab.page.reload()
            await tab.is_connected()  # kept for the session
            host.hub.robots.find("robot_0").unlock()
            await tab.page.get_by_role("button", name="Use another token").click()
            await tab.page.get_by_role("textbox", name="Token").fill(DRIVE)
            await tab.page.get_by_role("button", name="Log in").click()
            await tab.shows("#drive-state", "no driver")
            assert not await tab.page.locator("#max-linear").is_disabled()
            assert tab.other_hosts == []
            gate = host.hub.robots.find("robot_0").gate
            assert gate.counts.commands == 0
            await tab.hold("KeyW", lambda: gate.counts.commands > 0)  # the new token may drive
            await tab.shows("#drive-state", "You drive")
            await tab.page.keyboard.up("KeyW")


@pytest.mark.parametrize("size", SIZES)
async def test_page_of_a_driving_robot_has_the_right_layout_and_text(browser: Browser, size: str) -> None:
    """Pictures are kept; nothing hangs over the side, and axe finds nothing that keeps anybody out."""
    async with daemon(PAPER) as host, visit(browser, host.url, **SIZES[size]) as tab:
        await tab.is_connected()
        async with simulated_robot(host.tcp) as robot:
            await tab.shows("#log", "robot is ready")
            await tab.shows("#drive-state", "no driver")
            await tab.page.keyboard.down("KeyW")
            await tab.page.keyboard.down("KeyA")
            await expect(lambda: robot.world.odometry.theta_rad > TURN_RAD, timeout_s=60.0)
            for scheme in ("light", "dark"):
                await tab.page.emulate_media(color_scheme=scheme)
                await tab.page.screenshot(path=PICTURES / f"page-{size}-{scheme}.png")
                found = await Axe().run(tab.page)
                assert found.violations_count == 0, found.generate_report()
            width = SIZES[size]["viewport"]["width"]
            assert await tab.page.evaluate("document.documentElement.scrollWidth") == width
            assert tab.complaints == []
