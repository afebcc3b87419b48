"""The panels: their sizes, one of them alone, the room that plots have, and how old what they show is."""

import re
from typing import Any

import pytest
from axe_playwright_python.async_playwright import Axe
from playwright.async_api import Browser
from playwright.async_api import expect as expect_page

from tests.support.browser import PHONE, Visit, visit
from tests.support.page_server import PageServer, State, link, page_server, robot, topic_view
from tests.support.waiting import expect, expect_never

pytestmark = [pytest.mark.asyncio(loop_scope="session"), pytest.mark.long]

LAPTOP = {"width": 1366, "height": 768}
WIDE = {"width": 1920, "height": 1080}
TABLETS = ({"width": 768, "height": 1024}, {"width": 1024, "height": 768})
STICK_PX = 51  # from its middle to where the knob is drawn at full speed
GAMEPAD = """
  window.pad = { connected: true, axes: [0, 0], buttons: Array.from({ length: 16 }, () => ({ pressed: false })) };
  navigator.getGamepads = () => [window.pad];
"""

BOX = """(element) => {
  const { left, top, right, bottom } = element.getBoundingClientRect();
  let [high, low] = [Math.max(0, top), Math.min(innerHeight, bottom)];
  for (let at = element.parentElement; at !== document.body; at = at.parentElement) {
    if (getComputedStyle(at).overflowY === "visible") continue;
    const box = at.getBoundingClientRect();
    [high, low] = [Math.max(high, box.top), Math.min(low, box.bottom)];
  }
  return { left, top, width: right - left, height: bottom - top, bottom, seen: Math.max(0, low - high) };
}"""  # `seen`: how much of its height is shown without scrolling

SCROLL_TO_START = """(box) => new Promise((scrolled) => {
  box.addEventListener("scroll", scrolled, { once: true });
  box.scrollTop = 0;
})"""


def fleet(count: int = 3, **changes: Any) -> State:
    names = [f"robot_{number}" for number in range(count)]
    return State([robot(name, **changes) for name in names], [link(name) for name in names])


async def box(tab: Visit, selector: str) -> dict[str, float]:
    measured: dict[str, float] = await tab.page.locator(selector).evaluate(BOX)
    return measured


def drives(server: PageServer) -> list[tuple[float, float]]:
    return [(each["linear"], each["angular"]) for each in server.published if each["op"] == "drive"]


async def test_panels_and_columns_keep_the_size_that_a_user_gives_them_in_a_layout(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=LAPTOP) as tab:
        server.show(fleet())
        await tab.shows("#drive-state", "no driver")
        height, width = (await box(tab, "#map"))["height"], (await box(tab, ".left"))["width"]
        edge = tab.page.get_by_role("separator", name="Height of Map")
        await tab.page.keyboard.down("KeyW")
        await expect(lambda: bool(drives(server)))
        await edge.focus()
        await expect(lambda: drives(server)[-1] == (0, 0))  # a held key must be pressed again
        await tab.page.keyboard.up("KeyW")
        server.published.clear()
        for key in ("ArrowUp", "ArrowUp", "ArrowDown", "ArrowUp", "KeyW", "KeyD"):
            await tab.page.keyboard.press(key)
        await expect_never(lambda: set(drives(server)) - {(0, 0)}, for_s=0.3)  # keys on an edge drive nothing
        assert (await box(tab, "#map"))["height"] == pytest.approx(height - 32, abs=1)
        assert await edge.get_attribute("aria-valuenow") == str(round(height - 32))
        side = await box(tab, ".of-left")
        await tab.page.mouse.move(side["left"] + 6, side["top"] + 300)
        await tab.page.mouse.down()
        await tab.page.mouse.move(side["left"] + 66, side["top"] + 310, steps=3)
        await tab.page.mouse.up()
        await tab.page.mouse.move(400, 400)
        for _ in range(2):
            assert (await box(tab, ".left"))["width"] == pytest.approx(width + 60, abs=1)
            assert (await box(tab, "#map"))["height"] == pytest.approx(height - 32, abs=1)
            await tab.page.reload()
            await tab.shows("#drive-state", "no driver")
        await tab.layout("Watch")
        assert (await box(tab, ".left"))["width"] == pytest.approx(width, abs=1)
        assert await tab.page.locator(".sized").count() == 0
        await tab.layout("Drive")
        await tab.page.locator(".of-left").dblclick()
        await edge.press("Enter")
        assert (await box(tab, ".left"))["width"] == pytest.approx(width, abs=1)
        assert (await box(tab, "#map"))["height"] == pytest.approx(height, abs=1)
        assert tab.complaints == []


