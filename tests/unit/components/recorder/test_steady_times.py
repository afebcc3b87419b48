"""Steady times: order, pauses and ages are correct although the wall clock is set during the recording."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from hostlink.components.gateway.history import stored_history
from hostlink.components.recorder import mcap_writer
from hostlink.components.recorder.black_box import write_incident
from hostlink.components.recorder.channel import DEVICE, EVENTS, Channel, as_text, ros_channel
from hostlink.components.recorder.folder import Folder
from hostlink.components.recorder.incident import Incident
from hostlink.components.recorder.mcap_writer import FileThread, McapWriter
from hostlink.components.recorder.playing import schedule
from hostlink.components.recorder.reader import McapReader, contents_of
from hostlink.components.recorder.ring import Entry
from hostlink.components.recorder.salvage import repair
from hostlink.components.recorder.tables import read
from hostlink.core.messages.catalog import Catalog
from hostlink.core.runtime.units import NS_PER_S

DAY_S = 86_400
COUNT = 480  # ten messages a second
CHUNK_OF = 7
BEGIN_NS = 1_700_000_000 * NS_PER_S
POSE = Catalog().message("geometry_msgs/Pose2D")
ODOMETRY = ros_channel("/robot_0/odometry", POSE.name, POSE, is_latched=False, robot="robot_0", origin=DEVICE)
SECONDS = [number / 10 for number in range(COUNT)]
JUMPS = [
    pytest.param(100 * DAY_S, id="forward"),
    pytest.param(-100 * DAY_S, id="back"),
    pytest.param(5.0, id="a little"),
]


def wall_ns(second: float, jump_s: float) -> int:
    """Return the wall time of a clock that is set after 12 s."""
    return BEGIN_NS + round((second + jump_s * (second >= 12)) * NS_PER_S)


def pose(second: float) -> bytes:
    return POSE.encode({"x": second / 100})


def recording(path: Path, jump_s: float, *, has_steady_times: bool = True, is_finished: bool = True) -> Path:
    """Write a recording with steady times, or with wall times only, as the repair of another program's file does."""
    writer = McapWriter(path, metadata={}, has_steady_times=has_steady_times)
    for number, second in enumerate(SECONDS, 1):
        stamp_ns = wall_ns(second, jump_s)
        writer.write(ODOMETRY, stamp_ns, pose(second), BEGIN_NS + round(second * NS_PER_S))
        if number % 10 == 0:
            writer.write(EVENTS, stamp_ns, as_text(b"{}"), BEGIN_NS + round(second * NS_PER_S))
        if number % CHUNK_OF == 0:
            writer.end_chunk()
    if is_finished:
        writer.close()
    else:
        writer.abandon()
    return path


def times(path: Path, **options: float) -> list[float]:
    reader = McapReader(path)
    due = schedule(reader.messages(lambda channel: channel == ODOMETRY), **options)
    return [round(each.at_s, 6) for each in due]


@pytest.mark.parametrize("is_finished", [True, False])
@pytest.mark.parametrize("jump_s", JUMPS)
def test_recording_with_steady_times_is_read_as_if_the_clock_had_not_been_set(
    tmp_path: Path, jump_s: float, is_finished: bool
) -> None:
    path = recording(tmp_path / "a.mcap", jump_s, is_finished=is_finished)
    count = COUNT if is_finished else COUNT // CHUNK_OF * CHUNK_OF
    assert times(path) == SECONDS[:count]
    assert times(path, start_s=30.0) == [round(second - 30, 6) for second in SECONDS[:count] if second >= 30]
    found = contents_of(path)
    assert found.seconds == pytest.approx(SECONDS[count - 1])
    assert [(step.at_s, step.step_s) for step in found.clock_steps] == [(12.0, jump_s)]
    table = read(path)["/robot_0/odometry"]
    assert table.time_s.tolist() == pytest.approx(SECONDS[:count])
    assert table.stamp_ns.tolist() == [wall_ns(second, jump_s) for second in SECONDS[:count]]


