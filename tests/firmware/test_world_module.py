"""The module firmware.wasm is made of these sources: compiled again, it has the same bytes."""

import subprocess
from functools import cache
from pathlib import Path

import pytest

from tools.build_world import CLANG, MODULE, build
from tools.built_stale import BUILT, Built


@cache
def clang_version() -> str:
    done = subprocess.run(["clang++", "-dumpversion"], capture_output=True, text=True, check=True)
    return done.stdout.partition(".")[0]


def test_module_has_the_digest_of_its_sources() -> None:
    assert not BUILT["world"].is_stale(), "run  make world"
    names = {path.name for path in BUILT["world"].files()}
    assert {"world.cpp", "wheel.h", "node.cpp", "build_world.py", "firmware.wasm"} <= names


@pytest.mark.parametrize("changed", ["source.cpp", "made.wasm"])
def test_change_of_a_source_or_of_what_was_made_is_found(tmp_path: Path, changed: str) -> None:
    built = Built(tmp_path, "made.wasm", "digest", ("*.cpp",), frozenset({"other.cpp"}))
    for name in ("source.cpp", "other.cpp", "made.wasm"):
        (tmp_path / name).write_text(name)
    assert built.is_stale()
    built.write_digest()
    (tmp_path / "other.cpp").write_text("something else")
    assert not built.is_stale()
    (tmp_path / changed).write_text("something else")
    assert built.is_stale()


@pytest.mark.long
def test_module_built_again_has_the_same_bytes(tmp_path: Path) -> None:
    if clang_version() != CLANG:
        pytest.skip(f"clang {clang_version()} makes other bytes than clang {CLANG}, which the module is built with")
    build(tmp_path / "again.wasm")
    assert (tmp_path / "again.wasm").read_bytes() == MODULE.read_bytes()
