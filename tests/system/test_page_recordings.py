"""Recordings and incidents on the page: from the record button to the file, from a cut link to its plots."""

import asyncio
import contextlib
import re
from pathlib import Path

import aiohttp
import pytest
from axe_playwright_python.async_playwright import Axe
from playwright.async_api import Browser, Locator, Page
from playwright.async_api import expect as expect_page

import hostlink.recording
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config, RobotConfig
from tests.support.browser import PHONE, Visit, visit
from tests.support.daemon import Daemon, daemon
from tests.support.process import run
from tests.support.proxy import address_of, proxy
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

pytestmark = [pytest.mark.asyncio(loop_scope="session"), pytest.mark.long]

WATCH = "localStorage.setItem('hostlink.layout', 'Watch')"
READ = "a-token-of-a-watcher"
DRIVEN_M, TIMEOUT_S = 0.1, 20.0
HOSTILE = '<img src=x onerror="window.hit = 1">'
ROBOTS = {"robot_0": RobotConfig(wheel_separation_m=0.210, max_wheel_m_s=0.3436)}


def config(folder: Path, api: ApiConfig | None = None) -> Config:
    recording = RecordingConfig(folder=folder, min_free_disk_mb=0.0)
    box = BlackBoxConfig(before_s=30.0, after_s=0.5)
    return Config(robots=ROBOTS).with_tables(
        recording=recording, black_box=box, api=ApiConfig() if api is None else api
    )


async def count(chart: Locator) -> int:
    """Return the number of samples of a chart."""
    return int(await chart.locator(".uplot").get_attribute("data-count") or 0)


async def downloaded(page: Page, button: Locator, folder: Path) -> Path:
    async with page.expect_download() as started:
        await button.click()
    download = await started.value
    path = folder / download.suggested_filename
    await download.save_as(path)
    return path


async def drive(tab: Visit, host: Daemon) -> None:
    """Drive until the robot has moved and is driven. A busy page may let go, so the key is pressed again.

    Keys drive only where the stick is visible, and go on in no other layout.
    """
    await tab.layout("Drive")
    robot = host.hub.robots.find("robot_0")
    odometry = robot.odometry
    async with asyncio.timeout(TIMEOUT_S):
        while odometry.snapshot(0.0).pose.x_m < DRIVEN_M or robot.gate.owner is None:
            await tab.page.keyboard.up("KeyW")
            await tab.page.keyboard.down("KeyW")
            with contextlib.suppress(AssertionError):
                await expect(lambda: odometry.snapshot(0.0).pose.x_m > DRIVEN_M, timeout_s=TIMEOUT_S / 5)


async def another_incident(page: Page, host: Daemon) -> None:
    """The list is loaded again while an incident of it is open."""
    async with (
        aiohttp.ClientSession() as session,
        session.post(host.url + "/api/incidents", json={"robot": "robot_0", "reason": "another"}) as response,
    ):
        assert response.status == 200, await response.text()
    await expect_page(page.locator("#incidents li")).to_have_count(2)


