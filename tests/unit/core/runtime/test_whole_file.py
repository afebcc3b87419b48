"""Whole files: an error or a power failure leaves the older content."""

from pathlib import Path

import pytest

from hostlink.core.runtime import whole_file
from hostlink.core.runtime.whole_file import put_in_place, replace_file


@pytest.fixture
def order(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record of calls: "sync NAME" and "rename NAME"."""
    found: list[str] = []
    sync, replace = whole_file._sync, Path.replace

    def note_sync(path: Path) -> None:
        found.append(f"sync {path.name}")
        sync(path)

    def note_replace(self: Path, target: Path) -> Path:
        found.append(f"rename {target.name}")
        return replace(self, target)

    monkeypatch.setattr(whole_file, "_sync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    return found


def test_content_is_on_the_disk_before_the_name_and_the_name_before_the_return(
    tmp_path: Path, order: list[str]
) -> None:
    file = tmp_path / "names.json"
    replace_file(file, b"one")
    replace_file(file, b"two")
    assert order == ["sync names.json.part", "rename names.json", f"sync {tmp_path.name}"] * 2
    assert file.read_bytes() == b"two"
    assert [each.name for each in tmp_path.iterdir()] == ["names.json"]


@pytest.mark.parametrize("fails", ["write_bytes", "replace"])
def test_error_leaves_the_older_content_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    file = tmp_path / "names.json"
    replace_file(file, b"one")

    def fail(self: Path, data: object) -> None:
        if fails == "write_bytes":
            self.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, fails, fail)
    with pytest.raises(OSError, match="No space"):
        replace_file(file, b"two")
    assert file.read_bytes() == b"one"
    assert [each.name for each in tmp_path.iterdir()] == ["names.json"]


def test_file_of_another_name_is_put_in_place(tmp_path: Path, order: list[str]) -> None:
    (tmp_path / "a.new").write_bytes(b"one")
    put_in_place(tmp_path / "a.new", tmp_path / "a")
    assert order == ["sync a.new", "rename a", f"sync {tmp_path.name}"]
    assert (tmp_path / "a").read_bytes() == b"one"
