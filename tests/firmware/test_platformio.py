"""Both sketches with PlatformIO's own functions: found, converted, and compiled with everything that belongs to them.

Its platforms, with the boards' cores and compilers, are not there: the stand-ins of firmware/host take their place.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.firmware.due import ROOT
from tests.support.compilers import SKETCH_WARNINGS, run

FIRMWARE = ROOT / "firmware"
BOARDS = [("due", "due"), ("esp8266", "nodemcuv2"), ("esp8266", "d1_mini")]
CORE = {
    "due": ["-std=gnu++11", "-DARDUINO_ARCH_SAM", f"-I{FIRMWARE}/host/due_arduino", f"-I{FIRMWARE}/rosserial/src"],
    "esp8266": ["-std=gnu++17", f"-I{FIRMWARE}/host/arduino", f"-I{FIRMWARE}/rosserial/src"],
}


def built(env: str, folder: Path) -> dict[str, Any]:
    """PlatformIO's result for the folder."""
    command = [sys.executable, "-m", "tests.firmware.platformio_build", env]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def copied(sketch: str, folder: Path) -> Path:
    """The sketch as a user has it."""
    shutil.copytree(FIRMWARE / sketch, folder / sketch)
    if sketch == "esp8266":
        shutil.copy(folder / sketch / "settings.example.h", folder / sketch / "settings.h")
    return folder / sketch


@pytest.mark.parametrize(("sketch", "env"), BOARDS)
def test_platformio_finds_the_sketch_and_all_of_its_sources(sketch: str, env: str, tmp_path: Path) -> None:
    folder = copied(sketch, tmp_path)
    found = built(env, folder)
    own = {str(path.relative_to(folder)) for path in (folder / "src").rglob("*.cpp")}
    assert found["sketches"] == [f"{sketch}.ino"]
    assert set(found["sources"]) == {f"{sketch}.ino.cpp", *own}


@pytest.mark.parametrize(("sketch", "env"), BOARDS)
def test_the_sketch_compiles_as_platformio_converts_it(sketch: str, env: str, tmp_path: Path) -> None:
    folder = copied(sketch, tmp_path)
    converted = built(env, folder)["converted"][f"{sketch}.ino.cpp"]
    (folder / "converted.cpp").write_text(converted)
    run(["g++", *CORE[sketch], *SKETCH_WARNINGS, "-fsyntax-only", folder / "converted.cpp"])


def test_platformio_finds_no_sketch_below_the_top_of_its_sources(tmp_path: Path) -> None:
    """The reason for a platformio.ini next to each sketch, and none above them."""
    (copied("due", tmp_path) / "platformio.ini").rename(tmp_path / "platformio.ini")
    assert built("due", tmp_path)["sketches"] == []
