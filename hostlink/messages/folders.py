"""Folders of .msg and .srv files: which type stands in which file."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hostlink.errors import ConfigError

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
    for kind in ("msg", "srv"):
        if _files(folder / kind, f".{kind}") or _files(folder, f".{kind}"):
            raise ConfigError(str(folder), "this is a package; give the folder that it stands in")


def read_definition(path: Path) -> str:
    """The text of the file."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(str(path), error.strerror or "cannot be read") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}", "not UTF-8") from None


def _packages(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.iterdir()) if path.is_dir())


def _files(folder: Path, suffix: str) -> list[Path]:
    """The definitions right in the folder."""
    paths = sorted(folder.glob(f"*{suffix}"))
    for path in paths:
        if not _NAME.fullmatch(path.stem) or not _NAME.fullmatch(folder.name):
            raise ConfigError(str(path), "no name for a type: letters, digits and _, a letter first")
    return paths