def test_repair_keeps_steady_times_and_invents_none(tmp_path: Path) -> None:
    for has_steady_times in (False, True):
        path = tmp_path / f"{has_steady_times}.mcap"
        recording(path, 100 * DAY_S, has_steady_times=has_steady_times, is_finished=False)
        before = list(McapReader(path).messages())
        repair(path)
        assert list(McapReader(path).messages()) == before
        reader = McapReader(path)
        reader.read_beginning()
        assert reader.has_steady_times is has_steady_times


def test_start_of_a_play_reads_few_chunks(tmp_path: Path) -> None:
    """Found by bisection, although the chunks' wall times step back halfway."""
    path = recording(tmp_path / "a.mcap", -100 * DAY_S)
    assert len(list(McapReader(path).messages(after_s=45.0))) < COUNT // 8
    assert times(path, start_s=45.0)[0] == 0.0


def test_play_cuts_a_long_pause_and_says_how_much() -> None:
    class Message:
        def __init__(self, second: float) -> None:
            self.steady_ns = int(second * NS_PER_S)

    messages: list[Message] = [Message(each) for each in (0, 1, 1001, 1002)]
    due = list(schedule(messages, max_pause_s=60.0))  # type: ignore[arg-type] - only times matter
    assert [(each.at_s, each.cut_s) for each in due] == [(0, 0), (1, 0), (61, 940), (62, 0)]


async def test_recording_that_is_written_has_steady_times_in_all_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program sets the wall clock meanwhile."""
    jump_ns = [0]
    of_system: Callable[[], int] = mcap_writer.time.time_ns
    monkeypatch.setattr(mcap_writer.time, "time_ns", lambda: of_system() + jump_ns[0])
    thread = FileThread(
        lambda number: tmp_path / f"{number}.mcap",
        max_file_bytes=10**9,
        max_file_s=10**9,
        loop=asyncio.get_running_loop(),
        metadata={},
    )
    for number in range(20):
        if number == 10:
            jump_ns[0] = 100 * DAY_S * NS_PER_S
        thread.put(EVENTS, mcap_writer.time.time_ns(), as_text(b"{}"))
    await thread.aclose()
    found = list(McapReader(tmp_path / "0.mcap").messages())
    steady = [message.steady_ns for message in found]
    assert steady == sorted(steady)
    assert steady[-1] - steady[0] < 60 * NS_PER_S
    assert found[-1].stamp_ns - found[0].stamp_ns >= 100 * DAY_S * NS_PER_S


@pytest.mark.parametrize("jump_s", [100 * DAY_S, -100 * DAY_S])
def test_ages_around_an_incident_are_seconds_though_the_clock_was_set(tmp_path: Path, jump_s: float) -> None:
    incident = Incident("robot_0", "gone", "", wall_ns(40.0, jump_s), 1040.0)
    entries = [Entry(ODOMETRY, wall_ns(second, jump_s), pose(second), 1000 + second) for second in SECONDS]
    folder = Folder(tmp_path, max_disk_mb=100, min_free_disk_mb=0)
    path = write_incident(folder, incident, [ODOMETRY], [entries], before_s=120.0, rest=lambda: None)
    encoded = stored_history(Catalog(), path)
    assert encoded is not None
    view = json.loads(encoded)
    ages = [each["age_s"] for each in view["history"]["poses"]]
    assert (view["robot"], view["damage"], len(ages)) == ("robot_0", [], COUNT)
    assert ages == pytest.approx([40 - second for second in SECONDS])


def channel_of(topic: str) -> Channel:
    return ros_channel(topic, "std_msgs/String", None, is_latched=False)


def test_begin_of_a_recording_is_its_first_message_of_any_topic(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "a.mcap", metadata={})
    for number in range(100):
        writer.write(channel_of("/a" if number < 60 else "/b"), number * NS_PER_S, b"", number * NS_PER_S + 7)
        writer.end_chunk()
    writer.close()
    reader = McapReader(tmp_path / "a.mcap")
    (first, *_) = reader.messages(lambda channel: channel.topic == "/b")
    assert (first.steady_ns - reader.begin_ns) == 60 * NS_PER_S
