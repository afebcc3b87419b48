"""Black box with a hub and without sockets: what it keeps, and when it saves."""

import asyncio
import contextlib
import subprocess
import tempfile
import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.components.recorder import black_box as module
from hostlink.components.recorder.black_box import MAX_DETAIL, MAX_REQUESTED, BlackBox
from hostlink.components.recorder.channel import ros_channel
from hostlink.components.recorder.drives import LastCommand
from hostlink.components.recorder.incident import OutOfTime, read_incident
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.ring import RingMemory
from hostlink.components.recorder.salvage import salvage
from hostlink.components.recorder.settings import BlackBoxConfig
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import RecordingBusy, UnknownTopic
from tests.support.fake_device import CATALOG, topic
from tests.support.hosts import black_box_of
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT, ScriptedDevice, robot_topics
from tests.support.virtual_loop import virtual
from tests.support.waiting import TIMEOUT_S, expect

TEXT = f"/{ROBOT}/text"


@contextlib.asynccontextmanager
async def running(folder: Path, config: BlackBoxConfig) -> AsyncIterator[tuple[Hub, BlackBox]]:
    hub = Hub(Config().with_tables(black_box=config), CATALOG, reraises=True)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(hub.run())
        await hub.is_running.wait()
        box = black_box_of(hub, folder)
        box.start()
        ScriptedDevice(hub, robot_topics(ROBOT), address="10.0.0.1")
        program = hub.join("program")
        await expect(lambda: hub.robots.get_here(ROBOT))  # a topic that is subscribed earlier has no robot
        program.advertise(TEXT, "std_msgs/String")
        await expect(lambda: hub.topics.find(TEXT).subscribers or not config.enabled)
        program.publish(TEXT, b"\2\0\0\0hi")
        try:
            yield hub, box
        finally:
            await box.aclose()
            task.cancel()


def kept(box: BlackBox, robot: str) -> bool:
    """Whether messages of the robot other than events are in the memory."""
    return any(
        entry.channel.topic in (f"/{robot}/odometry", TEXT) for copy in box.rings.copies(robot) for entry in copy
    )


def saved(folder: Path) -> list[Path]:
    return sorted((folder / "incidents").glob("*.mcap"))


async def test_incident_is_saved_with_what_came_before_it_when_the_daemon_ends(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig()) as (_, box):
        incident = await box.save(f"/{ROBOT}", "x" * (MAX_DETAIL + 1))
        assert (incident.cause, incident.detail) == ("requested", "x" * MAX_DETAIL)
        assert (list(box.pending), saved(tmp_path)) == ([incident], [])
    (path,) = saved(tmp_path)
    found = read_incident(path)
    assert (found.robot, found.cause, found.detail) == (ROBOT, "requested", "x" * MAX_DETAIL)
    assert [each.payload for each in McapReader(path).messages(lambda channel: channel.topic == TEXT)] == [
        b"\2\0\0\0hi"
    ]
    assert (box.saved, box.missed, list(box.pending)) == (1, 0, [])


async def test_black_box_that_is_off_keeps_and_saves_nothing(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig(enabled=False)) as (_, box):
        with pytest.raises(RecordingBusy, match="the black box is off"):
            await box.save(ROBOT, "why")
        assert box.rings.size_bytes == 0
    assert saved(tmp_path) == []


async def test_requests_are_bounded_and_only_for_robots_here(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig()) as (_, box):
        with pytest.raises(UnknownTopic):
            await box.save("robot_9", "why")
        for _ in range(MAX_REQUESTED):
            await box.save(ROBOT, "why")
        with pytest.raises(RecordingBusy, match=f"{MAX_REQUESTED} incidents are being saved on request"):
            await box.save(ROBOT, "why")
        assert len(box.pending) == MAX_REQUESTED


async def test_lock_is_saved_after_the_time_after_it(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig(after_s=0.05)) as (hub, box):
        hub.robots.find_here(ROBOT).lock("a hand in the wheel")
        assert [(each.cause, each.detail) for each in box.pending] == [("locked", "a hand in the wheel")]
        assert saved(tmp_path) == []
        await expect(lambda: box.saved == 1)
        assert list(box.pending) == []
        (path,) = saved(tmp_path)
        found = read_incident(path)
        assert (found.cause, found.detail) == ("locked", "a hand in the wheel")
        topics = {each.channel.topic for each in McapReader(path).messages()}
        assert {TEXT, "/hostlink/events"} <= topics


async def test_incident_that_cannot_be_written_is_counted_and_logged(tmp_path: Path) -> None:
    (tmp_path / "incidents").write_text("in the place of the folder")
    with capture_logs() as logs:
        async with running(tmp_path, BlackBoxConfig(after_s=0.05)) as (_, box):
            await box.save(ROBOT, "why")
            await expect(lambda: box.missed == 1)
            assert (box.saved, list(box.pending)) == (0, [])
    (line,) = [each for each in logs if each["event"] == "incident.lost"]
    assert (line["robot"], line["cause"]) == (ROBOT, "requested")


async def test_incidents_over_the_bound_are_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PENDING", 1)
    async with running(tmp_path, BlackBoxConfig()) as (hub, box):
        await box.save(ROBOT, "why")
        hub.robots.find_here(ROBOT).lock("why")
        assert (len(box.pending), box.missed) == (1, 1)


