"""The page in use: a real browser drives a simulated robot by mouse, finger, key and gamepad."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

import pytest
import pytest_asyncio
from playwright.async_api import Browser, Page

from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.kinematics import Pose
from hostlink.errors import RefusalKind
from hostlink.workbench.sim.firmware_module import WorldParameters
from tests.support.browser import PHONE, Visit, revisit, visit
from tests.support.daemon import Daemon, daemon
from tests.support.device_codec import encode_log
from tests.support.proxy import Line, proxy
from tests.support.rosbridge import client
from tests.support.simulated import DisturbedRobot, simulated_robot
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect, expect_never

pytestmark = pytest.mark.asyncio(loop_scope="session")

LOW_S = 7.0  # smoothed over a second, low for five
SHOWN_S = 10.0  # for which the firmware shows an error
NOTICED_S = 1.0  # within this time the page shows that the daemon does not answer
MOST_STREAMS = 6  # that a browser opens to one address
TABS_S = 60.0  # bound of a wait for an event of seven tabs on a busy machine
GAMEPAD = """() => {
  const pad = { connected: true, axes: [0, 0, 0, 0], buttons: Array.from({ length: 16 }, () => ({ pressed: false })) };
  window.pad = pad;
  navigator.getGamepads = () => (pad.connected ? [pad] : []);
}"""
INSECURE = """
  delete Crypto.prototype.randomUUID;
  delete Navigator.prototype.getGamepads;
"""  # what browsers withhold from a page that was loaded over http from another computer
ACCENT = """canvas => {
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  let found = 0;
  for (let at = 0; at < data.length; at += 4) if (data[at + 2] > 150 && data[at] < 80) found += 1;
  return found;
}"""  # how much of the canvas is blue: the robot and its path


@dataclass
class Scene:
    """A daemon with a robot, and the browser."""

    host: Daemon
    robot: DisturbedRobot
    browser: Browser
    tab: Visit  # used again by most tests

    @property
    def wanted(self) -> tuple[float, ...]:
        """The speeds of the wheels that were commanded."""
        return tuple(control.target_ticks_s for control in self.robot.controls)

    @property
    def owner(self) -> str | None:
        return self.host.hub.robots.find("robot_0").gate.owner_name

    def refusals(self, kind: RefusalKind) -> int:
        """Return how many commands were refused."""
        return self.host.hub.robots.find("robot_0").admission.refused.get(kind, 0)

    async def drives(self) -> None:
        await expect(lambda: self.wanted != (0, 0))

    async def holds(self, tab: Visit, key: str) -> None:
        """Drive with a key."""
        await tab.hold(key, lambda: self.wanted != (0, 0))

    async def stands(self, *, within_s: float = 5.0) -> None:
        """Wait until the command is zero and the robot has no driver. Time without a free core is left out."""
        watch = Stopwatch()
        await expect(lambda: self.wanted == (0, 0) and self.owner is None)
        assert watch.seconds < within_s

    async def stays_still(self, seconds: float) -> None:
        await expect_never(lambda: self.wanted != (0, 0), for_s=seconds)


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def everything(browser: Browser) -> AsyncIterator[Scene]:
    robots = {"robot_0": RobotConfig(wheel_separation_m=0.210, max_wheel_m_s=0.3436)}
    async with (
        daemon(Config(robots=robots)) as host,
        simulated_robot(host.tcp) as robot,
        visit(browser, "about:blank") as tab,
    ):
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 0)
        yield Scene(host, robot, browser, tab)


@pytest_asyncio.fixture(loop_scope="session")
async def scene(everything: Scene) -> Scene:
    """Reset the robot for the next test."""
    everything.host.hub.robots.find("robot_0").unlock()
    await everything.stands()
    return everything


@contextlib.asynccontextmanager
async def connected(scene: Scene, url: str = "", *, is_new: bool = False, **options: object) -> AsyncIterator[Visit]:
    """Open the page. A tab that the test closes, or that differs from a computer's, is a new one."""
    url = url or scene.host.url
    async with visit(scene.browser, url, **options) if is_new or options else revisit(scene.tab, url) as tab:
        await tab.is_connected()
        await tab.shows("#robots", "robot_0")
        yield tab


