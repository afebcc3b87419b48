"""Daemons of a fleet as processes: killed, stopped, crowded; and what a daemon without Zenoh imports."""

import asyncio
import contextlib
import json
import signal
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from hostlink.components.zenoh.fleet import READ_S
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import HOSTLINK, Process, free_port, run, serve
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S
from tools.measure_fleet import all_known, drive, populated, robots_of

STILL, MOVING = (0.0, 0.0), (0.2, 0.0)


def settings(folder: Path, name: str, port: int, *others: int) -> str:
    """The path of a configuration."""
    file = folder / f"{name}.toml"
    connect = json.dumps([f"tcp/127.0.0.1:{other}" for other in others])
    file.write_text(
        f'[zenoh]\nname = "{name}"\nlisten = ["tcp/127.0.0.1:{port}"]\nconnect = {connect}\nmulticast = false\n'
    )
    return str(file)


@contextlib.asynccontextmanager
async def two(folder: Path) -> AsyncIterator[tuple[Process, Process, aiohttp.ClientSession]]:
    ports = [free_port(), free_port()]
    async with (
        serve("--config", settings(folder, "a", ports[0])) as a,
        serve("--config", settings(folder, "b", ports[1], ports[0])) as b,
        aiohttp.ClientSession() as session,
    ):
        yield a, b, session


async def shows(session: aiohttp.ClientSession, host: Process, is_so: Callable[[dict[str, Any]], object]) -> float:
    """Seconds until the daemon's robots, by name, are as wanted."""
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    async with asyncio.timeout(TIMEOUT_S):
        while not is_so({robot["name"]: robot for robot in await robots_of(session, host)}):  # noqa: ASYNC110 - a process
            await asyncio.sleep(0.05)
    return loop.time() - began_s


async def command(session: aiohttp.ClientSession, host: Process, name: str) -> None:
    """Drive over REST until cancelled, or until the daemon is gone."""
    with contextlib.suppress(aiohttp.ClientError):
        while True:
            body = {"linear": MOVING[0], "angular": 0.0}
            async with session.put(f"{host.url}/api/robots/{name}/velocity", json=body):
                await asyncio.sleep(0.1)


@pytest.mark.quiet
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM])
async def test_robot_that_a_daemon_drove_stops_when_the_daemon_is_gone(tmp_path: Path, how: signal.Signals) -> None:
    async with (
        two(tmp_path) as (a, b, session),
        fake_device(a.tcp, robot_topics("robot_1")) as driven,
        fake_device(b.tcp, robot_topics("robot_2")),
        asyncio.TaskGroup() as tasks,
    ):
        await shows(session, b, lambda robots: robots.get("robot_1", {}).get("connected"))
        await shows(session, a, lambda robots: robots.get("robot_2", {}).get("connected"))
        driving = tasks.create_task(command(session, b, "robot_1"))
        assert await driven.velocity_other_than(STILL) == MOVING
        watch = Stopwatch(a.pid)
        b.child.send_signal(how)
        assert await driven.velocity_other_than(MOVING) == STILL
        assert watch.seconds < 0.8  # a lease, and a step of the gate
        await shows(session, a, lambda robots: not robots["robot_2"]["connected"])
        assert watch.seconds < 2.0
        driving.cancel()
        if how is signal.SIGSTOP:
            b.child.send_signal(signal.SIGCONT)
            await shows(session, a, lambda robots: robots["robot_2"]["connected"])


@pytest.mark.alone
@pytest.mark.long
async def test_three_daemons_show_thirty_robots_and_drive_across_within_ten_milliseconds() -> None:
    async with populated(3, 10) as (hosts, session):
        assert await all_known(session, hosts, 30) < 5.0
        await asyncio.sleep(READ_S + 1)  # poses travel on for a while
        measured = await drive(session, hosts, 4.0)
    for latency in ("to_device_ms", "to_answer_ms"):
        far, near = measured[latency], measured["near"][latency]
        assert far["count"] >= 195
        # On a busy machine the robot of the same daemon takes as long: it was driven by the same program.
        assert far["p99"] < max(10.0, 4 * near["p99"]), (far, near)


async def test_daemon_with_zenoh_that_runs_imports_nothing_more(tmp_path: Path) -> None:
    async with _imports(tmp_path, [free_port(), free_port()]) as log:
        late = log.read_text().split("daemon.started", 1)[1].splitlines()
    assert [line for line in late if line.startswith("import time")] == []


@contextlib.asynccontextmanager
async def _imports(folder: Path, ports: list[int]) -> AsyncIterator[Path]:
    """The log of a daemon to which another one came, whose robot was driven."""
    log = folder / "log"
    program = (sys.executable, "-X", "importtime", HOSTLINK)
    async with (
        serve("--config", settings(folder, "a", ports[0]), program=program, log=log) as a,
        serve("--config", settings(folder, "b", ports[1], ports[0])) as b,
        fake_device(b.tcp, robot_topics("robot_2")) as device,
        aiohttp.ClientSession() as session,
        asyncio.TaskGroup() as tasks,
    ):
        await shows(session, a, lambda robots: robots.get("robot_2", {}).get("connected"))
        driving = tasks.create_task(command(session, a, "robot_2"))
        assert await device.velocity_other_than(STILL) == MOVING
        driving.cancel()
    yield log


async def test_wrong_settings_are_one_line(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    for text, reason in (
        ('[zenoh]\nlisten = ["nonsense"]\n', "zenoh: Zenoh refuses the settings: Endpoints must be"),
        ('[zenoh]\nname = "a/b"\n', "zenoh.name 'a/b' must be made of letters"),
        ("[zenoh]\nconect = []\n", "did you mean connect?"),
        ('[zenoh]\ncertificate = "a.pem"\n', "set zenoh.certificate and zenoh.key together"),
        ('[zenoh]\nfile = "gone.json5"\n', "zenoh: Zenoh refuses the settings: "),
    ):
        file.write_text(text)
        status, _, error = await run("serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", "--config", str(file))
        lines = [line for line in error.splitlines() if not line.startswith("{")]
        assert status == 2, error
        assert len(lines) == 1
        assert reason in lines[0]
