"""Checks whether built files in the repository are of the present sources, without Node or a compiler.

The page (`make web`) and the firmware in its world (`make world`) have a digest of every file that they are made of and
of what was made; `make check` compares.
"""

import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Built:
    """Built files of one target of make."""

    folder: Path
    made: str  # below it, as are the others
    digest: str
    patterns: tuple[str, ...]  # of its sources
    without: frozenset[str] = frozenset()

    def files(self) -> set[Path]:
        """Return the sources and the built files."""
        patterns = (*self.patterns, self.made, f"{self.made}/**/*")
        found = {path for pattern in patterns for path in self.folder.glob(pattern) if path.is_file()}
        return found - {self.folder / name for name in (self.digest, *self.without)}

    def compute_digest(self) -> str:
        """Return one digest of all files, independent of their order on the disk and their line ends."""
        total = hashlib.sha256()
        for path in sorted(self.files()):
            content = path.read_bytes().replace(b"\r\n", b"\n")
            total.update(f"{path.relative_to(self.folder).as_posix()} {hashlib.sha256(content).hexdigest()}\n".encode())
        return total.hexdigest()

    def is_stale(self) -> bool:
        """Whether a source, or what was made, has changed since the build."""
        digest = self.folder / self.digest
        return not digest.exists() or digest.read_text(encoding="utf-8").strip() != self.compute_digest()

    def write_digest(self) -> None:
        """After a build."""
        (self.folder / self.digest).write_text(self.compute_digest() + "\n", encoding="utf-8")


BUILT = {
    "web": Built(
        ROOT / "hostlink" / "components" / "gateway" / "web",
        "built",
        "built/digest.txt",
        (
            "index.html",
            "package.json",
            "package-lock.json",
            "tsconfig.json",
            "vite.config.ts",
            "src/**/*",
            "public/**/*",
        ),
    ),
    "world": Built(
        ROOT,
        "hostlink/workbench/sim/firmware.wasm",
        "hostlink/workbench/sim/firmware.digest",
        (
            "tools/build_world.py",
            "firmware/host/*.cpp",
            "firmware/host/*.h",
            "firmware/due/src/*.cpp",
            "firmware/due/src/*.h",
            "firmware/rosserial/src/ros/*",
        ),
        frozenset({"firmware/host/main.cpp", "firmware/host/activity_recorder.h"}),  # of due_native alone
    ),
}


def main(arguments: list[str]) -> int:
    """`--write TARGET` after a build; without, 1 when something is stale."""
    if arguments[:1] == ["--write"]:
        for target in arguments[1:]:
            BUILT[target].write_digest()
        return 0
    stale = [target for target, built in BUILT.items() if built.is_stale()]
    for target in stale:
        made = BUILT[target].folder / BUILT[target].made
        sys.stderr.write(f"{made.relative_to(ROOT)} is not built from the sources beside it: run  make {target}\n")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
