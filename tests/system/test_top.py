"""`hostlink top` on its screen, by textual's own pilot, and as text."""

import json

from textual.widgets import DataTable, Static

from hostlink.cli.top_screen import TopScreen
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import HOSTLINK, run
from tests.support.screen import screen
from tests.support.waiting import expect


async def test_the_screen_shows_links_robots_and_what_is_wrong() -> None:
    small = [info._replace(buffer_bytes=48) for info in robot_topics()]
    async with daemon() as host, fake_device(host.tcp, small):
        screen = TopScreen(host.url, None, 0.1)
        async with screen.run_test(size=(140, 30)) as pilot:
            links, robots = screen.query_one("#links", DataTable), screen.query_one("#robots", DataTable)
            await expect(lambda: links.row_count == robots.row_count == 1 and "buffer" in links.get_row_at(0)[-1])
            assert links.get_row_at(0)[2:4] == ["robot_0", "3"]
            assert robots.get_row_at(0)[:3] == ["robot_0", "1", "nobody"]
            reported = str(screen.query_one("#advice", Static).render())
            assert "/robot_0/velocity_commands: a frame of 56 bytes, the device takes 48" in reported
            await pilot.press("q")
    assert screen.failure is None


async def test_top_whose_daemon_ends_leaves_the_screen_with_the_reason() -> None:
    screen = TopScreen("http://127.0.0.1:9", None, 0.1)
    async with screen.run_test():
        await expect(lambda: screen.failure is not None)
    assert "no hostlink at" in str(screen.failure)


async def test_top_once_prints_text_or_json() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        status, out, err = await run("top", "--once", "--interval", "0.1", "--url", host.url)
        assert (status, err) == (0, "")
        assert [line.split()[0] for line in out.splitlines() if line] == ["link", "1", "robot", "robot_0"]
        status, out, _ = await run("top", "--once", "--json", "--interval", "0.1", "--url", host.url)
    shown = json.loads(out)
    assert status == 0
    assert shown["links"][0]["robots"] == ["robot_0"]


async def test_top_without_a_terminal_prints_what_to_do() -> None:
    status, out, err = await run("top")
    assert (status, out) == (2, "")
    assert err == "hostlink: top: standard output is not a terminal; use --once or --json\n"


async def test_top_in_a_terminal_ends_at_ctrl_c() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), screen() as terminal:
        await terminal.keys(f"{HOSTLINK} top --url {host.url}", "Enter")
        shown = await terminal.shows("no findings")
        assert "robot_0" in shown
        await terminal.keys("C-c")
        await terminal.shows("bash-")  # the prompt is back