@pytest.mark.parametrize("viewport", [LAPTOP, PHONE], ids=["laptop", "phone"])
async def test_one_panel_covers_the_others_and_the_stops_stay(browser: Browser, viewport: dict[str, int]) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=viewport) as tab:
        server.show(fleet())
        await tab.shows("#drive-state", "no driver")
        usual = await box(tab, "#map")
        button = tab.page.get_by_role("button", name="Map: maximise")
        await tab.page.keyboard.down("KeyW")
        await expect(lambda: bool(drives(server)))
        await button.click()
        await expect(lambda: drives(server)[-1] == (0, 0))  # the stick is hidden: what is held must be pressed again
        await tab.page.keyboard.up("KeyW")
        alone, main = await box(tab, "#map"), await box(tab, "main")
        assert alone["width"] > viewport["width"] - 30
        assert alone["seen"] > main["height"] - 30
        assert await tab.page.locator("main .panel:visible").count() == 1
        assert await button.get_attribute("aria-pressed") == "true"
        for stop in ("#stop", "#stop-all"):
            measured = await box(tab, stop)
            assert measured["seen"] == measured["height"] > 30
        found = await Axe().run(tab.page)
        assert found.violations_count == 0, found.generate_report()
        await tab.page.locator("#stop-all").click()
        await expect(lambda: ("POST", "/api/stop") in server.requests)
        await tab.page.locator("#stop").click()
        await expect(lambda: ("POST", "/api/robots/robot_0/lock") in server.requests)
        server.requests.clear()
        await tab.page.keyboard.press("Escape")  # closes, and the next one locks
        assert (await box(tab, "#map"))["height"] == pytest.approx(usual["height"], abs=1)
        assert server.requests == []
        await tab.page.keyboard.press("Escape")
        await expect(lambda: server.requests == [("POST", "/api/robots/robot_0/lock")])
        await tab.page.get_by_role("button", name="Drive: maximise").click()
        await tab.page.keyboard.down("KeyW")  # the button was pressed by mouse, so keys drive
        await expect(lambda: drives(server)[-1][0] > 0)
        await tab.page.keyboard.up("KeyW")
        await tab.page.keyboard.press("Escape")
        await expect(lambda: drives(server)[-1] == (0, 0))
        server.published.clear()
        await button.focus()
        for key in ("Enter", "KeyW", "ArrowUp"):
            await tab.page.keyboard.press(key)
        assert await tab.page.locator("main .panel:visible").count() == 1
        # Keys on the button drive nothing. A zero of the drive before may come late.
        await expect_never(lambda: any(each != (0, 0) for each in drives(server)), for_s=0.3)
        await button.press("Enter")
        assert await tab.page.locator("main .panel:visible").count() > 1
        assert tab.complaints == []


async def test_plots_share_the_free_height(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=WIDE) as tab:
        server.show(fleet(1))
        await tab.shows("#drive-state", "no driver")
        for layout, plots in (("Drive", "#speeds"), ("Tune", "#plots"), ("Watch", "#speeds")):
            await tab.layout(layout)
            column, last = await box(tab, ".right"), await box(tab, ".right > .panel:last-child")
            assert column["bottom"] - last["bottom"] < 2, layout  # nothing is left empty
            for plot in await tab.page.locator(f"{plots} .plot").all():
                measured = await plot.evaluate(BOX)
                assert measured["seen"] == measured["height"] > 140, layout
        await tab.page.set_viewport_size(LAPTOP)
        for layout in ("Drive", "Tune"):
            await tab.layout(layout)
            for plot in await tab.page.locator("main .plot").all():
                measured = await plot.evaluate(BOX)
                assert measured["seen"] == measured["height"] > 140, layout
        await tab.page.set_viewport_size(TABLETS[0])
        for plot in await tab.page.locator("main .plot").all():  # of Tune
            measured = await plot.evaluate(BOX)
            assert measured["seen"] == measured["height"] >= 100
        await tab.page.set_viewport_size(LAPTOP)
        await tab.layout("Watch")
        await tab.page.locator("#topics .topics button").click()
        await server.publish("/robot_0/odometry", {"x": 1.0, "y": 2.0, "theta": 0.5})
        await tab.page.get_by_label("Plot theta").check()
        plot = await box(tab, "#topics .plot")
        assert plot["seen"] == plot["height"] >= 160
        assert (await box(tab, "#topics .tree"))["seen"] > 60  # the values are shown next to the plot
        assert tab.complaints == []


