"""Checks whether the built page (hostlink/api/web/built) is the one of the sources beside it; needs no Node.

`make web` writes a digest of every file that the page is made of and of what was made; `make check` compares.
"""

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

WEB = Path(__file__).parent.parent / "hostlink" / "api" / "web"
BUILT = WEB / "built"
DIGEST = BUILT / "digest.txt"
SOURCES = ("index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts", "src", "public")


def digest() -> str:
    """One line for all files, whatever their order on the disk and their ends of line."""
    total = hashlib.sha256()
    for path in sorted(files()):
        content = path.read_bytes().replace(b"\r\n", b"\n")
        total.update(f"{path.relative_to(WEB).as_posix()} {hashlib.sha256(content).hexdigest()}\n".encode())
    return total.hexdigest()


def files() -> Iterator[Path]:
    """What the page is made of, and what was made."""
    for name in (*SOURCES, "built"):
        source = WEB / name
        for path in source.rglob("*") if source.is_dir() else [source]:
            if path.is_file() and path != DIGEST:
                yield path


def main(arguments: list[str]) -> int:
    """`--write` after a build; without, 1 when the page is stale."""
    if arguments == ["--write"]:
        DIGEST.write_text(digest() + "\n", encoding="utf-8")
    elif not DIGEST.exists() or DIGEST.read_text(encoding="utf-8").strip() != digest():
        sys.stderr.write(
            f"{BUILT.relative_to(WEB.parents[2])} is not built from the sources beside it: run  make web\n"
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
