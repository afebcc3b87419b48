"""Recordings of the daemon: their names, bounds, files and ends, with a hub and without sockets."""

import asyncio
import contextlib
import shutil
import threading
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.components.gateway.recordings import recording_view
from hostlink.components.recorder import recordings as module
from hostlink.components.recorder.channel import EVENTS
from hostlink.components.recorder.drives import DIED, Drive, DriveLog, append_drives, read_drives
from hostlink.components.recorder.folder import Folder
from hostlink.components.recorder.mcap_writer import FileThread
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.recorder import TopicSelection
from hostlink.components.recorder.recordings import Recordings
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadRequest, RecordingBusy, RecordingFailed, UnknownTopic
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_of, recordings_of
from tests.support.logs import logged
from tests.support.waiting import expect

ALL = TopicSelection()
BOOL = "std_msgs/Bool"


@contextlib.asynccontextmanager
async def running(folder: Path, **settings: object) -> AsyncIterator[tuple[Hub, Recordings]]:
    recording = replace(RecordingConfig(folder=folder), **settings)  # type: ignore[arg-type]
    async with running_hub(Config().with_tables(recording=recording)) as found:
        yield found


@contextlib.asynccontextmanager
async def running_hub(config: Config) -> AsyncIterator[tuple[Hub, Recordings]]:
    hub = Hub(config, CATALOG, reraises=True)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(hub.run())
        await hub.is_running.wait()
        made = recordings_of(hub)
        await made.open()
        try:
            yield hub, made
        finally:
            await made.aclose()
            task.cancel()


async def test_recording_has_messages_from_its_start_to_its_stop(tmp_path: Path) -> None:
    async with running(tmp_path) as (hub, recordings):
        program = hub.join("program")
        program.advertise("/door", BOOL)
        program.publish("/door", b"\0")
        await recordings.start(ALL, name="run", owner="client 1")
        await asyncio.sleep(0.2)
        program.publish("/door", b"\1")
        changes = recordings.changes
        recording = await recordings.stop("run")
        program.publish("/door", b"\0")
        payloads = [each.payload for each in McapReader(tmp_path / "run.mcap").messages(lambda c: c.topic == "/door")]
        assert payloads == [b"\1"]
        assert recordings.under_way() == []
        assert recordings.changes == changes + 1
        assert recordings.totals().messages == recording.thread.messages > 0
        with pytest.raises(UnknownTopic):
            await recordings.stop("run")


async def test_name_is_refused_that_is_invalid_or_in_use(tmp_path: Path) -> None:
    async with running(tmp_path) as (_, recordings):
        with pytest.raises(BadRequest):
            await recordings.start(ALL, name="../run")
        await recordings.start(ALL, name="run")
        with pytest.raises(RecordingBusy, match="under way already"):
            await recordings.start(ALL, name="run")
        await recordings.stop("run")
        with pytest.raises(RecordingBusy, match="already exists"):
            await recordings.start(ALL, name="run")


async def test_two_starts_of_one_name_at_once_make_one_recording(tmp_path: Path) -> None:
    async with running(tmp_path) as (_, recordings):
        refused: list[RecordingBusy] = []

        async def start() -> None:
            try:
                await recordings.start(ALL, name="run")
            except RecordingBusy as error:
                refused.append(error)

        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(start())
            tasks.create_task(start())
        assert len(refused) == 1
        assert [each.name for each in recordings.under_way()] == ["run"]


async def test_recordings_at_once_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_UNDER_WAY", 2)
    async with running(tmp_path) as (_, recordings):
        await recordings.start(ALL, name="a")
        await recordings.start(ALL, name="b")
        with pytest.raises(RecordingBusy, match="2 recordings are under way"):
            await recordings.start(ALL, name="c")
        await recordings.stop("a")
        await recordings.start(ALL, name="c")


async def test_names_without_a_wish_differ_within_a_second(tmp_path: Path) -> None:
    async with running(tmp_path) as (_, recordings):
        names = [(await recordings.start(TopicSelection(robots=("robot_0",)))).name for _ in range(3)]
        assert len(set(names)) == 3
        assert all("robot_0" in name for name in names)


