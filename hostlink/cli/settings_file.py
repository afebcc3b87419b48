"""Changes of single settings in a TOML file that a person wrote. The rest is kept, and a copy of the old file."""

import contextlib
import copy
import os
import re
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hostlink.cli.settings import load
from hostlink.core.runtime.text_file import read_text
from hostlink.core.runtime.whole_file import put_in_place
from hostlink.errors import ConfigError

Tables = Mapping[str, Mapping[str, str]]  # header -> key -> value, each as TOML writes it
_HEADER = re.compile(r"^\s*\[\s*(?P<name>[^\[\]]+?)\s*\]\s*(#.*)?$")


def toml_lines(tables: Tables) -> list[str]:
    """Lines of the tables, as TOML has them."""
    lines: list[str] = []
    for header, values in tables.items():
        lines += [f"[{header}]", *(f"{key} = {value}" for key, value in values.items())]
    return lines


def write_settings(path: Path, tables: Tables) -> Path:
    """Write settings into the file; return the path of the copy of the old one.

    Raises:
        ConfigError: the file cannot be read or written, or has such a setting in a form that cannot be changed here.
    """
    with _refused(path):
        file = path.resolve()  # what a link points to, not the link
        return _replace(file, _text_with(file, tables))


def require_changeable(path: Path, tables: Tables) -> None:
    """Refuse a file that cannot be changed, before the values are measured.

    Raises:
        ConfigError: `write_settings` would fail with settings of these names.
    """
    with _refused(path):
        file = path.resolve()
        _text_with(file, tables)
        if not os.access(file.parent, os.W_OK):
            raise PermissionError(f"{file.parent} cannot be written")


def changed(text: str, tables: Tables) -> str:
    """Return the text with these settings. A line of the same key is replaced; a missing table is added."""
    lines = text.removesuffix("\n").split("\n") if text else []  # TOML has no other ends of lines
    for header, values in tables.items():
        for key, value in values.items():
            lines = _set(lines, header, key, value)
    return "\n".join(lines) + "\n"


@contextlib.contextmanager
def _refused(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(str(path), f"the file is not changed: {error}") from error


def _text_with(file: Path, tables: Tables) -> str:
    """Return the file's text with these settings and its own line endings."""
    before = read_text(file)
    newline = "\r\n" if "\r\n" in before else "\n"
    plain = before.replace(newline, "\n")
    after = changed(plain, tables)
    if not _is_only_changed(plain, after, tables):
        raise ConfigError(
            str(file), f"hostlink cannot change this file; write into it yourself: {'; '.join(toml_lines(tables))}"
        )
    return after.replace("\n", newline)


def _set(lines: list[str], header: str, key: str, value: str) -> list[str]:
    start = next((number for number, line in enumerate(lines) if _is_header(line, header)), None)
    if start is None:
        return [*lines, *([""] if lines and lines[-1] else []), f"[{header}]", f"{key} = {value}"]
    for number in range(start + 1, len(lines)):
        if lines[number].lstrip().startswith("["):
            break
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[number]):
            return [*lines[:number], f"{key} = {value}{_comment_of(lines[number])}", *lines[number + 1 :]]
    return [*lines[: start + 1], f"{key} = {value}", *lines[start + 1 :]]


def _comment_of(line: str) -> str:
    """Return the comment behind a setting, with the blanks before it. A `#` within a string does not begin one."""
    for found in re.finditer(r"\s*#", line):
        with contextlib.suppress(tomllib.TOMLDecodeError):
            tomllib.loads(line[: found.start()])
            return line[found.start() :]
    return ""


def _is_header(line: str, header: str) -> bool:
    found = _HEADER.match(line)
    return found is not None and _names(found["name"]) == _names(header)


def _names(header: str) -> Any:
    try:
        return tomllib.loads(f"[{header}]")
    except tomllib.TOMLDecodeError:
        return header


def _is_only_changed(before: str, after: str, tables: Tables) -> bool:
    """Whether `after` has these settings, and all others of `before`."""
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
    """Replace the file by a new one, which must be a configuration that the daemon accepts."""
    beside, backup = path.with_name(f"{path.name}.new"), path.with_name(f"{path.name}.before")
    number = 2
    while backup.exists():
        number, backup = number + 1, path.with_name(f"{path.name}.before{number}")
    try:
        shutil.copy2(path, beside)
        owner = path.stat()
        os.chown(
            beside, owner.st_uid, owner.st_gid
        )  # a copy that root makes belongs to root, but the daemon may run as another user
        beside.write_bytes(text.encode())
        load(beside)
        shutil.copy2(path, backup)
        put_in_place(beside, path)
    finally:
        beside.unlink(missing_ok=True)
    return backup
