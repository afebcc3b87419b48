"""Folders of .msg and .srv files: which type stands in which file."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hostlink.errors import ConfigError

KINDS: Final = ("msg", "srv")
_DEEPER: Final = ("*/*/{0}/*.{0}", "*/*/*/{0}/*.{0}")  # as in the sources of a catkin workspace
SUFFIXES: Final = tuple(f".{kind}" for kind in KINDS)
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def find_definitions(folder: Path, suffix: str) -> dict[str, Path]:
    """The files below the folder by the name of their type: <package>/msg/Type.msg or <package>/Type.msg."""
    kind = suffix.removeprefix(".")
    found: dict[str, Path] = {}
    for package in _packages(folder):
        for path in (*_files(package, suffix), *_files(package / kind, suffix)):
            found[f"{package.name}/{path.stem}"] = path
    return found


def check_folder(folder: Path) -> None:
    """ConfigError where a folder of the user's is not what he thinks it is."""
    if not folder.is_dir():
        raise ConfigError(str(folder), "no such folder")
    for kind in KINDS:
        if _files(folder / kind, f".{kind}") or _files(folder, f".{kind}"):
            raise ConfigError(str(folder), "this is a package; give the folder that it stands in")


def check_not_empty(folder: Path) -> None:
    """Check a folder that was named for the definitions in it.

    Raises:
        ConfigError: no package right in the folder has one.
    """
    if any(find_definitions(folder, suffix) for suffix in SUFFIXES):
        return
    for pattern in _DEEPER:  # somebody may give the root of his disk
        for kind in KINDS:
            if found := min(folder.glob(pattern.format(kind)), default=None):
                place = found.parents[2]
                raise ConfigError(str(folder), f"its packages are deeper; give the folder of each, as {place}")
    raise ConfigError(str(folder), "no package with .msg or .srv files is in it")


def read_definition(path: Path) -> str:
    """The text of the file."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(str(path), error.strerror or "cannot be read") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}", "not UTF-8") from None


def _packages(folder: Path) -> Iterator[Path]:
    return (path for path in _entries(folder) if path.is_dir())


def _files(folder: Path, suffix: str) -> list[Path]:
    """The definitions right in the folder; none where it is not there."""
    try:
        entries = _entries(folder)
    except ConfigError:
        if _NAME.fullmatch(folder.parent.name if folder.name in KINDS else folder.name):  # lost+found is no package
            raise
        return []
    paths = [path for path in entries if path.suffix == suffix]
    for path in paths:
        if not _NAME.fullmatch(path.stem) or not _NAME.fullmatch(folder.name):
            raise ConfigError(str(path), "no name for a type: letters, digits and _, a letter first")
    return paths


def _entries(folder: Path) -> list[Path]:
    """What is in the folder and not hidden; nothing where it is no folder.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise ConfigError(str(folder), error.strerror or "cannot be read") from None
