"""`hostlink reload` and SIGUSR1, with a daemon in its own process."""

import asyncio
import itertools
import json
import os
import signal
import time
from pathlib import Path

import aiohttp
import pytest

from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import run, serve
from tests.support.rosbridge import Client, publish_until_driven
from tests.support.waiting import is_soon


async def test_a_file_is_read_again_by_a_command_and_by_a_signal(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("")
    async with serve("--config", str(file)) as daemon:
        words = ("reload", "--url", daemon.url)
        assert await run(*words) == (0, "nothing has changed\n", "")
        file.write_text("[robots.rover]\nmax_linear_m_s = 0.2\n[tcp]\nmax_connections = 7\n")
        changed = "changed: robots.rover.max_linear_m_s\nneeds a restart: tcp.max_connections\n"
        assert await run(*words) == (0, changed, "")
        file.write_text("[robots.rover]\nmax_linear_m_s = 0.3\n")
        daemon.child.send_signal(signal.SIGUSR1)
        reloaded = await daemon.read_log("config.reloaded")
        assert reloaded["changed"] == ["robots.rover.max_linear_m_s"]
        assert json.loads((await run(*words, "--json"))[1]) == {"changed": [], "needs_restart": [], "renamed": {}}
        file.write_text("[robots.rover]\nmax_linear = 0.2\n")
        daemon.child.send_signal(signal.SIGUSR1)
        assert "max_linear" in (await daemon.read_log("config.refused"))["reason"]
        for text, reason in (
            ("[robots.rover]\nmax_linear = 0.2\n", "max_linear"),
            ("[ros1]\nmaster = 'http://m:1'\nport = 70000\n", "ros1.port"),
        ):
            file.write_text(text)  # what a start would refuse
            status, _, complaint = await run(*words)
            assert status == 1
            assert complaint.count("\n") == 1
            assert reason in complaint
        assert await daemon.end(signal.SIGTERM) == 0


@pytest.mark.parametrize("what", ["settings", "token file"])
async def test_reload_with_a_file_that_blocks_keeps_driving_stopping_and_ending(tmp_path: Path, what: str) -> None:
    """Opening a FIFO without a writer blocks, like a file of a dead NFS mount."""
    file, token_file, fifo = tmp_path / "hostlink.toml", tmp_path / "token", tmp_path / "fifo"
    file.write_text("")
    os.mkfifo(fifo)
    async with (
        serve("--config", str(file)) as daemon,
        fake_device(daemon.tcp, robot_topics()) as device,
        aiohttp.ClientSession() as session,
    ):
        await daemon.read_log("robot.appeared")
        async with session.ws_connect(daemon.url) as socket:
            program = Client(socket)
            await program.send(op="advertise", topic="/robot_0/velocity_commands", type="geometry_msgs/Twist")
            await publish_until_driven(program, device, 0.2)
            threads = threads_of(daemon.pid)
            if what == "settings":
                fifo.rename(file)
            else:
                fifo.rename(token_file)
                file.write_text(f'[[api.tokens]]\nname = "alice"\ntoken_file = "{token_file}"\n')
            for _ in range(5):
                daemon.child.send_signal(signal.SIGUSR1)
                await publish_until_driven(program, device, 0.3)
                await publish_until_driven(program, device, 0.2)
            assert threads_of(daemon.pid) <= threads + 1
        await device.velocity_of((0.0, 0.0))  # its driver has gone
        assert await daemon.end(signal.SIGTERM) == 0
        assert daemon.lines("daemon.stopped")


async def test_reload_of_ten_thousand_robots_blocks_the_loop_for_a_fraction_of_its_time(tmp_path: Path) -> None:
    """Relative to the reload itself, which a loop that does nothing else would be blocked for."""
    file, nets = tmp_path / "hostlink.toml", itertools.count(10)
    file.write_text("")
    async with serve("--config", str(file)) as daemon, aiohttp.ClientSession() as session:

        async def longest_part() -> float:
            net = next(nets)
            tables = (f'[robots.r{n}]\naddress = "{net}.{n >> 16}.{n >> 8 & 255}.{n & 255}"\n' for n in range(10_000))
            file.write_text("".join(tables))
            waits_s = [0.0]
            async with asyncio.TaskGroup() as tasks:
                began_s = time.monotonic()
                reload = tasks.create_task(daemon.post("/api/reload"))
                while not reload.done():
                    asked_s = time.monotonic()
                    async with session.get(f"{daemon.url}/healthz") as response:
                        assert response.status == 200
                    waits_s.append(time.monotonic() - asked_s)
                    await asyncio.sleep(0.01)
                lasted_s = time.monotonic() - began_s
            assert len((await reload)["changed"]) == 10_000
            return max(waits_s) / lasted_s

        assert await is_soon(longest_part, 0.3)


def threads_of(pid: int) -> int:
    return len(list(Path(f"/proc/{pid}/task").iterdir()))
