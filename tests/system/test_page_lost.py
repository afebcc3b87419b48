"""The page while the daemon is not heard: nothing that was true looks as if it were. And before there is a robot."""

import asyncio
import shlex
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path

import pytest
from playwright.async_api import Browser
from playwright.async_api import expect as expect_page

from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config, TcpConfig, UdpConfig
from hostlink.core.diagnosis.finding import finding
from tests.support.browser import PHONE, Visit, visit
from tests.support.daemon import Daemon, daemon
from tests.support.driving import driven
from tests.support.fork_server import start
from tests.support.page_server import State, page_server
from tests.support.proxy import Line, Proxy, address_of, proxy
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

pytestmark = pytest.mark.asyncio(loop_scope="session")

PICTURES = Path("build/screenshots")
UNKNOWN_MS = 5000  # the page knows after 0.7 s; a busy machine takes longer
HOW_IT_GOES = ["swallowed", "refused"]  # as in a network that fails, and as by a daemon that has ended


@asynccontextmanager
async def shown(browser: Browser, config: Config) -> AsyncIterator[tuple[Daemon, Proxy, Visit]]:
    """A page that shows a robot which is driven, through a line that can be cut."""
    async with (
        daemon(config, has_black_box=True) as host,
        proxy(host.url) as line,
        simulated_robot(host.tcp),
        visit(browser, line.url) as tab,
    ):
        await tab.shows("#robots", "robot_0")
        async with driven(host.hub, "robot_0", 0.2):
            yield host, line, tab


def cut(line: Proxy, how: str) -> None:
    if how == "swallowed":
        line.set_line(Line.SWALLOWS)
    else:
        line.is_refusing = True
        line.break_off()


def mend(line: Proxy) -> None:
    line.is_refusing = False
    line.set_line(Line.WORKS)
    line.break_off()


def tile(tab: Visit, name: str) -> str:
    return f"#link [data-tile={name}] dd"


async def age_s(tab: Visit) -> float:
    text = await tab.page.locator(tile(tab, "age")).inner_text()
    return float(text.removesuffix(" s"))


@pytest.mark.long
@pytest.mark.parametrize("how", HOW_IT_GOES)
async def test_values_of_a_robot_are_blank_or_grow_old_while_the_daemon_is_gone(browser: Browser, how: str) -> None:
    async with shown(browser, Config()) as (_, line, tab):
        await tab.shows(tile(tab, "rate"), "Hz")
        await tab.shows(tile(tab, "battery"), "V")
        await tab.shows(tile(tab, "errors"), "none")
        await tab.shows("#robots .speed", "m/s")
        await tab.shows("#robots .what", "drives")
        cut(line, how)
        for blank in ("rate", "page", "device", "signal", "battery", "errors"):
            await expect_page(tab.page.locator(tile(tab, blank))).to_have_text("–", timeout=UNKNOWN_MS)
        first_s = await age_s(tab)
        await tab.until(
            "([selector, least]) => parseFloat(document.querySelector(selector).textContent) > least",
            [tile(tab, "age"), first_s + 0.9],
        )
        await tab.shows("#robots .what", "heard")
        for empty in (".speed", ".battery", ".signal"):
            await expect_page(tab.page.locator(f"#robots {empty}")).to_have_text("")
        await tab.shows("#pose .age", "old")
        await expect_page(tab.page.locator("#pose div:last-of-type dd")).to_have_text("–")
        await tab.shows("#speeds .bar", "no data")
        await tab.shows("#drive-state", "No connection")
        await tab.page.screenshot(path=PICTURES / f"page-lost-{how}.png")
        mend(line)
        await tab.shows(tile(tab, "rate"), "Hz", timeout_s=15.0)
        await tab.shows(tile(tab, "battery"), "V", timeout_s=15.0)
        await tab.shows("#robots .what", "drives")


@pytest.mark.long
@pytest.mark.parametrize("how", HOW_IT_GOES)
async def test_lists_of_activity_are_empty_while_the_daemon_is_gone(browser: Browser, how: str, tmp_path: Path) -> None:
    config = Config().with_tables(recording=RecordingConfig(folder=tmp_path, min_free_disk_mb=0.0))
    async with shown(browser, config) as (host, line, tab):
        await tab.layout("Watch")
        assert (await host.rest("POST", "/api/recordings", b'{"name": "run"}'))[0] == 200
        await tab.shows("#recordings .figures", "message")
        await tab.shows("#drives", "drives now")
        await tab.shows("#topics .topics", "Hz", timeout_s=15.0)
        cut(line, how)
        await tab.shows("#recordings .figures", "no data")
        await tab.shows("#drives .still", "was driving at the last contact with hostlink")
        await expect_page(tab.page.locator("#topics .topics")).not_to_contain_text("Hz", timeout=2 * UNKNOWN_MS)
        mend(line)
        await tab.shows("#topics .topics", "Hz", timeout_s=15.0)
        await tab.shows("#recordings .figures", "message")
        await tab.shows("#drives", "drives now")


async def test_an_opened_topic_says_how_old_its_values_are_while_the_daemon_is_gone(browser: Browser) -> None:
    async with shown(browser, Config()) as (_, line, tab):
        await tab.layout("Watch")
        await tab.page.locator("#topics .topics button", has_text="/robot_0/odometry").first.click(timeout=15_000)
        await tab.shows("#topics .opened", "since opening")
        await expect_page(tab.page.locator("#topics .opened > .hint").first).not_to_contain_text("no connection")
        cut(line, "refused")
        await tab.shows("#topics .opened", "no connection, the newest is")


