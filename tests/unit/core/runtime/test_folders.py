"""FolderOwner: one daemon writes into a folder."""

import errno
import fcntl
import os
import shutil
from pathlib import Path

import pytest

from hostlink.core.runtime.folders import NAME, FolderOwner, FolderTaken, owner_of


def test_second_owner_is_refused_with_the_name_of_the_first_until_that_one_ends(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    assert owner_of(folder) is None
    first, second = FolderOwner(folder, "daemon 7"), FolderOwner(folder, "daemon 8")
    first.claim()
    first.claim()
    with pytest.raises(FolderTaken, match="recordings belongs to daemon 7; set another") as refused:
        second.claim()
    assert refused.value.errno == errno.EBUSY
    assert owner_of(folder) == "daemon 7"
    first.release()
    assert owner_of(folder) is None
    second.claim()
    assert owner_of(folder) == "daemon 8"


def test_thread_that_claims_after_the_end_of_its_daemon_is_refused(tmp_path: Path) -> None:
    first, second = FolderOwner(tmp_path, "daemon 7"), FolderOwner(tmp_path, "daemon 8")
    first.claim()
    first.release()
    with pytest.raises(OSError, match="this daemon has ended"):
        first.claim()
    second.claim()
    assert owner_of(tmp_path) == "daemon 8"


def test_forked_child_does_not_keep_the_folder(tmp_path: Path) -> None:
    first, second = FolderOwner(tmp_path, "daemon 7"), FolderOwner(tmp_path, "daemon 8")
    first.claim()
    copy = os.dup(first._descriptor)  # as a child has it until it starts its program
    first.release()
    second.claim()
    os.close(copy)
    assert owner_of(tmp_path) == "daemon 8"


def test_question_for_the_owner_refuses_no_daemon_that_claims_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = FolderOwner(tmp_path, "daemon 7")
    with (tmp_path / NAME).open("wb") as asked:
        fcntl.flock(asked, fcntl.LOCK_EX)
        monkeypatch.setattr("hostlink.core.runtime.folders.time.sleep", lambda _: fcntl.flock(asked, fcntl.LOCK_UN))
        owner.claim()
    assert owner_of(tmp_path) == "daemon 7"


def test_removed_folder_belongs_to_the_first_that_claims_it_again(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    first, second = FolderOwner(folder, "daemon 7"), FolderOwner(folder, "daemon 8")
    first.claim()
    shutil.rmtree(folder)
    second.claim()
    with pytest.raises(FolderTaken, match="daemon 8"):
        first.claim()
    second.release()
    first.claim()
    shutil.rmtree(folder)
    first.claim()
    assert owner_of(folder) == "daemon 7"


def test_folder_that_vanishes_again_and_again_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    owner = FolderOwner(tmp_path / "recordings", "daemon 7")

    def remove(_: int, __: int) -> None:
        shutil.rmtree(tmp_path / "recordings")

    monkeypatch.setattr("hostlink.core.runtime.folders.fcntl.flock", remove)
    with pytest.raises(FolderTaken, match="another daemon"):
        owner.claim()


def test_file_system_without_locks_lets_every_daemon_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int, __: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("hostlink.core.runtime.folders.fcntl.flock", refuse)
    FolderOwner(tmp_path, "daemon 7").claim()
    FolderOwner(tmp_path, "daemon 8").claim()
    assert owner_of(tmp_path) is None


def test_disk_that_refuses_is_an_error_of_the_disk(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError):
        FolderOwner(tmp_path / "file" / "folder", "daemon 7").claim()


def test_text_of_an_owner_is_safe_to_print(tmp_path: Path) -> None:
    file = tmp_path / NAME
    file.write_bytes(b"\x1b[2Jdaemon\n" + b"\xff" + b"x" * 1000)
    with file.open("rb") as locked:
        fcntl.flock(locked, fcntl.LOCK_EX)
        text = owner_of(tmp_path)
    assert text is not None
    assert text.isprintable()
    assert len(text) <= 200
    file.write_bytes(b"")
    with file.open("rb") as locked:
        fcntl.flock(locked, fcntl.LOCK_EX)
        assert owner_of(tmp_path) == "another daemon"
