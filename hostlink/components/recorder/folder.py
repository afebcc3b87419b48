"""Folder of recordings, and its disk budget: the oldest files are removed first, never one being written."""

import contextlib
import errno
import os
import re
import shutil
import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from hostlink.core.runtime.folders import FolderOwner, state_folder
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadRequest

SUFFIX = ".mcap"
MEGABYTE = 1_000_000
NAME_PATTERN = r"^[A-Za-z0-9]([A-Za-z0-9_+-]|\.(?!\.)){0,99}$"  # cannot leave the folder

# -- disk budget ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StoredFile:
    """File of the folder."""

    name: str
    size_bytes: int
    modified_s: float
    is_open: bool = False


def over_budget(files: Iterable[StoredFile], budget_bytes: int) -> list[str]:
    """Return the names of the files to remove so that the rest fits the budget, oldest first."""
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


def default_folder() -> Path:
    """Return the default folder of recordings."""
    return state_folder() / "recordings"


def file_stamp(stamp_ns: int) -> str:
    """Return a wall time for the name of a file, in UTC: `2026-11-22T07-40-57Z`."""
    return time.strftime("%Y-%m-%dT%H-%M-%SZ", time.gmtime(stamp_ns // NS_PER_S))


def is_name(name: str) -> bool:
    """Whether a recording may have this name: not a path, and no leading dot."""
    return re.fullmatch(NAME_PATTERN, name, re.ASCII) is not None


def check_name(name: str) -> str:
    """Return the name of a recording without its suffix.

    Raises:
        BadRequest: the name is invalid.
    """
    if not is_name(name):
        raise BadRequest(
            "invalid recording name; use at most 100 letters, digits and . _ + -, and begin with a letter or digit"
        )
    return name.removesuffix(SUFFIX)


@dataclass(frozen=True, slots=True)
class DiskUsage:
    """Disk space: used and allowed for a folder, free and to be kept free on its disk."""

    used_bytes: int
    budget_bytes: int
    free_bytes: int
    min_free_bytes: int


class Folder:
    """Folder of recordings. Every method raises the OSError of the disk."""

    def __init__(
        self, path: Path, *, max_disk_mb: float, min_free_disk_mb: float, owner: FolderOwner | None = None
    ) -> None:
        """`owner`: the daemon's claim on the folder; None: another process did not end yet, and this one helps it."""
        self.path, self.owner = path, owner
        self.max_disk_mb, self.min_free_disk_mb = max_disk_mb, min_free_disk_mb

    def file(self, name: str, number: int) -> Path:
        """Return the path of a recording's file with this number, from 0."""
        return self.path / (f"{name}_{number + 1}{SUFFIX}" if number else f"{name}{SUFFIX}")

    def files(self, is_open: Collection[Path] = ()) -> list[StoredFile]:
        """List the recordings, oldest first."""
        if not self.path.is_dir():
            return []
        found = []
        for entry in os.scandir(self.path):
            with contextlib.suppress(FileNotFoundError):  # removed meanwhile
                if entry.name.endswith(SUFFIX) and entry.is_file():
                    facts = entry.stat()
                    is_written = self.path / entry.name in is_open
                    found.append(StoredFile(entry.name, facts.st_size, facts.st_mtime, is_open=is_written))
        return sorted(found, key=lambda file: (file.modified_s, file.name))

    def find(self, name: str) -> Path | None:
        """Return the file of that name, with or without its suffix; None if there is none."""
        if not is_name(name):
            return None
        path = self.path / f"{name.removesuffix(SUFFIX)}{SUFFIX}"
        return path if path.is_file() else None

    def usage(self) -> DiskUsage:
        """Disk usage of the folder, or of the place where it would be created."""
        there = next(path for path in (self.path, *self.path.parents) if path.exists())
        return DiskUsage(
            used_bytes=sum(file.size_bytes for file in self.files()),
            budget_bytes=int(self.max_disk_mb * MEGABYTE),
            free_bytes=shutil.disk_usage(there).free,
            min_free_bytes=int(self.min_free_disk_mb * MEGABYTE),
        )

    def claim(self) -> None:
        """Check, before the folder is changed, that no other daemon owns it.

        Raises:
            FolderTaken: another daemon owns it.
            OSError: the disk failed.
        """
        if self.owner is not None:
            self.owner.claim()

    def make_room(self, is_open: Collection[Path]) -> list[str]:
        """Remove the oldest recordings above the budget. Return their names.

        Raises:
            FolderTaken: another daemon owns the folder.
            OSError: less than `min_free_disk_mb` is free afterwards, or the folder cannot be created.
        """
        self.claim()
        self.path.mkdir(parents=True, exist_ok=True)
        gone = over_budget(self.files(is_open), int(self.max_disk_mb * MEGABYTE))
        for name in gone:
            (self.path / name).unlink(missing_ok=True)
        self._check_free()
        return gone

    def check(self) -> None:
        """Check that a recording can be written. The folder is created, also after it was removed.

        Raises:
            FolderTaken: another daemon owns the folder.
            OSError: it cannot be created or written to, or less than `min_free_disk_mb` is free.
        """
        self.claim()
        self.path.mkdir(parents=True, exist_ok=True)
        if not os.access(self.path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "it cannot be written to")
        self._check_free()

    def _check_free(self) -> None:
        free_mb = shutil.disk_usage(self.path).free / MEGABYTE
        if free_mb < self.min_free_disk_mb:
            least = self.min_free_disk_mb
            raise OSError(f"{free_mb:.0f} MB of disk space are free, less than min_free_disk_mb = {least:g}")
