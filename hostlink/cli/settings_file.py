"""Settings that a program writes into a person's TOML file: the rest of it stays as it is, and a copy beside it."""

import copy
import re
import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hostlink.config import load
from hostlink.errors import ConfigError

Tables = Mapping[str, Mapping[str, str]]  # header -> key -> value, each as TOML writes it
_HEADER = re.compile(r"^\s*\[\s*(?P<name>[^\[\]]+?)\s*\]\s*(#.*)?$")


def toml_lines(tables: Tables) -> list[str]:
    """As they stand in a file."""
    lines: list[str] = []
    for header, values in tables.items():
        lines += [f"[{header}]", *(f"{key} = {value}" for key, value in values.items())]
    return lines


def write_settings(path: Path, tables: Tables) -> Path:
    """Set them; returns the copy of the file as it was.

    Raises:
        ConfigError: the file cannot be read or written, or has such a setting in a form that is not changed here.
    """
    try:
        before = path.read_text(encoding="utf-8")
        after = changed(before, tables)
        if not _is_only_changed(before, after, tables):
            raise ConfigError(str(path), f"cannot be changed by hostlink: write there {'; '.join(toml_lines(tables))}")
        return _replace(path, after)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(str(path), f"is not changed: {error}") from error


def changed(text: str, tables: Tables) -> str:
    """The text with these settings; a line of the same key is replaced, a table that is not there is added."""
    lines = text.splitlines()
    for header, values in tables.items():
        for key, value in values.items():
            lines = _set(lines, header, key, value)
    return "\n".join(lines) + "\n"


def _set(lines: list[str], header: str, key: str, value: str) -> list[str]:
    start = next((number for number, line in enumerate(lines) if _is_header(line, header)), None)
    if start is None:
        return [*lines, *([""] if lines and lines[-1] else []), f"[{header}]", f"{key} = {value}"]
    for number in range(start + 1, len(lines)):
        if lines[number].lstrip().startswith("["):
            break
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[number]):
            return [*lines[:number], f"{key} = {value}", *lines[number + 1 :]]
    return [*lines[: start + 1], f"{key} = {value}", *lines[start + 1 :]]


def _is_header(line: str, header: str) -> bool:
    found = _HEADER.match(line)
    return found is not None and _names(found["name"]) == _names(header)


def _names(header: str) -> Any:
    try:
        return tomllib.loads(f"[{header}]")
    except tomllib.TOMLDecodeError:
        return header


def _is_only_changed(before: str, after: str, tables: Tables) -> bool:
    """Whether the file now has these settings, and all others that it had."""
    wanted = copy.deepcopy(tomllib.loads(before))
    for header, values in tables.items():
        _merge(wanted, tomllib.loads("\n".join(toml_lines({header: values}))))
    try:
        return tomllib.loads(after) == wanted
    except tomllib.TOMLDecodeError:
        return False


def _merge(into: dict[str, Any], other: Mapping[str, Any]) -> None:
    for key, value in other.items():
        if isinstance(value, dict) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = value


def _replace(path: Path, text: str) -> Path:
    """Through a file beside it, which must be a configuration that the daemon accepts."""
    beside, backup = path.with_name(f"{path.name}.new"), path.with_name(f"{path.name}.before")
    number = 2
    while backup.exists():
        number, backup = number + 1, path.with_name(f"{path.name}.before{number}")
    shutil.copy2(path, beside)
    try:
        beside.write_text(text, encoding="utf-8")
        load(beside)
        shutil.copy2(path, backup)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return backup
