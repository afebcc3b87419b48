"""File of drives: cut lines, a new file above the bound, ends that a killed daemon could not write."""

from pathlib import Path

import pytest

from hostlink.components.recorder import drives as module
from hostlink.components.recorder.drives import (
    DIED,
    MAX_FILE_BYTES,
    MAX_RECENT,
    NAME,
    NAME_BEFORE,
    Drive,
    LastCommand,
    append_drives,
    corrected,
    finish_drives,
    read_drives,
)

S = 1_000_000_000


def drive(began_s: int, *, robot: str = "rover", owner: str = "ann", end: str = "released") -> Drive:
    made = Drive(robot=robot, owner=owner, priority=50, began_ns=began_s * S, ended_ns=began_s * S)
    made.end = end
    return made


def begins(folder: Path) -> list[int]:
    return [each.began_ns // S for each in read_drives(folder)]


def test_folder_without_a_file_has_no_drives(tmp_path: Path) -> None:
    assert read_drives(tmp_path / "none") == []


def test_drives_are_read_in_the_order_of_their_last_lines(tmp_path: Path) -> None:
    append_drives(tmp_path / "new", [drive(1, end=""), drive(2)])
    append_drives(tmp_path / "new", [drive(1)])
    found = read_drives(tmp_path / "new")
    assert [(each.began_ns // S, each.end) for each in found] == [(2, "released"), (1, "released")]


def test_drive_without_an_end_has_ended_with_its_daemon(tmp_path: Path) -> None:
    append_drives(tmp_path, [drive(1, end="")])
    assert read_drives(tmp_path)[0].end == DIED


def test_line_after_a_cut_one_is_read(tmp_path: Path) -> None:
    append_drives(tmp_path, [drive(1)])
    with (tmp_path / NAME).open("ab") as file:
        file.write(b'{"robot": "ro')
    append_drives(tmp_path, [drive(2)])
    append_drives(tmp_path, [drive(3)])
    assert begins(tmp_path) == [1, 2, 3]
    assert (tmp_path / NAME).read_bytes().count(b"\n") == 4
    with (tmp_path / NAME).open("ab") as file:
        file.write(b"\xff\xfe\n[]\n")
    assert begins(tmp_path) == [1, 2, 3]


def test_file_over_its_bound_is_followed_by_a_new_one_and_kept(tmp_path: Path) -> None:
    owner = "a" * 400_000
    append_drives(tmp_path, [drive(1, owner=owner), drive(1, owner=f"{owner}b")])
    with (tmp_path / NAME).open("ab") as file:
        file.write(b"\n" * (MAX_FILE_BYTES - file.tell()))
    append_drives(tmp_path, [drive(2)])
    assert not (tmp_path / NAME_BEFORE).exists()
    append_drives(tmp_path, [drive(3)])
    assert (tmp_path / NAME_BEFORE).exists()
    assert (tmp_path / NAME).read_bytes().count(b"\n") == 1
    assert begins(tmp_path) == [1, 1, 2, 3]


def test_file_over_its_bound_that_has_many_lines_of_each_drive_is_shortened(tmp_path: Path) -> None:
    long = "e" * 1000
    append_drives(tmp_path, [drive(2, end=long), *[drive(1, end=long)] * 1100])
    append_drives(tmp_path, [drive(3)])
    assert not (tmp_path / NAME_BEFORE).exists()
    assert (tmp_path / NAME).read_bytes().count(b"\n") == 3
    assert begins(tmp_path) == [2, 1, 3]


def test_newest_drives_alone_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_RECENT == 1000
    monkeypatch.setattr(module, "MAX_RECENT", 3)
    append_drives(tmp_path, [drive(number) for number in range(5)])
    assert begins(tmp_path) == [2, 3, 4]


def test_killed_daemons_drive_ends_with_the_last_command_of_its_driver(tmp_path: Path) -> None:
    append_drives(tmp_path, [drive(1, end=""), drive(1, owner="bob", end=""), drive(2)])
    commands = [
        LastCommand("rover", "ann", 4 * S),
        LastCommand("rover", "ann", 3 * S),
        LastCommand("dog", "bob", 9 * S),
    ]
    size = (tmp_path / NAME).stat().st_size
    finish_drives(tmp_path, commands)
    found = {(each.owner, each.began_ns // S): each for each in read_drives(tmp_path)}
    assert (found["ann", 1].ended_ns, found["ann", 1].seconds, found["ann", 1].end) == (4 * S, None, DIED)
    assert (found["bob", 1].ended_ns, found["ann", 2].ended_ns) == (1 * S, 2 * S)
    assert (tmp_path / NAME).stat().st_size > size
    size = (tmp_path / NAME).stat().st_size
    finish_drives(tmp_path, commands)
    assert (tmp_path / NAME).stat().st_size == size


@pytest.mark.parametrize(
    ("end", "ended_s", "last_s", "is_corrected"),
    [(DIED, 1, 2, True), (DIED, 1, 1, False), (DIED, 2, 3, False), ("released", 1, 2, False)],
)
def test_drive_with_a_known_end_is_not_corrected(end: str, ended_s: int, last_s: int, is_corrected: bool) -> None:
    made = drive(1, end=end)
    made.ended_ns = ended_s * S
    assert corrected(made, [LastCommand("rover", "ann", last_s * S)]) is is_corrected
    assert made.ended_ns == (last_s if is_corrected else ended_s) * S
