"""Files of incidents in a folder: newest first, each read once, and other files left out."""

from pathlib import Path

import pytest

from hostlink.components.recorder import incident as module
from hostlink.components.recorder.folder import Folder
from hostlink.components.recorder.incident import Incident, IncidentFiles, read_incident, write_incident
from hostlink.components.recorder.mcap_writer import McapWriter

SECOND_NS = 1_000_000_000


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path, max_disk_mb=100, min_free_disk_mb=0)


def write(folder: Folder, at_s: int, robot: str = "robot_0") -> Path:
    incident = Incident(robot, "requested", f"at {at_s}", at_s * SECOND_NS, float(at_s))
    return write_incident(folder, incident, [], [[]], before_s=10.0, rest=lambda: None)


def test_incidents_are_listed_newest_first_by_their_time_and_not_by_their_file(folder: Folder) -> None:
    paths = {at_s: write(folder, at_s) for at_s in (200, 300, 100)}
    found = IncidentFiles(folder).newest_first()
    assert [each.incident.detail for each in found] == ["at 300", "at 200", "at 100"]
    assert [each.file.name for each in found] == [paths[at_s].name for at_s in (300, 200, 100)]
    assert all(each.file.size_bytes == (folder.path / each.file.name).stat().st_size for each in found)


def test_files_other_than_incidents_are_left_out(folder: Folder) -> None:
    path = write(folder, 100)
    McapWriter(folder.path / "plain.mcap", metadata={"recording": "plain"}).close()
    (folder.path / "damaged.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (folder.path / "empty.mcap").touch()
    McapWriter(folder.path / "odd.mcap", metadata={"cause": "requested", "stamp_ns": "soon"}).close()
    McapWriter(folder.path / "half.mcap", metadata={"cause": "requested"}).close()
    assert [each.file.name for each in IncidentFiles(folder).newest_first()] == [path.name]
    for name in ("plain", "damaged", "empty", "odd", "half", "none"):
        assert read_incident(folder.path / f"{name}.mcap") is None


def test_known_file_is_not_read_again_and_a_removed_one_is_forgotten(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[str] = []

    def read(path: Path) -> Incident | None:
        reads.append(path.name)
        return read_incident(path)

    monkeypatch.setattr(module, "read_incident", read)
    first, files = write(folder, 100), IncidentFiles(folder)
    files.newest_first()
    second = write(folder, 200)
    assert len(files.newest_first()) == 2
    assert reads == [first.name, second.name]
    first.unlink()
    assert [each.incident.detail for each in files.newest_first()] == ["at 200"]
    assert len(reads) == 2


def test_newest_files_alone_are_listed(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_LISTED", 2)
    for at_s in (100, 200, 300):
        write(folder, at_s)
    assert len(IncidentFiles(folder).newest_first()) == 2