async def test_a_tablet_shows_robot_stick_and_stops_without_scrolling_and_a_finger_resizes(browser: Browser) -> None:
    tablet = {"viewport": TABLETS[0], "has_touch": True, "is_mobile": True}
    async with page_server() as server, visit(browser, server.url, **tablet) as tab:
        for count, size in ((3, TABLETS[0]), (50, TABLETS[0]), (50, TABLETS[1])):
            server.show(fleet(count))
            await tab.page.set_viewport_size(size)
            await tab.shows(f"#robots .robot:nth-child({count})", f"robot_{count - 1}")
            for layout in ("Drive", "Tune"):
                await tab.layout(layout)
                for selector in ("#robots .robot:has(:checked)", "#joystick", "#stop", "#stop-all"):
                    measured = await box(tab, selector)
                    assert measured["seen"] == measured["height"] > 25, (count, size, layout, selector)
        assert await tab.page.evaluate("document.documentElement.scrollWidth") == TABLETS[1]["width"]
        await tab.layout("Drive")
        for size in (PHONE, *TABLETS):  # with the larger buttons of a touch screen
            await tab.page.set_viewport_size(size)
            assert await tab.faults() == [], size
        finger = await tab.page.context.new_cdp_session(tab.page)
        before, edge = await box(tab, "#map"), await box(tab, "#map > .splitter")
        assert edge["height"] >= 14  # as high as a finger needs it
        x, y = edge["left"] + edge["width"] / 2, edge["top"] + edge["height"] / 2
        for kind, to in (("touchStart", 0), ("touchMove", -30), ("touchMove", -70)):
            await finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y + to}]})
        await finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        assert (await box(tab, "#map"))["height"] == pytest.approx(before["height"] - 70, abs=1)
        for kind, to in (("touchStart", -70), ("touchMove", -900)):
            await finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y + to}]})
        await finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        assert (await box(tab, "#map"))["height"] == pytest.approx(80, abs=1)  # no less: its bar stays


async def test_keys_and_gamepad_move_the_knob_of_the_stick(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, script=GAMEPAD) as tab:
        server.show(fleet(1))
        await tab.shows("#drive-state", "no driver")
        keys = tab.page.keyboard

        async def is_at(x: float, y: float) -> None:
            """Wait until the knob is so far from the middle of the stick."""
            await tab.until(
                """([x, y]) => {
                  const [ground, knob] = ["#joystick svg", "#joystick .front"].map((each) => {
                    const { left, top, width, height } = document.querySelector(each).getBoundingClientRect();
                    return [left + width / 2, top + height / 2];
                  });
                  return Math.hypot(knob[0] - ground[0] - x, knob[1] - ground[1] - y) < 2;
                }""",
                [x, y],
            )

        await is_at(0, 0)
        await keys.down("KeyW")
        await is_at(0, -STICK_PX)
        await keys.down("ArrowLeft")
        await is_at(-STICK_PX / 2**0.5, -STICK_PX / 2**0.5)  # within the circle
        await keys.up("KeyW")
        await is_at(-STICK_PX, 0)
        await keys.press("Space")  # the key is still held, and drives no longer
        await is_at(0, 0)
        await keys.up("ArrowLeft")
        await tab.page.evaluate("pad.axes[1] = 0.5; pad.buttons[4].pressed = true")
        await is_at(0, STICK_PX / 2)
        await tab.page.evaluate("pad.buttons[4].pressed = false")
        await is_at(0, 0)
        x, y = await tab.stick()
        await tab.page.mouse.move(x, y)
        await tab.page.mouse.down()
        await tab.page.mouse.move(x + 40, y, steps=2)
        await is_at(40 * 0.68, 0)
        await tab.page.mouse.up()
        await is_at(0, 0)


async def test_panels_show_the_age_of_their_values_while_the_daemon_is_gone(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=LAPTOP) as tab:
        server.show(fleet())
        await tab.shows("#drive-state", "no driver")
        await tab.shows("#link [data-tile=device]", "4 ms")
        lost = fleet()
        lost.is_lost = True
        server.show(lost)
        old = re.compile(r"\b([2-9]|\d\d)(\.\d)? s")  # two seconds, so over several attempts to connect again
        for layout, panels in (
            ("Drive", ("#link .age", "#clients .age", "#robots .what >> nth=0", "#pose .age", "#speeds .bar .hint")),
            ("Watch", ("#link .age", "#topics .age", "#drives .age", "#recordings .age")),
            ("Tune", ("#plots .age",)),
        ):
            await tab.layout(layout)
            for panel in panels:
                await expect_page(tab.page.locator(panel)).to_have_text(old)
        await tab.layout("Drive")
        for tile in ("rate", "page", "device", "signal", "battery", "errors"):
            await expect_page(tab.page.locator(f"#link [data-tile={tile}] dd")).to_have_text("–")
        for tile in ("lost", "resyncs"):
            await expect_page(tab.page.locator(f"#link [data-tile={tile}] dd")).to_have_css("font-style", "italic")
        server.show(fleet())
        await expect_page(tab.page.locator("#link .age")).to_be_empty(timeout=15_000)
        await tab.shows("#link [data-tile=device]", "4 ms")


