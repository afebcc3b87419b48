"""Release check: problems of a wheel and of a source distribution."""

import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from tools import compiled, release
from tools.build_deb import ROOT


def wheel(folder: Path, *names: str, tags: str = "py3-none-any") -> Path:
    file = folder / f"hostlink-1-{tags}.whl"
    with zipfile.ZipFile(file, "w") as archive:
        for name in names:
            archive.writestr(name, "x")
        archive.writestr("hostlink-1.dist-info/METADATA", "Metadata-Version: 2.1\nName: hostlink\nVersion: 1\n")
        archive.writestr("hostlink-1.dist-info/WHEEL", "Wheel-Version: 1.0\n")
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
    [
        "tests/conftest.py",
        "hostlink/components/gateway/web/src/main.ts",
        "hostlink/__pycache__/a.pyc",
        "hostlink/node_modules/x",
    ],
)
def test_unwanted_file_is_named(tmp_path: Path, name: str) -> None:
    assert release.problems_of_wheel(wheel(tmp_path, *release.NEEDED, name)) == [f"{name} is in the wheel"]


def test_a_wheel_that_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(release, "MAX_WHEEL_BYTES", 100)
    (problem,) = release.problems_of_wheel(wheel(tmp_path, *release.NEEDED))
    assert problem.endswith("bytes, more than 100")


def test_a_python_that_is_not_there_is_none() -> None:
    assert release.interpreter("3.99") is None


def test_compiled_wheel_without_one_of_its_modules(tmp_path: Path) -> None:
    modules = sorted(str(path.relative_to(ROOT).with_suffix("")) for path in compiled.modules())
    libraries = [f"{name}.cpython-311-x86_64-linux-gnu.so" for name in modules]
    assert release.problems_of_compiled(wheel(tmp_path, *release.NEEDED, *libraries)) == []
    (problem,) = release.problems_of_compiled(wheel(tmp_path, *release.NEEDED, *libraries[1:]))
    assert problem.startswith(f"{modules[0]} is not compiled in ")


@pytest.mark.long
def test_pip_chooses_the_compiled_wheel_where_it_fits_and_else_the_pure_one(tmp_path: Path) -> None:
    pure = wheel(tmp_path)
    compiled_wheel = wheel(tmp_path, tags="cp311-cp311-manylinux2014_x86_64.manylinux_2_17_x86_64")
    assert release.choice(tmp_path, "3.11", "manylinux2014_x86_64") == compiled_wheel.name
    assert {release.choice(tmp_path, *other) for other in release.PURE_ONLY} == {pure.name}
