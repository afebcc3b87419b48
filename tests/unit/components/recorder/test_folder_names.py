"""Folder of recordings: where it is by default, the names of its files, what it lists, and its disk."""

import os
from pathlib import Path

import pytest

from hostlink.components.recorder.folder import Folder, StoredFile, check_name, default_folder, is_name
from hostlink.errors import BadRequest


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path, max_disk_mb=1, min_free_disk_mb=0)


def stored(folder: Folder, name: str, size: int, at_s: float) -> Path:
    path = folder.path / name
    path.write_bytes(bytes(size))
    os.utime(path, (at_s, at_s))
    return path


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"STATE_DIRECTORY": "/var/lib/hostlink:/other", "XDG_STATE_HOME": "/x"}, "/var/lib/hostlink/recordings"),
        ({"STATE_DIRECTORY": "", "XDG_STATE_HOME": "/x"}, "/x/hostlink/recordings"),
        ({"XDG_STATE_HOME": "", "HOME": "/home/ann"}, "/home/ann/.local/state/hostlink/recordings"),
    ],
)
def test_default_folder_is_that_of_the_service_or_the_user(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], expected: str
) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert default_folder() == Path(expected)


@pytest.mark.parametrize("name", ["a", "run.mcap", "2026-01-02T03-04-05_robot", "a+b", "a.b.c", "x" * 100])
def test_name_within_the_folder_is_accepted_without_its_suffix(name: str) -> None:
    assert is_name(name)
    assert check_name(name) == name.removesuffix(".mcap")


@pytest.mark.parametrize("name", ["", ".a", "-a", "a/b", "..", "a..b", "a b", "ä", "a\n", "x" * 101])
def test_name_that_could_leave_the_folder_is_refused(folder: Folder, name: str) -> None:
    assert not is_name(name)
    assert folder.find(name) is None
    with pytest.raises(BadRequest, match="invalid recording name"):
        check_name(name)


def test_files_of_a_recording_are_numbered_from_the_second_on(folder: Folder) -> None:
    assert [folder.file("run", number).name for number in range(3)] == ["run.mcap", "run_2.mcap", "run_3.mcap"]


def test_recordings_are_listed_oldest_first_and_nothing_else(folder: Folder) -> None:
    stored(folder, "b.mcap", 10, 200.0)
    stored(folder, "a.mcap", 20, 200.0)
    is_open = stored(folder, "c.mcap", 30, 100.0)
    stored(folder, "notes.txt", 5, 50.0)
    (folder.path / "folder.mcap").mkdir()
    assert folder.files({is_open}) == [
        StoredFile("c.mcap", 30, 100.0, is_open=True),
        StoredFile("a.mcap", 20, 200.0),
        StoredFile("b.mcap", 10, 200.0),
    ]
    assert folder.find("a") == folder.find("a.mcap") == folder.path / "a.mcap"
    assert folder.find("notes.txt") is None
    assert folder.find("folder") is None


def test_folder_that_does_not_exist_has_no_files_and_the_disk_of_its_parent(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "a" / "b", max_disk_mb=2, min_free_disk_mb=3)
    usage = folder.usage()
    assert (folder.files(), usage.used_bytes) == ([], 0)
    assert (usage.budget_bytes, usage.min_free_bytes) == (2_000_000, 3_000_000)
    assert usage.free_bytes > 0
    assert folder.make_room(()) == []
    assert folder.path.is_dir()


def test_oldest_recordings_over_the_budget_are_removed(folder: Folder) -> None:
    for number in range(4):
        stored(folder, f"{number}.mcap", 400_000, 100.0 + number)
    assert folder.usage().used_bytes == 1_600_000
    assert folder.make_room({folder.path / "0.mcap"}) == ["1.mcap", "2.mcap"]
    assert [file.name for file in folder.files()] == ["0.mcap", "3.mcap"]


def test_full_disk_is_an_error_that_names_the_setting(tmp_path: Path) -> None:
    folder = Folder(tmp_path, max_disk_mb=1, min_free_disk_mb=1e12)
    with pytest.raises(OSError, match=r"MB of disk space are free, less than min_free_disk_mb = 1e\+12"):
        folder.make_room(())
