"""The daemon on uvloop: its transports, readers and sockets differ from those of asyncio."""

import asyncio
import os
import signal
import subprocess
import sys
from http import HTTPStatus
from pathlib import Path

import aiohttp
import pytest

from hostlink.errors import LibraryMissing
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.killing import LIMIT_S, driving, end_at, killer
from tests.support.process import HOSTLINK, serve
from tests.support.pty_pair import pty_pair
from tests.support.unwatched_robot import Reading
from tests.support.waiting import TIMEOUT_S, expect

ON_UVLOOP = ("--loop", "uvloop")
ZERO = (0.0, 0.0)

pytestmark = pytest.mark.filterwarnings("default::DeprecationWarning")


def is_loaded(library: str, pid: int) -> bool:
    return library in Path(f"/proc/{pid}/maps").read_text()


async def drive(session: aiohttp.ClientSession, robot: str) -> None:
    """Command until a busy machine delivers a command in time."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            async with session.get(robot) as response:
                epoch = (await response.json())["epoch"]
            velocity = {"linear": 0.2, "angular": 0.0, "epoch": epoch}
            async with session.put(f"{robot}/velocity", json=velocity) as response:
                if response.status == HTTPStatus.OK:
                    return
                assert (await response.json())["error"]["kind"] == "late"


async def test_devices_come_and_go_and_a_robot_is_driven() -> None:
    with pty_pair() as (_, path):
        async with serve("--serial", path, *ON_UVLOOP) as daemon, aiohttp.ClientSession() as session:
            assert is_loaded("uvloop", daemon.child.pid)
            for _ in range(3):
                async with fake_device(daemon.tcp, robot_topics()) as device:
                    await device.send(pose(1.0))
                    robot = f"{daemon.url}/api/robots/robot_0"
                    await drive(session, robot)
                    assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
                    async with session.get(f"{daemon.url}/api/links") as response:
                        assert response.status == 200
                await daemon.read_log("robot.gone")
                await daemon.read_log("link.closed")
                async with session.get(f"{daemon.url}/api/links") as response:
                    assert response.status == 200
            async with fake_device(daemon.tcp, robot_topics()) as device:
                assert await device.velocity() == ZERO
                daemon.child.send_signal(signal.SIGTERM)
                async with asyncio.timeout(TIMEOUT_S):
                    assert await daemon.child.wait() == 0
        assert not [line for line in daemon.log if str(line["event"]).endswith(".crashed")]


async def test_a_killed_daemon_leaves_no_robot_moving() -> None:
    """The guardian has duplicates of the descriptors of uvloop's transports."""
    async with driving(Reading(), *ON_UVLOOP) as drive:
        guardian = int(drive.daemon.lines("guardian.started")[-1]["pid"])
        await expect(lambda: len(list(Path(f"/proc/{guardian}/fd").iterdir())) == 6)  # two robots, stdio, its channel
        assert await end_at(drive, 0.1, killer(signal.SIGKILL)) < LIMIT_S


async def test_uvloop_is_the_default_where_it_is_installed() -> None:
    async with serve() as daemon:
        assert daemon.lines("daemon.started")[0]["loop"] == "uvloop"
        assert is_loaded("uvloop", daemon.pid)
    async with serve("--loop", "asyncio") as daemon:
        assert daemon.lines("daemon.started")[0]["loop"] == "asyncio"


async def test_without_uvloop_the_daemon_runs_on_asyncio(tmp_path: Path) -> None:
    (tmp_path / "uvloop.py").write_text("raise ImportError")
    async with serve(environment={"PYTHONPATH": str(tmp_path)}, program=(HOSTLINK,)) as daemon:
        assert daemon.lines("daemon.started")[0]["loop"] == "asyncio"


def test_a_loop_that_is_not_installed_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "uvloop.py").write_text("raise ImportError")
    command = [sys.executable, "-m", "hostlink", "serve", *ON_UVLOOP]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20, env=environment)
    message = f"hostlink: {LibraryMissing('--loop', 'uvloop', 'uvloop')}\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", message)