async def test_without_a_robot_the_page_names_the_ports_of_this_daemon(browser: Browser) -> None:
    config = Config(udp=UdpConfig(host="127.0.0.1", port=0))
    async with daemon(config) as host, visit(browser, host.url) as tab:
        assert host.udp is not None
        await tab.shows("#robots .ways", f"127.0.0.1:{host.tcp[1]}")
        await tab.shows("#robots .ways", f"127.0.0.1:{host.udp[1]}")
        await tab.shows("#robots .heard", "Nothing was received")
        listening = f"listening on TCP 127.0.0.1:{host.tcp[1]}, UDP 127.0.0.1:{host.udp[1]}"
        await tab.shows("#robots .found", f"no device has connected to this computer ({listening})")
        await tab.shows("#robots .found", "Next: check the host address and the port")
        assert "11411" not in await tab.page.locator("#robots .empty").inner_text()
        await tab.page.screenshot(path=PICTURES / "page-empty.png")
        _, writer = await asyncio.open_connection(*host.tcp)
        writer.write(b"GET / HTTP/1.1\r\n\r\n")
        await tab.shows("#robots .heard", "TCP 127.0.0.1: connected, sent 18 bytes without a frame")
        await expect_page(tab.page.locator("#robots .found")).to_be_empty()  # a device is connected
        writer.close()
        await tab.shows("#robots .heard", "the connection ended: peer closed")
        shown_command = await tab.page.locator("#robots .ways code").last.inner_text()
        command = shlex.split(shown_command)
        assert command[:2] == ["hostlink", "sim"]
        program = await start(*command[1:])
        try:
            await tab.shows("#robots", "robot_0", timeout_s=20.0)
        finally:
            program.terminate()
            await program.communicate()
        assert tab.complaints == []


@pytest.mark.long
async def test_without_a_robot_that_may_connect_from_here_the_page_names_no_simulator(browser: Browser) -> None:
    config = Config(tcp=TcpConfig(allow=("10.0.0.0/8",)))
    async with daemon(config) as host, visit(browser, host.url) as tab:
        await tab.shows("#robots .ways", f"127.0.0.1:{host.tcp[1]}")
        for _ in range(2):
            _, writer = await asyncio.open_connection(*host.tcp)
            writer.close()
        refused = "TCP 127.0.0.1: refused: its address is not in the allowed networks (tcp.allow, udp.allow) (2 times"
        await tab.shows("#robots .heard", refused)
        await tab.shows("#robots .found", "their connections are refused (not_allowed 2)")
        assert "hostlink sim" not in await tab.page.locator("#robots .empty").inner_text()


async def test_ports_of_a_daemon_that_was_started_anew_are_the_new_ones(browser: Browser) -> None:
    async with daemon() as first, daemon() as second, proxy(first.url) as line, visit(browser, line.url) as tab:
        await tab.shows("#robots .ways", str(first.tcp[1]))
        line.target = address_of(second.url)
        line.break_off()
        await tab.shows("#robots .ways", str(second.tcp[1]))
        await expect(lambda: tab.other_hosts == [])


async def test_without_a_robot_a_daemon_on_all_addresses_names_its_port_and_serial_ports(browser: Browser) -> None:
    async with page_server() as server:
        listening = {
            "tcp": {"host": "0.0.0.0", "port": 11412},
            "udp": {"host": "10.0.0.7", "port": 11500},
            "micro_ros": [],
            "serial": [{"port": "/dev/ttyACM0", "bauds": [57600, 115200]}],
            "simulate": "hostlink sim --connect 127.0.0.1:11412",
            "address": "192.168.1.20",
        }
        wrong_baud = asdict(finding("wrong_baud", "57600 instead of 115200"))
        noise = {"way": "serial", "peer": "/dev/ttyACM0", "cause": "connected", "text": "connected, sent 900 bytes"}
        arrivals = [{**noise, "count": 1, "ago_s": 0.4, "diagnosis": [wrong_baud]}]
        server.show(State(listening=listening, diagnosis={"findings": [], "arrivals": arrivals}))
        async with visit(browser, server.url) as tab:
            await tab.shows("#robots .heard", "/dev/ttyACM0: connected, sent 900 bytes (0.4 s ago)")
            await tab.shows("#robots .heard", "at another baud rate than its reader (57600 instead of 115200)")
            await tab.shows(
                "#robots .boards", "Arduino over USBplug it in as /dev/ttyACM0; its sketch uses 57600 or 115200"
            )
            await tab.shows("#robots .boards", "nh.getHardware()->setConnection(IPAddress(192, 168, 1, 20), 11412);")
            await tab.shows("#robots .boards", "hostlink serve --serial /dev/ttyUSB0@57600")
            await tab.page.set_viewport_size(PHONE)  # all of it can be read there
            assert await tab.page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
            await tab.page.locator("#robots .heard li").last.scroll_into_view_if_needed()
            await expect_page(tab.page.locator("#robots .heard li").last).to_be_in_viewport()
            await tab.shows("#robots .ways", "port 11412, this computer")
            await tab.shows("#robots .ways", "10.0.0.7:11500")
            await tab.shows("#robots .ways", "on /dev/ttyACM0 at 57600, 115200 baud")
            await tab.shows("#robots .ways", "hostlink sim --connect 127.0.0.1:11412")
            await tab.page.screenshot(path=PICTURES / "page-empty-all.png")