@contextlib.asynccontextmanager
async def driven_by_a_program(scene: Scene, *, priority: int) -> AsyncIterator[None]:
    """In a slow turn on the spot."""
    async with client(scene.host) as program, asyncio.TaskGroup() as tasks:

        async def drive() -> None:
            while True:
                await program.send(op="drive", robot="robot_0", linear=0.0, angular=0.3, priority=priority)
                await asyncio.sleep(LEASE_S / 4)

        driving = tasks.create_task(drive())
        await scene.drives()
        yield
        driving.cancel()


async def test_page_of_an_insecure_origin_shows_the_robot_and_sends_no_request_to_other_hosts(scene: Scene) -> None:
    async with connected(scene, script=INSECURE) as tab:
        await tab.shows("#drive-state", "no driver")
        await tab.shows("#link", "Hz")
        await tab.shows("#clients", "(Chrome)")
        assert tab.complaints == []
        assert tab.other_hosts == []


async def test_the_mouse_on_the_joystick_drives_draws_and_plots(scene: Scene) -> None:
    async with connected(scene) as tab:
        await tab.drag_stick(0, 70, lambda: scene.wanted != (0, 0))
        await tab.shows("#drive-state", "You drive")
        await tab.shows("#robots", "you drive")
        begun = scene.robot.world.odometry.x_m
        await expect(
            lambda: abs(scene.robot.world.odometry.x_m - begun) > 0.3
        )  # a shorter path hides under the robot's picture
        await tab.page.mouse.up()
        await scene.stands(within_s=1.0)
        await tab.map_has("length", r"^0\.[2-9]|^[1-9]")
        drawn = await tab.page.locator("#map-canvas").evaluate(ACCENT)
        await tab.page.get_by_role("button", name="Clear the path").click()
        await tab.map_has("length", r"^0\.0")
        assert 100 < await tab.page.locator("#map-canvas").evaluate(ACCENT) < drawn
        assert int(await tab.page.locator("#plot-forward .uplot").get_attribute("data-count") or 0) > 5
        assert (tab.complaints, tab.other_hosts) == ([], [])


async def test_a_finger_drives_until_it_is_gone(scene: Scene) -> None:
    async with connected(scene, viewport=PHONE, has_touch=True, is_mobile=True) as tab:
        touch = await tab.page.context.new_cdp_session(tab.page)
        for end in ("touchEnd", "touchCancel"):

            async def press() -> None:
                x, y = await tab.stick()
                for kind, points in (("touchStart", [{"x": x, "y": y}]), ("touchMove", [{"x": x + 20, "y": y - 60}])):
                    await touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

            async def release(end: str = end) -> None:
                await touch.send("Input.dispatchTouchEvent", {"type": end, "touchPoints": []})

            # A finger to the right turns clockwise.
            await tab.press_until(press, release, lambda: scene.wanted[0] > scene.wanted[1] > 0)
            await release()
            await scene.stands(within_s=1.0)


async def test_keys_drive_while_they_are_pressed(scene: Scene) -> None:
    async with connected(scene) as tab:
        keys = tab.page.keyboard

        async def press() -> None:
            await keys.down("ArrowUp")
            await keys.down("KeyA")

        async def release() -> None:
            await keys.up("KeyA")
            await keys.up("ArrowUp")

        await scene.holds(tab, "ArrowUp")
        straight = scene.wanted
        assert straight[0] == straight[1]
        await tab.press_until(press, release, lambda: 0 < scene.wanted[0] < scene.wanted[1])
        await release()
        await scene.stands(within_s=1.0)


async def test_a_key_in_a_field_is_a_letter_and_a_slider_moves_nothing(scene: Scene) -> None:
    async with connected(scene) as tab:
        await tab.layout("Tune")
        for selector in ("[aria-label='Left Kp']", "#max-linear"):
            await tab.page.locator(selector).focus()
            for key in ("ArrowUp", "KeyW", "ArrowRight"):
                await tab.page.keyboard.press(key)
        await tab.shows("label[for=max-linear] + output", "0.24")
        await scene.stays_still(0.3)


