"""Hazards that must not move a robot or block a stop: lost keys, robots that connect and leave, wild values."""

import asyncio
import math
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Browser
from playwright.async_api import expect as expect_page

from tests.support.browser import PHONE, Visit, visit
from tests.support.page_server import PageServer, State, link, odometry, page_server, robot
from tests.support.waiting import TIMEOUT_S, expect, expect_never

pytestmark = pytest.mark.asyncio(loop_scope="session")

PAD = """
  const pad = { connected: true, axes: [0, -1, 0, 0], buttons: Array.from({ length: 16 }, () => ({ pressed: false })) };
  window.pad = pad;
  navigator.getGamepads = () => [pad];
"""
SECOND_PAD = """
  window.other = { ...pad, buttons: Array.from({ length: 16 }, () => ({ pressed: false })) };
  navigator.getGamepads = () => [pad, null, other];
"""
TAP = """async (ms) => {
  const press = (pressed) => (pad.buttons[1].pressed = pressed);
  press(true);
  await new Promise((resolve) => setTimeout(resolve, ms));
  press(false);
  await new Promise((resolve) => setTimeout(resolve, 3 * ms));
}"""
SHORTEST_MS, PRESSES = 30, 8  # a finger that hits a button lets it go no sooner
DISPATCH = "([name, selector]) => document.querySelector(selector).dispatchEvent(new Event(name, { bubbles: true }))"
FREEZE = "(ms) => { const end = performance.now() + ms; while (performance.now() < end); }"
LASTING_COMMANDS = 10  # more than the zeros after a motion
SENT_AGAIN_S = 0.12  # what is held is sent every 80 ms
FROZEN_MS = 700
BEHIND_S = """(time) => {
  const [hours, minutes, seconds] = time.textContent.split(":").map(Number);
  const now = new Date(Date.now());
  const behind = (now.getHours() - hours) * 3600 + (now.getMinutes() - minutes) * 60 + now.getSeconds() - seconds;
  return (behind + 86400) % 86400;
}"""
KEEPS_NOTHING = """
  for (const name of ["localStorage", "sessionStorage"]) {
    Object.defineProperty(window, name, { get: () => { throw new DOMException("blocked", "SecurityError"); } });
  }
"""
FOCUSED = """() => {
  window.focused = [];
  addEventListener("focusin", ({ target }) => target.matches("[type=radio]") && window.focused.push(target.value));
}"""
LINES = """
  window.lines = 0;
  const line = CanvasRenderingContext2D.prototype.lineTo;
  CanvasRenderingContext2D.prototype.lineTo = function (...to) {
    window.lines += 1;
    line.apply(this, to);
  };
"""


def fleet(*names: str, **changes: Any) -> State:
    return State([robot(name, **changes) for name in names], [link(name) for name in names])


@dataclass
class Scene:
    server: PageServer
    tab: Visit

    def commands(self) -> list[tuple[str, float, float]]:
        sent = [each for each in self.server.published if each["op"] == "drive"]
        return [(each["robot"], each["linear"], each["angular"]) for each in sent]

    def moving_epochs(self) -> list[int | None]:
        sent = [each for each in self.server.published if each["op"] == "drive"]
        return [each["epoch"] for each in sent if (each["linear"], each["angular"]) != (0, 0)]

    def is_driven(self, name: str) -> bool:
        return any(each[0] == name and each[1:] != (0, 0) for each in self.commands()[-1:])

    async def drives(self, name: str = "robot_0") -> None:
        await expect(lambda: self.is_driven(name))

    async def holds(self, key: str, name: str = "robot_0") -> None:
        """Drive with a key."""
        await self.tab.hold(key, lambda: self.is_driven(name))

    async def drags_forward(self) -> float:
        """Drag the stick 40 px up; return its velocity. The first commands are of positions on the way."""
        await self.tab.drag_stick(0, 40, lambda: self.is_driven("robot_0"))
        sent = len(self.commands())
        await expect(lambda: len(self.commands()) > sent + 2)
        return self.commands()[-1][1]

    async def pauses(self) -> None:
        """Wait until nothing more is sent."""
        sent = -1
        async with asyncio.timeout(TIMEOUT_S):
            while sent != len(self.commands()):
                sent = len(self.commands())
                await asyncio.sleep(2 * SENT_AGAIN_S)

    async def stands(self) -> None:
        """Check that zeros were sent last, and that nothing follows while keys stay held."""
        await expect(lambda: [each[1:] for each in self.commands()[-2:]] == [(0, 0), (0, 0)])
        sent = len(self.commands())
        await expect_never(lambda: any(each[1:] != (0, 0) for each in self.commands()[sent:]), for_s=SENT_AGAIN_S)


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def opened(browser: Browser) -> AsyncIterator[Scene]:
    async with page_server() as server, visit(browser, server.url, script=PAD) as tab:
        yield Scene(server, tab)


@pytest_asyncio.fixture(loop_scope="session")
async def scene(opened: Scene) -> Scene:
    """Show one robot without a driver, with nothing held."""
    page = opened.tab.page
    opened.server.show(fleet("robot_0"))
    await opened.tab.layout("Drive")
    await page.mouse.up()
    for key in ("KeyW", "KeyA", "ArrowDown", "Meta"):
        await page.keyboard.up(key)
    await page.evaluate("document.activeElement.blur()")
    await opened.tab.shows("#drive-state", "no driver")
    opened.server.published.clear()
    opened.server.requests.clear()
    return opened


