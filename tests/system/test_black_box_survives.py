"""Black box of a daemon that is killed, or that ends with more incidents than it has time to write."""

import asyncio
import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from hostlink.components.recorder.black_box import MAX_REQUESTED
from hostlink.components.recorder.channel import EVENTS, json_of
from hostlink.components.recorder.reader import McapReader
from hostlink.core.runtime import remains
from tests.support.fake_device import fake_device, pose, repeating, robot_topics
from tests.support.process import Process, run, serve
from tests.support.rosbridge import Client
from tests.support.waiting import expect

pytestmark = [pytest.mark.quiet, pytest.mark.timeout(600)]

TOPIC = "/robot_0/velocity_commands"
TWIST = {"linear": {"x": 0.2}}
POSES = 20_000
WRITTEN_S = 240.0  # the guardian writes with the lowest priority: on a busy machine that takes minutes


def settings(folder: Path, *, has_guardian: bool = True, after_s: float = 30.0) -> tuple[str, ...]:
    file = folder / "hostlink.toml"
    file.write_text(
        f"guardian = {str(has_guardian).lower()}\n[recording]\nfolder = 'kept'\nmin_free_disk_mb = 0\n"
        f"[black_box]\nafter_s = {after_s}\n"
    )
    return "--config", str(file)


def incident_files(folder: Path) -> list[Path]:
    return sorted((folder / "kept" / "incidents").glob("*.mcap"))


async def kill_while_driving(daemon: Process) -> None:
    """A program drives robot_0 for half a second, then the daemon is killed."""
    async with (
        fake_device(daemon.tcp, robot_topics()) as device,
        repeating(device, pose(1.0, 2.0, 0.5), interval_s=0.02),
        aiohttp.ClientSession() as session,
    ):
        await daemon.read_log("robot.appeared")
        async with session.ws_connect(daemon.url) as socket:
            program = Client(socket)
            await program.send(op="advertise", topic=TOPIC, type="geometry_msgs/Twist")
            for _ in range(10):
                await program.send(op="publish", topic=TOPIC, msg=TWIST)
                await asyncio.sleep(0.05)
            await device.velocity_of((0.2, 0.0))
            os.kill(daemon.pid, signal.SIGKILL)
            await daemon.ended()


async def check_incident(folder: Path) -> None:
    """Check that the incident's file has the last commands and poses, and that `hostlink info` reads it."""
    (file,) = incident_files(folder)
    assert "daemon_died" in file.name
    reader = McapReader(file)
    found = list(reader.messages())
    topics = [message.channel.topic for message in found]
    assert topics.count("/robot_0/odometry") >= 10
    commanded = [message for message in found if message.channel.topic == "/hostlink/events"]
    assert json.loads(json_of(EVENTS, commanded[-1].payload))["kind"] == "commanded"
    assert reader.metadata["cause"] == "daemon_died"
    assert "client 1 drove it" in reader.metadata["detail"]
    assert found[-1].stamp_ns - commanded[-1].stamp_ns < 10**9
    status, text, _ = await run("info", str(file))
    assert (status, "/robot_0/odometry" in text) == (0, True)


@pytest.mark.parametrize("has_guardian", [pytest.param(True, marks=pytest.mark.long), False])
async def test_a_daemon_killed_while_driving_leaves_an_incident_with_its_last_seconds(
    tmp_path: Path, *, has_guardian: bool
) -> None:
    """Saved by the guardian, and by the next start where there was none.

    Without the tests marked long, the guardian saves in the next test, and in tests/system/test_container.py.
    """
    words = settings(tmp_path, has_guardian=has_guardian)
    async with serve(*words) as daemon:
        await kill_while_driving(daemon)
    if has_guardian:
        await expect(lambda: incident_files(tmp_path), timeout_s=WRITTEN_S)
        await expect(lambda: not remains.of_process(daemon.pid), timeout_s=WRITTEN_S)
        await check_incident(tmp_path)
    else:
        assert remains.of_process(daemon.pid)
    async with serve(*words) as successor:
        if not has_guardian:
            saved = await successor.logged("incident.saved")
            assert (saved["robot"], saved["cause"]) == ("robot_0", "daemon_died")
        await check_incident(tmp_path)
        assert remains.of_process(daemon.pid) == []
        (incident,) = (await successor.get("/api/incidents"))["incidents"]
        assert (incident["robot"], incident["cause"]) == ("robot_0", "daemon_died")
        (drive,) = (await successor.get("/api/drives"))["drives"]
        assert (drive["robot"], drive["end"]) == ("robot_0", "the daemon died")
        assert drive["began"] < drive["ended"]
        assert await successor.end(signal.SIGTERM) == 0
    assert len(incident_files(tmp_path)) == 1