async def test_file_that_is_written_is_not_removed_and_an_ended_one_is(tmp_path: Path) -> None:
    async with running(tmp_path) as (_, recordings):
        await recordings.start(ALL, name="run")
        with pytest.raises(RecordingBusy):
            await recordings.remove("run.mcap")
        await recordings.stop("run")
        changes = recordings.changes
        assert await recordings.remove("run.mcap") == "run.mcap"
        assert recordings.changes == changes + 1
        assert not (tmp_path / "run.mcap").exists()
        with pytest.raises(UnknownTopic):
            await recordings.remove("run.mcap")


async def test_second_daemon_of_a_folder_changes_nothing_in_it_and_says_whose_it_is(tmp_path: Path) -> None:
    async with running(tmp_path) as (hub, recordings):
        program = hub.join("program")
        program.advertise("/door", BOOL)
        await recordings.start(ALL, name="run")
        async with running(tmp_path, max_disk_mb=1e-9) as (_, second):
            taken = f"{tmp_path} belongs to the daemon with process id "
            with pytest.raises(RecordingBusy, match=taken):
                await second.start(ALL, name="other")
            with pytest.raises(RecordingBusy, match=taken):
                await second.remove("run")
            with pytest.raises(RecordingBusy, match=taken):
                await second.store("other", 0, pieces())
            with capture_logs() as logs:
                await second.drives._keep([DRIVE])
                with pytest.raises(OSError, match=taken):
                    second.black_box.folder.make_room(())
            assert [(line["event"], line["reason"].startswith(taken)) for line in logs] == [("drives.lost", True)]
        program.publish("/door", b"\0")
        view = await recordings.stop("run")
        assert [each.name for each in view.thread.paths] == ["run.mcap"]
        assert any(McapReader(tmp_path / "run.mcap").messages(lambda c: c.topic == "/door"))
    async with running(tmp_path) as (_, later):
        await later.start(ALL, name="later")


def findings(hub: Hub) -> list[tuple[str, str]]:
    """Return code and detail of each finding about the folder."""
    found = hub.diagnoses.daemon_findings("listening on no port")
    return [(each.code, each.detail) for each in found if each.code.startswith("recordings_")]


async def test_daemon_whose_folder_another_one_owns_has_a_finding_until_that_one_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FOLDER_INTERVAL_S", 0.01)
    async with contextlib.AsyncExitStack() as stack:
        async with running(tmp_path) as (first, _):
            with capture_logs() as logs:
                second, _ = await stack.enter_async_context(running(tmp_path))
            ((code, detail),) = findings(second)
            assert code == "recordings_taken"
            assert detail.startswith(f"{tmp_path} belongs to the daemon with process id ")
            assert not findings(first)
            assert [line["code"] for line in logs if line["event"] == "daemon.diagnosed"] == [code]
        await expect(lambda: not findings(second))


async def test_removed_folder_is_a_finding_and_is_made_again_as_soon_as_that_is_possible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FOLDER_INTERVAL_S", 0.01)
    monkeypatch.setattr(module, "REMOVED_S", 0.5)
    place = tmp_path / "state"
    async with running(place / "recordings") as (hub, recordings):
        assert not findings(hub)
        shutil.rmtree(place)
        await expect((place / "recordings" / ".owner").exists)
        await expect(lambda: findings(hub) == [("recordings_removed", str(place / "recordings"))])
        await expect(lambda: not findings(hub))
        place.rename(tmp_path / "elsewhere")
        place.write_text("no folder")
        await expect(lambda: [code for code, _ in findings(hub)] == ["recordings_unusable"])
        place.unlink()
        await expect(lambda: [code for code, _ in findings(hub)] == ["recordings_removed"])
        await recordings.start(ALL, name="run")


async def test_full_disk_is_a_finding_while_nothing_is_recorded(tmp_path: Path) -> None:
    async with running(tmp_path, min_free_disk_mb=1e12) as (hub, _):
        ((code, detail),) = findings(hub)
        assert code == "recordings_unusable"
        assert "are free, less than min_free_disk_mb = 1e+12" in detail