@pytest.mark.parametrize("name", ["contextmenu", pytest.param("dragstart", marks=pytest.mark.long)])
async def test_a_menu_or_a_drag_that_swallows_the_release_of_a_key_stops(scene: Scene, name: str) -> None:
    await scene.holds("KeyW")
    await scene.tab.page.evaluate(DISPATCH, [name, "#link"])
    await scene.stands()


@pytest.mark.parametrize("key", ["Meta", *(pytest.param(each, marks=pytest.mark.long) for each in ("Alt", "Control"))])
async def test_a_key_of_the_system_stops_because_a_release_beside_it_is_not_reported(scene: Scene, key: str) -> None:
    await scene.holds("KeyW")
    await scene.tab.page.keyboard.down(key)
    await scene.stands()
    await scene.tab.page.keyboard.up(key)
    await scene.tab.page.keyboard.up("KeyW")
    await scene.holds("KeyW")


async def test_another_button_of_the_mouse_drives_nothing(scene: Scene) -> None:
    page = scene.tab.page
    x, y = await scene.tab.stick()
    for button in ("right", "middle"):
        await page.mouse.move(x, y - 40)
        await page.mouse.down(button=button)  # type: ignore[arg-type]
        await page.mouse.move(x, y - 60)
        await asyncio.sleep(0.1)
        await page.mouse.up(button=button)  # type: ignore[arg-type]
    assert scene.commands() == []


async def test_a_stick_that_moves_on_the_screen_while_it_is_held_keeps_its_velocity(scene: Scene) -> None:
    """The list of robots above it becomes shorter: the middle of the stick must not pass under the pointer."""
    page = scene.tab.page
    scene.server.show(fleet(*(f"robot_{number}" for number in range(6))))
    await scene.tab.shows("#robots .robot:nth-child(6)", "robot_5")
    velocity = await scene.drags_forward()
    x, y = await scene.tab.stick()
    scene.server.show(fleet("robot_0"))
    await expect_page(page.locator("#robots .robot")).to_have_count(1)
    assert (await scene.tab.stick())[1] < y - 80
    await page.mouse.move(x, y - 41)
    sent = len(scene.commands())
    await expect(lambda: len(scene.commands()) > sent + 2)
    name, linear, angular = scene.commands()[-1]
    assert (name, linear) == ("robot_0", pytest.approx(velocity, rel=0.1))
    assert abs(angular) < 0.05
    await page.mouse.up()
    await scene.stands()
    assert await scene.drags_forward() == pytest.approx(velocity, rel=0.1)  # measured again
    await page.mouse.up()


async def test_a_window_whose_size_changes_lets_go_of_the_stick(scene: Scene) -> None:
    await scene.tab.drag_stick(0, 40, lambda: scene.is_driven("robot_0"))
    await scene.tab.page.evaluate("dispatchEvent(new Event('resize'))")
    await scene.stands()
    await scene.tab.page.mouse.up()


async def test_findings_and_errors_do_not_move_the_stick_of_a_phone(browser: Browser) -> None:
    """Errors and findings appear while the stick is held."""
    async with page_server() as server, visit(browser, server.url, viewport=PHONE, has_touch=True) as tab:
        state = fleet("robot_0")
        known = state.links[0]["topics"][0]
        state.links[0]["topics"].append({**known, "name": "/robot_0/errors", "type": "std_msgs/UInt16MultiArray"})
        server.show(state)
        await tab.shows("#drive-state", "no driver")
        place = await tab.stick()
        await expect(lambda: any(each.get("topic") == "/robot_0/errors" for each in server.published))
        await server.publish("/robot_0/errors", {"data": [31, 12, 43]})
        await tab.shows("#link", "31 no command")
        assert await tab.stick() == place
        found = {
            "code": "no_topics",
            "cause": "It announces no topics.",
            "next_step": "Flash another one.",
            "detail": "",
        }
        state.links[0]["diagnosis"] = [found]
        state.robots[0]["firmware"] = "the_firmware 1.2"
        server.show(state)
        await tab.shows("#link .diagnosis", "announces no topics")
        assert await tab.stick() == place
        assert await tab.faults() == []


async def test_a_mouse_whose_release_was_lost_lets_go_as_soon_as_it_moves(scene: Scene) -> None:
    page = scene.tab.page
    await scene.tab.drag_stick(0, 60, lambda: scene.is_driven("robot_0"))
    moved = "new PointerEvent('pointermove', { pointerType: 'mouse', pointerId: 1, buttons: 0, bubbles: true })"
    await page.evaluate(f"document.body.dispatchEvent({moved})")
    await scene.stands()
    await page.mouse.up()
    await scene.tab.drag_stick(0, 60, lambda: scene.is_driven("robot_0"))


async def test_a_page_that_did_not_run_drives_on_only_when_it_is_pressed_again(scene: Scene) -> None:
    """A laptop that slept, a debugger or a dialog does the same: releases meanwhile are not known."""
    page = scene.tab.page
    await scene.holds("KeyW")
    await page.evaluate(FREEZE, FROZEN_MS)
    await scene.stands()
    await page.keyboard.up("KeyW")
    await scene.holds("KeyW")


async def test_a_computer_that_slept_while_a_key_was_held_drives_no_more(scene: Scene) -> None:
    """The page's clock may stand meanwhile, as it does on Linux; the time of day does not."""
    page = scene.tab.page
    await scene.holds("KeyW")
    await page.evaluate("const now = Date.now; Date.now = () => now() + 7_200_000")
    await scene.stands()
    scene.server.show(fleet("robot_0", locked=True))
    line = page.locator("#log li", has_text="locked")
    await expect_page(line).to_be_visible()
    assert await line.locator("time").evaluate(BEHIND_S) < 60  # what happens now is not shown two hours early