async def test_key_that_is_held_when_the_window_is_left_must_be_pressed_again(scene: Scene) -> None:
    async with connected(scene) as tab:
        for event in ("blur", "pagehide"):
            await scene.holds(tab, "KeyW")
            await tab.page.evaluate("name => dispatchEvent(new Event(name))", event)
            await scene.stands(within_s=1.0)
            await tab.page.keyboard.down("KeyW")  # a repeat
            await scene.stays_still(0.3)
            await tab.page.keyboard.up("KeyW")
        await scene.holds(tab, "KeyW")


async def test_a_gamepad_drives_with_its_shoulder_pressed_and_not_when_it_is_lost(scene: Scene) -> None:
    async with connected(scene) as tab:
        await tab.page.evaluate(GAMEPAD)
        await tab.page.evaluate("pad.axes[1] = -1")
        await tab.shows("#gamepad", "hold a shoulder button")
        await scene.stays_still(0.3)
        await tab.hold_button("pad.buttons[4]", lambda: scene.wanted != (0, 0))
        await tab.page.evaluate("pad.connected = false")
        await scene.stands(within_s=1.0)


@pytest.mark.parametrize("way", ["closed", "crashed"])
async def test_page_that_is_closed_while_driving_stops_the_robot(scene: Scene, way: str) -> None:
    async with connected(scene, is_new=True) as tab:
        await scene.holds(tab, "KeyW")
        if way == "closed":
            await tab.page.close()
        else:
            killer = await tab.page.context.new_cdp_session(tab.page)
            crashed = tab.page.wait_for_event("crash")
            async with asyncio.TaskGroup() as tasks:
                dying = tasks.create_task(killer.send("Page.crash"))
                await crashed
                dying.cancel()
        await scene.stands(within_s=LEASE_S + 0.3)


async def test_reset_makes_this_the_origin_and_gains_reach_the_robot(scene: Scene) -> None:
    async with connected(scene) as tab:
        for wheel in scene.robot.world.wheels:  # by hand
            wheel.grip(300.0)
        await expect(lambda: scene.robot.world.odometry.x_m > 0.4)
        for wheel in scene.robot.world.wheels:
            wheel.grip(0.0)
        await asyncio.sleep(0.1)  # its last edges are counted
        await tab.shows("#pose", f"{scene.robot.world.odometry.x_m:.2f} m")
        await tab.page.get_by_role("button", name="Reset odometry").click()
        await tab.page.get_by_role("button", name="Really reset?").click()
        await expect(lambda: scene.robot.world.odometry == Pose())
        await tab.shows("#pose", "x0.00 m")

        await tab.layout("Tune")
        await tab.page.get_by_label("Left Kp").fill("12.5")
        await tab.page.get_by_label("Right Kd").fill("0.25")
        await tab.page.get_by_role("button", name="Send").click()
        await expect(lambda: (scene.robot.controls[0].kp, scene.robot.controls[1].kd) == (12.5, 0.25))
        await tab.shows("#tuning-state", "Sent")


async def test_stop_locks_until_unlocked(scene: Scene) -> None:
    async with connected(scene) as tab:
        stop = tab.page.get_by_role("button", name="Stop")
        keys = tab.page.keyboard
        for press in (stop.click, lambda: keys.press("KeyL"), lambda: keys.press("Escape")):
            await scene.holds(tab, "KeyW")
            await press()
            await scene.stands(within_s=1.0)
            await tab.shows("#drive-state", "locked")
            await keys.up("KeyW")
            await keys.down("KeyW")
            await scene.stays_still(0.2)
            await keys.up("KeyW")
            await tab.page.get_by_role("button", name="Unlock").click()
            await tab.page.locator("#lock-reason").wait_for(state="hidden")
        await scene.holds(tab, "KeyW")


