"""`hostlink top` on its screen, and as text."""

import json
import os
import signal
from pathlib import Path

import pytest

from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import HOSTLINK, run
from tests.support.screen import screen


@pytest.mark.parametrize("key", ["q", "C-c"])
async def test_the_screen_shows_links_robots_and_what_is_wrong_until_a_key_ends_it(key: str) -> None:
    small = [info._replace(buffer_bytes=48) for info in robot_topics()]
    async with daemon() as host, fake_device(host.tcp, small), screen(columns=220) as terminal:
        await terminal.keys(f"{HOSTLINK} top --interval 0.1 --url {host.url}", "Enter")
        shown = await terminal.shows("/robot_0/velocity_commands: a frame of 56 bytes, the device takes 48")
        assert "robot_0  1     nobody" in shown
        await terminal.keys("s")
        await terminal.shows("hostlink top by state")
        await terminal.keys(key)
        await terminal.shows("bash-")  # the prompt is back


async def test_the_screen_of_a_daemon_without_devices_says_so() -> None:
    async with daemon() as host, screen() as terminal:
        await terminal.keys(f"{HOSTLINK} top --interval 0.1 --url {host.url}", "Enter")
        assert "no device is connected" in await terminal.shows("no findings")


async def test_top_without_a_daemon_prints_the_reason() -> None:
    async with screen() as terminal:
        await terminal.keys(f"{HOSTLINK} top --url http://127.0.0.1:9", "Enter")
        await terminal.shows("hostlink: no hostlink at http://127.0.0.1:9")


async def test_top_once_prints_text_or_json() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        status, out, err = await run("top", "--once", "--interval", "0.1", "--url", host.url)
        assert (status, err) == (0, "")
        assert [line.split()[0] for line in out.splitlines() if line][:4] == ["robot", "robot_0", "link", "1"]
        status, out, _ = await run("top", "--once", "--json", "--interval", "0.1", "--url", host.url)
    shown = json.loads(out)
    assert status == 0
    assert shown["links"][0]["robots"] == ["robot_0"]


async def test_top_without_a_terminal_prints_what_to_do() -> None:
    status, out, err = await run("top")
    assert (status, out) == (2, "")
    assert err == "hostlink: top: standard input or output is not a terminal; use --once or --json\n"


async def test_a_terminated_top_restores_the_terminal(tmp_path: Path) -> None:
    async with daemon() as host, screen() as terminal:
        top = f"echo $$ > {tmp_path}/pid; exec {HOSTLINK} top --interval 0.1 --url {host.url}"
        await terminal.keys(f"sh -c '{top}'; echo en''ded", "Enter")
        await terminal.shows("no findings")
        os.kill(int((tmp_path / "pid").read_text()), signal.SIGTERM)
        await terminal.shows("ended")
        assert (await terminal.tmux("display-message", "-p", "#{cursor_flag}")).strip() == "1"