async def test_the_log_keeps_its_newest_line_in_view_in_every_layout(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=LAPTOP) as tab:
        state = fleet(1)
        state.log = [
            {"header": {"stamp": {"secs": 0}}, "level": 2, "name": "robot_0", "msg": f"line {number}"}
            for number in range(60)
        ]
        server.show(state)
        await tab.shows("#log", "line 59")
        for step in ("Watch", "Tune", "Drive", "folded", "unfolded", "alone", "beside others", "Watch"):
            if step in ("folded", "unfolded"):
                await tab.page.get_by_role("button", name="Log", exact=True).click()
            elif step in ("alone", "beside others"):
                await tab.page.get_by_role("button", name="Log: maximise").click()
            else:
                await tab.layout(step)
            if step not in ("Tune", "folded"):
                await expect_page(tab.page.locator("#log li").last).to_be_in_viewport()
        locked = fleet(1, locked=True, lock_reason="a cable")
        server.show(locked)
        await expect_page(tab.page.locator("#log li", has_text="locked: a cable")).to_be_in_viewport()
        await tab.page.locator("#log [role=log]").evaluate(SCROLL_TO_START)
        server.show(fleet(1))
        await tab.shows("#log", "unlocked")
        await expect_page(tab.page.locator("#log li").last).not_to_be_in_viewport()  # the reader has scrolled away


async def test_the_knob_of_the_stick_covers_no_text(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=LAPTOP) as tab:
        server.show(fleet(1))
        await tab.shows("#drive-state", "no driver")
        ground = await box(tab, "#joystick svg")
        for key in ("ArrowUp", "ArrowDown"):
            await tab.page.keyboard.down(key)
            await tab.until("() => document.querySelector('#joystick .front').style.translate !== '0px'")
            knob = await box(tab, "#joystick .front")
            assert ground["top"] - 4 < knob["top"] < knob["bottom"] < ground["bottom"] + 4
            await tab.page.keyboard.up(key)


CUT = """texts => texts
  .filter((text) => text.scrollWidth > text.clientWidth || text.scrollHeight > text.clientHeight + 1)
  .map((text) => text.textContent)"""


async def test_fleet_has_heads_and_does_not_cut_a_reason_beside_free_room(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=LAPTOP) as tab:
        state = fleet(3)
        state.robots[1] |= {"locked": True, "lock_reason": "somebody stands in front of the third bench"}
        server.show(state)
        await tab.layout("Fleet")
        await tab.shows("#robots .heads", "RobotStateSpeedPoses, WiFi")  # none of them measures a battery
        for part in ("b", ".what"):
            assert await tab.page.locator(f"#robots .robot {part}").evaluate_all(CUT) == []
        heads, states = (
            await box(tab, "#robots .heads :nth-child(2)"),
            await box(tab, "#robots .robot:first-child .what"),
        )
        assert heads["left"] == pytest.approx(states["left"], abs=1)


async def test_a_folded_map_is_its_bar_alone(browser: Browser) -> None:
    async with page_server() as server:
        server.show(fleet(1))
        for viewport in (LAPTOP, PHONE):
            async with visit(browser, server.url, viewport=viewport) as tab:
                await tab.shows("#drive-state", "no driver")
                await tab.page.get_by_role("button", name="Map", exact=True).click()
                assert (await box(tab, "#map"))["height"] <= (await box(tab, "#map .bar"))["height"] + 3


async def test_a_phone_counts_robots_in_trouble_beside_its_strip(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=PHONE) as tab:
        state = fleet(5)
        server.show(state)
        await tab.shows("#robots .robot:nth-child(5)", "robot_4")
        await expect_page(tab.page.locator("#robots-counts button:visible")).to_have_count(0)
        state.robots[3] |= {"locked": True, "lock_reason": "a cable"}
        server.show(state)
        count = tab.page.locator("#robots-counts button:visible")
        await expect_page(count).to_have_text(["1 locked"])
        assert await tab.faults() == []
        await count.click()
        await expect_page(tab.page.locator("#robots .robot", has_text="robot_3")).to_be_in_viewport(ratio=0.9)