@pytest.mark.parametrize("way", ["space", pytest.param("gamepad", marks=pytest.mark.long)])
async def test_stop_without_a_lock_must_be_let_go_and_drives_again(scene: Scene, way: str) -> None:
    async with connected(scene) as tab:
        await tab.page.evaluate(GAMEPAD)
        keys = tab.page.keyboard
        await scene.holds(tab, "KeyW")
        if way == "space":
            await keys.press("Space")
        else:
            await tab.page.evaluate("pad.buttons[1].pressed = true")
        await scene.stands(within_s=1.0)
        await tab.shows("#notice", "robot_0 is stopped.")
        assert scene.host.hub.robots.find("robot_0").gate.lock_reason is None
        await scene.stays_still(LEASE_S)
        await keys.up("KeyW")
        await scene.holds(tab, "KeyW")
        await keys.up("KeyW")


async def test_space_stops_what_a_program_drives_until_it_lets_go(scene: Scene) -> None:
    async with connected(scene) as tab, driven_by_a_program(scene, priority=90):
        await scene.drives()
        await tab.page.keyboard.press("Space")
        await scene.stands(within_s=1.0)
        await scene.stays_still(LEASE_S)


async def test_stop_works_without_the_websocket(scene: Scene) -> None:
    async with visit(scene.browser, "about:blank") as tab, driven_by_a_program(scene, priority=90):
        await tab.page.route_web_socket("**/*", lambda socket: socket.close())
        await tab.page.goto(scene.host.url)
        await tab.shows("#connection", "no connection")
        await tab.shows("#robots", "drives")
        await tab.page.get_by_role("button", name="Stop").click()
        await scene.stands(within_s=1.0)
        await scene.stays_still(LEASE_S)  # though the program continues
        assert scene.host.hub.robots.find("robot_0").gate.lock_reason == "the stop on the page"


@pytest.mark.long
async def test_every_tab_of_a_browser_can_stop(scene: Scene) -> None:
    """A browser has six connections to one address: the tabs' streams of events must not use up those of a stop."""
    async with connected(scene, is_new=True) as first:
        robot = scene.host.hub.robots.find("robot_0")
        tabs = [first.page, *[await first.page.context.new_page() for _ in range(MOST_STREAMS)]]
        async with driven_by_a_program(scene, priority=90):
            for tab in tabs[1:]:
                await tab.goto(scene.host.url)
            late = await without_stream(tabs)
            for tab in [tab for tab in tabs if tab is not late][1::3]:
                robot.unlock()
                await tab.get_by_role("button", name="Stop").click()
                await expect(lambda: robot.gate.lock_reason == "the stop on the page", timeout_s=1.0)
        robot.unlock()
        async with driven_by_a_program(scene, priority=90):  # the one before has not let go since
            late = await without_stream(tabs)
            await late.get_by_role("button", name="Stop").click()
            await expect(lambda: robot.gate.counts.stops > 0, timeout_s=1.0)


async def without_stream(tabs: list[Page]) -> Page:
    """The tab that waits for a connection. On a slow machine a tab gives up its stream and another takes it."""
    async with asyncio.timeout(TABS_S):
        while True:
            waiting = [tab for tab in tabs if "close other tabs" in await tab.locator("#notice").inner_text()]
            if len(waiting) == 1:
                return waiting[0]
            await asyncio.sleep(0.1)


@pytest.mark.long
async def test_a_network_that_dies_is_noticed_within_a_second_without_the_websocket(scene: Scene) -> None:
    async with proxy(scene.host.url) as network, visit(scene.browser, "about:blank") as tab:
        await tab.page.route_web_socket("**/*", lambda socket: socket.close())
        await tab.page.goto(network.url)
        await tab.shows("#robots", "no driver")
        await tab.shows("#notice", "The stop works")
        network.set_line(Line.STALLS)
        await tab.shows("#notice", "hostlink does not answer", timeout_s=NOTICED_S)
        network.set_line(Line.WORKS)
        await tab.shows("#notice", "The stop works", timeout_s=NOTICED_S)
        network.break_off()
        scene.host.hub.robots.find("robot_0").lock("somebody stands there")
        await tab.shows("#lock-reason", "somebody stands there", timeout_s=2 * NOTICED_S)


