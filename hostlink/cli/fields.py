"""Fields of a message: one by its path, all of them as a row, numbers with the digits that a person reads. Pure."""

import csv
import io
import json
import re
from collections.abc import Iterable, Iterator
from typing import Any

from hostlink.errors import HostlinkError

DIGITS = 6  # after the point of what is 1 or more, and significant ones below: a float32 has no more
_STEP = re.compile(r"([^.\[\]]+)|\[(\d{1,9})\]")


def field_of(message: Any, path: str) -> Any:
    """The value at a path, as pose.position.x or ranges[0].

    Raises:
        HostlinkError: there is no such field; it names those that there are.
    """
    value = message
    for name, index in _STEP.findall(path):
        if isinstance(value, dict) and name in value:
            value = value[name]
        elif isinstance(value, list) and (index or name).isdecimal() and int(index or name) < len(value):
            value = value[int(index or name)]
        else:
            raise HostlinkError(f"no field {path}: there is {_known(value)}")
    return value


def _known(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(value) or "none"
    return f"a list of {len(value)}" if isinstance(value, list) else "a single value"


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """(path, value) of every field that has no fields of its own; a list is one of them."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flat(inner, f"{name}.{key}" if name else key)
    else:
        yield name, value


def csv_line(cells: Iterable[Any]) -> str:
    """A line of a table; lists are JSON."""
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(
        json.dumps(cell) if isinstance(cell, list | dict | bool) else cell for cell in cells
    )
    return line.getvalue()


def readable(value: Any) -> Any:
    """The value with the digits that a person reads."""
    if isinstance(value, dict):
        return {key: readable(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [readable(inner) for inner in value]
    if isinstance(value, float):
        return round(value, DIGITS) if abs(value) >= 1 else float(f"{value:.{DIGITS}g}")
    return value
