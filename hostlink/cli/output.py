"""Output of the commands. It contains names and texts of devices and programs: none of them steers a terminal."""

import contextlib
import json
import os
import sys
from typing import Any, TextIO

_CLEAR_LINE = "\r\x1b[2K"


def plain(text: str) -> str:
    """The text in one line; what is not printable is escaped as in JSON, so that JSON stays the JSON that it was.

    That is controls, ESC and the C1 of old terminals, what turns the direction of reading, and ends of lines.
    """
    return text if text.isprintable() else "".join(map(_escaped, text))


def write(*lines: str) -> None:
    """Write lines on standard output, now."""
    _write(sys.stdout, "".join(f"{plain(line)}\n" for line in lines))


def write_error(*lines: str) -> None:
    """Write lines on standard error, now."""
    _write(sys.stderr, "".join(f"{plain(line)}\n" for line in lines))


def write_over(line: str) -> None:
    """Write a line over the one before on a terminal; elsewhere a line each."""
    _write(sys.stdout, f"{_CLEAR_LINE}{plain(line)}" if sys.stdout.isatty() else f"{plain(line)}\n")


def show_question(text: str) -> None:
    """Write on standard error what somebody at the terminal answers behind it."""
    _write(sys.stderr, plain(text))


def show_progress(line: str) -> None:
    """On a terminal, a line of standard error that is written over; elsewhere nobody waits for it."""
    if sys.stderr.isatty():
        _write(sys.stderr, f"{_CLEAR_LINE}{_fitting(plain(line), sys.stderr)}")


def _fitting(line: str, terminal: TextIO) -> str:
    """As much of it as fits: of a line that wraps, only the end would be written over."""
    with contextlib.suppress(OSError):
        if columns := os.get_terminal_size(terminal.fileno()).columns:
            return line[: columns - 1]
    return line


def _escaped(char: str) -> str:
    return char if char.isprintable() else json.dumps(char)[1:-1]


def _write(stream: TextIO, text: str) -> None:
    stream.write(text)
    stream.flush()


def table(head: list[str], rows: list[list[Any]]) -> list[str]:
    """Columns under a head; nothing where there are no rows."""
    if not rows:
        return []
    cells = [head, *([plain(str(cell)) for cell in row] for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    return [
        "",
        *("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells),
    ]