@pytest.mark.long
async def test_page_watches_by_one_stream_and_does_not_poll(scene: Scene) -> None:
    async with connected(scene) as tab:
        await tab.shows("#clients", "(Chrome)")
        requests: list[str] = []
        tab.page.on("request", lambda request: requests.append(request.url))
        await expect_never(lambda: requests, for_s=1.5)


@pytest.mark.parametrize("line", [Line.STALLS, pytest.param(Line.SWALLOWS, marks=pytest.mark.long)])
async def test_a_dead_network_is_noticed_within_a_second_and_nothing_old_is_driven_after_it(
    scene: Scene, line: Line
) -> None:
    async with proxy(scene.host.url) as network, connected(scene, network.url) as tab:
        await scene.holds(tab, "KeyW")
        network.set_line(line)
        await tab.shows("#connection", "no answer", timeout_s=NOTICED_S)
        await tab.shows("#notice", "does not answer")
        await scene.stands(within_s=1.0)
        await scene.stays_still(LEASE_S)  # what is on its way is older than a command holds
        network.set_line(Line.WORKS)
        await scene.stays_still(0.5)  # commands that were on their way
        await tab.is_connected()
        await scene.stays_still(0.3)  # though the key is still held
        await tab.page.keyboard.up("KeyW")
        await scene.holds(tab, "KeyW")


async def test_a_daemon_that_is_gone_is_waited_for(scene: Scene) -> None:
    async with proxy(scene.host.url) as network, connected(scene, network.url) as tab:
        network.is_refusing = True
        network.break_off()
        await tab.shows("#connection", "no connection", timeout_s=NOTICED_S)
        await tab.shows("#drive-state", "No connection")
        network.is_refusing = False
        await tab.is_connected(timeout_s=3.0)
        await tab.shows("#drive-state", "no driver")
        await tab.page.locator("#notice").wait_for(state="hidden")


@pytest.mark.long
async def test_page_shows_which_client_drives_and_which_has_priority(scene: Scene) -> None:
    async with connected(scene) as tab:
        async with driven_by_a_program(scene, priority=50):
            await tab.shows("#drive-state", "your stick takes over")
        await scene.stands()
        async with driven_by_a_program(scene, priority=90):
            await tab.shows("#drive-state", "with a higher priority")
            before, refused = scene.wanted, scene.refusals(RefusalKind.HELD)
            await tab.page.keyboard.down("KeyW")
            await expect(lambda: scene.refusals(RefusalKind.HELD) > refused)
            await tab.shows("#drive-state", "drives with a higher priority")
            assert scene.wanted == before
            await tab.page.keyboard.up("KeyW")
        await tab.shows("#drive-state", "no driver")


@pytest.mark.long
async def test_page_shows_the_battery_the_signal_and_the_errors_in_words(scene: Scene) -> None:
    async with connected(scene) as tab:
        await tab.shows("#link", "Battery12.0 V")
        await tab.shows("#link", "Errorsnone")
        await tab.shows("#link", "WiFi–")
        scene.robot.added = encode(Id.LOG, encode_log(Log(0, "WiFi signal -67 dBm")))
        await tab.shows("#link", "WiFi−67 dBm")
        supply(scene.robot, 9.5)
        await tab.shows("#link", "51 battery low")
        await tab.shows("#link", "Battery9.5 V")
        await tab.shows("#link .diagnosis", "limit for five seconds")
        supply(scene.robot, 12.0)
        scene.robot.skip(SHOWN_S)
        await tab.shows("#link", "Errorsnone")
        assert tab.complaints == []


def supply(robot: DisturbedRobot, volts: float) -> None:
    """Show this battery voltage for longer than the robot waits before it reports a low battery."""
    robot.world.change(WorldParameters({"battery_v": volts}))
    robot.skip(LOW_S)
