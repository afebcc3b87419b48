"""tests/support/once.py: a program is compiled again only where its result is missing or a source has changed."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import once as module
from tests.support.once import digest, once


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("ROOT", "BUILD"):
        monkeypatch.setattr(module, name, tmp_path)
    (tmp_path / "firmware").mkdir()
    (tmp_path / "firmware" / "due.cpp").write_text("int main() {}")
    digest.cache_clear()
    return tmp_path


def test_result_that_exists_is_made_again_only_after_a_source_changed(folder: Path) -> None:
    result, made = folder / "program", []

    def make() -> None:
        made.append(len(made))
        result.touch()

    for _ in range(2):
        once("program", make, result)
    assert made == [0]
    result.unlink()
    once("program", make, result)
    assert made == [0, 1]
    (folder / "firmware" / "due.cpp").write_text("int main() { return 0; }")
    digest.cache_clear()  # another run
    once("program", make, result)
    assert made == [0, 1, 2]


def test_result_of_a_compilation_that_failed_is_made_again(folder: Path) -> None:
    result = folder / "program"
    result.touch()
    with pytest.raises(ZeroDivisionError):
        once("program", lambda: 1 / 0, result)
    once("program", lambda: result.write_text("made"), result)
    assert result.read_text() == "made"


@pytest.fixture(autouse=True)
def _restored() -> Iterator[None]:
    yield
    digest.cache_clear()
