"""`make compiled`: the wheel of the same sources compiled with mypyc, for this machine and this Python.

Builds in a copy of the sources: the extension modules that the build leaves next to them would hide later changes from
everything that runs from the source tree.
"""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "compiled"
SOURCES = ("LICENSE", "README.md", "firmware/rosserial", "hostlink", "pyproject.toml")
UNUSED = shutil.ignore_patterns("__pycache__", "node_modules", "src")  # the page's sources are not in the wheel


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--into", type=Path, default=ROOT / "dist", help="folder of the wheel")
    wheel = build(parser.parse_args().into)
    print(f"{wheel}: {wheel.stat().st_size / 1e6:.2f} MB")
    return 0


def build(into: Path) -> Path:
    """Return the wheel.

    Raises:
        subprocess.CalledProcessError: the sources cannot be compiled; stderr says why.
    """
    shutil.rmtree(FOLDER, ignore_errors=True)
    for name in SOURCES:
        target = FOLDER / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            ignore = UNUSED if name == "hostlink" else None
            shutil.copytree(ROOT / name, target, ignore=ignore)
        else:
            shutil.copy(ROOT / name, target)
    words = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(into.resolve())]
    subprocess.run(words, cwd=FOLDER, env={**os.environ, "HATCH_BUILD_HOOKS_ENABLE": "1"}, check=True)
    return max(into.glob("*linux*.whl"), key=lambda wheel: wheel.stat().st_mtime)


if __name__ == "__main__":
    sys.exit(main())
