"""Release check: problems of a wheel and of a source distribution."""

import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from tools import release


def wheel(folder: Path, *names: str) -> Path:
    file = folder / "hostlink-1-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        for name in names:
            archive.writestr(name, "x")
    return file


def sources(folder: Path, *names: str) -> Path:
    file = folder / "hostlink-1.tar.gz"
    with tarfile.open(file, "w:gz") as archive:
        for name in names:
            info = tarfile.TarInfo(f"hostlink-1/{name}")
            info.size = 1
            archive.addfile(info, io.BytesIO(b"x"))
    return file


def test_complete_archive_has_no_problem(tmp_path: Path) -> None:
    assert release.problems_of_wheel(wheel(tmp_path, *release.NEEDED)) == []
    whole = sources(tmp_path, *release.OF_SOURCES, *release.NEEDED, "tests/conftest.py")
    assert release.problems_of_sources(whole) == []


@pytest.mark.parametrize("missing", release.NEEDED)
def test_missing_file_is_named(tmp_path: Path, missing: str) -> None:
    names = [name for name in release.NEEDED if name != missing]
    assert release.problems_of_wheel(wheel(tmp_path, *names)) == [f"{missing} is not in the wheel"]


@pytest.mark.parametrize(
    "name",
    ["tests/conftest.py", "hostlink/api/web/src/main.ts", "hostlink/__pycache__/a.pyc", "hostlink/node_modules/x"],
)
def test_unwanted_file_is_named(tmp_path: Path, name: str) -> None:
    assert release.problems_of_wheel(wheel(tmp_path, *release.NEEDED, name)) == [f"{name} is in the wheel"]


def test_a_wheel_that_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(release, "MAX_WHEEL_BYTES", 100)
    (problem,) = release.problems_of_wheel(wheel(tmp_path, *release.NEEDED))
    assert problem.endswith("bytes, more than 100")


def test_a_python_that_is_not_there_is_none() -> None:
    assert release.interpreter("3.99") is None