async def test_a_gamepad_drives_only_from_the_window_that_has_the_focus(scene: Scene) -> None:
    page = scene.tab.page
    await page.evaluate("document.hasFocus = () => false; pad.buttons[5].pressed = true")
    await scene.tab.shows("#gamepad", "another window")
    assert scene.commands() == []
    await page.evaluate("delete document.hasFocus")
    await scene.tab.shows("#gamepad", "release the shoulder button")  # it was held before the window had the focus
    assert scene.commands() == []
    await page.evaluate("pad.buttons[5].pressed = false")
    await scene.tab.shows("#gamepad", "hold a shoulder button")
    await scene.tab.hold_button("pad.buttons[5]", lambda: scene.is_driven("robot_0"))
    await page.evaluate("pad.buttons[5].pressed = false")
    await scene.stands()


async def test_a_gamepad_beside_another_one_drives_and_stops(scene: Scene) -> None:
    """Browsers list some keyboards and receivers as gamepads, and the first one may lie about."""
    page = scene.tab.page
    await page.evaluate(SECOND_PAD)
    await scene.tab.hold_button("other.buttons[5]", lambda: scene.is_driven("robot_0"))
    await page.evaluate("other.buttons[1].pressed = true")
    await expect(lambda: scene.server.requests == [("POST", "/api/robots/robot_0/stop")])
    await scene.stands()
    await page.evaluate("navigator.getGamepads = () => [pad]")


async def test_no_short_press_of_the_stop_on_a_gamepad_is_missed(scene: Scene) -> None:
    page = scene.tab.page
    for press in range(PRESSES):
        await page.evaluate(TAP, SHORTEST_MS)
        await expect(lambda press=press: len(scene.server.requests) == press + 1)  # type: ignore[misc]


@pytest.mark.long
async def test_arrows_in_the_menu_of_a_panel_and_in_a_list_drive_nothing(scene: Scene) -> None:
    page = scene.tab.page
    await page.get_by_role("button", name="Log: move, fold").press("Enter")
    first = await page.locator(":focus").inner_text()
    await page.keyboard.press("ArrowDown")
    await page.keyboard.press("KeyW")
    assert await page.locator(":focus").inner_text() != first
    await page.keyboard.press("End")
    await expect_page(page.locator(":focus")).to_have_text("Reset Drive")
    await page.keyboard.press("ArrowDown")
    await expect_page(page.locator(":focus")).to_have_text(first)
    await page.keyboard.press("Tab")
    await page.locator("#clients ul").focus()
    await page.keyboard.press("Shift+Tab")
    await page.keyboard.press("Tab")  # like a user without a mouse
    await expect_page(page.locator("#clients ul")).to_be_focused()
    await page.keyboard.press("ArrowDown")
    assert scene.commands() == []
    await page.keyboard.press("KeyW")
    await expect(lambda: scene.commands() != [])


INCIDENT = {
    "robot": "robot_0",
    "cause": "locked",
    "detail": "",
    "at": "2026-11-22T07:43:29+00:00",
    "file": "one.mcap",
    "bytes": 9,
}


async def open_something(scene: Scene, what: str) -> None:
    """Open what lies over the page, or what Escape closes."""
    page = scene.tab.page
    if what in ("an incident", "another layout"):
        await scene.tab.layout("Watch")
    if what == "an incident":
        await page.get_by_role("button", name="Open Emergency stop").click()
        await expect_page(page.get_by_role("heading", name="Emergency stop: robot_0")).to_be_focused()
    elif what == "a panel alone":
        await page.get_by_role("button", name="Map: maximise").click()
    elif what == "a folded panel":
        await page.get_by_role("button", name="Drive", exact=True).nth(1).click()
    elif what == "a menu":
        await page.get_by_role("button", name="Log: move, fold").click()
    elif what == "a search":
        await page.get_by_role("searchbox", name="Filter").fill("lost")
        await page.get_by_role("searchbox", name="Filter").focus()


async def is_open(scene: Scene, what: str) -> bool:
    page = scene.tab.page
    selector = {"an incident": "#incident", "a panel alone": ".maximised", "a menu": "#panel-menu:popover-open"}
    if what == "a search":
        return bool(await page.get_by_role("searchbox", name="Filter").input_value())
    return await page.locator(selector[what]).count() > 0


HIDES = ("an incident", "a panel alone", "a folded panel", "another layout")


@pytest.mark.parametrize("what", [HIDES[0], *(pytest.param(each, marks=pytest.mark.long) for each in HIDES[1:])])
async def test_keys_drive_only_where_the_stick_is_visible(scene: Scene, what: str) -> None:
    state = fleet("robot_0")
    state.incidents = [INCIDENT]
    scene.server.show(state)
    keys = scene.tab.page.keyboard
    await open_something(scene, what)
    for key in ("KeyW", "KeyD", "ArrowUp"):
        await keys.down(key)
    await scene.tab.shows("#notice", "Keys drive only where the stick is visible.")
    await expect_never(lambda: scene.is_driven("robot_0"), for_s=SENT_AGAIN_S)
    if what == "a folded panel":
        await open_something(scene, what)
    elif what != "another layout":
        await keys.press("Escape")
    await scene.tab.layout("Drive")
    await expect_never(lambda: scene.is_driven("robot_0"), for_s=SENT_AGAIN_S)  # a key is pressed anew
    for key in ("KeyW", "KeyD", "ArrowUp"):
        await keys.up(key)
    await scene.holds("KeyW")


