"""The last minutes of a robot, saved when something happens."""

import asyncio
import contextlib
import itertools
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from aiohttp.test_utils import make_mocked_request

from hostlink.components.gateway.history import HistoryRoutes
from hostlink.components.recorder import black_box
from hostlink.components.recorder.black_box import MAX_CHANNELS
from hostlink.components.recorder.channel import Channel
from hostlink.components.recorder.reader import McapReader, StoredMessage
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config, LinkConfig
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.detached import start_python
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.hosts import black_box_of, host_of
from tests.support.waiting import TIMEOUT_S, expect

FORWARD, STANDING = ({"linear_m_s": speed_m_s, "linear_y_m_s": 0.0, "angular_rad_s": 0.0} for speed_m_s in (0.2, 0.0))


def config(folder: Path, *, free_mb: float = 0.0, **changes: Any) -> Config:
    box = {"before_s": 20.0, "after_s": 0.5, **changes}
    return Config().with_tables(
        recording=RecordingConfig(folder=folder, min_free_disk_mb=free_mb), black_box=BlackBoxConfig(**box)
    )


@contextlib.asynccontextmanager
async def boxed(settings: Config, name: str = "robot_0") -> AsyncIterator[tuple[Daemon, FakeDevice]]:
    """A daemon with a robot that has said where it is."""
    async with daemon(settings, has_black_box=True) as host, fake_device(host.tcp, robot_topics(name)) as device:
        await expect(lambda: [robot.name for robot in host.hub.robots.all()] == [name])
        await expect(lambda: len(host.hub.topics.find(f"/{name}/odometry").subscribers) > 1)  # the black box is one
        await device.send(pose(1.0, 2.0, 0.5))
        await expect(lambda: host.hub.topics.find(f"/{name}/odometry").messages == 1)
        yield host, device


REQUEST_INTERVAL_S = 0.05  # the API limits the rate of requests


