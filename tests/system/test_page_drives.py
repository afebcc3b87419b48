"""The page shows what is known of a robot's motion, and commands what its drive can do."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from playwright.async_api import Browser
from playwright.async_api import expect as expect_page

from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.background import meanwhile
from tests.support.browser import Visit, visit
from tests.support.daemon import daemon
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, topic
from tests.support.page_server import PageServer, State, link, odometry, page_server, robot
from tests.support.waiting import expect, expect_never

pytestmark = pytest.mark.asyncio(loop_scope="session")

PICTURES = Path("build/screenshots")
SENT_AGAIN_S = 0.2
ASKS_S = 1.0
PAD = """
  const pad = { connected: true, mapping: "standard", axes: [0, 0, -1, 0],
    buttons: Array.from({ length: 16 }, () => ({ pressed: false })) };
  window.pad = pad;
  navigator.getGamepads = () => [pad];
"""
Motion = tuple[float, float, float]  # forward, to the left, counter-clockwise


class Board:
    """The velocities that arrive at a device."""

    def __init__(self, tab: Visit, url: str) -> None:
        self.tab, self.url = tab, url
        self.heard: list[Motion] = []

    async def listen(self, device: FakeDevice) -> None:
        """Note each velocity until the connection ends."""
        with contextlib.suppress(EOFError):
            while True:
                frame = await device.next()
                if frame.topic_id == 100:
                    x, y, _, _, _, yaw = struct.unpack("<6d", frame.payload)
                    self.heard.append((x, y, yaw))

    async def live(self, device: FakeDevice) -> None:
        """Ask for the time as a device does that publishes nothing; else the page says that it is silent."""
        with contextlib.suppress(OSError):
            while True:
                await device.send(encode(Id.TIME, bytes(8)))
                await asyncio.sleep(ASKS_S)

    def moves(self, *signs: int) -> bool:
        """Whether the newest velocity has these signs."""
        return bool(self.heard) and tuple((part > 0) - (part < 0) for part in self.heard[-1]) == signs

    async def stands(self) -> None:
        await expect(lambda: self.moves(0, 0, 0))


@contextlib.asynccontextmanager
async def board(browser: Browser, kinematics: Any) -> AsyncIterator[Board]:
    """A device without odometry, and the page on which it is driven."""
    config = Config(robots={"robot_0": RobotConfig(kinematics=kinematics)})
    topics = [topic(EndpointKind.SUBSCRIBER, 100, "/robot_0/cmd_vel", "geometry_msgs/Twist")]
    assert robot_topics()[1].id == topics[0].id
    async with (
        daemon(config) as host,
        fake_device(host.tcp, topics) as device,
        visit(browser, host.url, script=PAD) as tab,
    ):
        new = Board(tab, host.url)
        async with meanwhile(new.listen(device)), meanwhile(new.live(device)):
            await tab.shows("#drive-state", "no driver")
            yield new
            assert tab.complaints == []


async def test_a_drive_that_moves_sideways_is_driven_so_by_keys_stick_and_gamepad(browser: Browser) -> None:
    async with board(browser, "mecanum") as device:
        tab, keys = device.tab, device.tab.page.keyboard
        for key, way in (("KeyQ", 1), ("KeyE", -1)):
            await tab.hold(key, lambda way=way: device.moves(0, way, 0))
            await keys.up(key)
            await device.stands()
        await keys.down("Shift")
        await tab.hold("ArrowLeft", lambda: device.moves(0, 1, 0))
        await expect_page(tab.page.locator("#command-left output")).not_to_have_text("0.00")
        await keys.up("Shift")  # a key that is held keeps its meaning
        await expect_never(lambda: not device.moves(0, 1, 0), for_s=SENT_AGAIN_S)
        await keys.up("ArrowLeft")
        await device.stands()
        await tab.hold("ArrowLeft", lambda: device.moves(0, 0, 1))
        await keys.up("ArrowLeft")
        await device.stands()
        await tab.page.click("#strafe")
        await tab.drag_stick(60, 0, lambda: device.moves(0, -1, 0))
        await tab.page.screenshot(path=PICTURES / "page-sideways.png")
        await tab.page.mouse.up()
        await device.stands()
        await tab.hold_button("pad.buttons[4]", lambda: device.moves(0, 1, 0))
        await tab.page.evaluate("pad.buttons[4].pressed = false")
        await device.stands()


async def test_a_drive_that_cannot_move_sideways_is_not_asked_to(browser: Browser) -> None:
    async with board(browser, "differential") as device:
        keys = device.tab.page.keyboard
        await expect_page(device.tab.page.locator("#strafe")).to_be_hidden()
        sent = len(device.heard)
        await keys.down("KeyQ")
        await device.tab.shows("#notice", "cannot move it sideways")
        await keys.up("KeyQ")
        assert device.heard[sent:] == []
        await keys.down("Shift")
        await device.tab.hold("ArrowLeft", lambda: device.moves(0, 0, 1))
        await keys.up("ArrowLeft")
        await keys.up("Shift")
        await device.stands()


async def test_a_car_is_not_asked_to_turn_in_place_and_the_page_says_why(browser: Browser) -> None:
    async with board(browser, "ackermann") as device:
        tab, keys = device.tab, device.tab.page.keyboard
        sent = len(device.heard)
        await keys.down("ArrowLeft")
        await tab.shows("#drive-state", "Cannot turn in place")
        await tab.page.screenshot(path=PICTURES / "page-car.png")
        assert all(each == (0, 0, 0) for each in device.heard[sent:])
        await tab.hold("ArrowUp", lambda: device.moves(1, 0, 1))
        await keys.up("ArrowUp")  # the turn alone is held: zeros
        await device.stands()
        await keys.up("ArrowLeft")
        await expect_never(lambda: not device.moves(0, 0, 0), for_s=SENT_AGAIN_S)


async def test_of_two_pages_the_one_that_takes_over_drives_until_it_lets_go(browser: Browser) -> None:
    """The first page holds its key all the time: the key must be pressed again, and its zeros do not stop the robot."""
    async with board(browser, "differential") as device, visit(browser, device.url) as other:
        first, second = device.tab.page.keyboard, other.page.keyboard
        await device.tab.hold("KeyW", lambda: device.moves(1, 0, 0))
        await device.tab.shows("#drive-state", "You drive")
        await second.down("KeyS")
        await other.shows("#drive-state", "127.0.0.1) until it lets go")
        await other.page.get_by_role("button", name="Take over").click()
        await other.shows("#drive-state", "Hold the stick to take over")
        assert device.moves(1, 0, 0)
        await second.up("KeyS")
        await other.hold("KeyS", lambda: device.moves(-1, 0, 0))
        await other.shows("#drive-state", "You drive")
        await device.tab.shows("#drive-state", "127.0.0.1) until it lets go")
        await expect_page(device.tab.page.get_by_role("button", name="Take over")).to_be_visible()
        taken = len(device.heard)
        await first.up("KeyW")
        await first.down("KeyW")
        await expect_never(lambda: any(each[0] >= 0 for each in device.heard[taken:]), for_s=SENT_AGAIN_S)
        await device.tab.shows("#drive-state", "127.0.0.1) until it lets go")
        await second.up("KeyS")
        await device.tab.hold("KeyW", lambda: device.moves(1, 0, 0))
        await first.up("KeyW")
        await device.stands()
        assert other.complaints == []


async def test_a_page_whose_robot_was_stopped_says_by_whom_and_to_release_the_stick(browser: Browser) -> None:
    async with board(browser, "differential") as device:
        tab, keys = device.tab, device.tab.page.keyboard
        await tab.hold("KeyW", lambda: device.moves(1, 0, 0))
        await tab.page.request.post(f"{device.url}/api/robots/robot_0/stop?wait_s=0")
        await tab.shows("#drive-state", "a stop by program (127.0.0.1). Release the stick, then hold it again")
        await device.stands()
        await keys.up("KeyW")
        await tab.shows("#drive-state", "no driver")  # the reason is shown for as long as the key is held
        await tab.hold("KeyW", lambda: device.moves(1, 0, 0))
        await keys.up("KeyW")
        await device.stands()


async def shown(server: PageServer, tab: Visit, **changes: Any) -> None:
    server.show(State([robot("robot_0", **changes), robot("robot_1")], [link("robot_0"), link("robot_1")]))
    await tab.shows("#drive-state", "no driver")


async def test_the_page_shows_what_is_known_of_the_motion_and_no_zero_that_was_not_measured(browser: Browser) -> None:
    speed = {"linear_m_s": 0.25, "linear_y_m_s": -0.1, "angular_rad_s": 0.0}
    async with page_server() as server, visit(browser, server.url) as tab:
        pose, card = tab.page.locator("#pose"), tab.page.locator("#robots .robot").first
        await shown(server, tab, feedback="none", odometry=None, odometry_topic=None, command_type="sensor_msgs/Joy")
        await tab.shows("#pose", "no odometry")
        await expect_page(card).to_contain_text("commanded by Joy")
        await expect_page(card).to_contain_text("no odometry")
        await expect_page(tab.page.locator("#odometry-reset")).to_be_disabled()
        await tab.shows("[data-tile=rate]", "none")
        assert "0.0" not in await pose.inner_text()
        await tab.page.screenshot(path=PICTURES / "page-no-odometry.png")
        await shown(server, tab, feedback="velocity", odometry=odometry(0, 0, 0, pose=None, twist=speed))
        await tab.shows("#pose", "0.25 m/s, y −0.10 m/s")
        await expect_page(card).to_contain_text("0.25 m/s")
        assert "0.00 m\n" not in await pose.inner_text()
        for is_moving, text in ((True, "moves"), (False, "stands")):
            known = odometry(0, 0, 0, pose=None, twist=None, is_moving=is_moving)
            await shown(server, tab, feedback="motion", odometry=known)
            await tab.shows("#pose", text)
            await expect_page(card).to_contain_text(text)
            assert "0.0" not in await pose.inner_text()
        await tab.layout("Fleet")
        await tab.shows("#robots", "stands")
        assert tab.complaints == []
