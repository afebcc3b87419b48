"""Salvage of the memory of an ended process."""

import fcntl
import os
from pathlib import Path

import msgspec
import pytest

from hostlink.components.recorder.channel import EVENTS, Channel, as_text
from hostlink.components.recorder.drives import DIED, Drive, append_drives, read_drives
from hostlink.components.recorder.incident import Incident, OutOfTime
from hostlink.components.recorder.reader import McapReader
from hostlink.components.recorder.ring import BLOCK_BYTES, RING, RingMemory, Rings
from hostlink.components.recorder.salvage import ABOUT, CLOSED, About, Pending, clear_old, main, pending_name, salvage
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.core.runtime import remains

POSES = Channel("/robot_0/odometry", "ros1", "geometry_msgs/Pose2D", "float64 x", (("robot", "robot_0"),))
S = 1_000_000_000
FORWARD = PlanarVelocity(0.2)


class Process:
    """Process with a black box in memory that survives, until `gone`."""

    def __init__(self, folder: Path) -> None:
        self.memory = RingMemory(8 * BLOCK_BYTES, purpose="test")
        assert self.memory.folder is not None
        self.folder = self.memory.folder
        self.rings = Rings(self.memory, keep_s=100)
        self.memory.put_fact(ABOUT, About(str(folder / "incidents"), 100, 0, 50))

    def event(self, at_s: int, kind: str, **facts: object) -> None:
        event = {"kind": kind, "robot": "robot_0", "facts": facts}
        self.rings.add("robot_0", EVENTS, at_s * S, as_text(msgspec.json.encode(event)), at_s)

    def command(self, at_s: int, velocity: PlanarVelocity = FORWARD, owner: str = "ann") -> None:
        self.event(at_s, "commanded", owner=owner, limited=velocity._asdict())

    def pose(self, at_s: int) -> None:
        self.rings.add("robot_0", POSES, at_s * S, b"pose", at_s)

    def begin(self, number: int) -> Incident:
        incident = Incident("robot_0", "requested", f"number {number}", 10 * S, 10.0)
        self.memory.put_fact(pending_name(number), Pending(incident, [POSES]))
        return incident

    def gone(self) -> Path:
        self.memory.release()
        return self.folder


@pytest.fixture
def process(tmp_path: Path) -> Process:
    return Process(tmp_path)


def details(folder: Path) -> list[str]:
    found = []
    for file in sorted((folder / "incidents").glob("*.mcap")):
        reader = McapReader(file)
        list(reader.messages())
        found.append(f"{reader.metadata['cause']} {reader.metadata['detail']}")
    return sorted(found)