async def test_an_incident_from_the_cut_link_to_its_plots_and_its_file(browser: Browser, tmp_path: Path) -> None:
    async with (
        daemon(config(tmp_path / "kept"), has_black_box=True) as host,
        proxy(host.tcp) as network,
        visit(browser, host.url, script=WATCH) as tab,
    ):
        page = tab.page
        await tab.is_connected()
        async with simulated_robot(address_of(network.url)):
            await tab.shows("#robots", "no driver")
            await drive(tab, host)
            network.break_off()
        await page.keyboard.up("KeyW")
        await tab.layout("Watch")
        await tab.shows("#incidents", "Link lost while driven")
        item = page.locator("#incidents li", has_text="Link lost while driven")
        await item.get_by_role("button", name="Open").click()
        opened = page.locator("#incident")
        await expect_page(opened.get_by_role("heading", name="Link lost while driven: robot_0")).to_be_focused()
        await tab.shows("#incident [role=log]", "link lost while it was driven")
        assert int(await opened.locator("canvas.path").get_attribute("data-points") or 0) > 10
        for chart in ("forward", "turn", "left", "right", "pwm"):
            await expect_page(opened.locator(f"#incident-plot-{chart} .uplot")).to_have_attribute(
                "data-count", re.compile(r"\d\d+")
            )
        await expect_page(opened.locator("> .hint")).to_have_text(re.compile("In a terminal: hostlink plot "))
        await opens_at_the_incident(opened)
        await one_instant_everywhere(opened)
        for viewport in ({"width": 1280, "height": 800}, PHONE):
            await page.set_viewport_size(viewport)
            found = await Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
            assert await page.evaluate("document.documentElement.scrollWidth") == viewport["width"]
            await expect_page(page.locator("#stop")).to_be_visible()
        path = await downloaded(page, opened.get_by_role("link", name="Download"), tmp_path)
        await another_incident(page, host)
        await opened.get_by_role("button", name="Close").click()
        await expect_page(item.get_by_role("button", name="Open")).to_be_focused()
        assert tab.complaints == []
        await past_before_the_page(browser, host)
    assert hostlink.recording.read(path)["/robot_0/odometry"]["x"][-1] > 0.1
    for words in (("/robot_0/odometry.x",), ("--map",)):
        picture = tmp_path / f"{words[0].strip('/-').replace('/', '_')}.png"
        status, _, err = await run("plot", str(path), *words, "-o", str(picture))
        assert (status, picture.read_bytes()[:4]) == (0, b"\x89PNG"), err


async def opens_at_the_incident(opened: Locator) -> None:
    """The cursor, the plots and the log are at the incident, in the middle of what is shown."""
    await expect_page(opened.locator(".timebar output")).to_have_text("0 s")
    await expect_page(opened.locator("[role=log] [aria-current]")).to_contain_text("link lost while it was driven")
    commanded = opened.locator("#incident-plot-forward .legend b").first
    await expect_page(commanded).not_to_have_text(re.compile(r"–|0\.00"))  # it was driven at that time


async def one_instant_everywhere(opened: Locator) -> None:
    """The slider, a chart and a line of the log move the same cursor: all of them show that instant."""
    slider = opened.get_by_role("slider", name="Incident: instant")
    asked = opened.locator("#incident-plot-forward .legend b").first
    await slider.press("Home")
    await expect_page(asked).to_have_text(re.compile(r"–|0\.00"))
    await opened.locator("[role=log] li", has_text="link lost while it was driven").click()
    await expect_page(opened.locator(".timebar output")).to_have_text("0 s")
    await expect_page(asked).not_to_have_text(re.compile(r"–|0\.00"))
    await expect_page(opened.locator("[aria-current]")).to_have_count(1)
    await opened.locator("#incident-plot-turn .u-over").hover(position={"x": 3, "y": 20})
    await expect_page(opened.locator(".timebar output")).to_have_text(re.compile(r"^−"))
    await expect_page(opened.locator("[role=log] .later", has_text="link lost")).to_have_count(1)
    before = await slider.get_attribute("aria-valuetext")
    await opened.get_by_role("button", name="show less time").click()
    assert await slider.get_attribute("aria-valuetext") == before  # zooming keeps the instant


async def past_before_the_page(browser: Browser, host: Daemon) -> None:
    """A page that is opened later shows the path, the plots and the log of what was before."""
    async with visit(browser, host.url, script=WATCH) as tab:
        await tab.shows("#log", "link lost while it was driven")
        await tab.map_has("points", r"^\d\d+$")
        assert await count(tab.page.locator("#plot-forward")) > 10
        line = tab.page.locator("#log li", has_text="link opened").first
        await line.click()
        await expect_page(tab.page.get_by_role("button", name="Speeds: follow now")).to_be_visible()
        await expect_page(tab.page.locator("#plot-forward .legend b").last).to_have_text(re.compile(r"–|0\.0"))
        await tab.page.get_by_role("button", name="Speeds: follow now").click()
        await tab.page.locator("#log select").select_option("4")
        await expect_page(line).to_be_hidden()
        await tab.page.locator("#log input").fill("no such words")
        await expect_page(tab.page.locator("#log li:visible")).to_have_count(0)
        assert tab.complaints == []


