"""Black box with a hub and without sockets: what it keeps, and when it saves."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest

from hostlink.config import BlackBoxConfig, Config
from hostlink.errors import RecordingBusy, UnknownTopic
from hostlink.hub.hub import Hub
from hostlink.recording.black_box import MAX_DETAIL, MAX_REQUESTED, BlackBox
from hostlink.recording.incident import read_incident
from hostlink.recording.reader import McapReader
from tests.support.fake_device import CATALOG
from tests.support.participants import ROBOT, ScriptedDevice, robot_topics
from tests.support.waiting import expect

TEXT = f"/{ROBOT}/text"


@contextlib.asynccontextmanager
async def running(folder: Path, config: BlackBoxConfig) -> AsyncIterator[tuple[Hub, BlackBox]]:
    hub = Hub(replace(Config(), black_box=config), CATALOG, reraises=True)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(hub.run())
        await hub.is_running.wait()
        box = BlackBox(hub, folder)
        box.start()
        ScriptedDevice(hub, robot_topics(ROBOT), address="10.0.0.1")
        program = hub.join("program")
        program.advertise(TEXT, "std_msgs/String")
        await expect(lambda: hub.robots.get_here(ROBOT))
        await expect(lambda: hub.topics.find(TEXT).subscribers or not config.enabled)
        program.publish(TEXT, b"\2\0\0\0hi")
        try:
            yield hub, box
        finally:
            await box.aclose()
            task.cancel()


def saved(folder: Path) -> list[Path]:
    return sorted((folder / "incidents").glob("*.mcap"))


async def test_incident_is_saved_with_what_came_before_it_when_the_daemon_ends(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig()) as (_, box):
        incident = box.save(f"/{ROBOT}", "x" * (MAX_DETAIL + 1))
        assert (incident.cause, incident.detail) == ("requested", "x" * MAX_DETAIL)
        assert (list(box.pending), saved(tmp_path)) == ([incident], [])
    (path,) = saved(tmp_path)
    found = read_incident(path)
    assert found is not None
    assert (found.robot, found.cause, found.detail) == (ROBOT, "requested", "x" * MAX_DETAIL)
    assert [each.payload for each in McapReader(path).messages(lambda channel: channel.topic == TEXT)] == [
        b"\2\0\0\0hi"
    ]
    assert (box.saved, box.missed, list(box.pending)) == (1, 0, [])


async def test_black_box_that_is_off_keeps_and_saves_nothing(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig(enabled=False)) as (_, box):
        with pytest.raises(RecordingBusy, match="the black box is off"):
            box.save(ROBOT, "why")
        assert box.rings.size_bytes == 0
    assert saved(tmp_path) == []


async def test_requests_are_bounded_and_only_for_robots_here(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig()) as (_, box):
        with pytest.raises(UnknownTopic):
            box.save("robot_9", "why")
        for _ in range(MAX_REQUESTED):
            box.save(ROBOT, "why")
        with pytest.raises(RecordingBusy, match=f"{MAX_REQUESTED} incidents are being saved on request"):
            box.save(ROBOT, "why")
        assert len(box.pending) == MAX_REQUESTED