def test_process_that_died_while_driving_is_an_incident_with_its_last_messages(
    process: Process, tmp_path: Path
) -> None:
    process.pose(1)
    process.command(2)
    process.pose(3)
    found = salvage(process.gone())
    ((incident, file),) = found.saved
    assert (incident.robot, incident.cause, incident.stamp_ns) == ("robot_0", "daemon_died", 3 * S)
    assert "ann drove it" in incident.detail
    messages = list(McapReader(file).messages())
    assert [message.stamp_ns // S for message in messages] == [1, 2, 3]
    assert messages[0].channel == POSES
    assert not process.folder.exists()


@pytest.mark.parametrize(("kind", "facts"), [("stopped", {"reason": "x"}), ("locked", {}), ("gone", {})])
def test_process_that_died_after_the_stop_causes_no_incident(
    process: Process, kind: str, facts: dict[str, object]
) -> None:
    process.command(1)
    process.event(2, kind, **facts)
    assert salvage(process.gone()) is not None
    assert not process.folder.exists()


def test_process_that_died_after_a_zero_causes_no_incident(process: Process, tmp_path: Path) -> None:
    process.command(1)
    process.command(2, ZERO)
    salvage(process.gone())
    assert details(tmp_path) == []


def test_process_that_ended_in_order_leaves_what_was_pending(process: Process, tmp_path: Path) -> None:
    process.command(1)
    for number in range(3):
        process.begin(number)
    process.memory.drop_fact(pending_name(1))  # already saved
    process.memory.put_fact(CLOSED, "in order")
    salvage(process.gone())
    assert details(tmp_path) == ["requested number 0", "requested number 2"]


def test_process_that_lives_is_left_alone(process: Process, tmp_path: Path) -> None:
    process.begin(0)
    assert salvage(process.folder) is None
    assert details(tmp_path) == []
    process.memory.remove()


def test_salvage_that_is_interrupted_is_continued_by_the_next(process: Process, tmp_path: Path) -> None:
    process.command(1)
    for number in range(200):
        process.pose(2 + number // 10)
    process.begin(0)

    def interrupt() -> None:
        raise OutOfTime

    with pytest.raises(OutOfTime):
        salvage(process.gone(), rest=interrupt)
    assert list((tmp_path / "incidents").iterdir()) == []
    found = salvage(process.folder)
    assert len(found.saved) == 2
    assert [detail.split()[0] for detail in details(tmp_path)] == ["daemon_died", "requested"]


def test_salvage_with_a_disk_that_refuses_is_tried_again(process: Process, tmp_path: Path) -> None:
    process.begin(0)
    (tmp_path / "incidents").write_text("no folder")
    with pytest.raises(OSError, match="exists"):
        salvage(process.gone())
    (tmp_path / "incidents").unlink()
    main(os.getpid())  # the guardian calls it this way
    assert details(tmp_path) == ["requested number 0"]
    assert remains.of_process(os.getpid()) == []


@pytest.mark.parametrize("name", [f"{ABOUT}.json", f"{pending_name(0)}.json", "schemas", RING])
@pytest.mark.parametrize("damage", [b"", b"\xff\x00{", b'{"incident": 3}'])
def test_salvage_of_damaged_files_leaves_nothing_behind(process: Process, name: str, damage: bytes) -> None:
    process.command(1)
    process.begin(0)
    folder = process.gone()
    (folder / name).write_bytes(damage)
    assert salvage(folder) is not None
    assert not folder.exists()


def test_drive_that_the_daemon_did_not_end_ends_with_its_last_command(process: Process, tmp_path: Path) -> None:
    for owner in ("ann", "bob"):
        append_drives(tmp_path, [Drive(robot="robot_0", owner=owner, priority=50, began_ns=S, ended_ns=S)])
    process.command(2, owner="bob")
    process.command(5, owner="bob")
    salvage(process.gone())
    drives = {drive.owner: drive for drive in read_drives(tmp_path)}
    assert [drives[owner].end for owner in ("ann", "bob")] == [DIED] * 2
    assert [drives[owner].ended_ns // S for owner in ("ann", "bob")] == [1, 5]


def test_only_memory_with_pending_incidents_starts_a_process(process: Process, tmp_path: Path) -> None:
    other = Process(tmp_path)
    process.begin(0)
    other.pose(1)
    remains.remove_empty(os.getpid())
    left = remains.of_process(os.getpid())  # with what other tests of this process have left
    assert str(process.folder) in left
    assert str(other.folder) not in left
    process.memory.remove()


def test_memory_unsaved_for_a_week_is_removed(process: Process) -> None:
    os.utime(process.folder, (0, 0))
    clear_old()
    assert process.folder.exists()  # the process is alive
    folder = process.gone()
    os.utime(folder, (0, 0))
    clear_old()
    assert not folder.exists()


def test_folder_of_another_user_or_name_is_ignored(process: Process, monkeypatch: pytest.MonkeyPatch) -> None:
    assert str(process.folder) in remains.of_purpose("test")
    assert str(process.folder) not in remains.of_purpose("tes")
    assert str(process.folder) in remains.of_process(os.getpid())
    assert remains.of_process(1) == []
    monkeypatch.setattr(remains, "PLACE", "/nowhere")
    assert remains.of_user() == []
    assert RingMemory(BLOCK_BYTES, purpose="test").folder is None
    process.memory.remove()


def test_memory_on_a_full_tmpfs_reuses_its_blocks(process: Process, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full tmpfs: existing blocks are reused, and no page is written that cannot be allocated."""

    def refuse(*_: int) -> None:
        raise OSError

    monkeypatch.setattr(os, "posix_fallocate", refuse)
    blocks = process.memory.blocks
    for number in range(10_000):
        process.rings.add("robot_0", POSES, number, bytes(100), number / 1e4)
    assert process.memory.blocks == process.memory.max_blocks == blocks
    assert process.rings.size_bytes <= blocks * BLOCK_BYTES
    process.memory.remove()


def test_lock_of_the_memory_ends_with_its_process(process: Process) -> None:
    with (process.folder / RING).open("rb") as file:
        with pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        process.memory.release()
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    process.memory.remove()