async def test_a_recording_is_begun_stopped_downloaded_and_removed(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    async with (
        daemon(config(folder), has_black_box=True) as host,
        simulated_robot(host.tcp),
        visit(browser, host.url, script=WATCH) as tab,
    ):
        page, panel = tab.page, tab.page.locator("#recordings")
        await tab.shows("#robots", "no driver")
        await panel.get_by_label("Robots").select_option("robot_0")
        await panel.get_by_label("Topics").fill("/robot_0/odometry, /robot_0/velocity_commands")
        await panel.get_by_role("button", name="Record", exact=True).click()
        await tab.shows("#recordings .underway", "0 dropped")
        await drive(tab, host)
        await page.keyboard.up("KeyW")
        await tab.layout("Watch")
        await expect_page(panel.locator(".underway .figures")).to_have_text(
            re.compile(r"^\d\d+ messages · .*[kM]?B · 0:0\d · 0 dropped$")
        )
        await panel.get_by_role("button", name="Stop recording").click()
        await expect_page(panel.locator(".files li")).to_have_count(1)
        await expect_page(panel.locator(".underway li")).to_have_count(0)
        path = await downloaded(page, panel.get_by_role("link", name="Download"), tmp_path)
        found = {message.channel.topic for message in McapReader(path).messages()}
        assert {"/robot_0/odometry", "/robot_0/velocity_commands"} <= found
        assert "/robot_0/plot_data" not in found
        await is_opened(tab, panel.get_by_role("button", name=f"Open {path.name}"), path.name)
        remove = panel.get_by_role("button", name="Remove")
        await remove.click()
        await expect_page(remove).to_have_text("Remove it?")
        assert path.name in [each.name for each in folder.iterdir()]
        await remove.click()
        await expect_page(panel.locator(".files li")).to_have_count(0)
        assert path.name not in [each.name for each in folder.iterdir()]
        another = path.rename(path.with_name("from my laptop (2).mcap"))
        await panel.locator("input[type=file]").set_input_files(another)
        await is_opened(tab, None, "from-my-laptop-2-.mcap")
        assert (folder / "from-my-laptop-2-.mcap").read_bytes() == another.read_bytes()
        await panel.locator("input[type=file]").set_input_files(another)
        await tab.shows("#recordings [role=status]", "a recording named from-my-laptop-2- already exists")
        assert [each for each in tab.complaints if "409" not in each] == []


async def is_opened(tab: Visit, button: Locator | None, file: str) -> None:
    """Check that the recording is shown from its beginning, and close it. `button` opens it."""
    if button is not None:
        await button.click()
    opened = tab.page.locator("#incident")
    await expect_page(opened.get_by_role("heading", name=f"{file}: robot_0")).to_be_focused()
    await expect_page(opened.locator(".timebar output")).to_have_text("0 s")
    await expect_page(opened.locator("#incident-plot-forward .uplot")).to_have_attribute(
        "data-count", re.compile(r"\d\d+")
    )
    assert int(await opened.locator("canvas.path").get_attribute("data-points") or 0) > 3
    await opened.get_by_role("slider", name="Recording: instant").press("End")
    await expect_page(opened.locator(".timebar output")).to_have_text(re.compile(r"^\+\d"))
    await expect_page(tab.page.locator("#stop")).to_be_visible()
    await opened.get_by_role("button", name="Close").click()


async def test_a_remove_that_is_to_be_confirmed_outlives_another_recording(browser: Browser, tmp_path: Path) -> None:
    async with (
        daemon(config(tmp_path), has_black_box=True) as host,
        simulated_robot(host.tcp),
        visit(browser, host.url, script=WATCH) as tab,
    ):
        await host.rest("POST", "/api/recordings", b'{"name": "first"}')
        await host.rest("POST", "/api/recordings/first/stop")
        await tab.shows("#robots", "no driver")
        await tab.shows("#recordings .files", "first.mcap")
        await host.rest("POST", "/api/recordings", b'{"name": "second"}')
        await tab.shows("#recordings .underway", "second")
        remove = tab.page.get_by_role("button", name="Remove first.mcap")
        await remove.click()
        await expect_page(remove).to_have_text("Remove it?")
        await host.rest("POST", "/api/recordings/second/stop")
        await tab.shows("#recordings .files", "second.mcap")
        await expect_page(remove).to_have_text("Remove it?")
        await remove.click()
        await expect_page(remove).to_have_count(0)
        await host.rest("DELETE", "/api/recordings/second.mcap")
        await expect_page(tab.page.locator("#recordings .files li")).to_have_count(0)


async def test_recording_of_another_client_is_shown_and_names_stay_text(browser: Browser, tmp_path: Path) -> None:
    async with (
        daemon(config(tmp_path), has_black_box=True) as host,
        simulated_robot(host.tcp),
        visit(browser, host.url, script=WATCH) as tab,
    ):
        await tab.shows("#robots", "no driver")
        await host.rest("POST", "/api/recordings", b'{"name": "of_a_program"}')
        await tab.shows("#recordings .underway", "of_a_program")
        await host.rest("POST", "/api/recordings/of_a_program/stop")
        await tab.shows("#recordings .files", "of_a_program.mcap")
        host.hub.robots.find("robot_0").lock(HOSTILE)
        await tab.shows("#incidents .detail", HOSTILE)
        await tab.page.locator("#incidents").get_by_role("button", name="Open").click()
        await tab.shows("#incident .facts", HOSTILE)
        await tab.shows("#incident [role=log]", HOSTILE)
        await tab.shows("#log", HOSTILE)
        assert await tab.page.evaluate("window.hit ?? document.querySelectorAll('img').length") == 0


async def test_a_token_that_may_only_read_records_nothing_and_downloads(browser: Browser, tmp_path: Path) -> None:
    tokens = (TokenConfig(name="wall", role="read", token=READ),)
    folder = tmp_path / "kept"
    folder.mkdir()
    (folder / "before.mcap").write_bytes(b"")
    async with daemon(config(folder, ApiConfig(tokens=tokens)), has_black_box=True) as host:
        async with simulated_robot(host.tcp), visit(browser, f"{host.url}/?token={READ}", script=WATCH) as tab:
            await tab.shows("#robots", "no driver")
            await expect_page(tab.page.get_by_role("button", name="Record", exact=True)).to_be_disabled()
            await expect_page(tab.page.get_by_role("button", name="Save now")).to_be_disabled()
            await expect_page(tab.page.get_by_role("button", name="Remove before.mcap")).to_be_disabled()
            await expect_page(tab.page.get_by_role("button", name="Open a file")).to_be_disabled()
            await tab.page.get_by_role("button", name="Open before.mcap").click()  # reading needs no other right
            await tab.shows("#recordings [role=status]", "before.mcap is not an MCAP file")
            await expect_page(tab.page.locator("#tuning").get_by_text("Send")).to_be_disabled()
            host.hub.robots.find("robot_0").lock("a hand in the wheel")
            await tab.shows("#incidents .detail", "a hand in the wheel")
            button = tab.page.locator("#incidents").get_by_role("link", name="Download")
            path = await downloaded(tab.page, button, tmp_path)
        assert McapReader(path).metadata == {}
        assert [message.channel.topic for message in McapReader(path).messages()]