@pytest.mark.parametrize("what", [HIDES[0], *(pytest.param(each, marks=pytest.mark.long) for each in HIDES[1:])])
async def test_gamepad_drives_only_where_the_stick_is_visible(scene: Scene, what: str) -> None:
    state = fleet("robot_0")
    state.incidents = [INCIDENT]
    scene.server.show(state)
    await open_something(scene, what)
    await scene.tab.page.evaluate("pad.buttons[5].pressed = true")
    await scene.tab.shows("#notice", "The gamepad drives only where the stick is visible.")
    await expect_never(scene.commands, for_s=SENT_AGAIN_S)
    if what == "a folded panel":
        await open_something(scene, what)
    elif what != "another layout":
        await scene.tab.page.keyboard.press("Escape")
    await scene.tab.layout("Drive")
    await scene.tab.shows("#gamepad", "hold it again to drive")
    await expect_never(scene.commands, for_s=SENT_AGAIN_S)
    await scene.tab.page.evaluate("pad.buttons[5].pressed = false")
    await scene.tab.shows("#gamepad", "hold a shoulder button")  # the page reads a gamepad now and then
    await scene.tab.hold_button("pad.buttons[5]", lambda: scene.is_driven("robot_0"))
    await scene.tab.page.evaluate("pad.buttons[5].pressed = false")
    await scene.stands()


async def test_a_stick_that_is_covered_while_it_is_held_lets_go(scene: Scene) -> None:
    """An incident is read from the disk, so it may open while its reader drives again."""
    cover = "document.querySelector('main').append(Object.assign(document.createElement('p'), { id: 'cover' }))"
    style = "position: absolute; inset: 0; z-index: 5"
    for hold, release in (
        (lambda: scene.holds("KeyW"), lambda: scene.tab.page.keyboard.up("KeyW")),
        (lambda: scene.tab.drag_stick(0, 60, lambda: scene.is_driven("robot_0")), scene.tab.page.mouse.up),
        (
            lambda: scene.tab.hold_button("pad.buttons[5]", lambda: scene.is_driven("robot_0")),
            lambda: scene.tab.page.evaluate("pad.buttons[5].pressed = false"),
        ),
    ):
        await hold()
        await scene.tab.page.evaluate(f"() => {{ {cover}; document.querySelector('#cover').style = '{style}'; }}")
        await scene.stands()
        await scene.tab.page.evaluate("document.querySelector('#cover').remove()")
        await scene.stands()
        await release()


@pytest.mark.parametrize("what", ["an incident", "a panel alone", "a menu", "a search"])
async def test_escape_closes_what_is_open_and_locks_when_nothing_is(scene: Scene, what: str) -> None:
    state = fleet("robot_0", holder="client 3", priority=90)  # another client drives
    state.incidents = [INCIDENT]
    scene.server.show(state)
    page = scene.tab.page
    await open_something(scene, what)
    assert await is_open(scene, what)
    await page.keyboard.press("Escape")
    assert not await is_open(scene, what)
    assert scene.server.requests == []
    await page.keyboard.press("Escape")
    await expect(lambda: scene.server.requests == [("POST", "/api/robots/robot_0/lock")])


async def test_escape_while_the_page_drives_locks_at_once(scene: Scene) -> None:
    page = scene.tab.page
    await page.get_by_role("button", name="Drive: maximise").click()
    await scene.holds("KeyW")
    await page.keyboard.press("Escape")
    await expect(lambda: scene.server.requests == [("POST", "/api/robots/robot_0/lock")])
    await scene.stands()
    await page.keyboard.up("KeyW")
    await page.keyboard.press("Escape")
    await expect_page(page.locator(".maximised")).to_have_count(0)
    assert len(scene.server.requests) == 1


async def test_a_robot_that_was_chosen_by_mouse_is_driven_by_keys_at_once(scene: Scene) -> None:
    page = scene.tab.page
    scene.server.show(fleet("robot_0", "robot_1", "robot_2"))
    await page.evaluate(FOCUSED)
    await page.locator("#robots .robot", has_text="robot_1").click()
    assert await page.evaluate("window.focused") == []  # not for a moment, in which an arrow would choose another one
    await scene.holds("ArrowDown", "robot_1")
    await page.keyboard.up("ArrowDown")
    await page.locator("#robots input:checked").focus()
    await page.keyboard.press("ArrowUp")  # as in every group of radio buttons
    await expect_page(page.locator("#robots .robot:has(:checked)")).to_contain_text("robot_0")
    await scene.holds("KeyW", "robot_0")


async def test_robot_that_connects_takes_neither_the_stick_nor_the_stop(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url) as tab:
        scene = Scene(server, tab)
        server.show(fleet("robot_5"))
        await tab.shows("#drive-state", "no driver")
        await scene.holds("KeyW", "robot_5")
        server.show(fleet("robot_0", "robot_5"))
        await tab.shows("#robots", "robot_0")
        await tab.page.keyboard.press("Escape")
        await expect(lambda: server.requests == [("POST", "/api/robots/robot_5/lock")])
        await tab.page.keyboard.up("KeyW")
        assert {name for name, *_ in scene.commands()} == {"robot_5"}
        server.show(fleet("robot_0", "robot_1"))  # it is forgotten: no other one was chosen
        await tab.shows("#drive-state", "Choose a robot")
        await tab.page.keyboard.press("KeyW")
        assert {name for name, *_ in scene.commands()} == {"robot_5"}
        server.requests.clear()
        await tab.page.keyboard.press("Escape")
        await expect(lambda: server.requests == [("POST", "/api/stop")])
        await tab.page.locator("#robots .robot", has_text="robot_1").click()
        await scene.holds("KeyW", "robot_1")


