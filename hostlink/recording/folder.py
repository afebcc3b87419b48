"""Which recordings go when there is no room: the oldest first, never one that is being written."""

import contextlib
import os
import re
import shutil
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from hostlink.errors import BadRequest

# -- disk budget ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StoredFile:
    """One file of the folder."""

    name: str
    size_bytes: int
    modified_s: float
    is_open: bool = False


def over_budget(files: Iterable[StoredFile], budget_bytes: int) -> list[str]:
    """The names of the files that must go, so that the others fit, oldest first."""
    kept = sorted(files, key=lambda file: (file.modified_s, file.name))
    total_bytes = sum(file.size_bytes for file in kept)
    gone = []
    for file in kept:
        if total_bytes <= budget_bytes:
            break
        if not file.is_open:
            gone.append(file.name)
            total_bytes -= file.size_bytes
    return gone


# -- folder -----------------------------------------------------------------------------------------------------------

SUFFIX = ".mcap"
MEGABYTE = 1_000_000
NAME_PATTERN = r"^[A-Za-z0-9]([A-Za-z0-9_+-]|\.(?!\.)){0,99}$"  # no way out of the folder


def default_folder() -> Path:
    """systemd's for a service, else the user's, as the XDG base directories have it."""
    of_service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return (Path(of_service) if of_service else state / "hostlink") / "recordings"


def is_name(name: str) -> bool:
    """Whether a recording may be called so: no path, and nothing that begins with a dot."""
    return re.fullmatch(NAME_PATTERN, name, re.ASCII) is not None


def check_name(name: str) -> str:
    """The name of a recording, without its suffix.

    Raises:
        BadRequest: it is none.
    """
    if not is_name(name):
        raise BadRequest("a recording's name has letters, digits, and . _ + - between them, 100 at most")
    return name.removesuffix(SUFFIX)


@dataclass(frozen=True, slots=True)
class DiskUsage:
    """What the files of a folder take, and what its disk has left."""

    used_bytes: int
    budget_bytes: int
    free_bytes: int
    min_free_bytes: int


class Folder:
    """Its files; every method raises the OSError of the disk."""

    def __init__(self, path: Path, *, max_disk_mb: float, min_free_disk_mb: float) -> None:
        self.path = path
        self.max_disk_mb, self.min_free_disk_mb = max_disk_mb, min_free_disk_mb

    def file(self, name: str, number: int) -> Path:
        """Of a recording, its file of that number from 0."""
        return self.path / (f"{name}_{number + 1}{SUFFIX}" if number else f"{name}{SUFFIX}")

    def files(self, is_open: Collection[Path] = ()) -> list[StoredFile]:
        """The recordings in it, oldest first."""
        if not self.path.is_dir():
            return []
        found = []
        for entry in os.scandir(self.path):
            with contextlib.suppress(FileNotFoundError):  # it was removed meanwhile
                if entry.name.endswith(SUFFIX) and entry.is_file():
                    facts = entry.stat()
                    is_written = self.path / entry.name in is_open
                    found.append(StoredFile(entry.name, facts.st_size, facts.st_mtime, is_open=is_written))
        return sorted(found, key=lambda file: (file.modified_s, file.name))

    def find(self, name: str) -> Path | None:
        """The file of that name, with or without its suffix."""
        if not is_name(name):
            return None
        path = self.path / f"{name.removesuffix(SUFFIX)}{SUFFIX}"
        return path if path.is_file() else None

    def usage(self) -> DiskUsage:
        """Of the folder, or of where it would be made."""
        there = next(path for path in (self.path, *self.path.parents) if path.exists())
        return DiskUsage(
            used_bytes=sum(file.size_bytes for file in self.files()),
            budget_bytes=int(self.max_disk_mb * MEGABYTE),
            free_bytes=shutil.disk_usage(there).free,
            min_free_bytes=int(self.min_free_disk_mb * MEGABYTE),
        )

    def make_room(self, is_open: Collection[Path]) -> list[str]:
        """Remove the oldest recordings over the budget; returns their names.

        Raises:
            OSError: less than `min_free_disk_mb` are free all the same, or the folder cannot be made.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        gone = over_budget(self.files(is_open), int(self.max_disk_mb * MEGABYTE))
        for name in gone:
            (self.path / name).unlink(missing_ok=True)
        free_mb = shutil.disk_usage(self.path).free / MEGABYTE
        if free_mb < self.min_free_disk_mb:
            least = self.min_free_disk_mb
            raise OSError(f"{free_mb:.0f} MB are free on its disk, less than min_free_disk_mb = {least:g}")
        return gone
