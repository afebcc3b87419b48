"""The page in Firefox: it shows, drives and stops as in Chromium."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from hostlink.robot.velocity_gate import LEASE_S
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, repeating, robot_topics
from tests.support.firefox import Tab, firefox
from tests.support.waiting import expect

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.quiet]

ARROW_UP, SPACE = "\ue013", " "
Scene = tuple[Daemon, FakeDevice, Tab]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def scene() -> AsyncIterator[Scene]:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()) as device,
        repeating(device, pose(1.0, 2.0, 0.5)),
    ):
        await expect(lambda: host.hub.robots.has("robot_0"))
        async with firefox(host.url) as tab:
            await tab.shows("#robots", "robot_0")
            await tab.shows("#drive-state", "nobody drives")
            yield host, device, tab


def commanded(host: Daemon) -> tuple[float, str | None]:
    gate = host.hub.robots.find_here("robot_0").gate
    return gate.current.linear_x_m_s, gate.owner_name


async def stands(host: Daemon) -> None:
    await expect(lambda: commanded(host) == (0.0, None), timeout_s=2 * LEASE_S)


async def test_it_shows_the_robot_and_its_link(scene: Scene) -> None:
    _, _, tab = scene
    await tab.shows("#link", "Hz")
    await tab.shows("#clients", "client")


async def test_a_key_drives_and_letting_it_go_stops(scene: Scene) -> None:
    host, device, tab = scene
    await tab.press(ARROW_UP)
    assert (await device.velocity_other_than((0.0, 0.0)))[0] > 0
    await tab.shows("#drive-state", "You drive")
    await tab.release(ARROW_UP)
    await stands(host)


async def test_the_stick_drives_and_letting_it_go_stops(scene: Scene) -> None:
    host, _, tab = scene
    await tab.hold("#joystick", up_px=60)
    await expect(lambda: commanded(host)[0] > 0)
    await tab.let_go()
    await stands(host)


async def test_the_stop_stops_what_another_drives(scene: Scene) -> None:
    host, device, tab = scene
    await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0}')
    await device.velocity_of((0.2, 0.0))
    await tab.press(SPACE)
    await tab.release(SPACE)
    assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
    await stands(host)


@pytest.mark.parametrize("layout", ["Tune", "Fleet", "Watch", "Drive"])
async def test_every_layout_fits_its_window(scene: Scene, layout: str) -> None:
    _, _, tab = scene
    chosen = f"[...document.querySelectorAll('button, a')].find(each => each.textContent.trim() === '{layout}').click()"
    await tab.evaluate(f"({chosen}, true)")
    await tab.shows("#robots", "robot_0")
    assert await tab.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


async def test_a_robot_that_leaves_is_shown_as_gone(scene: Scene) -> None:
    _, device, tab = scene
    device.hang_up()
    await tab.shows("#robots", "not connected")