async def test_a_later_stop_takes_nothing_from_an_earlier_one(scene: Scene) -> None:
    page = scene.tab.page
    state = fleet("robot_0", "robot_1", "robot_2")
    state.is_stop_lost = True
    scene.server.show(state)
    await page.get_by_role("button", name="Lock all").click()
    await scene.tab.shows("#notice", "has not arrived yet")
    await page.keyboard.press("KeyL")
    await asyncio.sleep(0.1)
    scene.server.show(fleet("robot_0", "robot_1", "robot_2"))
    paths = {"/api/lock", "/api/robots/robot_0/lock"}
    await expect(lambda: {path for _, path in scene.server.requests} == paths)
    await scene.tab.shows("#notice", "stopped")


async def test_stop_of_all_names_what_it_sent_to_boards(scene: Scene) -> None:
    state = fleet("robot_0", "robot_1")
    board = {"link": 3, "peer": "10.0.0.3", "host": None, "robot": None, "is_guarded": False, "is_locked": False}
    motor = {**board, "topic": "/left_motor", "type": "std_msgs/Int16", "is_zero_sent": True, "reason": ""}
    word = {
        **board,
        "host": "kitchen",
        "topic": "/word",
        "type": "std_msgs/String",
        "is_zero_sent": False,
        "reason": "it has no zero",
    }
    state.endpoints = [motor, word]
    scene.server.show(state)
    await scene.tab.page.get_by_role("button", name="Stop all").click()
    sent = "/left_motor of 10.0.0.3: zero sent; it is not a robot's, so nobody can say that it is stopped."
    await scene.tab.shows(
        "#notice", f"All 2 robots are stopped. {sent} /word of 10.0.0.3 at kitchen was not sent a zero"
    )


async def test_the_stop_works_when_it_is_pressed_and_waits_for_no_release(scene: Scene) -> None:
    """A hurried press slides off the button, or scrolls: the browser then sends no click."""
    page, lock = scene.tab.page, ("POST", "/api/robots/robot_0/lock")
    await page.locator("#stop").hover()
    await page.mouse.down()
    await expect(lambda: scene.server.requests == [lock])
    await page.mouse.move(10, 10)
    await page.mouse.up()
    await page.locator("#stop").press("Enter")
    await expect(lambda: scene.server.requests == [lock] * 2)
    await page.locator("#stop").click()
    await expect(lambda: scene.server.requests == [lock] * 3)
    await expect_never(lambda: len(scene.server.requests) > 3, for_s=SENT_AGAIN_S)


async def test_the_stop_works_beside_a_finger_on_the_stick(browser: Browser) -> None:
    """A browser makes no click of a second finger."""
    async with page_server() as server, visit(browser, server.url, has_touch=True) as tab:
        scene = Scene(server, tab)
        server.show(fleet("robot_0"))
        await tab.shows("#drive-state", "no driver")
        x, y = await tab.stick()
        box = await tab.page.locator("#stop").bounding_box()
        assert box is not None
        touch = await tab.page.context.new_cdp_session(tab.page)
        stick = {"x": x, "y": y - 50, "id": 1}
        stop = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "id": 2}
        for kind, points in (
            ("touchStart", [{**stick, "y": y}]),
            ("touchMove", [stick]),
            ("touchStart", [stick, stop]),
            ("touchMove", [stick]),  # the second one is let go
        ):
            await touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        await expect(lambda: server.requests == [("POST", "/api/robots/robot_0/lock")])
        await scene.stands()


async def test_a_stop_that_the_daemon_cannot_pass_on_now_is_tried_again(scene: Scene) -> None:
    state = fleet("robot_0")
    state.refusal, state.refusal_status = "bench-2 has not answered", HTTPStatus.SERVICE_UNAVAILABLE
    scene.server.show(state)
    await scene.tab.page.keyboard.press("Escape")
    await scene.tab.shows("#notice", "bench-2 has not answered")
    await expect(lambda: len(scene.server.requests) >= 3)
    scene.server.show(fleet("robot_0"))
    await scene.tab.shows("#notice", "robot_0 is stopped")


async def test_a_stop_of_all_names_each_robot_that_moves_or_is_not_known_to_stand(scene: Scene) -> None:
    state = fleet("robot_0", "robot_1", "robot_2")
    state.standstills["robot_1"] = {
        "state": "moving", "speed_m_s": -0.1, "after_s": None, "reason": "driven by client 3",
    }  # fmt: skip
    scene.server.show(state)
    await scene.tab.layout("Fleet")
    await scene.tab.page.get_by_role("button", name="Stop all").click()
    await scene.tab.shows("#notice", "2 of 3 robots are stopped. robot_1 moves at 0.10 m/s, driven by client 3.")
    unknown = {"state": "unknown", "speed_m_s": None, "turn_rad_s": None, "after_s": None}
    state.standstills = {"robot_2": {**unknown, "reason": "its device is not connected"}}
    await scene.tab.page.get_by_role("button", name="Stop all").click()
    await scene.tab.shows("#notice", "Whether robot_2 is stopped is unknown: its device is not connected.")
    state.standstills = {}
    await scene.tab.page.get_by_role("button", name="Stop all").click()
    await scene.tab.shows("#notice", "All 3 robots are stopped.")


