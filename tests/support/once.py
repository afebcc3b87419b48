"""Compiled programs in build/ that all workers share, and that later runs use while no source has changed."""

import fcntl
import hashlib
import shutil
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from tests.support import compilers

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"
SOURCES = ("firmware", "hostlink/board", "hostlink/core/messages", "tests/firmware", "tests/support/compilers.py")
COMPILERS = ("cmake", "g++", "clang++", "arm-none-eabi-g++", "avr-g++")


def once(name: str, make: Callable[[], object], result: Path) -> None:
    """Call `make` in the first worker if `result` is missing or older sources made it. The others wait for it.

    A failed `make` is repeated by the next worker.
    """
    BUILD.mkdir(exist_ok=True)
    with (BUILD / f"{name}.made").open("a+") as made:
        fcntl.flock(made, fcntl.LOCK_EX)
        made.seek(0)
        if made.read() != digest() or not result.exists():
            made.truncate(0)
            make()
            made.write(digest())


def compiled(command: Sequence[object], result: Path, *inputs: Path) -> None:
    """Run a compiler that writes `result`, or copy what the same command made of the same inputs before.

    Args:
        command: compiler and its options, with `result` and paths in or of `inputs`
        result: file that the command writes; an empty one stays, if it only checks
        inputs: all files and folders of the repository and of the test that the compiler may read

    Raises:
        AssertionError: the compiler failed, or it wrote a warning. Nothing is kept then.
    """
    found = hashlib.sha256(f"{[shutil.which(str(command[0])), digest()]}".encode())
    for number, each in enumerate(inputs):
        for path in sorted(file for file in (each, *each.rglob("*")) if file.is_file()):
            found.update(f"{number} {path.relative_to(each)}\0{path.stat().st_size}\0".encode() + path.read_bytes())
    text = " ".join(map(str, command)).replace(str(result), "<result>")
    for number, each in enumerate(inputs):
        text = text.replace(str(each), f"<{number}>")
    found.update(text.encode())
    kept = BUILD / "compiled" / found.hexdigest()
    kept.parent.mkdir(parents=True, exist_ok=True)
    with kept.with_suffix(".lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            result.touch()
            compilers.run(command)
            shutil.copy(result, kept.with_suffix(".new"))
            kept.with_suffix(".new").rename(kept)
    shutil.copy(kept, result)


@cache
def digest() -> str:
    """Return a digest of all sources of compiled programs, and of the compilers."""
    found = hashlib.sha256()
    for folder in SOURCES:
        for path in (ROOT / folder, *sorted((ROOT / folder).rglob("*"))):
            if path.is_file() and "__pycache__" not in path.parts:
                found.update(f"{path.relative_to(ROOT)}\0{path.stat().st_size}\0".encode())
                found.update(path.read_bytes())
    for compiler in COMPILERS:
        file = shutil.which(compiler)
        found.update(f"{compiler}\0{Path(file).stat().st_mtime_ns if file else 0}\0".encode())
    return found.hexdigest()