async def incidents(host: Daemon, is_so: Callable[[list[dict[str, Any]]], bool]) -> list[dict[str, Any]]:
    """The incidents, once something is so of them."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            listed: list[dict[str, Any]] = (await host.get("/api/incidents"))["incidents"]
            if is_so(listed):
                return listed
            await asyncio.sleep(REQUEST_INTERVAL_S)


async def saved(host: Daemon, count: int = 1) -> list[dict[str, Any]]:
    """The incidents, once so many are in files."""
    listed = await incidents(host, lambda each: len(in_files(each)) >= count)
    written = in_files(listed)  # a pause of a starved process may be another, still pending
    assert len(written) == count, listed
    return written


async def saved_as(host: Daemon, cause: str) -> dict[str, Any]:
    """The only incident of this cause, once it is in a file."""

    def of_cause(listed: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [each for each in listed if each["cause"] == cause]

    listed = await incidents(host, lambda each: of_cause(each) != [] and in_files(of_cause(each)) == of_cause(each))
    (incident,) = of_cause(listed)
    return incident


def in_files(listed: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [each for each in listed if each["file"]]


def read(folder: Path, incident: dict[str, Any]) -> list[StoredMessage]:
    return list(McapReader(folder / "incidents" / incident["file"]).messages())


def commanded(history: dict[str, Any]) -> list[dict[str, float]]:
    """The velocities that the device was sent, without repetitions."""
    return [velocity for velocity, _ in itertools.groupby(each["velocity"] for each in history["commands"])]


def topics(messages: list[StoredMessage]) -> set[str]:
    return {message.channel.topic for message in messages}


async def test_lock_saves_the_messages_before_and_after_it(tmp_path: Path) -> None:
    async with boxed(config(tmp_path)) as (host, device):
        await host.rest("POST", "/api/robots/robot_0/lock?wait_s=0", b'{"reason": "a hand in the wheel"}')
        (pending,) = (await host.get("/api/incidents"))["incidents"]
        assert (pending["cause"], pending["file"]) == ("locked", "")
        await device.send(pose(3.0, 2.0, 0.5))
        (incident,) = await saved(host)
        async with host.session.get(f"{host.url}/api/incidents/{incident['file']}") as answer:
            content = await answer.read()
    assert (incident["robot"], incident["cause"], incident["detail"]) == ("robot_0", "locked", "a hand in the wheel")
    assert incident["bytes"] == len(content)
    found = read(tmp_path, incident)
    poses = [message.payload for message in found if message.channel.topic == "/robot_0/odometry"]
    assert poses == [pose(1.0, 2.0, 0.5)[7:-1], pose(3.0, 2.0, 0.5)[7:-1]]
    assert {"/robot_0/velocity_commands", "/hostlink/events"} <= topics(found)
    assert [message.steady_ns for message in found] == sorted(message.steady_ns for message in found)


async def test_ages_are_seconds_though_the_clock_is_set_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_system, set_back_ns = time.time_ns, 0
    monkeypatch.setattr(time, "time_ns", lambda: of_system() - set_back_ns)
    async with boxed(config(tmp_path)) as (host, device):
        set_back_ns = 8_640_000 * 1_000_000_000
        await host.rest("POST", "/api/robots/robot_0/lock?wait_s=0")
        await device.send(pose(1.5, 2.0, 0.5))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 2)
        live = await host.get("/api/robots/robot_0/history")
        incident = await saved_as(host, "locked")  # that the clock is wrong may be diagnosed meanwhile, and saved, too
        stored = (await host.get(f"/api/incidents/{incident['file']}/history"))["history"]
    for history in (live, stored):
        assert [each["pose"]["x_m"] for each in history["poses"]] == [1.0, 1.5]
        ages = [each["age_s"] for part in ("poses", "events") for each in history[part]]
        assert max(map(abs, ages)) < 60


async def test_histories_are_made_one_at_a_time(tmp_path: Path) -> None:
    at_once = most = 0

    class Turn(asyncio.Semaphore):
        """Counts who has it."""

        async def __aenter__(self) -> None:
            nonlocal at_once, most
            await super().__aenter__()
            at_once += 1
            most = max(most, at_once)

        async def __aexit__(self, *error: Any) -> None:
            nonlocal at_once
            at_once -= 1
            await super().__aexit__(*error)

    async with boxed(config(tmp_path)) as (host, _):
        await host.rest("POST", "/api/robots/robot_0/lock?wait_s=0")
        (incident,) = await saved(host)
        box = black_box_of(host.hub, tmp_path)
        own = host_of(host.hub)
        own.offer(box)
        histories = HistoryRoutes(own)
        histories._turn = Turn(1)
        handler_of = {route.path: route.handler for route in histories.routes()}
        handlers = [handler_of["/api/robots/{name}/history"], handler_of["/api/incidents/{name}/history"]]
        async with asyncio.TaskGroup() as tasks:
            for handler, name in zip(handlers * 4, ["robot_0", incident["file"]] * 4, strict=True):
                request = make_mocked_request("GET", "/", match_info={"name": name})
                tasks.create_task(handler(request))  # type: ignore[arg-type] - a handler is a coroutine function
        await box.aclose()
    assert most == 1


async def test_every_robot_of_a_room_may_be_locked_at_once(tmp_path: Path) -> None:
    names = [f"robot_{number}" for number in range(12)]
    async with daemon(config(tmp_path), has_black_box=True) as host, contextlib.AsyncExitStack() as devices:
        for name in names:
            await devices.enter_async_context(fake_device(host.tcp, robot_topics(name)))
        await expect(lambda: all(map(host.hub.robots.has, names)))
        for name in names:
            assert (await host.rest("POST", f"/api/robots/{name}/lock?wait_s=0"))[0] == 200
        # A pause of a starved process may be another incident of a robot.
        await incidents(host, lambda listed: {each["robot"] for each in in_files(listed)} == set(names))
        assert (await host.get("/api/incidents"))["missed"] == 0


async def test_black_box_does_not_subscribe_to_derived_odometry(tmp_path: Path) -> None:
    async with boxed(config(tmp_path)) as (host, _):
        assert not host.hub.topics.find("/robot_0/odom").has_subscribers
        assert not host.hub.topics.find("/tf").has_subscribers


async def test_a_robots_history_is_where_it_drove_and_what_happened(tmp_path: Path) -> None:
    async with boxed(config(tmp_path)) as (host, device):
        for number in range(1, 4):
            await device.send(pose(1.0 + number / 100, 2.0, 0.5))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 4)
        host.hub.robots.find("robot_0").stop()
        async with asyncio.timeout(TIMEOUT_S):
            while not commanded(await host.get("/api/robots/robot_0/history")):  # noqa: ASYNC110 - there is no event
                await asyncio.sleep(REQUEST_INTERVAL_S)
        host.hub.join("pilot").drive(host.hub.robots.find("robot_0"), PlanarVelocity(0.2))
        await host.rest("POST", "/api/robots/robot_0/lock?wait_s=0")
        history = await host.get("/api/robots/robot_0/history")
        robot = await host.get("/api/robots/robot_0")
        fleet, chosen = await host.get("/api/history"), await host.get("/api/history?chosen=robot_0")
        assert (await host.rest("GET", "/api/robots/robot_9/history"))[0] == 404
    for (of_one,), has_plots in ((fleet["robots"], False), (chosen["robots"], True)):
        assert of_one["name"] == "robot_0"
        assert [each["pose"] for each in of_one["poses"]] == [each["pose"] for each in history["poses"]]
        assert [each["msg"] for each in of_one["events"]] == [each["msg"] for each in history["events"]]
        assert {"twist" in each for each in of_one["poses"]} == {has_plots}
        assert bool(of_one["commands"]) is has_plots
    assert [each["pose"]["x_m"] for each in history["poses"]] == [1.0, 1.01, 1.02, 1.03]
    assert history["poses"][-1]["pose"] == robot["odometry"]["pose"]
    assert commanded(history) == [STANDING, FORWARD, STANDING]
    assert all(each["age_s"] >= 0 for each in history["poses"])
    assert [each["msg"]["kind"] for each in history["events"]][-1] == "locked"
    assert "commanded" not in {each["msg"]["kind"] for each in history["events"]}
    assert history["plot_data"] == []


async def test_a_damaged_incident_shows_what_is_left_of_it(tmp_path: Path) -> None:
    async with boxed(config(tmp_path)) as (host, _):
        await host.rest("POST", "/api/robots/robot_0/lock?wait_s=0")
        (incident,) = await saved(host)
        path = tmp_path / "incidents" / incident["file"]
        content = await asyncio.to_thread(path.read_bytes)
        await asyncio.to_thread(path.write_bytes, content[: len(content) // 2])
        status, view = await host.rest("GET", f"/api/incidents/{incident['file']}/history")
    assert (status, view["cause"], len(view["damage"])) == (200, "locked", 1)


async def test_a_robot_that_is_forgotten_in_the_half_minute_after_is_in_its_incident(tmp_path: Path) -> None:
    settings = config(tmp_path, after_s=0.6)
    async with boxed(replace(settings, link=LinkConfig(forget_robot_after_s=0.1))) as (host, device):
        drive = b'{"linear": 0.2, "angular": 0}'
        await host.drive("robot_0", drive)
        device.break_off()
        await expect(lambda: not host.hub.robots.has("robot_0"))
        (incident,) = await saved(host)
        assert (incident["robot"], incident["cause"]) == ("robot_0", "gone")
        assert "/robot_0/odometry" in topics(read(tmp_path, incident))


async def test_a_process_that_writes_what_the_daemon_left_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen[bytes]] = []

    def start(_: Sequence[str]) -> subprocess.Popen[bytes]:
        started.append(start_python(["-c", "pass"]))
        return started[0]

    monkeypatch.setattr(black_box, "END_S", 0.0)
    monkeypatch.setattr(black_box, "start_python", start)
    async with boxed(config(tmp_path)) as (host, _):
        box = black_box_of(host.hub, tmp_path)
        await box.save("robot_0", "late")
        await box.aclose()
    await expect(lambda: started[0].returncode == 0)  # otherwise it is a zombie


async def test_newest_of_many_short_lived_channels_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(black_box, "END_S", TIMEOUT_S)  # else another process writes the file on a busy machine
    async with boxed(config(tmp_path)) as (host, _):
        box = black_box_of(host.hub, tmp_path)
        channels = [
            Channel(f"/{number}", "ros1", "", "", (("robot", "robot_0"),)) for number in range(2 * MAX_CHANNELS)
        ]
        for each in channels:
            box.announce(each)
        await box.save("robot_0", "too many")
        await box.aclose()
    (file,) = (tmp_path / "incidents").iterdir()
    reader = McapReader(file)
    assert list(reader.messages()) == []
    assert reader.channels == channels[MAX_CHANNELS:]


@pytest.mark.parametrize(
    ("type_name", "payload"),
    [("std_msgs/UInt8", b"1"), ("std_msgs/UInt8", b"\xff"), ("std_msgs/String", b"\2\0\0\0{}")],
)
async def test_a_program_that_publishes_as_hostlink_itself_spoils_no_history(
    tmp_path: Path, type_name: str, payload: bytes
) -> None:
    async with boxed(config(tmp_path)) as (host, _):
        program = host.hub.join("program")
        for name in ("/hostlink/events", "/robot_0/events"):
            program.advertise(name, type_name)
        await asyncio.sleep(0.1)
        program.publish("/hostlink/events", payload)
        await host.rest("POST", "/api/robots/robot_0/lock?wait_s=0")
        history = await host.get("/api/robots/robot_0/history")
        assert [each["msg"]["kind"] for each in history["events"]][-1] == "locked"
        (incident,) = await saved(host)
        stored = await host.get(f"/api/incidents/{incident['file']}/history")
        assert stored["history"]["events"][-1]["msg"]["kind"] == "locked"
