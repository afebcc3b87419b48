"""Recordings of the hub's messages: over REST, of driven robots, and on failing disks."""

import asyncio
import contextlib
import io
import json
import resource
import shutil
import threading
from collections import Counter
from collections.abc import AsyncIterator, Collection, Iterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest
import structlog
from structlog.testing import capture_logs

from hostlink.components.gateway.history import recording_history
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.components.recorder import mcap_writer
from hostlink.components.recorder import recordings as recordings_module
from hostlink.components.recorder.channel import EVENTS_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC, json_of
from hostlink.components.recorder.folder import Folder
from hostlink.components.recorder.mcap_format import MAGIC
from hostlink.components.recorder.reader import McapReader, StoredMessage
from hostlink.components.recorder.recorder import GROUP, TopicSelection
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config
from hostlink.core.hub.node import is_of
from hostlink.core.hub.topic import Topic
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime import logs
from hostlink.core.runtime.folders import NAME as OWNER
from tests.support.daemon import Daemon, daemon
from tests.support.driving import driven
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics
from tests.support.hosts import recordings_of
from tests.support.waiting import expect

POSES = [pose(0.1 * number, 0.2, 0.3) for number in range(20)]


def config(folder: Path, **changes: Any) -> Config:
    return Config().with_tables(recording=RecordingConfig(folder=folder, min_free_disk_mb=0.0, **changes))


@contextlib.asynccontextmanager
async def recorded(settings: Config) -> AsyncIterator[tuple[Daemon, FakeDevice]]:
    """A daemon with a robot."""
    async with daemon(settings) as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: [robot.name for robot in host.hub.robots.all()] == ["robot_0"])
        yield host, device


async def start(host: Daemon, **request: Any) -> dict[str, Any]:
    status, view = await host.rest("POST", "/api/recordings", json.dumps(request).encode())
    assert status == 200, view
    assert isinstance(view, dict)
    return view


async def stop(host: Daemon, name: str) -> dict[str, Any]:
    status, view = await host.rest("POST", f"/api/recordings/{name}/stop")
    assert status == 200, view
    assert isinstance(view, dict)
    return view


def names(folder: Path) -> list[str]:
    """Return the sorted names of the files in the folder, without the mark of its owner."""
    return sorted(path.name for path in folder.iterdir() if path.name != OWNER)


def whole(path: Path) -> bytes:
    return path.read_bytes()


def messages(*paths: Path) -> list[StoredMessage]:
    return [message for path in paths for message in McapReader(path).messages()]


def payloads(found: list[StoredMessage], topic: str) -> list[bytes]:
    return [message.payload for message in found if message.channel.topic == topic]


def texts(found: list[StoredMessage], topic: str) -> list[Any]:
    """The JSON of one of hostlink's own topics."""
    of_topic = (message for message in found if message.channel.topic == topic)
    return [json.loads(json_of(message.channel, message.payload)) for message in of_topic]


def events(found: list[StoredMessage]) -> list[dict[str, Any]]:
    return texts(found, EVENTS_TOPIC)


def failed(lines: list[Any]) -> list[Any]:
    return [line for line in lines if line["event"] == "recording.failed"]


async def send_poses(host: Daemon, device: FakeDevice) -> None:
    topic = host.hub.topics.find("/robot_0/odometry")
    before = topic.messages
    for each in POSES:
        await device.send(each)
    await expect(lambda: topic.messages == before + len(POSES))


@pytest.fixture
def configured_log() -> Iterator[None]:
    """Configure the log as `serve` does: its lines are recorded."""
    logs.configure(stream=io.StringIO())
    yield
    structlog.reset_defaults()