async def test_removed_robot_is_kept_while_its_incident_is_pending(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig(after_s=0.3)) as (hub, box):
        device = ScriptedDevice(hub, robot_topics("robot_7"), address="10.0.0.7")
        await expect(lambda: hub.robots.get_here("robot_7"))
        await expect(lambda: hub.topics.find("/robot_7/odometry").subscribers)
        async with asyncio.timeout(TIMEOUT_S):
            while not kept(box, "robot_7"):  # until the recorder has subscribed
                await device.send(ODOMETRY_ID, POSE.pack(1.0, 2.0, 0.5))
                await asyncio.sleep(0.01)
        await device.aclose()
        await box.save("robot_7", "why")
        await expect(lambda: hub.robots.find_here("robot_7").link is None)
        hub.robots.forget("robot_7")
        assert not hub.robots.has("robot_7")
        assert kept(box, "robot_7")
        await expect(lambda: box.saved == 1)
        await expect(lambda: not kept(box, "robot_7"))
        assert kept(box, ROBOT)


@pytest.mark.parametrize("is_written", [True, False])
async def test_daemon_that_ends_while_a_file_is_written_leaves_it_to_another_process_or_writes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_written: bool
) -> None:
    """The file is complete, or the time was over before it: then another process writes it. Never both."""
    may_end = threading.Event()
    monkeypatch.setattr(module, "start_python", lambda _: subprocess.Popen(["true"]))
    monkeypatch.setattr(module, "END_S", TIMEOUT_S if is_written else 0.05)
    async with running(tmp_path, BlackBoxConfig(after_s=60.0)) as (_, box):

        class SlowWriter(McapWriter):
            def close(self) -> None:
                super().close()
                if not is_written:  # the disk is slow
                    assert may_end.wait(TIMEOUT_S)

        monkeypatch.setattr("hostlink.components.recorder.mcap_writer.McapWriter", SlowWriter)
        run = box._thread.run

        async def run_slowly(work: Callable[[], Path]) -> Path:
            await run(work)
            raise OutOfTime  # the time is over when the file is complete, before the loop has heard of it

        monkeypatch.setattr(box._thread, "run", run_slowly)
        await box.save(ROBOT, "why")
        await box.aclose()
        may_end.set()
        await expect(lambda: not box._thread.is_busy)
        folder = box._memory.folder
        assert folder is not None
        found = salvage(folder)
        assert found is not None
        assert len(found.saved) == (0 if is_written else 1)
        assert len(list((tmp_path / "incidents").iterdir())) == 1


async def test_incident_of_a_killed_daemon_is_saved_by_the_next_with_its_last_commands(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig()) as (hub, box):
        driver = hub.join("ann")
        await expect(lambda: driver.drive(hub.robots.find_here(ROBOT), PlanarVelocity(0.1)))
        await box.save(ROBOT, "why")
        await expect(lambda: box._memory.folder)
        facts = box._memory
        box.pending.clear()  # the process is killed: it writes nothing
        unsaved, box._unsaved = box._unsaved, {}
        facts.release()
        box._memory = RingMemory(1_000_000, purpose=None)
    assert unsaved
    commands: list[LastCommand] = []
    hub = Hub(Config().with_tables(black_box=BlackBoxConfig()), CATALOG, reraises=True)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(hub.run())
        await hub.is_running.wait()
        box = black_box_of(hub, tmp_path)
        box.start(commands.extend)
        await expect(lambda: box.saved == 2)  # the request, and the end of a daemon while a robot was driven
        await box.aclose()
        task.cancel()
    found = [read_incident(path) for path in saved(tmp_path)]
    assert [(each.robot, each.detail) for each in found if each and each.cause == "requested"] == [(ROBOT, "why")]
    assert box.missed == 0
    assert [(each.robot, each.owner) for each in commands] == [(ROBOT, "ann")]


async def test_locking_driving_and_ending_a_played_robot_makes_no_incident(tmp_path: Path) -> None:
    async with running(tmp_path, BlackBoxConfig()) as (hub, box):
        mark = topic(EndpointKind.PUBLISHER, 130, "/robot_7/played", "hostlink_msgs/PlayedRecording")
        played = ScriptedDevice(hub, [*robot_topics("robot_7"), mark], address="10.0.0.7")
        await expect(lambda: hub.robots.get_here("robot_7"))
        robot = hub.robots.find_here("robot_7")
        robot.lock("why")
        hub.robots.find_here(ROBOT).lock("why")
        robot.unlock()
        ann = hub.join("ann")
        await expect(lambda: ann.drive(robot, PlanarVelocity(0.1)))  # not right after a pause of the computer
        await played.aclose()
        await expect(lambda: robot.link is None)
        assert [each.robot for each in box.pending] == [ROBOT]


@virtual
async def test_messages_have_the_time_of_the_event_loop() -> None:
    with tempfile.TemporaryDirectory() as folder:
        hub = Hub(Config(), CATALOG, reraises=True)
        box = black_box_of(hub, Path(folder))
        await asyncio.sleep(1000.0)
        box.put(ros_channel(TEXT, "std_msgs/String", None, is_latched=False, robot=ROBOT), 0, b"", ROBOT)
        assert [entry.at_s for copy in box.rings.copies(ROBOT) for entry in copy] == [1000.0]
        await box.aclose()
