"""Compiled programs in build/ that all workers share, and that later runs use while no source has changed."""

import fcntl
import hashlib
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"
SOURCES = ("firmware", "hostlink/board", "hostlink/messages", "tests/firmware", "tests/support/compilers.py")
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