async def test_daemon_killed_while_no_source_drives_leaves_only_the_pending_incident(tmp_path: Path) -> None:
    async with (
        serve(*settings(tmp_path)) as daemon,
        fake_device(daemon.tcp, robot_topics()) as device,
        repeating(device, pose(1.0), interval_s=0.02),
    ):
        await daemon.read_log("robot.appeared")
        await asyncio.sleep(0.5)
        await daemon.post("/api/robots/robot_0/lock", {"reason": "a hand in the wheel"})
        os.kill(daemon.pid, signal.SIGKILL)
        await expect(lambda: incident_files(tmp_path), timeout_s=WRITTEN_S)
        await expect(lambda: not remains.of_process(daemon.pid), timeout_s=WRITTEN_S)
    (file,) = incident_files(tmp_path)
    reader = McapReader(file)
    assert [message.channel.topic for message in reader.messages()].count("/robot_0/odometry") >= 5
    assert (reader.metadata["cause"], reader.metadata["detail"]) == ("locked", "a hand in the wheel")


@pytest.mark.alone
@pytest.mark.long
async def test_a_daemon_that_ends_with_many_pending_incidents_is_quick_and_loses_none(tmp_path: Path) -> None:
    names = [f"robot_{number}" for number in range(4)]
    words = settings(tmp_path, after_s=60.0)
    async with serve(*words) as idle:
        began_s = time.monotonic()
        assert await idle.end(signal.SIGTERM) == 0
        idle_s = time.monotonic() - began_s
    async with serve(*words) as daemon, asyncio.TaskGroup() as tasks:
        begin = asyncio.Event()
        for name in names:
            tasks.create_task(flood(daemon, name, begin))
        for _ in names:
            await daemon.read_log("robot.appeared")
        await expect_topics(daemon, names, lambda each: each["subscribers"] >= 2)  # robot, black box
        begin.set()
        await expect_topics(daemon, names, lambda each: each["messages"] == POSES)
        for name in names:
            await daemon.post(f"/api/robots/{name}/lock", {"reason": "all at once"})
        for number in range(MAX_REQUESTED):
            await daemon.post("/api/incidents", {"robot": names[number % len(names)]})
        began_s = time.monotonic()
        assert await daemon.end(signal.SIGTERM) == 0
        lasted_s = time.monotonic() - began_s
    print(f"end: {idle_s:.2f} s with nothing pending, {lasted_s:.2f} s")  # noqa: T201
    assert lasted_s < idle_s + 1.4  # the robots' last zeros take 0.15 of it, the incidents 0.6
    async with serve(*words) as successor:
        await expect(lambda: len(asked_for(tmp_path)) == len(names) + MAX_REQUESTED)
        found = (await successor.get("/api/incidents"))["incidents"]
        assert [each["cause"] for each in found].count("locked") == len(names)
    for file in incident_files(tmp_path):
        reader = McapReader(file)
        topics = [message.channel.topic for message in reader.messages()]
        assert reader.damage == []
        assert topics.count(f"/{reader.metadata['robot']}/odometry") > 0.95 * POSES  # it subscribes after the first
    assert len(asked_for(tmp_path)) == len(names) + MAX_REQUESTED


def asked_for(folder: Path) -> list[Path]:
    """The incidents of the locks and requests. On a busy machine the flood lasts so long that each robot has another
    one: it sends poses, and no longer requests the time.
    """
    return [file for file in incident_files(folder) if "_diagnosed" not in file.name]


async def flood(daemon: Process, name: str, begin: asyncio.Event) -> None:
    """Send POSES poses of a robot after `begin`, and stay until the daemon ends."""
    async with fake_device(daemon.tcp, robot_topics(name)) as device:
        await begin.wait()
        for _ in range(POSES // 100):
            await device.send(pose(1.0, 2.0, 0.5) * 100)
        await device.closed()


async def expect_topics(daemon: Process, names: list[str], is_so: Callable[[dict[str, Any]], bool]) -> None:
    """Wait until the topics of all robots' poses are as wanted."""
    async with asyncio.timeout(60):
        while True:
            listed = {each["name"]: each for each in (await daemon.get("/api/topics"))["topics"]}
            poses = [listed.get(f"/{name}/odometry") for name in names]
            if all(each is not None and is_so(each) for each in poses):
                return
            await asyncio.sleep(0.02)