async def test_disk_that_does_not_answer_is_a_finding_until_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FOLDER_INTERVAL_S", 0.01)
    monkeypatch.setattr(module, "DISK_S", 0.01)
    answers = threading.Event()
    monkeypatch.setattr(Folder, "check", lambda _: answers.wait(30.0))
    async with running(tmp_path) as (hub, _):
        await expect(lambda: findings(hub) == [("recordings_unusable", f"{tmp_path}: its disk does not answer")])
        answers.set()
        await expect(lambda: not findings(hub))


async def test_daemon_that_keeps_nothing_has_no_finding_about_its_folder(tmp_path: Path) -> None:
    async with running(tmp_path):
        config = Config().with_tables(recording=RecordingConfig(folder=tmp_path, drives=False))
        config = config.with_tables(black_box=replace(config.table("black_box", BlackBoxConfig), enabled=False))
        async with running_hub(config) as (hub, _):
            assert not findings(hub)


async def pieces() -> AsyncIterator[bytes]:
    yield b""


async def test_removed_file_of_a_recording_is_told_and_its_messages_are_counted(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    async with running(folder) as (hub, recordings):
        program = hub.join("program")
        program.advertise("/door", BOOL)
        recording = await recordings.start(ALL, name="run")
        program.publish("/door", b"\0")
        await expect(lambda: recording.thread.messages > 0)
        with capture_logs() as logs:
            shutil.rmtree(folder)
            await expect(lambda: recording.removed)
            program.publish("/door", b"\1")
            await recordings.stop("run")
        removed = [line for line in logs if line["event"] == "recording.file_removed"]
        assert [(line["file"], line["lost"] > 0) for line in removed] == [(str(folder / "run.mcap"), True)]
        assert recording.thread.dropped == recording.thread.lost == removed[0]["lost"]
        view = recording_view(recording)
        assert (view["files"], view["removed"]) == (["run_2.mcap"], ["run.mcap"])
        stored = list(McapReader(folder / "run_2.mcap").messages())
        assert view["messages"] == len(stored)
        assert [each.payload for each in stored if each.channel.topic == "/door"] == [b"\1"]


async def test_file_that_is_removed_just_before_the_end_is_told_too(tmp_path: Path) -> None:
    async with running(tmp_path) as (_, recordings):
        recording = await recordings.start(ALL, name="run")
        (tmp_path / "run.mcap").unlink()
        await recordings.stop("run")
        await expect(lambda: recording.removed == ["run.mcap"])
        assert recording_view(recording)["files"] == []


async def test_folder_that_cannot_be_made_is_a_failure(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    async with running(tmp_path / "file" / "folder") as (_, recordings):
        with pytest.raises(RecordingFailed):
            await recordings.start(ALL, name="run")
        assert recordings.under_way() == []


async def test_recording_whose_disk_fails_ends_alone_and_is_counted(tmp_path: Path) -> None:
    async with running(tmp_path) as (hub, recordings):
        await recordings.start(ALL, name="good")
        bad = await recordings.start(ALL, name="bad")
        program = hub.join("program")
        program.advertise("/door", BOOL)

        def fail(*_: object) -> bool:
            raise OSError(28, "No space left on device")

        bad.thread._writer.write = fail  # type: ignore[method-assign]
        with capture_logs() as logs:
            await asyncio.sleep(0.2)
            program.publish("/door", b"\1")
            await expect(lambda: recordings.failed == 1)
        assert [each.name for each in recordings.under_way()] == ["good"]
        failed = [line for line in logs if line["event"] == "recording.failed"]
        assert [(line["recording"], "No space left" in line["reason"]) for line in failed] == [("bad", True)]


async def test_unknown_robot_is_refused(tmp_path: Path) -> None:
    async with running(tmp_path) as (_, recordings):
        with pytest.raises(UnknownTopic):
            recordings.check_robot("robot_9")


async def test_written_bytes_are_those_of_all_files(tmp_path: Path) -> None:
    thread = FileThread(
        lambda number: tmp_path / f"{number}.mcap",
        max_file_bytes=1,
        max_file_s=1e9,
        loop=asyncio.get_running_loop(),
        metadata={},
    )
    for number in range(3):
        thread.put(EVENTS, number, b"x" * 100)
        await expect(lambda number=number: len(thread.paths) > number + 1)  # type: ignore[misc]
    await thread.aclose()
    sizes = [path.stat().st_size for path in thread.paths]
    assert len(sizes) == 4
    assert 0.5 * sum(sizes) < thread.written_bytes <= sum(sizes)


# -- drive log --------------------------------------------------------------------------------------------------------


DRIVE = Drive(
    robot="robot_0",
    owner="client 1",
    priority=50,
    address="10.0.0.1",
    began_ns=1,
    ended_ns=5,
    seconds=1.0,
    end="stopped",
)


@contextlib.asynccontextmanager
async def drive_log(folder: Path, *, is_kept: bool = True, hub: Hub | None = None) -> AsyncIterator[DriveLog]:
    hub = hub or Hub(Config(), CATALOG, reraises=True)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(hub.run())
        await hub.is_running.wait()
        made = DriveLog(host_of(hub), folder, is_kept=is_kept)
        await made.start()
        yield made
        await made.aclose()
        task.cancel()


async def test_drive_log_lists_the_drives_of_earlier_daemons_newest_first(tmp_path: Path) -> None:
    other = Drive(
        robot="robot_1",
        owner="client 2",
        priority=50,
        address="10.0.0.1",
        began_ns=2,
        ended_ns=9,
        seconds=1.0,
        end="stopped",
    )
    append_drives(tmp_path, [DRIVE, other])
    async with drive_log(tmp_path) as made:
        assert [each.robot for each in made.newest_first()] == ["robot_1", "robot_0"]
        assert [each.robot for each in made.newest_first(robot="robot_0")] == ["robot_0"]
        assert [each.robot for each in made.newest_first(limit=1)] == ["robot_1"]
    async with drive_log(tmp_path, is_kept=False) as made:
        assert made.newest_first() == []


async def test_unwritable_drive_log_is_logged_once_and_counts_lost_drives(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    async with drive_log(tmp_path / "file") as made:
        with capture_logs() as logs:
            await made._keep([DRIVE])
            await made._keep([DRIVE, DRIVE])
        assert made.lost == 3
        assert logged(logs) == ["drives.lost"]
        assert len(made.newest_first()) == 3


async def test_drive_log_that_fails_again_after_it_could_be_written_is_logged_again(tmp_path: Path) -> None:
    folder = tmp_path / "drives"
    folder.write_text("")
    async with drive_log(folder) as made:
        with capture_logs() as logs:
            await made._keep([DRIVE])
            folder.unlink()
            await made._keep([DRIVE])
            shutil.rmtree(folder)
            folder.write_text("")
            await made._keep([DRIVE])
        assert made.lost == 2
        assert logged(logs) == ["drives.lost", "drives.lost"]


async def test_drive_log_that_keeps_no_file_writes_none(tmp_path: Path) -> None:
    async with drive_log(tmp_path, is_kept=False) as made:
        await made._keep([DRIVE])
        assert [each.owner for each in made.newest_first()] == ["client 1"]
    assert read_drives(tmp_path) == []


async def test_kept_drives_are_in_the_file(tmp_path: Path) -> None:
    async with drive_log(tmp_path) as made:
        await made._keep([DRIVE])
        await made._keep([])
    assert read_drives(tmp_path) == [DRIVE]


async def test_drive_is_in_the_file_with_its_end_as_soon_as_it_ends(tmp_path: Path) -> None:
    """A killed daemon writes no more. A drive that continues after a pause has no end again."""
    slow = PlanarVelocity(0.1)
    facts: dict[str, object] = {"owner": "ann", "address": "", "priority": 50, "velocity": slow, "limited": slow}
    hub = Hub(Config(), CATALOG, reraises=True)
    async with drive_log(tmp_path, hub=hub):
        events = hub.events

        def ends() -> list[tuple[str, int]]:
            return [(each.end, each.commands) for each in read_drives(tmp_path)]

        for _ in range(3):
            events.note(EventKind.COMMANDED, "rover", **facts)
        events.note(EventKind.STOPPED, "rover", reason="let go", owner="ann")
        await expect(lambda: ends() == [("let go", 3)])
        events.note(EventKind.COMMANDED, "rover", **facts)
        await expect(lambda: ends() == [(DIED, 4)])
        events.note(EventKind.STOPPED, "rover", reason="let go", owner="ann")
        await expect(lambda: ends() == [("let go", 4)])
