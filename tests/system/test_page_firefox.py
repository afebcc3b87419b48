"""The page in Firefox: it shows, drives and stops as in Chromium, also when a release is lost."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from hostlink.core.robot.admission import LEASE_S
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, repeating, robot_topics
from tests.support.firefox import MIDDLE, RIGHT, Tab, firefox
from tests.support.waiting import expect, expect_never

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.long]  # other tests of the page use Chromium

ARROW_UP, ARROW_DOWN, SPACE = "\ue013", "\ue015", " "
SYSTEM_KEYS = {"Control": "\ue009", "Alt": "\ue00a", "Meta": "\ue03d"}
SENT_AGAIN_S = 0.12  # what is held is sent every 80 ms
FREEZE = "(() => { const end = performance.now() + 700; while (performance.now() < end); return true; })()"
SLEEP = "(() => { const now = Date.now; Date.now = () => now() + 7_200_000; return true; })()"
FOCUSED = """(() => {
  window.focused = 0;
  addEventListener("focusin", ({ target }) => (window.focused += target.matches("[type=radio]")));
  return true;
})()"""
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
            await tab.shows("#drive-state", "no driver")
            yield host, device, tab


def commanded(host: Daemon, name: str = "robot_0") -> tuple[float, str | None]:
    gate = host.hub.robots.find_here(name).gate
    return gate.current.x_m_s, gate.owner_name


async def stands(host: Daemon, name: str = "robot_0") -> None:
    await expect(lambda: commanded(host, name) == (0.0, None), timeout_s=2 * LEASE_S)


async def stays_at_rest(host: Daemon) -> None:
    """Check that the robot stays stopped while the key is still held."""
    await stands(host)
    await expect_never(lambda: commanded(host) != (0.0, None), for_s=SENT_AGAIN_S)


async def test_page_shows_the_robot_and_its_link(scene: Scene) -> None:
    _, _, tab = scene
    await tab.shows("#link", "Hz")
    await tab.shows("#clients", "(Firefox)")


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
    await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
    await device.velocity_of((0.2, 0.0))
    await tab.press(SPACE)
    await tab.release(SPACE)
    assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
    await stands(host)
    await tab.shows("#drive-state", "no driver")


@pytest.mark.parametrize("lost", ["contextmenu", "dragstart", "blur"])
async def test_event_that_swallows_the_release_of_a_key_stops_the_robot(scene: Scene, lost: str) -> None:
    host, _, tab = scene
    await tab.press(ARROW_UP)
    await expect(lambda: commanded(host)[0] > 0)
    target = "window" if lost == "blur" else "document.querySelector('#link')"
    await tab.evaluate(f"{target}.dispatchEvent(new Event('{lost}', {{ bubbles: true }}))")
    await stays_at_rest(host)
    await tab.release(ARROW_UP)


@pytest.mark.parametrize("name", SYSTEM_KEYS)
async def test_a_key_of_the_system_beside_a_held_one_stops(scene: Scene, name: str) -> None:
    host, _, tab = scene
    await tab.press(ARROW_UP)
    await expect(lambda: commanded(host)[0] > 0)
    await tab.press(SYSTEM_KEYS[name])
    await stays_at_rest(host)
    await tab.release(SYSTEM_KEYS[name])
    await tab.release(ARROW_UP)


@pytest.mark.parametrize("pause", [FREEZE, SLEEP], ids=["frozen", "slept"])
async def test_a_page_that_did_not_run_drives_on_only_when_it_is_pressed_again(scene: Scene, pause: str) -> None:
    host, _, tab = scene
    await tab.press(ARROW_UP)
    await expect(lambda: commanded(host)[0] > 0)
    await tab.evaluate(pause)
    await stays_at_rest(host)
    await tab.release(ARROW_UP)
    await tab.press(ARROW_UP)
    await expect(lambda: commanded(host)[0] > 0)
    await tab.release(ARROW_UP)
    await stands(host)


@pytest.mark.parametrize("button", [MIDDLE, RIGHT])
async def test_another_button_of_the_mouse_drives_nothing(scene: Scene, button: int) -> None:
    host, _, tab = scene
    await tab.hold("#joystick", up_px=60, button=button)
    await stays_at_rest(host)
    await tab.let_go(button=button)


async def test_a_robot_that_is_chosen_by_mouse_is_driven_by_the_arrows(scene: Scene) -> None:
    host, _, tab = scene
    async with fake_device(host.tcp, robot_topics("robot_7")) as other, repeating(other, pose(0.0, 0.0, 0.0)):
        await tab.shows("#robots", "robot_7")
        await tab.evaluate(FOCUSED)
        await tab.click("#robots .robot:nth-child(2)")
        assert await tab.evaluate("window.focused") == 0  # in which an arrow would choose another one
        await tab.press(ARROW_DOWN)
        await expect(lambda: commanded(host, "robot_7")[0] < 0)
        await tab.release(ARROW_DOWN)
        await stands(host, "robot_7")
        await tab.click("#robots .robot:first-child")
        assert commanded(host) == (0.0, None)


async def test_the_stop_works_when_it_is_pressed_also_beside_a_finger_on_the_stick(scene: Scene) -> None:
    host, _, tab = scene
    await tab.hold("#joystick", up_px=60, finger="first")
    await expect(lambda: commanded(host)[0] > 0)
    await tab.hold("#stop", finger="second")
    await expect(lambda: host.hub.robots.find_here("robot_0").gate.lock_reason is not None)
    await stays_at_rest(host)
    await tab.let_go(finger="second")
    await tab.let_go(finger="first")
    await host.rest("POST", "/api/robots/robot_0/unlock")
    await tab.shows("#drive-state", "no driver")


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


async def test_a_page_that_is_left_while_a_key_is_held_stops(scene: Scene) -> None:
    host, _, _ = scene
    async with fake_device(host.tcp, robot_topics()) as device, repeating(device, pose(0.0, 0.0, 0.0)):
        await expect(lambda: host.hub.robots.find_here("robot_0").link is not None)
        async with firefox(host.url) as tab:
            await tab.shows("#drive-state", "no driver")
            await tab.press(ARROW_UP)
            await device.velocity_other_than((0.0, 0.0))
            await tab.leave()
            await device.velocity_of((0.0, 0.0))
            await stands(host)