async def test_a_phone_without_a_robot_shows_all_of_what_to_do(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=PHONE) as tab:
        state = State()
        state.listening["tcp"] = {"host": "0.0.0.0", "port": 11411}
        server.show(state)
        await tab.shows("#robots .boards", "STM32 or another UART")
        empty = await box(tab, "#robots .empty")
        assert empty["seen"] == empty["height"] > 300
        assert await tab.page.locator("#robots .empty").evaluate("box => box.scrollHeight <= box.clientHeight + 1")
        await expect_page(tab.page.locator("#joystick")).to_be_hidden()
        server.show(fleet(1))
        await expect_page(tab.page.locator("#joystick")).to_be_in_viewport()


async def test_micro_ros_is_named_where_it_matters(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url) as tab:
        state = State()
        server.show(state)
        await tab.shows("#robots .boards", "STM32 or another UART")
        assert await tab.page.locator("#robots", has_text="micro-ROS").count() == 0
        state.listening |= {"micro_ros": ["udp://127.0.0.1:8888"]}
        server.show(state)
        await tab.shows("#robots .boards", "hostlink serve --micro-ros udp://0.0.0.0:8888")
        state.listening |= {"micro_ros": ["udp://192.168.4.1:8888"]}
        server.show(state)
        await tab.shows("#robots .ways", "micro-ROS over UDP: 192.168.4.1:8888")
        await tab.shows("#robots .boards", "set as its agent 192.168.4.1 port 8888, UDP")
        for protocol, text in (("micro-ROS", "micro-ROS"), ("rosserial", "")):
            shown = State(robots=[robot("robot_0")], links=[link("robot_0", protocol=protocol)])
            server.show(shown)
            await expect_page(tab.page.locator("#link .firmware")).to_have_text(text)
        assert await tab.faults() == []


async def test_a_red_notice_of_a_phone_is_not_close_to_the_red_stop(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=PHONE) as tab:
        server.show(fleet(2))
        await tab.shows("#drive-state", "no driver")
        before = await box(tab, "#joystick")
        lost = fleet(2)
        lost.is_lost = True
        server.show(lost)
        await tab.shows("#notice", "hostlink does not answer")
        notice, stop = await box(tab, "#notice"), await box(tab, "#stop")
        assert stop["top"] - notice["bottom"] >= 8
        assert (await box(tab, "#joystick"))["top"] == before["top"]


async def test_times_have_their_offset_and_drivers_are_named_for_people(browser: Browser) -> None:
    chrome = "Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 (KHTML, like Gecko) Chrome/156.0 Safari/537.36"
    client = {"name": "client 3", "kind": "websocket", "peer": "10.0.0.5", "role": "drive", "program": chrome}
    ended = {
        "robot": "robot_0",
        "owner": "rest 10.0.0.7",
        "address": "10.0.0.7",
        "priority": 50,
        "began": "2026-07-22T07:43:29.123+00:00",
        "ended": "2026-07-22T07:44:42.000+00:00",
        "seconds": 72.9,
        "commands": 700,
        "fastest_m_s": 0.3,
        "fastest_rad_s": 1.5,
        "end": "owner left",
    }
    async with page_server() as server, visit(browser, server.url, timezone_id="Asia/Kolkata") as tab:
        state = fleet(1, holder="client 3", holder_address="10.0.0.5")
        state.clients = [{**client, "seconds": 9.0, "lag_s": 0.0, "dropped": 0}]
        state.drives = [ended]
        server.show(state)
        await tab.shows("#drive-state", "Chrome (client 3, 10.0.0.5) drives: your stick takes over")
        await tab.shows("#log", "times at +05:30")
        await tab.layout("Watch")
        await tab.shows("#drives li", "a REST request from 10.0.0.7")
        await tab.shows("#drives li", "13:13:29 +05:30")
        await tab.shows("#drives li", "ended: its program disconnected")


async def test_a_topic_that_hostlink_publishes_on_demand_is_not_called_silent(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url, viewport=LAPTOP) as tab:
        state = fleet(1)
        state.topics = [
            topic_view("/tf", "tf2_msgs/TFMessage", subscribers=0, is_derived=True),
            topic_view("/robot_0/odom", "nav_msgs/Odometry", subscribers=1, is_derived=True),
        ]
        server.show(state)
        await tab.layout("Watch")
        rates = tab.page.locator("#topics .rate")
        await expect_page(rates).to_have_text(["silent", "on demand", "silent"])