async def test_a_confirmed_stop_is_withdrawn_when_a_source_drives_again(scene: Scene) -> None:
    await scene.tab.page.keyboard.press("Escape")
    await scene.tab.shows("#notice", "robot_0 is stopped.")
    scene.server.show(fleet("robot_0", holder="client 3"))
    await expect_page(scene.tab.page.locator("#notice")).to_be_hidden(timeout=1000)  # sooner than by itself


async def test_a_motion_carries_the_epoch_of_its_first_answer(scene: Scene) -> None:
    """The daemon refuses the motion after an interruption: a stop, a lock, a reconnection of the device."""
    page, state = scene.tab.page, fleet("robot_0")
    state.drive_answer = {"epoch": 7}
    scene.server.show(state)
    for epoch in (7, 8):
        state.drive_answer = {"epoch": epoch}
        scene.server.published.clear()
        await page.keyboard.down("KeyW")
        await expect(lambda: scene.moving_epochs()[-2:] == [epoch, epoch])  # noqa: B023 - it is awaited here
        assert scene.moving_epochs()[0] is None
        await page.keyboard.up("KeyW")
        await scene.stands()


async def test_a_motion_after_a_loss_of_the_device_carries_no_epoch_from_before(scene: Scene) -> None:
    """The daemon would refuse it, though the stick was released."""
    page, state = scene.tab.page, fleet("robot_0")
    state.drive_answer = {"epoch": 7}
    scene.server.show(state)
    await page.keyboard.down("KeyW")
    await expect(lambda: scene.moving_epochs()[-2:] == [7, 7])
    scene.server.show(fleet("robot_0", connected=False))
    await scene.tab.shows("#drive-state", "not connected")
    await page.keyboard.up("KeyW")
    state.drive_answer = {"epoch": 8}
    scene.server.show(state)
    await scene.tab.shows("#drive-state", "no driver")
    scene.server.published.clear()
    await page.keyboard.down("KeyW")
    await expect(lambda: len(scene.moving_epochs()) > 0)
    assert scene.moving_epochs()[0] is None
    await page.keyboard.up("KeyW")


@pytest.mark.parametrize(
    "kind", ["disarmed", *(pytest.param(each, marks=pytest.mark.long) for each in ("locked", "late"))]
)
async def test_a_refused_motion_must_let_go(scene: Scene, kind: str) -> None:
    page, state = scene.tab.page, fleet("robot_0")
    await scene.holds("KeyW")
    state.drive_refusal = {"kind": kind, "reason": f"robot_0: {kind}"}
    scene.server.show(state)
    await scene.stands()
    scene.server.show(fleet("robot_0"))
    await scene.stands()
    await page.keyboard.up("KeyW")
    await scene.holds("KeyW")
    await page.keyboard.up("KeyW")


async def test_a_late_refusal_of_an_earlier_motion_does_not_end_this_one(scene: Scene) -> None:
    page, state, answering = scene.tab.page, fleet("robot_0"), asyncio.Event()
    state.drive_refusal, state.answering = {"kind": "disarmed", "reason": "robot_0: disarmed"}, answering
    scene.server.show(state)
    await scene.holds("KeyW")
    await page.keyboard.up("KeyW")
    await page.keyboard.down("KeyW")
    scene.server.show(fleet("robot_0"))
    answering.set()
    await scene.tab.shows("#drive-state", "robot_0: disarmed")
    sent = len(scene.commands())
    await expect(lambda: len(scene.commands()) > sent + LASTING_COMMANDS)
    await scene.drives()
    await page.keyboard.up("KeyW")


async def test_a_stick_waits_for_a_source_with_a_higher_priority(scene: Scene) -> None:
    page, state = scene.tab.page, fleet("robot_0")
    await scene.holds("KeyW")
    state.drive_refusal = {"kind": "held", "reason": "robot_0: client 3 drives it with a higher priority"}
    scene.server.show(state)
    await scene.tab.shows("#drive-state", "with a higher priority")
    await scene.drives()
    scene.server.show(fleet("robot_0"))
    await page.keyboard.up("KeyW")


@pytest.mark.long
async def test_a_browser_that_keeps_nothing_shows_and_stops(browser: Browser) -> None:
    """A browser may block the data of all pages: the token is kept until the page is left."""
    async with page_server() as server, visit(browser, f"{server.url}/?token=secret", script=KEEPS_NOTHING) as tab:
        server.show(fleet("robot_0"))
        await tab.shows("#drive-state", "no driver")
        await tab.layout("Watch")
        await tab.page.keyboard.press("Escape")
        await expect(lambda: server.requests == [("POST", "/api/robots/robot_0/lock")])
        assert tab.complaints == []


@pytest.mark.long
async def test_a_robot_whose_device_cannot_receive_says_so(scene: Scene) -> None:
    cause = "the frame of 60 bytes does not fit into the 40 of the device"
    scene.server.show(fleet("robot_0", unreachable=cause, holder="client 1"))
    await scene.tab.shows("#drive-state", cause)
    await expect_page(scene.tab.page.locator("#drive[data-state=refused]")).to_be_visible()