@pytest.mark.usefixtures("configured_log")
async def test_topics_commands_log_and_parameters_are_in_the_file(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        host.hub.parameters["~speed"] = 0.5
        view = await start(host, name="run")
        await send_poses(host, device)
        pilot = host.hub.join("pilot")
        pilot.address = "10.0.0.5"
        pilot.drive(host.hub.robots.find("robot_0"), PlanarVelocity(0.2))
        await expect(lambda: host.hub.robots.find("robot_0").gate.owner is None)  # the lease has ended
        stopped = await stop(host, "run")
    found = messages(tmp_path / "run.mcap")
    assert (view["files"], stopped["dropped"]) == (["run.mcap"], 0)
    assert stopped["messages"] == len(found)
    assert [bytes(payload) for payload in payloads(found, "/robot_0/odometry")] == [each[7:-1] for each in POSES]
    kinds = [(event["kind"], event["robot"]) for event in events(found)]
    assert ("commanded", "robot_0") in kinds
    assert ("stopped", "robot_0") in kinds
    commanded = next(event for event in events(found) if event["kind"] == "commanded")
    assert (commanded["facts"]["owner"], commanded["facts"]["velocity"]["linear_x_m_s"]) == ("pilot", 0.2)
    assert "address" not in commanded["facts"]  # other people get the file
    assert "robot.stopped" in [line["event"] for line in texts(found, LOG_TOPIC)]
    assert texts(found, PARAMETERS_TOPIC)[0] == {"~speed": 0.5}
    assert payloads(found, "/robot_0/velocity_commands")  # what the gate sent
    assert payloads(found, "/robot_0/odom")


async def test_patterns_and_robots_choose(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        for name, request in (("one", {"topics": ["/robot_0/odo*"]}), ("other", {"robots": ["robot_0"]})):
            await start(host, name=name, **request)
        await send_poses(host, device)
        for name in ("one", "other"):
            await stop(host, name)
        status, refusal = await host.rest("POST", "/api/recordings", b'{"robots": ["robot_9"]}')
    topics = Counter(message.channel.topic for message in messages(tmp_path / "one.mcap"))
    assert {topic for topic in topics if not topic.startswith("/hostlink/")} == {"/robot_0/odometry", "/robot_0/odom"}
    assert len(payloads(messages(tmp_path / "other.mcap"), "/robot_0/odometry")) == len(POSES)
    assert (status, refusal["error"]["kind"]) == (404, "UnknownTopic")


def is_recorded(topic: Topic) -> bool:
    return any(is_of(each.key, GROUP) for each in topic.subscribers)


async def test_topic_that_appears_later_is_recorded_and_one_that_disappears_is_released(tmp_path: Path) -> None:
    async with daemon(config(tmp_path)) as host:
        await start(host, name="run")
        async with fake_device(host.tcp, robot_topics()) as device:
            await expect(lambda: is_recorded(host.hub.topics.find("/robot_0/odometry")))
            await send_poses(host, device)
        await expect(lambda: host.hub.topics.find_or_none("/robot_0/odometry") is None)
        await stop(host, "run")
        assert not [topic.name for topic in host.hub.topics.all() if is_recorded(topic)]
    found = messages(tmp_path / "run.mcap")
    assert len(payloads(found, "/robot_0/odometry")) == len(POSES)
    assert [event["kind"] for event in events(found)][:2] == ["link_opened", "appeared"]
    assert {"gone", "link_closed"} <= {event["kind"] for event in events(found)}


async def test_page_of_another_origin_reads_a_recording_as_lichtblick_does(tmp_path: Path) -> None:
    """Lichtblick reads the headers of the whole file first, then ranges. A browser shows it only exposed headers."""
    page = "https://app.example"
    settings = config(tmp_path).with_tables(api=ApiConfig(origins=(page,)))
    async with recorded(settings) as (host, device):
        await start(host, name="run")
        await send_poses(host, device)
        await stop(host, "run")
        content, url = whole(tmp_path / "run.mcap"), f"{host.url}/api/recordings/run.mcap"
        for method in ("HEAD", "GET"):
            async with host.session.request(method, url, headers={"Origin": page}) as answer:
                exposed = answer.headers["Access-Control-Expose-Headers"].split(", ")
                assert (answer.status, answer.headers["Accept-Ranges"]) == (200, "bytes")
                assert answer.headers["Content-Length"] == str(len(content))
                assert {"Accept-Ranges", "Content-Length", "Content-Range", "ETag"} <= set(exposed)
                assert answer.headers["ETag"]
                assert await answer.read() == (content if method == "GET" else b"")
        preflight = {"Origin": page, "Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "range"}
        async with host.session.options(url, headers=preflight) as answer:
            assert answer.status == 204
            assert "Range" in answer.headers["Access-Control-Allow-Headers"].split(", ")
        async with host.session.get(url, headers={"Origin": page, "Range": "bytes=8-99"}) as part:
            assert part.headers["Content-Range"] == f"bytes 8-99/{len(content)}"
            assert (part.status, await part.read()) == (206, content[8:100])
        async with host.session.head(f"{host.url}/api/recordings/other.mcap") as answer:
            assert answer.status == 404


@pytest.mark.parametrize("name", ["../secret", "%2e%2e%2fsecret"])
async def test_name_cannot_leave_the_folder(tmp_path: Path, name: str) -> None:
    secret = tmp_path / "secret.mcap"
    secret.write_bytes(b"not yours")
    inside = tmp_path / "recordings"
    async with recorded(config(inside)) as (host, _):
        request = json.dumps({"name": name}).encode()
        assert (await host.rest("POST", "/api/recordings", request))[0] == 400
        async with host.session.get(f"{host.url}/api/recordings/{name}", allow_redirects=False) as answer:
            assert answer.status in (400, 404)
    assert whole(secret) == b"not yours"


async def test_a_token_that_may_read_fetches_and_does_not_record(tmp_path: Path) -> None:
    tokens = (
        TokenConfig(name="eye", role="read", token="r" * 20),
        TokenConfig(name="hand", role="drive", token="d" * 20),
    )
    settings = config(tmp_path).with_tables(api=ApiConfig(tokens=tokens))
    async with daemon(settings) as host:
        reading, driving = ({"Authorization": f"Bearer {letter * 20}"} for letter in "rd")
        path = f"{host.url}/api/recordings"
        async with host.session.post(path, headers=driving, data=b'{"name": "run"}') as answer:
            assert (answer.status, (await answer.json())["owner"]) == (200, "hand")
        for method, url in (("POST", path), ("POST", f"{path}/run/stop"), ("DELETE", f"{path}/run")):
            async with host.session.request(method, url, headers=reading) as answer:
                assert answer.status == 403
        for url in (path, f"{path}/run"):
            async with host.session.get(url, headers=reading) as answer:
                assert answer.status == 200
        assert (await put(host, "copy", MAGIC, **reading))[0] == 403
        assert (await put(host, "copy", MAGIC))[0] == 401
        assert names(tmp_path) == ["run.mcap"]


async def test_the_end_of_the_daemon_completes_the_file_with_its_last_zero(tmp_path: Path) -> None:
    async with contextlib.AsyncExitStack() as devices, daemon(config(tmp_path)) as host:
        device = await devices.enter_async_context(fake_device(host.tcp, robot_topics()))  # leaves after the daemon
        await expect(lambda: host.hub.robots.find("robot_0").link)
        await start(host, name="run")
        host.hub.join("pilot").drive(host.hub.robots.find("robot_0"), PlanarVelocity(0.2))
        await device.velocity()
    reader = McapReader(tmp_path / "run.mcap")
    found = list(reader.messages())
    assert reader.damage == []
    assert payloads(found, "/robot_0/velocity_commands")[-1] == PlanarVelocity().encode()


@contextlib.asynccontextmanager
async def undisturbed(host: Daemon, device: FakeDevice) -> AsyncIterator[None]:
    """The robot is driven all the while, and its device receives no other velocity while the machine runs."""
    received: list[tuple[float, float]] = []

    async def receive() -> None:
        while True:
            received.append(await device.velocity())

    async with driven(host.hub, "robot_0", 0.2) as driver, asyncio.TaskGroup() as tasks:
        await device.velocity_of((0.2, 0.0))
        receiving = tasks.create_task(receive())
        yield
        await expect(lambda: len(received) > 2)
        receiving.cancel()
    assert set(received) == {(0.2, 0.0)} or not driver.is_steady


async def test_a_folder_that_is_removed_is_made_again_and_costs_a_second(tmp_path: Path) -> None:
    inside = tmp_path / "recordings"
    async with recorded(config(inside)) as (host, device), undisturbed(host, device):
        await start(host, name="run")
        await send_poses(host, device)
        shutil.rmtree(inside)
        await expect(inside.exists)
        await send_poses(host, device)
        await stop(host, "run")
    assert len(payloads(messages(*(inside / name for name in names(inside))), "/robot_0/odometry")) == len(POSES)


@contextlib.contextmanager
def no_file_over(size_bytes: int) -> Iterator[None]:
    """The kernel refuses to let any file of this process grow further, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


async def test_a_disk_that_fills_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        pilot, robot = host.hub.join("pilot"), host.hub.robots.find("robot_0")
        await start(host, name="run")
        await send_poses(host, device)
        await asyncio.sleep(1.2)
        with capture_logs() as lines, no_file_over(len(whole(tmp_path / "run.mcap")) + 100):
            while not failed(lines):
                await send_poses(host, device)
            assert pilot.drive(robot, PlanarVelocity(0.2)) == PlanarVelocity(0.2)
        assert (await host.get("/api/recordings"))["recordings"] == []
        await send_poses(host, device)
        await start(host, name="again")
        await send_poses(host, device)
        await stop(host, "again")
    assert "File too large" in failed(lines)[0]["reason"]
    assert len(payloads(messages(tmp_path / "run.mcap"), "/robot_0/odometry")) >= len(POSES)
    assert len(payloads(messages(tmp_path / "again.mcap"), "/robot_0/odometry")) == len(POSES)


async def test_too_little_room_on_the_disk_is_told_before_a_file_is_made(tmp_path: Path) -> None:
    settings = Config().with_tables(recording=RecordingConfig(folder=tmp_path, min_free_disk_mb=1e12))
    async with recorded(settings) as (host, _):
        status, refusal = await host.rest("POST", "/api/recordings")
    assert (status, "min_free_disk_mb" in refusal["error"]["reason"]) == (507, True)
    assert names(tmp_path) == []


async def test_a_channel_says_whose_it_is_and_who_publishes_it(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        await start(host, name="run")
        await send_poses(host, device)
        host.hub.join("pilot").drive(host.hub.robots.find("robot_0"), PlanarVelocity(0.2))
        await stop(host, "run")
    found = {message.channel.topic: message.channel for message in messages(tmp_path / "run.mcap")}
    origins = {topic: (channel.robot, channel.origin) for topic, channel in found.items() if channel.robot}
    assert origins == {
        "/robot_0/odometry": ("robot_0", "device"),
        "/robot_0/odom": ("robot_0", "hostlink"),
        "/robot_0/velocity_commands": ("robot_0", "velocity"),
        "/robot_0/cmd_vel": ("robot_0", "velocity"),
    }


async def test_recording_whose_next_name_exists_continues_under_another(tmp_path: Path) -> None:
    """run.mcap was removed for the budget, and run_2.mcap was not."""
    (tmp_path / "run_2.mcap").write_bytes(b"of yesterday")
    async with recorded(config(tmp_path, max_file_s=0.5)) as (host, device):
        await start(host, name="run")
        sent = 0
        while not (tmp_path / "run_3.mcap").exists():
            await send_poses(host, device)
            await asyncio.sleep(0.1)
            sent += len(POSES)
        view = await stop(host, "run")
    assert "failure" not in view
    assert view["files"][:2] == ["run.mcap", "run_3.mcap"]
    assert (tmp_path / "run_2.mcap").read_bytes() == b"of yesterday"
    found = messages(*(tmp_path / name for name in view["files"]))
    assert len(payloads(found, "/robot_0/odometry")) == sent


class HeldFolder(Folder):
    """Folder on a slow disk: it makes no room until it is allowed to."""

    may = threading.Event()

    def make_room(self, is_open: Collection[Path]) -> list[str]:
        self.may.wait(10.0)
        return super().make_room(is_open)


async def test_a_start_that_is_cancelled_leaves_neither_a_file_nor_a_thread(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, _):
        recordings = recordings_of(host.hub)
        recordings.folder = HeldFolder(tmp_path, max_disk_mb=100.0, min_free_disk_mb=0.0)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.05):
                await recordings.start(TopicSelection(), name="run")
        recordings.folder.may.set()
        await recordings.start(TopicSelection(), name="again")
        assert [each.name for each in recordings.under_way()] == ["again"]
        await recordings.aclose()
        await expect(lambda: all(thread.name != "recording" for thread in threading.enumerate()))
        assert names(tmp_path) == ["again.mcap"]


async def test_topics_for_which_a_file_has_no_room_are_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_writer, "MAX_CHANNELS", 2)
    monkeypatch.setattr(recordings_module, "LOOK_INTERVAL_S", 0.05)
    with capture_logs() as lines:
        async with recorded(config(tmp_path)) as (host, device):
            await start(host, name="run")
            await device.send(POSES[0])
            await expect(lambda: [line for line in lines if line["event"] == "recording.channel_limit_reached"])
            assert (await stop(host, "run"))["dropped"] > 0
    assert [line["recording"] for line in lines if line["event"] == "recording.channel_limit_reached"] == ["run"]


async def put(host: Daemon, name: str, body: bytes, **headers: str) -> tuple[int, dict[str, Any]]:
    """Send a file as a recording."""
    async with aiohttp.ClientSession() as session:
        request = session.put(f"{host.url}/api/recordings/{name}", data=body, headers=headers)
        async with request as answer:
            return answer.status, await answer.json()


async def record_drive(host: Daemon, device: FakeDevice, name: str) -> bytes:
    """Record some poses and a drive, and return the file."""
    await start(host, name=name)
    async with driven(host.hub, "robot_0", 0.2):
        for each in POSES:
            await device.send(each)
        await expect(lambda: host.hub.robots.find("robot_0").state(0.0).odometry is not None)
    await stop(host, name)
    return (host.hub.config.table("recording", RecordingConfig).folder / f"{name}.mcap").read_bytes()  # type: ignore[operator]


async def test_recording_is_read_as_the_history_of_its_robot(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        await record_drive(host, device, "run")
        view = await host.get("/api/recordings/run.mcap/history")
        assert (view["robot"], view["robots"], view["damage"]) == ("robot_0", ["robot_0"], [])
        history = view["history"]
        assert history["poses"][-1]["pose"]["x_m"] == pytest.approx(1.9, abs=1e-3)
        assert {each["velocity"]["linear_m_s"] for each in history["commands"]} >= {0.2}
        ages = [-each["age_s"] for each in history["poses"]]
        assert ages == sorted(ages)
        assert 0 <= ages[0] <= ages[-1] <= view["seconds"] + 1e-3
        assert (await host.rest("GET", "/api/recordings/run.mcap/history?robot=other"))[0] == 404
        assert (await host.rest("GET", "/api/recordings/none.mcap/history"))[0] == 404


async def test_long_recording_is_read_for_a_bounded_time(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        await record_drive(host, device, "run")
    view = json.loads(recording_history(CATALOG, tmp_path / "run.mcap", "", read_s=-1.0))
    assert view["damage"] == ["only the first 0 s are shown; `hostlink plot run.mcap` shows all"]
    assert view["history"]["poses"] == []


async def test_sent_file_becomes_a_recording_once(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        content = await record_drive(host, device, "run")
        status, view = await put(host, "copy", content)
        assert (status, view["file"], view["bytes"]) == (200, "copy.mcap", len(content))
        assert (tmp_path / "copy.mcap").read_bytes() == content
        assert (await host.get("/api/recordings/copy.mcap/history"))["robots"] == ["robot_0"]
        assert (await put(host, "copy", content))[0] == 409
        assert names(tmp_path) == ["copy.mcap", "run.mcap"]


@pytest.mark.parametrize(
    ("name", "changes", "status", "words"),
    [
        ("other", {}, 400, "not an MCAP file"),
        (".hidden", {}, 400, "invalid recording name"),
        ("large", {"max_file_mb": 0.001}, 413, "recording.max_file_mb"),
        ("crowded", {"max_disk_mb": 0.001}, 507, "has 9.0 kB, and there is room for 1.0 kB"),
    ],
)
async def test_sent_file_without_mcap_or_without_room_is_refused(
    tmp_path: Path, name: str, changes: dict[str, float], status: int, words: str
) -> None:
    async with daemon(config(tmp_path, **changes)) as host:
        found, answer = await put(host, name, b"%PDF-1.7 " * 1000)
        assert (found, words in answer["error"]["reason"]) == (status, True), answer
        assert names(tmp_path) == []


async def test_file_of_a_client_that_disconnects_is_removed_and_the_next_one_is_stored(tmp_path: Path) -> None:
    async with recorded(config(tmp_path)) as (host, device):
        content = await record_drive(host, device, "run")
        where, _, port = host.url.removeprefix("http://").partition(":")
        _, writer = await asyncio.open_connection(where, int(port))
        head = f"PUT /api/recordings/copy HTTP/1.1\r\nHost: {where}:{port}\r\nContent-Length: {len(content)}\r\n\r\n"
        writer.write(head.encode() + content[:-100])
        await expect(lambda: ".upload.part" in names(tmp_path))
        assert (await put(host, "second", content))[0] == 409  # one at a time
        writer.close()
        await expect(lambda: names(tmp_path) == ["run.mcap"])
        assert (await put(host, "copy", content))[0] == 200
