"""`hostlink arduino-library` as a person runs it, and out of the wheel that users install."""

import io
import json
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.support.process import run

ROOT = Path(__file__).parents[2]


def names_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def message(folder: Path, text: str) -> Path:
    package = folder / "mine" / "my_msgs"
    package.mkdir(parents=True)
    (package / "Gripper.msg").write_text(text)
    return folder / "mine"


async def test_arduino_library_writes_the_same_zip_again_with_my_messages_and_what_they_contain(tmp_path: Path) -> None:
    folder = message(tmp_path, "Header header\nfloat32[] forces\n")
    arguments = ("arduino-library", "--messages", str(folder), "--only", "my_msgs,std_srvs/Trigger", "--json")
    packed = []
    for name in ("first.zip", "second.zip"):
        status, out, err = await run(*arguments, "-o", str(tmp_path / name))
        assert (status, err) == (0, "")
        packed.append((tmp_path / name).read_bytes())
    assert packed[0] == packed[1]
    facts = json.loads(out)
    assert {"my_msgs/Gripper", "std_msgs/Header"} <= set(facts["messages"])
    assert "std_srvs/Trigger" in facts["services"]
    assert "nav_msgs/Path" not in facts["messages"]
    assert facts["bytes"] == len(packed[0])
    with zipfile.ZipFile(io.BytesIO(packed[0])) as archive:
        assert b"float* forces = nullptr;" in archive.read("hostlink_rosserial/src/my_msgs/Gripper.h")


async def test_a_file_that_is_there_stays_without_force(tmp_path: Path) -> None:
    output = tmp_path / "x.zip"
    output.write_text("mine")
    status, _, err = await run("arduino-library", "-o", str(output), "--only", "std_msgs")
    assert (status, output.read_text()) == (2, "mine")
    assert err == f"hostlink: --output: {output} exists already; name another file, or replace it with --force\n"
    status, out, _ = await run("arduino-library", "-o", str(output), "--only", "std_msgs", "--force")
    assert status == 0
    assert zipfile.is_zipfile(output)
    assert "Add .ZIP Library" in out


async def test_an_error_is_one_line_with_the_next_step(tmp_path: Path) -> None:
    output = str(tmp_path / "x.zip")
    status, _, err = await run("arduino-library", "-o", output, "--only", "geometry_msg")
    assert (status, len(err.splitlines())) == (2, 1)
    assert "no package or type named geometry_msg; similar names: geometry_msgs" in err
    folder = message(tmp_path, "uint8 good\nuint8 1bad\n")
    status, _, err = await run("arduino-library", "-o", output, "--messages", str(folder))
    assert (status, len(err.splitlines())) == (2, 1)
    assert f"{folder}/my_msgs/Gripper.msg:2: '1bad' is not a valid name" in err
    status, _, err = await run("arduino-library", "-o", str(tmp_path / "none" / "x.zip"))
    assert (status, len(err.splitlines())) == (2, 1)
    assert "cannot be written: No such file or directory" in err
    assert names_in(tmp_path) == ["mine"]


@pytest.mark.long
def test_a_wheel_built_from_the_sources_that_are_published_has_the_library(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-d", tmp_path]
    subprocess.run([*build, "-t", "sdist"], cwd=ROOT, check=True, capture_output=True)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as archive:
        archive.extractall(tmp_path / "sources", filter="data")
    sources = next((tmp_path / "sources").iterdir())
    subprocess.run([*build, "-t", "wheel"], cwd=sources, check=True, capture_output=True)
    installed = tmp_path / "installed"
    shutil.unpack_archive(next(tmp_path.glob("*.whl")), installed, "zip")
    code = "import sys; sys.path.insert(0, sys.argv.pop(1)); from hostlink.cli.main import main; main()"
    command = [sys.executable, "-c", code, installed, "arduino-library", "--only", "std_msgs", "-o", "x.zip"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    with zipfile.ZipFile(tmp_path / "x.zip") as archive:
        assert archive.read("hostlink_rosserial/LICENSE") == (ROOT / "LICENSE").read_bytes()
        for path in (ROOT / "firmware" / "rosserial" / "src").rglob("*.cpp"):
            packed = archive.read(f"hostlink_rosserial/src/{path.relative_to(ROOT / 'firmware/rosserial/src')}")
            assert packed == path.read_bytes()