@pytest.mark.long
async def test_a_lock_of_which_no_event_tells_must_be_followed_by_another_press(scene: Scene) -> None:
    """Events may be late or lost; the answer to a command is not."""
    page, state = scene.tab.page, fleet("robot_0")
    await scene.holds("KeyW")
    state.drive_refusal = {"kind": "locked", "reason": "robot_0: locked"}
    scene.server.show(state)
    await scene.stands()
    scene.server.show(fleet("robot_0"))
    await asyncio.sleep(SENT_AGAIN_S)
    await scene.stands()
    await page.keyboard.up("KeyW")
    await scene.holds("KeyW")
    await page.keyboard.up("KeyW")


def take_overs(scene: Scene) -> Iterator[bool]:
    """Whether each command takes the robot over, of those that are not zero."""
    return (each["take_over"] for each in scene.server.published if each["op"] == "drive" and each["linear"])


async def test_a_zero_waits_for_no_answer(scene: Scene) -> None:
    """A car of which only the turn is held any longer stops, also while the daemon is slow."""
    keys, state = scene.tab.page.keyboard, fleet("robot_0", kinematics="ackermann")
    scene.server.show(state)
    await scene.tab.until("document.querySelector('#drive').dataset.turns === 'moving'")
    await scene.holds("KeyW")
    await keys.down("KeyA")
    state.is_mute = True
    await scene.pauses()
    assert scene.is_driven("robot_0")
    await keys.up("KeyW")
    await scene.stands()
    state.is_mute = False
    await keys.up("KeyA")


async def test_a_car_that_stood_while_its_turn_was_held_begins_a_new_motion(scene: Scene) -> None:
    """The daemon refuses the epoch of the earlier motion if the robot was stopped meanwhile."""
    keys, state = scene.tab.page.keyboard, fleet("robot_0", kinematics="ackermann")
    state.drive_answer = {"epoch": 7}
    scene.server.show(state)
    await scene.tab.until("document.querySelector('#drive').dataset.turns === 'moving'")
    await scene.holds("KeyW")
    await expect(lambda: scene.moving_epochs()[-1] == 7)
    await keys.down("KeyA")
    await keys.up("KeyW")
    await expect(lambda: [each[1:] for each in scene.commands()[-3:]] == 3 * [(0, 0)])  # all zeros are sent
    await keys.up("KeyA")
    scene.server.published.clear()
    await scene.holds("KeyW")
    assert scene.moving_epochs()[0] is None
    await keys.up("KeyW")


async def test_a_page_that_loses_its_right_to_drive_sends_its_zeros(scene: Scene) -> None:
    state = fleet("robot_0")
    await scene.holds("KeyW")
    scene.server.show(replace(state, role="read"))
    await scene.tab.shows("#drive-state", "has the role read")
    await scene.stands()
    await scene.tab.page.keyboard.up("KeyW")
    scene.server.show(state)
    await scene.tab.shows("#drive-state", "no driver")


async def test_a_page_that_never_drove_sends_no_zeros(scene: Scene) -> None:
    page, state = scene.tab.page, fleet("robot_0")
    scene.server.show(replace(state, role="read"))
    await scene.tab.shows("#drive-state", "has the role read")
    await page.keyboard.down("KeyW")
    await page.keyboard.up("KeyW")
    scene.server.show(replace(state, robots=fleet("robot_0", kinematics="ackermann").robots))
    await scene.tab.until("document.querySelector('#drive').dataset.turns === 'moving'")
    await scene.tab.hold("KeyA", lambda: True)
    await scene.tab.shows("#drive-state", "Cannot turn in place")
    await page.keyboard.up("KeyA")
    assert scene.commands() == []


async def test_a_take_over_begins_while_the_stick_is_still_refused(scene: Scene) -> None:
    """A user may click the button with the key still held, or just after it."""
    page, state = scene.tab.page, fleet("robot_0", holder="client 2", priority=60)
    state.drive_refusal = {"kind": "held", "reason": "robot_0: client 2 drives it with the same priority"}
    scene.server.show(state)
    await scene.holds("KeyW")
    await scene.tab.shows("#drive-state", "Driven by client 2 until it lets go")
    await page.get_by_role("button", name="Take over").click()
    await scene.stands()
    await scene.tab.shows("#drive-state", "Hold the stick to take over from client 2")
    await page.keyboard.up("KeyW")
    scene.server.published.clear()
    state.drive_refusal = {}
    await scene.holds("KeyW")
    assert next(take_overs(scene))
    await page.keyboard.up("KeyW")


async def test_a_take_over_is_of_the_robot_for_which_it_was_pressed(scene: Scene) -> None:
    page, button = scene.tab.page, scene.tab.page.get_by_role("button", name="Take over")
    scene.server.show(fleet("robot_0", "robot_1", holder="client 2", priority=60))
    await scene.tab.shows("#drive-state", "Driven by client 2 until it lets go")
    await button.click()
    await scene.tab.shows("#drive-state", "Hold the stick to take over from client 2")
    await page.locator("#robots .robot", has_text="robot_1").click()
    await scene.tab.shows("#drive-state", "Driven by client 2 until it lets go")
    await expect_page(button).to_be_visible()
    await scene.holds("KeyW", "robot_1")
    assert not any(take_overs(scene))
    await page.keyboard.up("KeyW")
    await page.locator("#robots .robot", has_text="robot_0").click()


@pytest.mark.long
async def test_page_that_is_held_by_another_page_shows_who_and_takes_over_by_its_button(scene: Scene) -> None:
    page, server = scene.tab.page, scene.server
    button = page.get_by_role("button", name="Take over")
    server.show(fleet("robot_0", holder="client 2", priority=50))
    await scene.tab.shows("#drive-state", "your stick takes over")  # from a program, as ever
    assert not await button.is_visible()
    server.show(fleet("robot_0", holder="client 2", priority=60))
    await scene.tab.shows("#drive-state", "Driven by client 2 until it lets go")
    await button.click()
    await scene.tab.shows("#drive-state", "Hold the stick to take over from client 2")
    assert not await button.is_visible()
    await scene.holds("KeyW")
    await expect(lambda: [*take_overs(scene)][:1] == [True])
    await expect(lambda: not [*take_overs(scene)][-1])  # it was accepted
    await page.keyboard.up("KeyW")


@pytest.mark.long
async def test_wild_values_of_a_device_stay_readable(scene: Scene) -> None:
    page, state = scene.tab.page, fleet("robot_0")
    known = state.links[0]["topics"][0]
    state.links[0]["topics"].append({**known, "name": "/robot_0/errors", "type": "std_msgs/UInt16MultiArray"})
    scene.server.show(state)
    await expect(lambda: any(each.get("topic") == "/robot_0/errors" for each in scene.server.published))
    await scene.server.publish("/robot_0/errors", {"data": list(range(60000, 60200))})
    await scene.tab.shows("#link [data-tile=errors]", "60005 unknown, and 194 more")
    await scene.tab.layout("Watch")
    await page.get_by_role("button", name="/robot_0/odometry").click()
    await scene.server.publish("/robot_0/odometry", {"x": 1e-9, "y": -1.7e308, "z": None, "long": "v" * 500, "n": 0.25})
    for text in ("1.000e−9", "−1.7e+308", "none", "(500 characters)", "0.2500"):
        await scene.tab.shows("#topics .tree", text)
    await page.get_by_role("button", name="All topics").click()


@pytest.mark.long
async def test_long_paths_of_many_robots_are_not_drawn_again_and_again(browser: Browser) -> None:
    """Fifty of them held the page, and with it its stop, for half a second at a time."""
    async with page_server() as server, visit(browser, server.url, script=LINES) as tab:
        state = fleet(*(f"robot_{number}" for number in range(12)))
        circle = [{"x_m": math.cos(at / 100), "y_m": math.sin(at / 100), "theta_rad": 0.0} for at in range(628)]
        state.past = [{"age_s": 70.0 - at / 10, "pose": pose} for at, pose in enumerate(circle)]
        server.show(state)
        await tab.shows("#robots .robot:nth-child(12)", "robot_11")
        await tab.until("window.lines > 12 * 50")  # they were drawn
        lines: list[int] = []
        async with asyncio.timeout(TIMEOUT_S):
            while len(lines) < 2 or lines[-1] > 200 * len(state.robots):
                await tab.page.evaluate("window.lines = 0")
                for number, view in enumerate(state.robots * 2):
                    view["odometry"] = odometry(0.01 * number, 0.0, 0.0)
                    server.show(state)
                    await asyncio.sleep(0.02)
                lines.append(await tab.page.evaluate("window.lines"))


async def test_late_values_of_a_slow_line_are_dimmed_with_their_age(scene: Scene) -> None:
    page = scene.tab.page
    state = fleet("robot_0")
    state.late_s = 3.0
    scene.server.show(state)
    await scene.tab.shows("#notice", "what is shown is 3")
    await scene.tab.shows("#pose", "old")
    await expect_page(page.locator("body.lost")).to_be_visible()
    assert await page.locator(".robot[data-state=silent]").count() == 0  # it is not the robot that is late
    scene.server.show(fleet("robot_0"))
    await expect_page(page.locator("body.lost")).to_have_count(0)


@pytest.mark.long
async def test_a_pose_far_away_freezes_neither_the_page_nor_its_stop(browser: Browser) -> None:
    async with page_server() as server, visit(browser, server.url) as tab:
        state = fleet("robot_0", "robot_1", "robot_2", "robot_3")
        for view, far_m in zip(state.robots[1:], (9e5, 1e19, 1.7e308), strict=True):
            fast = {"linear_m_s": far_m, "linear_y_m_s": 0.0, "angular_rad_s": far_m}
            view |= {"odometry": odometry(far_m, -far_m, 1.0, twist=fast), "velocity": fast}
        state.past = [{"age_s": 5.0, "pose": {"x_m": 1e19, "y_m": 0.0, "theta_rad": 0.0}}]
        server.show(state)
        for number in range(1, 4):
            await tab.page.locator("#robots .robot", has_text=f"robot_{number}").click()
            await tab.page.keyboard.press("Escape")
            await expect(lambda number=number: ("POST", f"/api/robots/robot_{number}/lock") in server.requests)
        assert tab.complaints == []


@pytest.mark.long
async def test_line_received_live_and_in_the_history_is_shown_once_for_each_robot(browser: Browser) -> None:
    async with page_server() as server:
        state = fleet("robot_0", "robot_1")
        state.log = [{"header": {"stamp": {"secs": 0}}, "level": 4, "name": "robot_0", "msg": "battery low"}]
        state.past_events = [
            {"age_s": 0.2, "msg": {"kind": "logged", "facts": {"level": 2, "text": "battery low"}}},
            {"age_s": 0.1, "msg": {"kind": "unlocked", "facts": {}}},
        ]
        server.show(state)
        async with visit(browser, server.url) as tab:
            shown = tab.page.locator("#log li span")
            await expect_page(shown.filter(has_text="unlocked")).to_have_text(["robot_0 unlocked", "robot_1 unlocked"])
            lows = ["robot_0 battery low", "robot_1 battery low"]
            assert sorted(await shown.filter(has_text="battery low").all_text_contents()) == lows
